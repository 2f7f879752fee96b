"""How verbs read files: of any renderer, by the options that say what they hold; whole, or in bands of rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.terminal.help import FILE_DETAILS, FILES, RESULT
from lobewise.errors import InputError, LobewiseError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from lobewise.interchange import Imported
    from lobewise.interchange.checks import Finding
    from lobewise.lobe_table import LobeTable
    from lobewise.streaming import DenoisedFile

Preset = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.toml",
        help="Whose conventions the file follows: cycles, arnold, vray, renderman, karma, redshift, corona, pbrt, "
        "luxcore, mitsuba, unreal, generic, or a file of them.",
        show_default="what the file tells",
        rich_help_panel=FILES,
    ),
]
Maps = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="ROLE=CHANNELS",
        help="Which channels are what, such as normal=N.X,N.Y,N.Z or roughness=rough.R:square; again for more.",
        show_default=False,
        rich_help_panel=FILES,
    ),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="FILE",
        help="The camera, where the file does not tell: JSON, a Mitsuba scene (.xml), glTF (.gltf, .glb) or USD.",
        show_default="what the file tells",
        rich_help_panel=FILES,
    ),
]
Half = Annotated[
    Path | None,
    typer.Option(
        "--half",
        metavar="FILE",
        help="The same frame rendered with another seed: both are halves of the samples.",
        show_default=False,
        rich_help_panel=FILES,
    ),
]
Also = Annotated[
    list[str] | None,
    typer.Option(
        "--also",
        metavar="PATTERN",
        help="Further noisy passes, such as 'Combined_*', filtered like what they belong to; again for more.",
        show_default=False,
        rich_help_panel=FILES,
    ),
]
Suffix = Annotated[
    str,
    typer.Option(
        "--suffix",
        metavar="TEXT",
        help="Put results beside the noisy passes, in passes whose names end so.",
        rich_help_panel=RESULT,
    ),
]
Only = Annotated[
    bool, typer.Option("--only", help="Write the results alone, no other channel.", rich_help_panel=RESULT)
]
Confidence = Annotated[
    bool,
    typer.Option(
        "--confidence",
        help="Add channels that tell how far to trust the result, and which pixels to render again.",
        rich_help_panel=RESULT,
    ),
]


Bands = Annotated[
    str,
    typer.Option(
        metavar="auto|off|ROWS",
        help="Filter so many rows at a time, from file to file: little memory, the same bits. auto does so with a file "
        "that would take more than 4 GiB.",
        rich_help_panel=FILE_DETAILS,
    ),
]


@dataclass
class Reading:
    """How files are read: the options, and what has been said of it already."""

    preset: str | None = None
    maps: list[str] | None = None
    camera: Path | None = None
    half: Path | None = None
    also: list[str] | None = None
    tables: Sequence[LobeTable] | None = None
    _told: set[str] = field(default_factory=set)

    @property
    def option(self) -> str:
        """The first option that was given, empty for none."""
        given = {
            "--preset": self.preset,
            "--map": self.maps,
            "--camera": self.camera,
            "--half": self.half,
            "--also": self.also,
        }
        return next((name for name, value in given.items() if value), "")

    def parse(self) -> dict[str, Any]:
        """Return what the options say of the channels and the camera, as `lobewise.read_frame` takes it."""
        from lobewise.interchange.cameras.files import read_camera_file

        return {
            "preset": self.preset,
            "mapping": parse_maps(self.maps or []),
            "camera": None if self.camera is None else read_camera_file(self.camera),
        }

    def read(self, path: Path, source: Path, *, light_passes: bool = False) -> Imported:
        """Return the frame of a file, one of the sequence ``source`` perhaps; what was made of it is said once."""
        from lobewise.interchange import import_file
        from lobewise.interchange.replacing import require_target

        given = self.parse()
        found = import_file(
            path,
            **given,
            half=None if self.half is None else _find_same(self.half, path, source),
            lobe_tables=self.tables,
            also=self.also or (),
            light_passes=light_passes,
        )
        if "color" not in given["mapping"]:
            refuse_results(path, found.findings)
        require_target(found)
        # Figures in what was found of conventions are of one frame; of a sequence the first frame's are told.
        known = {one.told: f"{one.what}, {one.mended}" for one in found.findings}
        for note in found.remarks:
            self.tell(note, known.get(note, note))
        return found

    def tell(self, note: str, key: str = "") -> None:
        """Print a note, but none that was printed before; ``key`` stands for it where its figures may differ."""
        from lobewise.cli.output import print_note

        if (key or note) not in self._told:
            print_note(note)
        self._told.add(key or note)


def refuse_results(path: Path, findings: Iterable[Finding]) -> None:
    """Raise InputError if it was found that the image of a file is a result of lobewise, which is no noise to judge."""
    from lobewise.interchange.checks import MARKED

    if any(one.what == MARKED and not one.mended for one in findings):
        raise InputError(
            f"input {str(path)!r}",
            expected="a noisy render",
            got="a result of lobewise, as its attribute 'lobewise/denoised' says",
            action="give the noisy render, or name the image that is noisy, such as --map color=PASS",
        )


def parse_maps(given: list[str]) -> Mapping[str, str]:
    """Return channels by role from words ``role=channels``."""
    found: dict[str, Any] = {}
    for text in given:
        role, equals, channels = text.partition("=")
        if not equals or not channels or role.strip() in found:
            raise InputError(
                "--map",
                expected="ROLE=CHANNELS, each role once",
                got=repr(text),
                action="write, for example, --map normal=N.X,N.Y,N.Z",
            )
        found[role.strip()] = channels.strip()
    return found


def _find_same(half: Path, path: Path, source: Path) -> Path:
    """Return the file of the second render that belongs to one of the first."""
    from lobewise.io.sequence import FramePattern, is_pattern

    if is_pattern(half) != is_pattern(source):
        raise InputError(
            "--half",
            expected="a sequence for a sequence, and a file for a file",
            got=f"{str(half)!r} for {str(source)!r}",
            action="name both alike",
        )
    if not is_pattern(half):
        return half
    number = {found: number for number, found in FramePattern.parse(source).find()}[path]
    return FramePattern.parse(half).name(number)


def parse_bands(text: str) -> str | int:
    """Return the rows of a band, or ``auto`` or ``off`` as they are."""
    if text in ("auto", "off"):
        return text
    if text.isdecimal() and int(text) > 0:
        return int(text)
    raise InputError("--bands", expected="auto, off or a number of rows", got=repr(text), action="leave it out")


def choose_bands(source: Path, text: str, settings: dict[str, Any], whole: str) -> bool:
    """Return whether a file is denoised in bands; ``whole`` names the option that takes whole frames, empty for none.

    Raises
    ------
    InputError
        If bands are asked for by number where there are none, or the file in bands is a result of lobewise.
    """
    from lobewise.interchange.checks import check_own_mark
    from lobewise.io.exr.parsing import read_container

    bands = parse_bands(text)
    if isinstance(bands, int) and whole:
        raise InputError(
            "--bands",
            expected=f"auto or off with {whole}, which takes whole frames",
            got=text,
            action="drop one of them",
        )
    if bands == "off" or whole:
        return False
    if not _is_own(source):
        if isinstance(bands, int):
            raise InputError(
                "--bands",
                expected="auto or off for files of other renderers, which are read as a whole",
                got=text,
                action="leave it out",
            )
        return False
    if isinstance(bands, int) or _is_large(source, settings):
        refuse_results(source, check_own_mark(read_container(source)))
        return True
    return False


def _is_own(source: Path) -> bool:
    from lobewise.interchange.reading import is_own
    from lobewise.io.exr.parsing import read_container

    try:
        return is_own(read_container(source))
    except LobewiseError:
        # Whoever reads it says what is wrong.
        return True


def _is_large(source: Path, settings: dict[str, Any]) -> bool:
    from lobewise.denoising.automatic import ask
    from lobewise.io.exr.bands import BandReader
    from lobewise.streaming import list_images, needs_bands

    asked = ask(None, settings, whole=False)
    try:
        return needs_bands(BandReader(source, wanted=list_images(asked)), asked)
    except LobewiseError:
        # Whoever reads it as a whole says what is wrong, or reads it nevertheless.
        return False


class FileInBands:
    """A file that is denoised as it is written; until then it stands for its frame, and for the result.

    Parameters
    ----------
    text : str
        As it was given: see `parse_bands`.
    tables : sequence of LobeTable, optional
        In place of those in the file.
    settings : dict
        Of the filter.
    progress : callable, optional
        Told what is done; see `lobewise.streaming.denoise_file`.
    """

    def __init__(
        self,
        text: str,
        tables: Sequence[LobeTable] | None,
        settings: dict[str, Any],
        *,
        progress: Callable[[str, int, int], None] | None = None,
    ) -> None:
        bands = parse_bands(text)
        self._rows = bands if isinstance(bands, int) else None
        self._tables, self._settings, self._progress = tables, settings, progress
        self._done: DenoisedFile | None = None

    def write(self, source: Path, output: Path) -> None:
        """Denoise ``source`` into ``output``; mistakes in a file are told with its name."""
        from lobewise.streaming import denoise_file

        options: dict[str, Any] = {"lobe_tables": self._tables, "rows": self._rows, **self._settings}
        try:
            self._done = denoise_file(source, output, progress=self._progress, **options)
        except LobewiseError as problem:
            if str(source) in str(problem) or str(output) in str(problem):
                raise
            raise type(problem)(f"{source}: {problem}") from problem

    def describe(self) -> str:
        """Return in one line what was done."""
        from lobewise.cli.output import describe_file_result

        return describe_file_result(self.done)

    @property
    def done(self) -> DenoisedFile:
        """What was done, once it was written."""
        assert self._done is not None, "it is written first"
        return self._done
