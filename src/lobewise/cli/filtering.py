"""The verbs `denoise` and `upsample`, for single files and for sequences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from lobewise.cli.options import with_settings
from lobewise.cli.reading import (
    Also,
    Bands,
    CameraFile,
    Confidence,
    FileInBands,
    Half,
    Maps,
    Only,
    Preset,
    Reading,
    Suffix,
    choose_bands,
)
from lobewise.cli.shared import (
    Adaptive,
    AdaptiveSpp,
    Exposure,
    Light,
    Memory,
    Output,
    Overwrite,
    Png,
    Quiet,
    Scene,
    Source,
    Temporal,
    Verbose,
    find_first,
    make_recomputing,
    parse_percent,
    parse_place,
    plan_pictures,
    protect_inputs,
)
from lobewise.cli.terminal.help import FILTER_DETAILS
from lobewise.cli.terminal.outcome import Remarks, describe, tell_picture, tell_settings
from lobewise.cli.terminal.steps import Steps
from lobewise.errors import InputError, LobewiseError
from lobewise.settings import DenoiseSettings, TemporalSettings

if TYPE_CHECKING:
    from lobewise.frame import Result
    from lobewise.interchange import Imported
    from lobewise.reporting.picture import Pictures
    from lobewise.sparse_frame import AnyFrame, SparseFrame

    FrameT = TypeVar("FrameT", bound=AnyFrame)

OVER_TIME = (
    "--temporal filters with the quality 'fast', without Open Image Denoise, and the light in total, not by its "
    "passes. It is for little flicker at few samples; where noise is moderate, renders that were measured had less "
    "error frame by frame: leave --temporal out."
)


@dataclass
class Writing:
    """How results are written: the options, and what has been said of it already."""

    suffix: str = ""
    only: bool = False
    confidence: bool = False
    pictures: Pictures | None = None
    _told: set[str] = field(default_factory=set)

    @property
    def option(self) -> str:
        """The first option that was given, empty for none."""
        return next((f"--{name}" for name in ("suffix", "only", "confidence") if getattr(self, name)), "")

    def write(self, target: Path, result: Result, found: Imported) -> None:
        """Write a result into a copy of its file, and its picture; what could not stay as it was is said once."""
        from lobewise.adaptive import find_unsupported
        from lobewise.cli.output import print_note
        from lobewise.interchange import write_result

        notes = write_result(
            target,
            result,
            source=found,
            suffix=self.suffix,
            only=self.only,
            confidence=self.confidence,
            rerender=find_unsupported(result).astype("f4") if self.confidence else None,
        )
        if self.pictures is not None:
            self.pictures.write(target, result.image)
        for note in notes:
            if note not in self._told:
                print_note(note)
            self._told.add(note)


@with_settings(
    DenoiseSettings,
    *("quality", "with_oidn", "similarity", "form", "radius", "beta", "lobes", "hit_distance", "device"),
    group=FILTER_DETAILS,
    usual=("quality", "with_oidn"),
)
def denoise(
    source: Source,
    output: Output,
    settings: dict[str, Any],
    material: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE.lobes",
            help="With sg_mixture: the lobes of material 1 (again for 2, ...) of channel material.I.",
            show_default="those in the file",
            rich_help_panel=FILTER_DETAILS,
        ),
    ] = None,
    adaptive: Adaptive = "0%",
    scene: Scene = None,
    adaptive_spp: AdaptiveSpp = 64,
    light: Light = "all",
    temporal: Temporal = False,
    memory: Memory = TemporalSettings.memory,
    bands: Bands = "auto",
    preset: Preset = None,
    maps: Maps = None,
    camera: CameraFile = None,
    half: Half = None,
    also: Also = None,
    suffix: Suffix = "",
    only: Only = False,
    confidence: Confidence = False,
    overwrite: Overwrite = False,
    png: Png = False,
    exposure: Exposure = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Denoise an EXR file of any renderer, or a sequence of them; other parts, channels and attributes are kept."""
    from lobewise.denoising import denoise as run_denoise
    from lobewise.io.materials import read_lobe_table
    from lobewise.io.sequence import is_pattern

    read_besides = [half, camera, preset, scene, *(material or [])]
    protect_inputs(source, output, read_besides, overwrite=overwrite, png=png)
    shade = make_recomputing(scene, adaptive, adaptive_spp, light)
    tables = [read_lobe_table(path) for path in material] if material else None
    steps = Steps(quiet=quiet)
    pictures = plan_pictures(png, exposure, find_first(source, output))
    reading, writing = Reading(preset, maps, camera, half, also, tables), Writing(suffix, only, confidence, pictures)
    alone = not is_pattern(source)
    adapts, mixes = parse_percent(adaptive) > 0.0, settings["with_oidn"] is True
    takers = {"--temporal": temporal, "--adaptive": adapts, "--with-oidn": mixes}
    given = next((name for name, is_so in takers.items() if is_so), "")
    whole = given or reading.option or writing.option

    def read(path: Path) -> Any:
        if temporal:
            reading.tell(OVER_TIME)
        if choose_bands(path, bands, settings, whole):
            return FileInBands(bands, tables, settings, progress=steps.tell if alone else None)
        return reading.read(path, source, light_passes=not temporal)

    def filter_one(found: Any) -> Any:
        return found if isinstance(found, FileInBands) else run_denoise(found.frame, **settings)

    def write(target: Path, result: Any, found: Any, path: Path) -> None:
        if isinstance(result, FileInBands):
            result.write(path, target)
            if pictures is not None:
                pictures.write_from_file(target)
        else:
            writing.write(target, shade(result, found.frame), found)

    _run(
        source,
        output,
        read=read,
        filter_one=filter_one,
        write=write,
        settings={
            **settings,
            "material": [str(path) for path in material or []],
            "adaptive": [adaptive, scene],
            "reading": [preset, maps, str(camera), str(half), also],
            "writing": [suffix, only, confidence],
            "picture": [png, exposure],
        },
        temporal={**settings, "memory": memory} if temporal else None,
        pictures=pictures,
        steps=steps,
        verbose=verbose,
        unwrap=lambda found: found.frame,
    )


