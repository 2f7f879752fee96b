"""The verbs `denoise` and `upsample`, for single files and for sequences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.bands import Bands, FileInBands, choose_bands
from lobewise.cli.options.common import OverTime, Source, Telling, parse_place
from lobewise.cli.options.reading import PassReading, find_counterpart
from lobewise.cli.options.shading import Reshading
from lobewise.cli.options.spreading import with_groups, with_settings
from lobewise.cli.options.windows import FileInWindow, Window, WindowReader, require_window
from lobewise.cli.options.writing import Output, Overwrite, Picture, Writing, protect_inputs
from lobewise.cli.running import FilterAlone, Job, run_filter
from lobewise.cli.terminal.help import FILTER_DETAILS
from lobewise.errors import InputError
from lobewise.settings import DenoiseSettings

if TYPE_CHECKING:
    from collections.abc import Callable

    from lobewise.frame import Result
    from lobewise.interchange import Imported
    from lobewise.lobe_table import LobeTable
    from lobewise.sequence import SequenceFilter
    from lobewise.sparse_frame import AnyFrame, SparseFrame
    from lobewise.streaming import DenoisedFile
    from lobewise.temporal import TemporalFilter
    from lobewise.windows import WindowFilter

OVER_TIME_NOTE = (
    "--temporal filters with the quality 'fast', without Open Image Denoise, and the light in total, not by its "
    "passes. It is made for frames that are filtered as they come. For files on disk, --window 2 also uses the frames "
    "after each frame, in any quality."
)


@with_settings(
    DenoiseSettings,
    *("quality", "with_oidn", "similarity", "form", "radius", "beta", "lobes", "hit_distance", "device"),
    group=FILTER_DETAILS,
    usual=("quality", "with_oidn"),
)
@with_groups
def denoise(
    source: Source,
    output: Output,
    *,
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
    reshading: Reshading,
    window: Window = 0,
    over_time: OverTime,
    bands: Bands = "auto",
    reading: PassReading,
    writing: Writing,
    overwrite: Overwrite = False,
    picture: Picture,
    telling: Telling,
) -> None:
    """Denoise an EXR file of any renderer, or a sequence of them; other parts, channels and attributes are kept."""
    from lobewise.io.materials import read_lobe_table

    besides = [reading.half, reading.camera, reading.preset, reshading.scene, *(material or [])]
    protect_inputs(source, output, besides, overwrite=overwrite, png=picture.png)
    shade = reshading.plan()
    tables = [read_lobe_table(path) for path in material] if material else None
    job = Job.plan(source, output, picture, telling)
    require_window(window, source, over_time)
    needs_whole = {
        "--temporal": over_time.temporal,
        "--window": window > 0,
        "--adaptive": reshading.share > 0.0,
        "--with-oidn": settings["with_oidn"] is True,
    }
    given = [*(name for name, is_given in needs_whole.items() if is_given), reading.option, writing.option]
    verb = _Denoiser(
        job=job,
        settings=settings,
        bands=bands,
        whole_option=next(filter(None, given), ""),
        tables=tables,
        over_time=over_time,
        window=window,
        reading=reading,
        writing=writing,
        shade=shade,
    )
    options = {
        **settings,
        "window": window,
        "material": [str(path) for path in material or []],
        "adaptive": [reshading.adaptive, reshading.scene],
        "reading": [reading.preset, reading.maps, str(reading.camera), str(reading.half), reading.also],
        "writing": [writing.suffix, writing.only, writing.confidence],
        "picture": [picture.png, picture.exposure],
    }
    run_filter(job, verb, [options, over_time.extend(settings)])


@dataclass(frozen=True, kw_only=True)
class _Denoiser:
    """How `denoise` reads, filters and writes a file."""

    job: Job
    settings: dict[str, Any]
    bands: str
    whole_option: str
    """Name of the first option that needs whole frames, empty for none."""
    tables: Sequence[LobeTable] | None
    over_time: OverTime
    window: int
    """Frames before and after that every frame uses; 0 for none."""
    reading: PassReading
    writing: Writing
    shade: Callable[[Result, AnyFrame], Result]

    def read(self, path: Path) -> Imported | FileInBands | FileInWindow:
        """Return the frame of a file, for a file that is denoised in bands its name, with a window all its frames."""
        job = self.job
        if self.over_time.temporal:
            job.remarks.tell(OVER_TIME_NOTE)
        if choose_bands(path, self.bands, self.settings, self.whole_option):
            target = find_counterpart(path, job.source, job.output)
            return FileInBands(path, target, self.bands, self.tables, self.settings)
        if self.window:
            return self._window_reader.read(path)
        return self._read_frame(path)

    def _read_frame(self, path: Path) -> Imported:
        job, passes = self.job, not self.over_time.temporal
        return self.reading.read(path, job.source, job.remarks, tables=self.tables, light_passes=passes)

    @cached_property
    def _window_reader(self) -> WindowReader:
        return WindowReader(self.job.source, self.window, self._read_frame)

    @cached_property
    def _window_filter(self) -> WindowFilter:
        from lobewise.windows import WindowFilter

        return WindowFilter(self.window, **self.settings)

    def make_filter(self) -> SequenceFilter[Imported | FileInBands | FileInWindow, Result | DenoisedFile]:
        """Return a filter of frames, each by itself or over time."""
        from lobewise.temporal import TemporalFilter

        changes = self.over_time.extend(self.settings)
        return FilterAlone(self._filter_one) if changes is None else _FilterOverTime(TemporalFilter(**changes))

    def _filter_one(self, found: Imported | FileInBands | FileInWindow) -> Result | DenoisedFile:
        from lobewise.denoising import denoise as denoise_frame
        from lobewise.io.sequence import is_pattern

        if isinstance(found, FileInBands):
            # A sequence shows how many files are done instead.
            return found.denoise(None if is_pattern(self.job.source) else self.job.steps.tell)
        if isinstance(found, FileInWindow):
            return self._window_filter.denoise(found.frames, found.index)
        return denoise_frame(found.frame, **self.settings)

    def write(self, target: Path, result: Result | DenoisedFile, found: Imported | FileInBands | FileInWindow) -> None:
        """Write a result, unless it was written in bands, and its picture."""
        from lobewise.frame import Result

        if isinstance(found, FileInWindow):
            found = found.found

        pictures = self.job.pictures
        if isinstance(found, FileInBands) or not isinstance(result, Result):
            if pictures is not None:
                pictures.write_from_file(target)
            return
        better = self.shade(result, found.frame)
        self.writing.write(target, better, found, self.job.remarks)
        if pictures is not None:
            pictures.write(target, better.image)


class _FilterOverTime:
    """A filter of imported frames that lets every frame use the frames before it."""

    def __init__(self, over_time: TemporalFilter) -> None:
        self._over_time = over_time
        self.get_state, self.set_state = over_time.get_state, over_time.set_state

    def add(self, frame: Imported | FileInBands | FileInWindow, *, cut: bool = False) -> Result:
        """Return the result of the next frame."""
        # The option --temporal needs whole frames, and takes no window.
        assert not isinstance(frame, (FileInBands, FileInWindow))
        return self._over_time.add(frame.frame, cut=cut)


@with_settings(DenoiseSettings, "similarity", "radius", "beta", "device", group=FILTER_DETAILS, radius=5)
@with_groups
def upsample(
    source: Source,
    output: Output,
    *,
    settings: dict[str, Any],
    scale: Annotated[
        int | None, typer.Option(metavar="N", help="Distance of shaded pixels, in pixels.", show_default="the file's")
    ] = None,
    place: Annotated[
        str | None,
        typer.Option(metavar="ROW,COLUMN", help="The shaded pixel of each block.", show_default="the file's, or 0,0"),
    ] = None,
    bilinear: Annotated[bool, typer.Option("--bilinear", help="Interpolate between pixels, without guides.")] = False,
    reshading: Reshading,
    over_time: OverTime,
    overwrite: Overwrite = False,
    picture: Picture,
    telling: Telling,
) -> None:
    """Bring sparsely shaded radiance to every pixel, in one file or a sequence of them; the guides are kept."""
    if bilinear and over_time.temporal:
        raise InputError("--bilinear", expected="no --temporal beside it", got="both", action="leave one out")
    where = None if place is None else parse_place(place)
    protect_inputs(source, output, [reshading.scene], overwrite=overwrite, png=picture.png)
    shade = reshading.plan()
    job = Job.plan(source, output, picture, telling)
    over_time.require_sequence(source)
    verb = _Upsampler(
        job=job, settings=settings, scale=scale, place=where, bilinear=bilinear, over_time=over_time, shade=shade
    )
    options = {
        **settings,
        "bilinear": bilinear,
        "scale": scale,
        "place": place,
        "adaptive": [reshading.adaptive, reshading.scene],
        "picture": [picture.png, picture.exposure],
    }
    run_filter(job, verb, [options, over_time.extend(settings)])


@dataclass(frozen=True, kw_only=True)
class _Upsampler:
    """How `upsample` reads, filters and writes a file."""

    job: Job
    settings: dict[str, Any]
    scale: int | None
    place: tuple[int, int] | None
    """Row and column of the shaded pixel in each block."""
    bilinear: bool
    over_time: OverTime
    shade: Callable[[Result, AnyFrame], Result]

    def read(self, path: Path) -> SparseFrame:
        """Return the sparse frame of a file."""
        from lobewise.io import read_sparse_frame

        return read_sparse_frame(path, scale=self.scale, place=self.place)

    def make_filter(self) -> SequenceFilter[SparseFrame, Result]:
        """Return a filter of sparse frames, each by itself or over time."""
        from lobewise.temporal import TemporalFilter
        from lobewise.upsampling import upsample as upsample_frame

        changes = self.over_time.extend(self.settings)
        if changes is not None:
            return TemporalFilter(**changes)
        return FilterAlone(partial(upsample_frame, bilinear=self.bilinear, **self.settings))

    def write(self, target: Path, result: Result, found: SparseFrame) -> None:
        """Write the result as a frame with the guides of ``found``, and its picture."""
        from lobewise.frame import Frame, Radiance
        from lobewise.io import write_frame

        done = self.shade(result, found)
        radiance = Radiance(done.image, diffuse=done.diffuse, specular=done.specular)
        write_frame(target, Frame(radiance, found.gbuffer, found.camera, spp=found.spp, lobe_tables=found.lobe_tables))
        if self.job.pictures is not None:
            self.job.pictures.write(target, done.image)
