"""The filters for other people's programs: compiled ahead of time with a C interface, or as shader text."""

from __future__ import annotations

from lobewise.exporting.library import export_library

__all__ = ["export_library"]