@with_settings(DenoiseSettings, "similarity", "radius", "beta", "device", group=FILTER_DETAILS, radius=5)
def upsample(
    source: Source,
    output: Output,
    settings: dict[str, Any],
    scale: Annotated[
        int | None,
        typer.Option(metavar="N", help="Pixels from shaded pixel to shaded pixel.", show_default="the file's"),
    ] = None,
    place: Annotated[
        str | None,
        typer.Option(metavar="ROW,COLUMN", help="The shaded pixel of each block.", show_default="the file's, or 0,0"),
    ] = None,
    bilinear: Annotated[bool, typer.Option("--bilinear", help="Interpolate on the screen alone.")] = False,
    adaptive: Adaptive = "0%",
    scene: Scene = None,
    adaptive_spp: AdaptiveSpp = 64,
    light: Light = "all",
    temporal: Temporal = False,
    memory: Memory = TemporalSettings.memory,
    overwrite: Overwrite = False,
    png: Png = False,
    exposure: Exposure = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Bring sparsely shaded radiance to every pixel, in one file or a sequence of them; the guides are kept."""
    from lobewise.frame import Frame, Radiance
    from lobewise.io import read_sparse_frame, write_frame
    from lobewise.upsampling import upsample as run_upsample

    if bilinear and temporal:
        raise InputError("--bilinear", expected="no --temporal beside it", got="both", action="leave one out")
    where = None if place is None else parse_place(place)
    protect_inputs(source, output, [scene], overwrite=overwrite, png=png)
    shade = make_recomputing(scene, adaptive, adaptive_spp, light)
    pictures = plan_pictures(png, exposure, find_first(source, output))

    def write(target: Path, result: Result, frame: SparseFrame, path: Path) -> None:
        done = shade(result, frame)
        radiance = Radiance(done.image, diffuse=done.diffuse, specular=done.specular)
        write_frame(target, Frame(radiance, frame.gbuffer, frame.camera, spp=frame.spp, lobe_tables=frame.lobe_tables))
        if pictures is not None:
            pictures.write(target, done.image)

    _run(
        source,
        output,
        read=lambda path: read_sparse_frame(path, scale=scale, place=where),
        filter_one=lambda frame: run_upsample(frame, bilinear=bilinear, **settings),
        write=write,
        settings={
            **settings,
            "bilinear": bilinear,
            "scale": scale,
            "place": place,
            "adaptive": [adaptive, scene],
            "picture": [png, exposure],
        },
        temporal={**settings, "memory": memory} if temporal else None,
        pictures=pictures,
        steps=Steps(quiet=quiet),
        verbose=verbose,
    )


class _Alone:
    """A filter that remembers nothing: every frame of a sequence by itself."""

    def __init__(self, filter_one: Callable[[Any], Result]) -> None:
        self._filter_one = filter_one

    def add(self, frame: Any, *, cut: bool = False) -> Result:
        return self._filter_one(frame)

    def get_state(self) -> dict[str, Any]:
        return {}

    def set_state(self, state: Any) -> None:
        pass


def _run(
    source: Path,
    output: Path,
    *,
    read: Callable[[Path], FrameT],
    filter_one: Callable[[FrameT], Result],
    write: Callable[[Path, Result, FrameT, Path], None],
    settings: dict[str, Any],
    temporal: dict[str, Any] | None,
    pictures: Pictures | None,
    steps: Steps,
    verbose: bool,
    unwrap: Callable[[Any], Any] = lambda frame: frame,
) -> None:
    """Filter one file, or every file of a pattern; mistakes in a file are told with its name."""
    from lobewise.cli.output import print_line, print_note
    from lobewise.io.files import require_exr_name, require_writable
    from lobewise.io.sequence import is_pattern
    from lobewise.sequence import filter_sequence
    from lobewise.temporal import TemporalFilter

    current, remarks = source, Remarks()
    require_exr_name(output)

    def read_one(path: Path) -> FrameT:
        nonlocal current
        current = path
        return read(path)

    if not is_pattern(source):
        if temporal is not None:
            raise InputError(
                "--temporal",
                expected="a sequence such as 'in.####.exr'",
                got=repr(str(source)),
                action="put # in place of the digits of the number, and quote the name",
            )
        require_writable(output)
        with steps:
            steps.tell(f"Reading {source.name}")
            frame = read_one(source)
            try:
                steps.tell("Filtering")
                result = filter_one(frame)
            except LobewiseError as problem:
                raise type(problem)(f"{source}: {problem}") from problem
            steps.tell(f"Writing {output.name}")
            write(output, result, frame, source)
        remarks.tell(result)
        print_line(f"Wrote {output}: {describe(result)}.")
        tell_picture(output, pictures)
        tell_settings(result, verbose)
        return

    def write_one(target: Path, result: Result, frame: FrameT, path: Path) -> None:
        write(target, result, frame, path)
        remarks.tell(result)

    active = TemporalFilter(**temporal) if temporal is not None else _Alone(filter_one)

    class Named:
        """The filter, whose complaints name the file."""

        get_state, set_state = active.get_state, active.set_state

        def add(self, frame: FrameT, *, cut: bool = False) -> Result:
            try:
                return active.add(frame if temporal is None else unwrap(frame), cut=cut)
            except LobewiseError as problem:
                raise type(problem)(f"{current}: {problem}") from problem

    with steps:
        report = filter_sequence(
            source,
            output,
            Named,
            read=read_one,
            write=write_one,
            fingerprint=repr([settings, temporal]),
            progress=lambda what, done, total: steps.tell(f"Filtering {source.name}", done, total),
            remark=print_note,
        )
    told = "" if report.last is None else f"; the last: {describe(report.last)}"
    print_line(f"Wrote {output}: {report.written} of {report.frames} frames{told}.")
    tell_picture(output, pictures)
    tell_settings(report.last, verbose)
