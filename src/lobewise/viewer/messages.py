"""Messages between the process of the page and the worker, the process that renders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import LobewiseError
from lobewise.interactive.settings import InteractiveSettings
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera


@dataclass(frozen=True)
class FrameReading:
    """How the file of a finished frame is read; the fields are those of `lobewise.read_frame`."""

    preset: PathLike | None = None
    mapping: Mapping[str, str] | None = None
    camera: Camera | None = None
    half: PathLike | None = None
    wraps: bool | None = None

    @property
    def is_given(self) -> bool:
        """Whether any field is set."""
        return self.wraps is not None or any((self.preset, self.mapping, self.camera, self.half))


@dataclass(frozen=True)
class Target:
    """The scene that the viewer shows."""

    name: str
    """A built-in scene or a Mitsuba XML file."""
    size: tuple[int, int] | None = None
    """Columns and rows of the picture; None for the scene's own size."""
    moving: str | None = None
    """File with the paths of the objects, or `lobewise.scenes.BY_THEMSELVES`; None if nothing moves."""


@dataclass(frozen=True)
class Description:
    """The properties of an open target, from which the controls of a page are built."""

    settings: InteractiveSettings
    """The first settings."""
    # Pixels of the picture.
    width: int
    height: int
    camera: Camera
    """The first camera."""
    look_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The point about which an orbit turns."""
    moves: bool = False
    """Whether objects of a scene move."""
    unseen: str = ""
    """A sentence about the parts of a scene that the pictures do not show; empty for none."""


@dataclass(frozen=True)
class Window:
    """The browser's picture area."""

    # Pixels of the picture area.
    width: int = 1
    height: int = 1
    fill: bool = False
    """Whether a picture of another aspect is cropped instead of getting bars."""


@dataclass(frozen=True)
class Request:
    """One picture for one browser."""

    client: int
    """The browser."""
    number: int
    """Counts the requests of the browser."""
    window: Window
    settings: InteractiveSettings
    """Settings of the picture, or of its part left of the wipe."""
    camera: Camera
    other: InteractiveSettings | None = None
    """Settings right of the wipe; None without a wipe."""
    wipe: float = 0.5
    """Position of the line, from 0 at the left to 1 at the right."""
    view: str = "image"
    """One of `lobewise.interactive.settings.VIEWS`."""
    stops: float | None = None
    """Exposure, base-2 logarithm; None to choose it from the image."""
    size: tuple[int, int] = (512, 512)
    """Columns and rows to render."""
    fresh: bool = True
    """Whether a new frame is rendered. If not, the last frame is shown again with another view or window."""
    accumulate: bool = True
    """Whether frames of a camera that stands still are averaged."""
    speed: float = 0.0
    """Frames of the objects' motion by which this picture follows the browser's last one; 0 while they stand still."""


@dataclass(frozen=True)
class Save:
    """A file for a browser to keep: ``kind`` is "exr" or "png"."""

    client: int
    kind: str


@dataclass(frozen=True)
class Forget:
    """A browser went away."""

    client: int


@dataclass(frozen=True)
class Opened:
    """The target is open."""

    description: Description


@dataclass(frozen=True)
class Progress:
    """The current work of the worker, for the status line."""

    text: str


@dataclass(frozen=True)
class Picture:
    """A picture to show, and its figures."""

    client: int
    number: int
    """Number of the request."""
    pixels: NDArray[np.uint8]
    """sRGB, shape (height, width, 3)."""
    size: tuple[int, int]
    """Columns and rows that were rendered."""
    stops: float | None
    """Exposure that was chosen from the image, base-2 logarithm; None where the request named one."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time by stage; "total" is the sum of the stages of rendering."""
    accumulated: int = 1
    """Frames in the mean."""
    recomputed: int = 0
    """Pixels that were shaded again."""
    memory: int = 0
    """Memory of the worker, bytes."""
    moment: float | None = None
    """Moment of the objects' motion, frames from 0; None if nothing moves."""
    final: bool = True
    """Whether the request is done. The noisy input is shown first where a filter takes long."""


@dataclass(frozen=True)
class SavedFile:
    """A file for a browser."""

    client: int
    name: str
    data: bytes


@dataclass(frozen=True)
class Problem:
    """An error; a RuntimeError is one of the program. Without a client the target cannot be shown at all."""

    error: LobewiseError | RuntimeError
    client: int | None = None

    @property
    def text(self) -> str:
        """What to show: one sentence."""
        return str(self.error)


Command = Request | Save | Forget
Report = Opened | Progress | Picture | SavedFile | Problem


def describe_failure(problem: Exception) -> str:
    """Return one line about an error of the program."""
    what = " ".join(f"{type(problem).__name__}: {problem}".split())[:300]
    return f"Something went wrong inside lobewise: {what}"
