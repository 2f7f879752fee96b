"""Shot: one image with its views. OpenTarget: a scene or finished frame that makes shots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from lobewise.frame import FloatArray
from lobewise.viewer.messages import Description, Request


@dataclass(frozen=True)
class Shot:
    """One image and how it was made."""

    image: FloatArray
    """Linear radiance, shape (height, width, 3)."""
    get_view: Callable[[str], FloatArray]
    """Return a view by its name: radiance or colours, (height, width, 3), or numbers in [0, 1], (height, width)."""
    size: tuple[int, int]
    """Columns and rows."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time by stage, "total" among them."""
    accumulated: int = 1
    """Frames in the mean."""
    recomputed: int = 0
    """Pixels that were shaded again."""
    moment: float | None = None
    """Moment of the objects' motion, frames from 0; None if nothing moves."""


class OpenTarget(Protocol):
    """A scene or a finished frame that is open in the worker. Every browser has its own state."""

    def describe(self) -> Description:
        """Return the properties of the target."""

    def is_slow(self, request: Request) -> bool:
        """Return whether `render` will take so long that `show_input` should be shown meanwhile."""

    def show_input(self, request: Request) -> list[Shot]:
        """Return the unfiltered image, to be shown until `render` is done."""

    def render(self, request: Request) -> list[Shot]:
        """Return one shot, or two for the wipe."""

    def forget(self, client: int) -> None:
        """Drop the state of a browser."""

    def write(self, client: int, folder: Path) -> Path:
        """Write the image that a browser sees into an EXR file in ``folder``; return its path."""
