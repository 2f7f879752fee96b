"""What travels between the page's process and the one that renders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.io.files import PathLike
from lobewise.viewer.looks import Look


@dataclass(frozen=True)
class FrameReading:
    """How the file of a finished frame is read, where it does not tell: as `lobewise.read_frame` takes it."""

    preset: PathLike | None = None
    mapping: Mapping[str, str] | None = None
    camera: Camera | None = None
    half: PathLike | None = None

    @property
    def is_given(self) -> bool:
        """Whether anything is said of the file."""
        return any((self.preset, self.mapping, self.camera, self.half))


@dataclass(frozen=True)
class Target:
    """What is looked at."""

    name: str
    """A built-in scene, a Mitsuba XML file or an EXR file."""
    is_frame: bool
    """Whether it is a finished frame."""
    size: tuple[int, int] | None = None
    """Columns and rows of a rendered scene, None for those of the scene."""
    reading: FrameReading = field(default_factory=FrameReading)
    """Of a finished frame."""


@dataclass(frozen=True)
class Description:
    """What the worker found: enough to build the controls of a page."""

    look: Look
    """The settings to begin with."""
    # Pixels of the picture.
    width: int
    height: int
    camera: Camera | None = None
    """Where a scene is seen from first; None for a finished frame."""
    look_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The point about which an orbit turns."""
    # What can be chosen. Views are named by `lobewise.viewer.pictures.VIEWS`.
    methods: tuple[str, ...] = ()
    similarities: tuple[str, ...] = ()
    qualities: tuple[str, ...] = ()
    forms: tuple[str, ...] = ()
    views: tuple[str, ...] = ("image",)
    # Of a finished frame: whether it was shaded sparsely, whether it tells what lobes hit.
    sparse: bool = False
    hit_distance: bool = False
    notes: tuple[str, ...] = ()
    """What was found in the file of a finished frame, converted, or is missing, in sentences."""
    unseen: str = ""
    """What of a scene the pictures do not show, in a sentence."""


@dataclass(frozen=True)
class Window:
    """The browser's picture area, and which part of a finished frame it shows."""

    # Pixels of the picture area.
    width: int = 1
    height: int = 1
    zoom: float = 1.0
    """1 shows the whole picture."""
    centre: tuple[float, float] = (0.0, 0.0)
    """The middle of what is seen: 0, 0 is the picture's, +-1 half the height that is seen at zoom 1; x right, y up."""
    fill: bool = False
    """Whether a picture of another aspect is cut instead of getting bars."""


@dataclass(frozen=True)
class Request:
    """One picture for one browser."""

    # Whose, and which of its requests.
    client: int
    number: int
    window: Window
    # Settings, and those right of the wipe; None without a wipe.
    look: Look
    other: Look | None = None
    wipe: float = 0.5
    """Where the line is, 0 at the left to 1 at the right."""
    view: str = "image"
    """What is shown."""
    stops: float | None = None
    """Exposure, base-2 logarithm; None to choose it from the image."""
    camera: Camera | None = None
    """Of a scene."""
    size: tuple[int, int] = (512, 512)
    """Columns and rows to render."""
    fresh: bool = True
    """Whether a scene is rendered, or only what was rendered last is shown anew."""
    accumulate: bool = True
    """Whether frames of a camera that stands still are averaged."""


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
    """What the worker does now, for the status line."""

    text: str


@dataclass(frozen=True)
class Picture:
    """A picture to show, and its figures."""

    # Those of the request.
    client: int
    number: int
    pixels: NDArray[np.uint8]
    """sRGB, shape (height, width, 3)."""
    size: tuple[int, int]
    """Columns and rows that were rendered."""
    stops: float
    """Exposure that was used."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time by stage; "total" is the whole."""
    # Frames averaged, pixels shaded again, bytes that the worker holds.
    accumulated: int = 1
    recomputed: int = 0
    memory: int = 0
    final: bool = True
    """Whether the request is done; of a frame that is filtered for the first time the noisy input comes before."""


@dataclass(frozen=True)
class SavedFile:
    """A file for a browser."""

    client: int
    name: str
    data: bytes


@dataclass(frozen=True)
class Problem:
    """One sentence about what went wrong; without a client the target cannot be shown at all.

    ``ours`` tells a mistake of the program from one that the user can mend.
    """

    text: str
    client: int | None = None
    ours: bool = False


Order = Request | Save | Forget
Report = Opened | Progress | Picture | SavedFile | Problem
