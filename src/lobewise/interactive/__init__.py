"""The interactive chain: guides, direct light, sparse indirect light, upsampling and repair, frame after frame.

Importing this package does not import Mitsuba: its first use does.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lobewise.interactive.frames import InteractiveFrame, InteractiveSettings
    from lobewise.interactive.session import Session

__all__ = ["InteractiveFrame", "InteractiveSettings", "Session"]

_HOMES = {
    "InteractiveFrame": "lobewise.interactive.frames",
    "InteractiveSettings": "lobewise.interactive.frames",
    "Session": "lobewise.interactive.session",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
