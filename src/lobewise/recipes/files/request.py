"""What is asked of files that are denoised: what is read of each, how it is filtered, and what is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from os import PathLike
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any

from lobewise.denoising.automatic import leaves_oidn_open
from lobewise.errors import InputError, name_value, require_integer, require_kind
from lobewise.interchange.mapping import split_mapping
from lobewise.interchange.preset import look_up_preset
from lobewise.interchange.siblings import list_family
from lobewise.io.files import anchor_name, as_path
from lobewise.io.materials import read_lobe_table
from lobewise.io.sequence import FramePattern, is_pattern, name_frame
from lobewise.recipes.adaptive.shading import Shading
from lobewise.records.lobe_table import LobeTable
from lobewise.settings import MAX_WINDOW, DenoiseSettings

if TYPE_CHECKING:
    from typing_extensions import Self

WHOLE_FIELDS = (
    *("past_only", "window", "shading", "with_oidn", "quality"),
    *("preset", "mapping", "camera", "half", "wraps", "also", "light_groups", "all_layers"),
    *("suffix", "only", "confidence"),
)
"""Fields that need whole frames where they differ from their defaults."""

KINDS: Mapping[str, tuple[type, ...]] = {
    "settings": (DenoiseSettings,),
    "mapping": (Mapping,),
    "bands": (int, str),
    **dict.fromkeys(("preset", "camera", "half"), (str, PathLike, NoneType)),
    "shading": (Shading, NoneType),
    "suffix": (str,),
    "wraps": (bool, NoneType),
    **dict.fromkeys(("materials", "also"), (tuple, list)),
    **dict.fromkeys(("light_groups", "all_layers", "past_only", "only", "confidence"), (bool,)),
}
"""Types of the fields of a request."""


def _list_files(path: Path) -> Sequence[Path]:
    """Return a file and those that are read with it; see `list_family`."""
    try:
        state = path.stat()
    except OSError:
        return [path]
    return _list_family(path, state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=64)
def _list_family(path: Path, size: int, time: int) -> Sequence[Path]:
    """Return what `list_family` says of a file with this size and time. Windows ask for each file many times."""
    return list_family(path)


@dataclass(frozen=True, kw_only=True)
class FileRequest:
    """How files are denoised, as plain data. A worker, and a run that goes on after a stop, do what it says.

    Parameters
    ----------
    settings : DenoiseSettings
        How each frame is filtered.
    preset, mapping, wraps, also, light_groups
        As of `lobewise.interchange.import_file`.
    camera : path, optional
        File with a camera that replaces the camera of every file; see
        `lobewise.interchange.cameras.files.read_camera_file`.
    half : path, optional
        The same frame rendered again with another seed; for a sequence another sequence.
    materials : sequence of path
        Files of lobe tables (``.lobes``), which replace the tables in the files.
    all_layers : bool
        Whether every view layer of a file is denoised, and not the first alone.
    window : int
        Frames before every frame of a sequence that its result uses, and after it unless ``past_only``; 0 for none.
    past_only : bool
        Whether a window has the frames before a frame alone.
    bands : int or str
        Rows that are filtered at a time; "auto" does so with a file that would take much memory, "off" never.
    suffix, only, confidence
        As of `lobewise.write_result`.
    shading : Shading, optional
        Which pixels are shaded again.
    """

    settings: DenoiseSettings = field(default_factory=DenoiseSettings)
    preset: str | PathLike[str] | None = None
    mapping: Mapping[str, str] = field(default_factory=dict)
    camera: str | PathLike[str] | None = None
    half: str | PathLike[str] | None = None
    wraps: bool | None = None
    materials: Sequence[str | PathLike[str]] = ()
    also: Sequence[str] = ()
    light_groups: bool = True
    all_layers: bool = False
    window: int = 0
    past_only: bool = False
    bands: int | str = "auto"
    suffix: str = ""
    only: bool = False
    confidence: bool = False
    shading: Shading | None = None

    def check(self, name: Callable[[str], str] = str) -> None:
        """Raise a LobewiseError if something is wrong with every file, before one is read.

        ``name`` returns what the caller calls a field.
        """
        for field_name, kinds in KINDS.items():
            require_kind(field_name, getattr(self, field_name), *kinds)
        for text in (*self.also, *self.mapping, *self.mapping.values()):
            require_kind("also and mapping", text, str)
        for path in self.materials:
            as_path(path, "materials")
        require_integer("window", self.window, 0, MAX_WINDOW)
        self.make_read_options()
        if self.shading is not None:
            self.shading.check()
        self._require_bands(name)
        self.read_tables()

    def _require_bands(self, name: Callable[[str], str]) -> None:
        bands = self.bands
        if bands not in ("auto", "off") and (isinstance(bands, bool) or not isinstance(bands, int) or bands < 1):
            expected = "auto, off or a number of rows"
            raise InputError("bands", expected=expected, got=name_value(bands), action="leave it out")
        if isinstance(bands, int) and self.whole_field:
            named = f" {self.settings.quality}" if self.whole_field == "quality" else ""
            raise InputError(
                "bands",
                expected=f"auto or off with {name(self.whole_field)}{named}, which takes whole frames",
                got=str(bands),
                action="drop one of them",
            )

    @property
    def whole_field(self) -> str:
        """The first field that needs whole frames, empty for none."""
        usual = FileRequest()
        own = [name for name in WHOLE_FIELDS if name not in ("with_oidn", "quality")]
        given = {name for name in own if getattr(self, name) != getattr(usual, name)}
        if self.settings.asks_for_oidn:
            given.add("quality" if self.settings.needs_oidn else "with_oidn")
        return next((name for name in WHOLE_FIELDS if name in given), "")

    def read_tables(self) -> list[LobeTable] | None:
        """Return the lobe tables of ``materials``; None for none."""
        return [read_lobe_table(path) for path in self.materials] or None

    def make_read_options(self) -> dict[str, Any]:
        """Return conventions, channels, camera and borders, as parameters of `lobewise.read_frame`.

        Raises InputError or FileError if one of them is wrong in every file.
        """
        for role, text in self.mapping.items():
            split_mapping(role, text)
        if self.preset is not None:
            look_up_preset(self.preset)
        camera = None
        if self.camera is not None:
            # Formats of scenes need XML and USD, and few runs name a camera.
            from lobewise.interchange.cameras.files import read_camera_file

            camera = read_camera_file(self.camera)
        return {
            "preset": self.preset,
            "mapping": self.mapping,
            "camera": camera,
            "wraps": self.wraps,
        }

    @property
    def fingerprint(self) -> str:
        """Everything but the files that results depend on, as text. Bands change no bit of a result."""
        return repr(replace(self, bands="auto"))

    def anchor(self) -> Self:
        """Return the request with absolute paths, for processes that run in another folder."""

        def make_absolute(path: str | PathLike[str] | None) -> Path | None:
            return None if path is None else Path(path).absolute()

        return replace(
            self,
            preset=None if self.preset is None else anchor_name(str(self.preset)),
            camera=make_absolute(self.camera),
            half=make_absolute(self.half),
            materials=tuple(Path(path).absolute() for path in self.materials),
            shading=None if self.shading is None else self.shading.anchor(),
        )

    def list_sources(self, number: int, source: Path) -> list[Path]:
        """Return every file that the result of a frame of a pattern depends on."""
        frames = self.list_window(source, number)
        return [file for each, path in frames for file in (*_list_files(path), *self._list_halves(each))]

    def _list_halves(self, number: int) -> list[Path]:
        """Return the file of the second render of a frame, if there is a second render."""
        if self.half is None:
            return []
        return [name_frame(Path(self.half), number) if is_pattern(self.half) else Path(self.half)]

    def list_window(self, source: Path, number: int) -> list[tuple[int, Path]]:
        """Return the existing files that a frame depends on with their numbers, in order; a missing number ends them.

        Neighbours have windows of their own, and one frame more tells the motion of the camera at the ends.
        """
        pattern = FramePattern.parse(source)
        most = 2 * self.window + 1 if self.window else 0
        first = last = number
        while number - first < most and pattern.name(first - 1).is_file():
            first -= 1
        while not self.past_only and last - number < most and pattern.name(last + 1).is_file():
            last += 1
        return [(each, pattern.name(each)) for each in range(first, last + 1)]

    def list_shared_sources(self) -> list[Path]:
        """Return every file, beside the frames, that results depend on."""
        named = [Path(path) for path in (self.preset, self.camera) if path is not None]
        files = [*map(Path, self.materials), *(path for path in named if path.is_file())]
        return files + ([] if self.shading is None else self.shading.list_files())

    remembers = False
    """Whether the filter itself remembers the frames before a frame."""

    @property
    def reads_neighbours(self) -> bool:
        """Whether a frame reads the files of the frames around it."""
        return self.window > 0

    @property
    def asks_for_oidn(self) -> bool:
        """Whether results depend on Open Image Denoise being installed."""
        return self.settings.asks_for_oidn or leaves_oidn_open(self.settings)
