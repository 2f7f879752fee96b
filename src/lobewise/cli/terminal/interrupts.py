"""What the program says of Ctrl-C, and how often it came."""

from __future__ import annotations

EXIT_INTERRUPTED = 130
INTERRUPTED = "interrupted; every output is whole, or as it was."

interrupts: list[int] = []
"""Signals of Ctrl-C that this process got: a library may turn the exception of one into another."""
