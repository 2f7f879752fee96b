"""Denoise files as a request says: read each view of a file, filter it, and write all results into one copy."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock

import numpy as np

from lobewise.denoising.automatic import ask
from lobewise.denoising.inputs import list_images
from lobewise.denoising.plan import estimate_work_bytes
from lobewise.denoising.recipe import check_frame, denoise_checked
from lobewise.errors import InputError, LobewiseError
from lobewise.guides.usable import CheckedGuides, check_guides
from lobewise.interchange.checks import MARKED, Finding
from lobewise.interchange.checks.denoised import check_mark
from lobewise.interchange.imported import Imported
from lobewise.interchange.mapping import map_file
from lobewise.interchange.reading import import_file, list_selections
from lobewise.interchange.replacing import PlannedResult, plan_result, require_target, write_planned
from lobewise.interchange.selections import Selection
from lobewise.io.exr.parsing import read_container
from lobewise.io.sequence import FramePattern, is_pattern, locate_counterpart, look_up_number, name_frame
from lobewise.recipes.adaptive import find_unsupported
from lobewise.recipes.files.foretelling import foretell_reading
from lobewise.recipes.files.remarks import Remarks
from lobewise.recipes.files.request import FileRequest
from lobewise.recipes.files.result import FileResult
from lobewise.recipes.sequence import OF_ALL_FRAMES, FilterAlone, Need
from lobewise.recipes.streaming.checks import open_bands
from lobewise.recipes.streaming.plan import needs_bands
from lobewise.records.frame import Frame, Result
from lobewise.records.lobe_table import LobeTable
from lobewise.settings import DenoiseSettings


@dataclass(frozen=True)
class OpenedView:
    """A view of a file, and the window of frames around it where it is denoised with one.

    Parameters
    ----------
    imported : Imported
        The view.
    window : sequence of Frame
        The frames.
    index : int
        The number of the view's frame among them.
    """

    imported: Imported
    window: Sequence[Frame] = ()
    index: int = 0


@dataclass(frozen=True)
class OpenedFile:
    """A file that will be denoised.

    Parameters
    ----------
    path : Path
        The file.
    selections : sequence of Selection
        Its views and view layers; none where it is denoised in bands.
    only : OpenedView or None
        The only view. Of several, each is read when it is filtered, so that one is in memory at a time.
    """

    path: Path
    selections: Sequence[Selection] = ()
    only: OpenedView | None = None


class FileDenoiser:
    """How a request denoises files.

    Parameters
    ----------
    request : FileRequest
        What is asked.
    source, output : Path
        Two files, or two patterns.
    remarks : Remarks
        Takes what is to be told of the files.
    """

    def __init__(self, request: FileRequest, source: Path, output: Path, remarks: Remarks) -> None:
        self._request, self._source, self._output, self._remarks = request, source, output, remarks
        self._tables = request.read_tables()
        self._improve = None if request.shading is None else request.shading.make_improver()
        self._windows: dict[Selection, _Window] = {}
        self._flips: dict[Selection, Mapping[str, str]] = {}
        self._reading = Lock()

    def foretell(self, path: Path) -> Need:
        """Return the memory that a file takes, from the headers of all that is read with it.

        Raises LobewiseError if the file cannot be read.
        """
        request, settings = self._request, ask(self._request.settings, {})
        held, pixels = foretell_reading(path)
        held *= 1 if request.half is None else 2
        work = estimate_work_bytes(None, pixels, settings.quality, with_oidn=bool(settings.with_oidn))
        if request.window:
            from lobewise.recipes.windows.recipe import HELD_SHARE

            number = FramePattern.parse(self._source).read_number(path)
            work += HELD_SHARE * held * len(request.list_window(self._source, number))
        return Need(held, work)

    def read(self, path: Path) -> OpenedFile:
        """Return a file, with its view if it has only one, unless it is denoised in bands."""
        if choose_bands(path, self._request):
            return OpenedFile(path)
        request = self._request
        selections = list_selections(
            path, preset=request.preset, mapping=request.mapping, all_layers=request.all_layers
        )
        only = self._read_view(path, selections[0], selections) if len(selections) == 1 else None
        return OpenedFile(path, selections, only)

    def _read_view(self, path: Path, selection: Selection, selections: Sequence[Selection]) -> OpenedView:
        read = partial(self._import, selection=selection, selections=selections)
        if not self._request.window:
            return OpenedView(read(path))
        # The only view of a file may be read while the views of the file before are.
        with self._reading:
            if selection not in self._windows:
                self._windows[selection] = _Window(self._request, self._source, self._remarks)
            return self._windows[selection].read(path, read)

    def _import(self, path: Path, selection: Selection, selections: Sequence[Selection]) -> Imported:
        return read_view(
            self._request,
            path,
            self._source,
            self._remarks,
            selection=selection,
            denoised=selections,
            tables=self._tables,
            choose_flips=partial(self._choose_flips, selection) if is_pattern(self._source) else None,
        )

    def _choose_flips(self, selection: Selection) -> Mapping[str, str]:
        """Return the `Imported.flips` of the sequence: those of most of three of its frames.

        In a frame of noise a guide may by chance explain the image better when it is turned over.
        """
        if selection not in self._flips:
            frames = FramePattern.parse(self._source).find()
            votes: list[Mapping[str, str]] = []
            for _, path in dict.fromkeys((frames[0], frames[len(frames) // 2], frames[-1])):
                with suppress(LobewiseError):
                    quiet = Remarks()
                    image = read_view(
                        self._request, path, self._source, quiet, selection=selection, tables=self._tables
                    )
                    votes.append(image.flips)
            self._flips[selection] = next((each for each in votes if 2 * votes.count(each) > len(votes)), {})
        return self._flips[selection]

    def make_filter(self) -> FilterAlone[OpenedFile, FileResult]:
        """Return the filter of the files. It remembers no file: a window is read anew."""
        return FilterAlone(self._filter)

    def _filter(self, file: OpenedFile) -> FileResult:
        request = self._request
        if not file.selections:
            from lobewise.recipes.streaming.recipe import denoise_file

            target = locate_counterpart(file.path, self._source, self._output)
            rows = request.bands if isinstance(request.bands, int) else None
            return FileResult((denoise_file(file.path, target, request.settings, lobe_tables=self._tables, rows=rows),))
        done, planned = [], []
        for selection in file.selections:
            view = file.only or self._read_view(file.path, selection, file.selections)
            result = self._filter_view(selection, view)
            done.append(result)
            planned.append(self._plan(result, view.imported))
        return FileResult(done, file.selections, view.imported.container, planned)

    def _filter_view(self, selection: Selection, view: OpenedView) -> Result:
        settings = self._request.settings
        if view.window:
            result = self._windows[selection].filter.denoise(view.window, view.index)
        else:
            result = denoise_checked(check_import(view.imported, settings), settings)
        return result if self._improve is None else self._improve(result, view.imported.frame)

    def _plan(self, result: Result, imported: Imported) -> PlannedResult:
        confidence = self._request.confidence
        return plan_result(
            result,
            imported,
            suffix=self._request.suffix,
            only=self._request.only,
            confidence=confidence,
            rerender=find_unsupported(result).astype(np.float32) if confidence else None,
        )

    def write(self, target: Path, result: FileResult, file: OpenedFile) -> None:
        """Write the results of a file into its copy, unless they were written in bands."""
        if result.container is None:
            return
        number = look_up_number(file.path, self._source)
        for note in write_planned(target, result.container, result.planned, only=self._request.only):
            self._remarks.add(note, frame=number)


class _Window:
    """Reads each file of a sequence with the files around it, and keeps files as long as windows need them."""

    def __init__(self, request: FileRequest, source: Path, remarks: Remarks) -> None:
        from lobewise.recipes.windows import WindowFilter

        self._request, self._source, self._remarks = request, source, remarks
        self.filter = WindowFilter(request.window, request.settings, past_only=request.past_only)
        self._kept: dict[Path, Imported | None] = {}
        """The frames of the files of a window; None for a file that cannot be read."""

    def read(self, path: Path, read: Callable[[Path], Imported]) -> OpenedView:
        """Return a file with the files around it.

        A missing number, or a frame that cannot be read or has another size, ends a window.
        """
        middle = FramePattern.parse(self._source).read_number(path)
        files = self._request.list_window(self._source, middle)
        known, self._kept = self._kept, {}
        own = known.get(path) or self._read(middle, path, read)
        for number, each in files:
            if each == path:
                self._kept[each] = own
            else:
                self._kept[each] = known[each] if each in known else self._read_other(number, each, read)
        images = [self._kept[each] for _, each in files]
        index = middle - files[0][0]
        first = max((k + 1 for k in range(index) if images[k] is None), default=0)
        past = next((k for k in range(index, len(images)) if images[k] is None), len(images))
        return OpenedView(own, [image.frame for image in images[first:past] if image is not None], index - first)

    def _read(self, number: int, path: Path, read: Callable[[Path], Imported]) -> Imported:
        imported = read(path)
        with suppress(LobewiseError):
            return imported.follow_window(read_container(name_frame(self._source, number - 1)))
        return imported

    def _read_other(self, number: int, path: Path, read: Callable[[Path], Imported]) -> Imported | None:
        try:
            return self._read(number, path, read)
        except OF_ALL_FRAMES:
            raise
        except LobewiseError as problem:
            self._remarks.add(f"Frame {number} ends the windows of the frames around it: {problem}")
            return None


def read_view(
    request: FileRequest,
    path: Path,
    source: Path,
    remarks: Remarks,
    *,
    selection: Selection,
    denoised: Collection[Selection] = (),
    tables: Sequence[LobeTable] | None = None,
    choose_flips: Callable[[], Mapping[str, str]] | None = None,
) -> Imported:
    """Return the frame of a view and view layer of a file, with its light by passes.

    Parameters
    ----------
    request : FileRequest
        How the file is read.
    path : Path
        The file.
    source : Path
        The file again, or the pattern of its sequence.
    remarks : Remarks
        Tells how the file was understood.
    selection : Selection
        The view and view layer.
    denoised : collection of Selection
        All that is filtered of the file. After the first one, only notes of a new kind are told.
    tables : sequence of LobeTable, optional
        Fitted materials that replace the materials in the file.
    choose_flips : callable, optional
        Returns the `Imported.flips` of the sequence. It is asked where the file alone seems to have any.
    """
    options = request.make_read_options()
    read = partial(
        import_file,
        path,
        **options,
        half=_locate_half(request, path, source),
        lobe_tables=tables,
        also=request.also,
        light_passes=True,
        light_groups=request.light_groups,
        view=selection.view or None,
        layer=selection.layer or None,
        denoised=denoised,
    )
    imported = read()
    if imported.flips and choose_flips is not None and (flips := choose_flips()) != imported.flips:
        imported = read(flips=flips)
    if "color" not in options["mapping"]:
        refuse_results(path, imported.findings)
    require_target(imported)
    # A finding holds figures of one frame: of a sequence only the first frame's are told.
    known = {one.sentence: f"{one.what}, {one.mended}" for one in imported.findings}
    first = next(iter(denoised), selection)
    for note in imported.remarks:
        remarks.add_of(selection, first, note, known.get(note, note), look_up_number(path, source))
    return imported


def _locate_half(request: FileRequest, path: Path, source: Path) -> Path | None:
    """Return the file of the second render that belongs to a file of the first; None where there is none."""
    if request.half is None:
        return None
    half = Path(request.half)
    if is_pattern(half) != is_pattern(source):
        raise InputError(
            "half",
            expected="a sequence for a sequence, and a file for a file",
            got=f"{str(half)!r} for {str(source)!r}",
            action="name both alike",
        )
    return locate_counterpart(path, source, half)


def check_import(imported: Imported, named: DenoiseSettings) -> CheckedGuides[Frame]:
    """Return the frame of a file with its guides checked, and notes; ``named`` are the settings of the user."""
    # The notes on a file of another renderer say already what it lacks, and how to have it.
    return check_frame(imported.frame, named) if imported.map.is_own else check_guides(imported.frame)


def choose_bands(path: Path, request: FileRequest) -> bool:
    """Return whether to denoise a file in bands.

    Raises InputError if it is a result of lobewise.
    """
    is_asked = isinstance(request.bands, int)
    if request.bands == "off" or request.whole_field or not (is_asked or _is_large(path, request.settings)):
        return False
    container = read_container(path)
    refuse_results(path, check_mark(container, map_file(container)))
    return True


def _is_large(path: Path, settings: DenoiseSettings) -> bool:
    asked = ask(settings, {}, whole=False)
    try:
        reader = open_bands(path, wanted=list_images(asked))
        # Normals that stand in for missing ones are found in the whole image; another renderer's file may need it too.
        return needs_bands(reader, asked) and ("gbuffer", "normal") in reader.images
    except LobewiseError:
        # A whole frame may be readable nevertheless; if it is not, reading it raises the error again.
        return False


def refuse_results(path: Path, findings: Iterable[Finding]) -> None:
    """Raise InputError if the image of a file is a result of lobewise: it has no noise left to measure."""
    if any(one.what == MARKED and not one.mended for one in findings):
        raise InputError(
            f"input {str(path)!r}",
            expected="a noisy render",
            got="a result of lobewise, as its attribute 'lobewise/denoised' says",
            action="give the noisy render, or name the image that is noisy, such as --map color=PASS",
        )
