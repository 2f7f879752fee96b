"""Upsample files as a request says: sparsely shaded radiance is brought to every pixel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lobewise.denoising.plan import estimate_work_bytes
from lobewise.errors import InputError
from lobewise.interchange.checks.unsampled import NOT_RENDERED
from lobewise.interchange.imported import Imported
from lobewise.interchange.importing.leftovers import list_names
from lobewise.interchange.lighting import name_pass
from lobewise.interchange.mapping import map_file
from lobewise.interchange.reading import list_selections
from lobewise.interchange.replacing import write_result
from lobewise.interchange.siblings import list_family
from lobewise.io.exr import write_frame
from lobewise.io.exr.layout import name_file
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.sparse import read_sparse_frame
from lobewise.io.sequence import name_frame
from lobewise.recipes.adaptive.shading import Shading
from lobewise.recipes.files.denoiser import read_view
from lobewise.recipes.files.foretelling import foretell_reading
from lobewise.recipes.files.remarks import Remarks
from lobewise.recipes.files.request import FileRequest
from lobewise.recipes.files.result import FileResult
from lobewise.recipes.sequence import FilterAlone, Need, SequenceFilter
from lobewise.recipes.states import State
from lobewise.recipes.upsampling import upsample
from lobewise.records.frame import Frame, Radiance, Result
from lobewise.records.sparse_frame import AnyFrame, SparseFrame, make_sparse

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True, kw_only=True)
class UpsampleRequest:
    """How files are upsampled, as plain data.

    Parameters
    ----------
    settings : mapping of str to object
        Settings of `lobewise.upsample`.
    scale : int or None
        Distance of shaded pixels, pixels; None for that in the header.
    place : (int, int) or None
        Row and column of the shaded pixel in each block; None for that in the header.
    bilinear : bool
        Whether to interpolate between pixels, without guides.
    memory : float or None
        The memory of a filter over time, as of `lobewise.TemporalFilter`; None to upsample each frame by itself.
    shading : Shading, optional
        Which pixels are shaded again.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    scale: int | None = None
    place: tuple[int, int] | None = None
    bilinear: bool = False
    memory: float | None = None
    shading: Shading | None = None

    @property
    def fingerprint(self) -> str:
        """Everything but the files that results depend on, as text."""
        return repr(self)

    def anchor(self) -> Self:
        """Return the request with absolute paths, for processes that run in another folder."""
        return self if self.shading is None else replace(self, shading=self.shading.anchor())

    def list_sources(self, number: int, source: Path) -> list[Path]:
        """Return every file that the result of a frame depends on."""
        return list_family(name_frame(source, number))

    def list_shared_sources(self) -> list[Path]:
        """Return every file, beside the frames, that results depend on."""
        return [] if self.shading is None else self.shading.list_files()

    @property
    def remembers(self) -> bool:
        """Whether the filter itself remembers the frames before a frame."""
        return self.memory is not None

    reads_neighbours = asks_for_oidn = False


@dataclass(frozen=True)
class SparseFile:
    """A sparse frame, and how it was read if another renderer wrote its file."""

    frame: SparseFrame
    imported: Imported | None = None


class FileUpsampler:
    """How a request upsamples files; see `lobewise.recipes.files.denoiser.FileDenoiser`."""

    def __init__(self, request: UpsampleRequest, source: Path, output: Path, remarks: Remarks) -> None:
        self._request, self._source, self._remarks = request, source, remarks
        self._improve = None if request.shading is None else request.shading.make_improver()

    def foretell(self, path: Path) -> Need:
        """Return the memory that a file takes. Raises LobewiseError if it cannot be read."""
        held, pixels = foretell_reading(path)
        history = 0.0
        if self._request.memory is not None:
            from lobewise.recipes.temporal.recipe import HISTORY_SHARE

            history = HISTORY_SHARE * held
        return Need(held, history + estimate_work_bytes(None, pixels, "fast", with_oidn=False))

    def read(self, path: Path) -> SparseFile:
        """Return the sparse frame of a file, and for a file of another renderer how it was read."""
        scale, place = self._request.scale, self._request.place
        if map_file(read_container(path)).is_own:
            return SparseFile(read_sparse_frame(path, scale=scale, place=place))
        if scale is None:
            raise InputError(
                f"input {str(path)!r}",
                expected="--scale for a file of another renderer, whose header names no shaded pixels",
                got="none",
                action="say how far they are apart, such as --scale 4",
            )
        first = list_selections(path)[0]
        imported = read_view(FileRequest(), path, self._source, self._remarks, selection=first)
        if not any(one.what == NOT_RENDERED for one in imported.findings):
            self._remarks.add(
                f"The light beside the pixels of --scale {scale} is not used; `lobewise denoise` uses all of it."
            )
        left = [name_pass(one.target.source.path) for name, one in imported.outputs.items() if name != "color"]
        for words in list_names("pass", left, many="passes"):
            self._remarks.add(f"Only the image is upsampled. Left as rendered: {words}.")
        with name_file(path):
            return SparseFile(make_sparse(imported.frame, scale, place or (0, 0)), imported)

    def make_filter(self) -> SequenceFilter[SparseFile, FileResult]:
        """Return a filter of sparse frames, each by itself or over time."""
        request = self._request
        of_frames: SequenceFilter[SparseFrame, Result]
        if request.memory is None:
            of_frames = FilterAlone(partial(upsample, bilinear=request.bilinear, **request.settings))
        else:
            from lobewise.recipes.temporal import TemporalFilter

            of_frames = TemporalFilter(**request.settings, memory=request.memory)
        return _FilterOfFiles(of_frames, self._improve)

    def write(self, target: Path, result: FileResult, file: SparseFile) -> None:
        """Write the result: into a copy of another renderer's file, else with the guides."""
        frame, done = file.frame, result.first
        assert isinstance(done, Result)
        if file.imported is not None:
            # A result has two layers, and passes of light may be any number of them.
            written = replace(file.imported, outputs={"color": file.imported.outputs["color"]})
            write_result(target, done, source=written)
            return
        radiance = Radiance(done.image, diffuse=done.diffuse, specular=done.specular)
        write_frame(target, Frame(radiance, frame.gbuffer, frame.camera, spp=frame.spp, lobe_tables=frame.lobe_tables))


@dataclass(frozen=True)
class _FilterOfFiles:
    """A filter of files by the filter of their frames."""

    of_frames: SequenceFilter[SparseFrame, Result]
    improve: Callable[[Result, AnyFrame], Result] | None

    def add(self, file: SparseFile, *, cut: bool = False) -> FileResult:
        """Return the result of the frame of a file."""
        result = self.of_frames.add(file.frame, cut=cut)
        return FileResult((result if self.improve is None else self.improve(result, file.frame),))

    def get_state(self) -> State:
        """Return what the filter of frames remembers."""
        return self.of_frames.get_state()

    def set_state(self, state: State) -> None:
        """Restore the memory that `get_state` returned."""
        self.of_frames.set_state(state)
