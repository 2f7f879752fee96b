"""Exit code and message of Ctrl-C, and the Ctrl-C signals that the process received."""

from __future__ import annotations

EXIT_INTERRUPTED = 130
INTERRUPTED = "interrupted; every output is whole, or as it was."

interrupts: list[int] = []
"""Numbers of the Ctrl-C signals that this process received. A library may turn KeyboardInterrupt into another error."""
