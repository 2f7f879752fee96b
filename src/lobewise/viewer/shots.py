"""Shot: one image that can be shown, and what can be looked at inside it. TargetSession: what makes them."""

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
    """Returns the array of a view by its name: radiance and colours (height, width, 3), numbers (height, width)."""
    size: tuple[int, int]
    """Columns and rows."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time by stage, "total" among them."""
    # Frames averaged, pixels shaded again.
    accumulated: int = 1
    recomputed: int = 0


class OpenTarget(Protocol):
    """A scene or a finished frame, open in the worker; it keeps what each browser needs apart."""

    def describe(self) -> Description:
        """Return what can be chosen."""

    def is_slow(self, request: Request) -> bool:
        """Return whether `show_input` has something to show before `render` is done."""

    def show_input(self, request: Request) -> list[Shot]:
        """Return what is there sooner, for the time until `render` is done."""

    def render(self, request: Request) -> list[Shot]:
        """Return one image, or two of them for the wipe."""

    def forget(self, client: int) -> None:
        """Drop what a browser had."""

    def write(self, client: int, folder: Path) -> Path:
        """Return the EXR file, written into a folder, of what a browser sees."""
