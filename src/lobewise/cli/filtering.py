"""The verbs `denoise` and `upsample`, for single files and for sequences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.bands import Bands, FileInBands, choose_bands, require_bands
from lobewise.cli.options.bounding import Bounds
from lobewise.cli.options.common import OverTime, Source, Telling, parse_place, require_device
from lobewise.cli.options.farming import Farm
from lobewise.cli.options.frames import Frames, choose_numbers
from lobewise.cli.options.naming import (
    Sources,
    Target,
    Tev,
    open_streams,
    pair_files,
    prepare_tev,
    require_files,
    require_inputs,
    run_each,
)
from lobewise.cli.options.reading import PassReading, locate_counterpart, look_up_number, name_frame, read_tables
from lobewise.cli.options.selections import DoneOne, DoneSeveral, FileOfSeveral, FilterOfEach
from lobewise.cli.options.shading import Reshading
from lobewise.cli.options.spreading import with_groups, with_settings
from lobewise.cli.options.windows import FileInWindow, Window, WindowReader
from lobewise.cli.options.writing import Output, Overwrite, Picture, Writing, protect_inputs
from lobewise.cli.running import FilterAlone, Job
from lobewise.cli.terminal.help import FILTER_DETAILS
from lobewise.errors import InputError
from lobewise.settings import DenoiseSettings, TemporalSettings

if TYPE_CHECKING:
    from collections.abc import Callable

    from lobewise.interchange import Imported
    from lobewise.interchange.selections import Selection
    from lobewise.recipes.sequence import SequenceFilter, State
    from lobewise.recipes.streaming import DenoisedFile
    from lobewise.records.frame import Result
    from lobewise.records.lobe_table import LobeTable
    from lobewise.records.sparse_frame import AnyFrame, SparseFrame

    FileOfOne = Imported | FileInBands | FileInWindow
    """A file, or one of its views."""


@with_settings(
    DenoiseSettings,
    *("quality", "with_oidn", "similarity", "form", "radius", "beta", "lobes", "hit_distance", "device"),
    group=FILTER_DETAILS,
    usual=("quality", "with_oidn"),
)
@with_groups
def denoise(
    sources: Sources,
    output: Target = None,
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
    frames: Frames = None,
    window: Window,
    farm: Farm,
    bounds: Bounds,
    bands: Bands = "auto",
    reading: PassReading,
    writing: Writing,
    overwrite: Overwrite = False,
    picture: Picture,
    tev: Tev = False,
    telling: Telling,
) -> None:
    """Denoise EXR files of any renderer, or a sequence of them; other parts, channels and attributes are kept."""
    request = _Denoising(
        settings=settings,
        bands=bands,
        material=tuple(material or ()),
        window=window,
        reading=reading,
        writing=writing,
        reshading=reshading,
    )
    besides = [reading.half, reading.camera, reading.preset, reshading.scene, *request.material]
    request.check()
    picture.check()
    bounds.limit()

    def run(path: Path, target: Path) -> None:
        from lobewise.cli.farming import run_request

        job = Job.plan(path, target, frames, picture, telling)
        # Bands change no bit of a result.
        run_request(job, request, [replace(request, bands=""), picture], farm, bounds)

    show = prepare_tev(tev)
    require_files(sources, output, "--tev" if tev else "--png" if picture.png else "")
    with open_streams(sources, output) as (paths, target):
        pairs, folders = pair_files(paths, target)
        reading.require_one(len(pairs))
        for path, each in pairs:
            window.require(path)
            farm.check(path)
            choose_numbers(frames, path, picture)
            protect_inputs(path, each, besides, overwrite=overwrite, png=picture.png)
        require_inputs(paths, [each for _, each in pairs] if output is not None and not folders else [])
        run_each(pairs, folders, run)
        show(pairs)


@dataclass(frozen=True, kw_only=True)
class _Denoising:
    """What `denoise` does with every file: the options of the verb."""

    settings: dict[str, Any]
    bands: str
    material: tuple[Path, ...]
    window: Window
    reading: PassReading
    writing: Writing
    reshading: Reshading

    def check(self) -> None:
        """Raise a LobewiseError if an option is wrong, before a file is read or written."""
        DenoiseSettings(**self.settings)
        require_device(self.settings["device"])
        self.reshading.plan()
        self.reading.parse()
        require_bands(self.bands, self.whole_option)
        read_tables(self.material)

    @property
    def whole_option(self) -> str:
        """Name of the first option that needs whole frames, empty for none."""
        needs_whole = {
            "--adaptive": self.reshading.share > 0.0,
            "--with-oidn": self.settings["with_oidn"] is True,
        }
        given = [name for name, is_given in needs_whole.items() if is_given]
        return next(filter(None, [self.window.option, *given, self.reading.option, self.writing.option]), "")

    def make_verb(self, job: Job) -> _Denoiser:
        """Return what reads, filters and writes the files of a job."""
        shade = self.reshading.plan(job.tell_pixels)
        return _Denoiser(job=job, request=self, tables=read_tables(self.material), shade=shade)

    def anchor(self) -> _Denoising:
        """Return the request with absolute paths, for processes that run in another folder."""
        material = tuple(path.absolute() for path in self.material)
        return replace(self, material=material, reading=self.reading.anchor(), reshading=self.reshading.anchor())

    def list_sources(self, number: int, source: Path) -> list[Path]:
        """Return every file that the result of a frame depends on."""
        from lobewise.interchange.siblings import list_family

        frames = self.window.list_files(source, number) if self.window.reach else [(number, name_frame(source, number))]
        return [file for each, path in frames for file in (*list_family(path), *self.reading.list_halves(each))]

    def list_shared_sources(self) -> list[Path]:
        """Return every file, beside the frames, that results depend on."""
        return [*self.material, *self.reading.list_files(), *self.reshading.list_files()]

    remembers = False

    @property
    def reads_neighbours(self) -> bool:
        """Whether a frame reads the files of the frames around it."""
        return self.window.reach > 0

    @property
    def asks_for_oidn(self) -> bool:
        """Whether results depend on Open Image Denoise being installed."""
        from lobewise.denoising.automatic import leaves_oidn_open

        settings = DenoiseSettings(**self.settings)
        return settings.asks_for_oidn or leaves_oidn_open(settings)


@dataclass(frozen=True, kw_only=True)
class _Denoiser:
    """How `denoise` reads, filters and writes a file."""

    job: Job
    request: _Denoising
    tables: Sequence[LobeTable] | None
    shade: Callable[[Result, AnyFrame], Result]
    window_readers: dict[Selection, WindowReader] = field(default_factory=dict)
    """The readers of each view, with a window."""

    def read(self, path: Path) -> FileOfOne | FileOfSeveral:
        """Return the frame of a file, for a file that is denoised in bands its name, with a window all its frames."""
        job, request = self.job, self.request
        if choose_bands(path, request.bands, request.settings, request.whole_option):
            target = locate_counterpart(path, job.source, job.output)
            return FileInBands(path, target, request.bands, self.tables, request.settings)
        selections = request.reading.list_selections(path)
        return (
            FileOfSeveral(path, selections) if len(selections) > 1 else self._read_one(path, selections[0], selections)
        )

    def _read_one(self, path: Path, selection: Selection, denoised: tuple[Selection, ...]) -> Imported | FileInWindow:
        job, request = self.job, self.request

        def read(path_of_one: Path) -> Imported:
            return request.reading.read(
                path_of_one,
                job.source,
                job.remarks,
                selection=selection,
                denoised=denoised,
                tables=self.tables,
            )

        if not request.window.reach:
            return read(path)
        reader = self.window_readers.setdefault(selection, WindowReader(job.source, request.window, read))
        return reader.read(path)

    def make_filter(self) -> SequenceFilter[FileOfOne | FileOfSeveral, Result | DenoisedFile | DoneSeveral]:
        """Return a filter of files that filters each view, by itself or over time."""
        return FilterOfEach(self._make_filter_of_one, self._filter_selection)

    def _make_filter_of_one(self) -> SequenceFilter[Any, Result | DenoisedFile]:
        from lobewise.cli.options.reading import check_import
        from lobewise.denoising.recipe import denoise_checked
        from lobewise.recipes.windows import WindowFilter

        settings, window = self.request.settings, self.request.window
        if window.reach:
            in_window = WindowFilter(window.reach, past_only=window.temporal, **settings)
            return FilterAlone(lambda frame: in_window.denoise(frame.frames, frame.index))
        named = DenoiseSettings(**settings)

        def filter_one(frame: Imported | FileInBands) -> Result | DenoisedFile:
            if isinstance(frame, FileInBands):
                return frame.denoise()
            return denoise_checked(check_import(frame, named), named)

        return FilterAlone(filter_one)

    def _filter_selection(
        self, file: FileOfSeveral, selection: Selection, of_one: SequenceFilter[Any, Any], cut: bool
    ) -> DoneOne:
        frame = self._read_one(file.path, selection, file.selections)
        return self._plan(of_one.add(frame, cut=cut), frame)

    def _plan(self, result: Result, frame: Imported | FileInWindow) -> DoneOne:
        own = frame.imported if isinstance(frame, FileInWindow) else frame
        better = self.shade(result, own.frame)
        return DoneOne(own.container, better, self.request.writing.plan(better, own))

    def write(self, target: Path, result: Result | DenoisedFile | DoneSeveral, file: FileOfOne | FileOfSeveral) -> None:
        """Write the results of a file, unless they were written in bands, and the picture of the first."""
        from lobewise.records.frame import Result

        pictures = self.job.pictures
        if isinstance(result, DoneSeveral):
            done = result.done
        elif isinstance(result, Result) and not isinstance(file, (FileInBands, FileOfSeveral)):
            done = (self._plan(result, file),)
        else:
            if pictures is not None:
                pictures.write_from_file(target)
            return
        container, planned = done[0].container, [each.planned for each in done]
        frame = look_up_number(container.path, self.job.source)
        self.request.writing.write(target, planned, container, self.job.remarks, frame)
        if pictures is not None:
            pictures.write(target, done[0].result.image)


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
    frames: Frames = None,
    over_time: OverTime,
    farm: Farm,
    bounds: Bounds,
    overwrite: Overwrite = False,
    picture: Picture,
    telling: Telling,
) -> None:
    """Bring sparsely shaded radiance to every pixel, in one file or a sequence of them; the guides are kept."""
    from lobewise.io.files import require_exr_name
    from lobewise.records.sparse_frame import require_place

    if bilinear and over_time.temporal:
        raise InputError("--bilinear", expected="no --temporal beside it", got="both", action="leave one out")
    where = None if place is None else parse_place(place)
    DenoiseSettings(**settings)
    TemporalSettings(memory=over_time.memory)
    require_device(settings["device"])
    if scale is not None:
        require_place(scale, where or (0, 0))
    picture.check()
    bounds.limit()
    require_exr_name(output)
    protect_inputs(source, output, [reshading.scene], overwrite=overwrite, png=picture.png)
    reshading.plan()
    job = Job.plan(source, output, frames, picture, telling)
    over_time.require_sequence(source)
    request = _Upsampling(
        settings=settings, scale=scale, place=where, bilinear=bilinear, over_time=over_time, reshading=reshading
    )
    farm.check(source)
    from lobewise.cli.farming import run_request

    run_request(job, request, [request, picture], farm, bounds)


@dataclass(frozen=True, kw_only=True)
class _Upsampling:
    """What `upsample` does with every file: the options of the verb."""

    settings: dict[str, Any]
    scale: int | None
    place: tuple[int, int] | None
    """Row and column of the shaded pixel in each block."""
    bilinear: bool
    over_time: OverTime
    reshading: Reshading

    def make_verb(self, job: Job) -> _Upsampler:
        """Return what reads, filters and writes the files of a job."""
        return _Upsampler(job=job, request=self, shade=self.reshading.plan(job.tell_pixels))

    def anchor(self) -> _Upsampling:
        """Return the request with absolute paths, for processes that run in another folder."""
        return replace(self, reshading=self.reshading.anchor())

    def list_sources(self, number: int, source: Path) -> list[Path]:
        """Return every file that the result of a frame depends on."""
        from lobewise.interchange.siblings import list_family

        return list_family(name_frame(source, number))

    def list_shared_sources(self) -> list[Path]:
        """Return every file, beside the frames, that results depend on."""
        return self.reshading.list_files()

    @property
    def remembers(self) -> bool:
        """Whether a frame uses the frames before it."""
        return self.over_time.temporal

    reads_neighbours = asks_for_oidn = False


@dataclass(frozen=True, kw_only=True)
class _Upsampler:
    """How `upsample` reads, filters and writes a file."""

    job: Job
    request: _Upsampling
    shade: Callable[[Result, AnyFrame], Result]

    def read(self, path: Path) -> SparseFile:
        """Return the sparse frame of a file, and for a file of another renderer how it was read."""
        from lobewise.interchange.reading import is_own
        from lobewise.io import read_sparse_frame
        from lobewise.io.exr.layout import name_file
        from lobewise.io.exr.parsing import read_container
        from lobewise.records.sparse_frame import make_sparse

        scale, place = self.request.scale, self.request.place
        if is_own(read_container(path)):
            return SparseFile(read_sparse_frame(path, scale=scale, place=place))
        if scale is None:
            raise InputError(
                f"input {str(path)!r}",
                expected="--scale for a file of another renderer, whose header names no shaded pixels",
                got="none",
                action="say how far they are apart, such as --scale 4",
            )
        reading = PassReading()
        first = reading.list_selections(path)[0]
        imported = reading.read(path, self.job.source, self.job.remarks, selection=first)
        with name_file(path):
            return SparseFile(make_sparse(imported.frame, scale, place or (0, 0)), imported)

    def make_filter(self) -> SequenceFilter[SparseFile, Result]:
        """Return a filter of sparse frames, each by itself or over time."""
        from lobewise.recipes.temporal import TemporalFilter
        from lobewise.recipes.upsampling import upsample as upsample_frame

        changes = self.request.over_time.extend(self.request.settings)
        if changes is not None:
            return FilterOfFrames(TemporalFilter(**changes))
        filter_one = partial(upsample_frame, bilinear=self.request.bilinear, **self.request.settings)
        return FilterOfFrames(FilterAlone(filter_one))

    def write(self, target: Path, result: Result, file: SparseFile) -> None:
        """Write the result, and its picture: into a copy of another renderer's file, else with the guides."""
        from lobewise.interchange import write_result
        from lobewise.io import write_frame
        from lobewise.records.frame import Frame, Radiance

        frame, done = file.frame, self.shade(result, file.frame)
        if file.imported is None:
            radiance = Radiance(done.image, diffuse=done.diffuse, specular=done.specular)
            whole = Frame(radiance, frame.gbuffer, frame.camera, spp=frame.spp, lobe_tables=frame.lobe_tables)
            write_frame(target, whole)
        else:
            # A result has two layers, and passes of light may be any number of them.
            written = replace(file.imported, outputs={"color": file.imported.outputs["color"]})
            write_result(target, done, source=written)
        if self.job.pictures is not None:
            self.job.pictures.write(target, done.image)


@dataclass(frozen=True)
class SparseFile:
    """A sparse frame, and how it was read if another renderer wrote its file."""

    frame: SparseFrame
    imported: Imported | None = None


@dataclass(frozen=True)
class FilterOfFrames:
    """A filter of files by the filter of their frames."""

    of_frames: SequenceFilter[SparseFrame, Result]

    def add(self, file: SparseFile, *, cut: bool = False) -> Result:
        """Return the result of the frame of a file."""
        return self.of_frames.add(file.frame, cut=cut)

    def get_state(self) -> State:
        """Return what the filter of frames remembers."""
        return self.of_frames.get_state()

    def set_state(self, state: State) -> None:
        """Restore what the filter of frames remembers."""
        self.of_frames.set_state(state)
