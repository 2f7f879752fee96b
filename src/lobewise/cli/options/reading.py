"""Options of verbs that read files of any renderer: what a file holds, where the file does not tell."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from lobewise.cli.terminal.help import file_detail, file_option
from lobewise.errors import InputError

if TYPE_CHECKING:
    from typing_extensions import Self

    from lobewise.cli.terminal.outcome import Remarks
    from lobewise.guides.usable import CheckedGuides
    from lobewise.interchange import Imported
    from lobewise.interchange.checks import Finding
    from lobewise.interchange.selections import Selection
    from lobewise.records.frame import Frame
    from lobewise.records.lobe_table import LobeTable
    from lobewise.settings import DenoiseSettings


@dataclass(frozen=True)
class Reading:
    """Options that tell what a file holds where the file does not."""

    preset: Annotated[
        str | None,
        file_option(
            metavar="NAME|FILE.toml",
            help="Conventions of the file: cycles, arnold, vray, renderman, karma, redshift, corona, pbrt, luxcore, "
            "mitsuba, unreal, generic, or a file of them.",
            show_default="what the file tells",
        ),
    ] = None
    maps: Annotated[
        list[str] | None,
        file_option(
            "--map",
            metavar="ROLE=CHANNELS",
            help="Channels of an image, such as normal=N.X,N.Y,N.Z or roughness=rough.R:square; again for more.",
            show_default=False,
        ),
    ] = None
    camera: Annotated[
        Path | None,
        file_option(
            metavar="FILE",
            help="The camera, where the file does not tell: JSON, a Mitsuba scene (.xml), glTF (.gltf, .glb) or USD.",
            show_default=False,
        ),
    ] = None
    half: Annotated[
        Path | None,
        file_option(
            metavar="FILE",
            help="The same frame rendered with another seed: both are halves of the samples.",
            show_default=False,
        ),
    ] = None

    wrap: Annotated[
        bool | None,
        file_detail(
            "--wrap/--no-wrap",
            help="The left and the right border are neighbours: a panorama of 360 degrees.",
            show_default="what the header tells",
        ),
    ] = None

    def list_words(self) -> list[str]:
        """Return the options that the user gave, as words of a command line."""
        options = {"--preset": [self.preset], "--map": self.maps, "--camera": [self.camera], "--half": [self.half]}
        return [*_list_words(options), *({True: ["--wrap"], False: ["--no-wrap"], None: []}[self.wrap])]

    @property
    def option(self) -> str:
        """Name of the first option that the user gave, empty for none."""
        return next(iter(self.list_words()), "")

    def anchor(self) -> Self:
        """Return the options with absolute paths, for processes that run in another folder."""
        return replace(
            self,
            preset=None if self.preset is None else anchor_name(self.preset),
            camera=None if self.camera is None else self.camera.absolute(),
            half=None if self.half is None else self.half.absolute(),
        )

    def list_files(self) -> list[Path]:
        """Return the files that say how every frame is read."""
        paths = [*([] if self.preset is None else [Path(self.preset)]), *([] if self.camera is None else [self.camera])]
        return [path for path in paths if path.is_file()]

    def list_halves(self, number: int) -> list[Path]:
        """Return the file of the second render of a frame of a sequence, if there is a second render."""
        from lobewise.io.sequence import is_pattern

        if self.half is None:
            return []
        return [name_frame(self.half, number) if is_pattern(self.half) else self.half]

    def parse(self) -> dict[str, Any]:
        """Return the conventions, channels, camera and borders, as parameters of `lobewise.read_frame`.

        Raises InputError or FileError if one of them is wrong in every file.
        """
        from lobewise.interchange.cameras.files import read_camera_file
        from lobewise.interchange.mapping import split_mapping
        from lobewise.interchange.preset import look_up_preset

        mapping = parse_maps(self.maps or [])
        for role, text in mapping.items():
            split_mapping(role, text)
        if self.preset is not None:
            look_up_preset(self.preset)
        return {
            "preset": self.preset,
            "mapping": mapping,
            "camera": None if self.camera is None else read_camera_file(self.camera),
            "wraps": self.wrap,
        }


@dataclass(frozen=True)
class PassReading(Reading):
    """Options that tell what a file holds, further noisy passes included."""

    also: Annotated[
        list[str] | None,
        file_option(
            metavar="PATTERN",
            help="Further noisy passes, such as 'Combined_*', AO or '*nm', which are filtered alike; again for more.",
            show_default=False,
        ),
    ] = None

    light_groups: Annotated[
        bool, file_detail("--light-groups/--no-light-groups", help="Denoise the light groups of the file as well.")
    ] = True

    all_layers: Annotated[bool, file_option("--all-layers", help="Denoise every view layer of the file.")] = False

    def list_words(self) -> list[str]:
        """Return the options that the user gave, as words of a command line."""
        own = _list_words({"--also": self.also}) + ([] if self.light_groups else ["--no-light-groups"])
        own += ["--all-layers"] if self.all_layers else []
        return super().list_words() + own

    def list_selections(self, path: Path) -> tuple[Selection, ...]:
        """Return what is filtered of a file: every view, in the first view layer or in all of them."""
        from lobewise.interchange.reading import list_selections

        return list_selections(
            path, preset=self.preset, mapping=parse_maps(self.maps or []), all_layers=self.all_layers
        )

    def read(
        self,
        path: Path,
        source: Path,
        remarks: Remarks,
        *,
        selection: Selection,
        denoised: Collection[Selection] = (),
        tables: Sequence[LobeTable] | None = None,
    ) -> Imported:
        """Return the frame of a view and view layer of a file, with its light by passes.

        Parameters
        ----------
        path : Path
            The file.
        source : Path
            The file again, or the pattern of its sequence.
        remarks : Remarks
            Prints how the file was understood.
        selection : Selection
            The view and view layer.
        denoised : collection of Selection
            All that is filtered of the file. After the first one, only notes of a new kind are printed.
        tables : sequence of LobeTable, optional
            Fitted materials that replace the materials in the file.
        """
        from lobewise.interchange import import_file
        from lobewise.interchange.replacing import require_target

        options = self.parse()
        imported = import_file(
            path,
            **options,
            half=None if self.half is None else self._locate_half(path, source),
            lobe_tables=tables,
            also=self.also or (),
            light_passes=True,
            light_groups=self.light_groups,
            view=selection.view or None,
            layer=selection.layer or None,
            denoised=denoised,
        )
        if "color" not in options["mapping"]:
            refuse_results(path, imported.findings)
        require_target(imported)
        # A finding holds figures of one frame: of a sequence only the first frame's are printed.
        known = {one.sentence: f"{one.what}, {one.mended}" for one in imported.findings}
        first = next(iter(denoised), selection)
        for note in imported.remarks:
            remarks.tell_of(selection, first, note, known.get(note, note), look_up_number(path, source))
        return imported

    def require_one(self, count: int) -> None:
        """Raise InputError if a second render is named for several inputs."""
        if self.half is not None and count > 1:
            got = f"{count} inputs"
            raise InputError("--half", expected="one input beside it", got=got, action="denoise them one by one")

    def _locate_half(self, path: Path, source: Path) -> Path:
        """Return the file of the second render that belongs to a file of the first."""
        from lobewise.io.sequence import is_pattern

        assert self.half is not None
        if is_pattern(self.half) != is_pattern(source):
            raise InputError(
                "--half",
                expected="a sequence for a sequence, and a file for a file",
                got=f"{str(self.half)!r} for {str(source)!r}",
                action="name both alike",
            )
        return locate_counterpart(path, source, self.half)


def _list_words(options: Mapping[str, Iterable[object] | None]) -> list[str]:
    return [word for name, values in options.items() for one in values or [] if one for word in (name, str(one))]


def read_tables(material: Sequence[Path]) -> list[LobeTable] | None:
    """Return the lobe tables of some files; None for no file."""
    from lobewise.io.materials import read_lobe_table

    return [read_lobe_table(path) for path in material] or None


def locate_counterpart(path: Path, source: Path, other: Path) -> Path:
    """Return the file of ``other`` that has the number of ``path`` in the sequence ``source``.

    Where ``source`` is a single file, ``other`` is returned.
    """
    from lobewise.io.sequence import FramePattern, is_pattern

    if not is_pattern(source):
        return other
    return FramePattern.parse(other).name(FramePattern.parse(source).read_number(path))


def look_up_number(path: Path, source: Path) -> int | None:
    """Return the number of a file of the sequence ``source``; None where that is a single file."""
    from lobewise.io.sequence import FramePattern, is_pattern

    return FramePattern.parse(source).read_number(path) if is_pattern(source) else None


def name_frame(source: Path, number: int) -> Path:
    """Return the file of a sequence with a number."""
    from lobewise.io.sequence import FramePattern

    return FramePattern.parse(source).name(number)


def refuse_results(path: Path, findings: Iterable[Finding]) -> None:
    """Raise InputError if the image of a file is a result of lobewise: it has no noise left to measure."""
    from lobewise.interchange.checks import MARKED

    if any(one.what == MARKED and not one.mended for one in findings):
        raise InputError(
            f"input {str(path)!r}",
            expected="a noisy render",
            got="a result of lobewise, as its attribute 'lobewise/denoised' says",
            action="give the noisy render, or name the image that is noisy, such as --map color=PASS",
        )


def check_import(imported: Imported, named: DenoiseSettings) -> CheckedGuides[Frame]:
    """Return the frame of a file with its guides checked, and notes; ``named`` are the settings of the user."""
    from lobewise.denoising.recipe import check_frame
    from lobewise.guides.usable import check_guides

    # The notes on a file of another renderer say already what it lacks, and how to have it.
    return check_frame(imported.frame, named) if imported.map is None else check_guides(imported.frame)


def anchor_name(text: str) -> str:
    """Return the absolute path of an existing file, and any other name as it is."""
    return str(Path(text).absolute()) if Path(text).is_file() else text


def parse_maps(pairs: list[str]) -> Mapping[str, str]:
    """Return channels by role from words ``role=channels``."""
    mapping: dict[str, Any] = {}
    for text in pairs:
        role, equals, channels = text.partition("=")
        if not equals or not channels or role.strip() in mapping:
            raise InputError(
                "--map",
                expected="ROLE=CHANNELS, each role once",
                got=repr(text),
                action="write, for example, --map normal=N.X,N.Y,N.Z",
            )
        mapping[role.strip()] = channels.strip()
    return mapping
