"""Filter one file, or every file of a sequence, as a request says."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from contextlib import nullcontext, suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

from lobewise.denoising.automatic import change_settings
from lobewise.errors import InputError, LobewiseError, require_choice, require_kind
from lobewise.io.exr.layout import name_file
from lobewise.io.files import PathLike, as_path, require_exr_name, require_other_files, require_writable
from lobewise.io.sequence import FramePattern, describe_gaps, is_pattern, look_up_number
from lobewise.recipes.environment import describe_environment
from lobewise.recipes.files.denoiser import FileDenoiser
from lobewise.recipes.files.remarks import Remarks
from lobewise.recipes.files.request import FileRequest
from lobewise.recipes.files.result import FileResult
from lobewise.recipes.ledger import Ledger, measure_all, open_ledger
from lobewise.recipes.sequence import Need, SequenceFilter, SequenceReport, filter_sequence, require_frames
from lobewise.settings import DenoiseSettings
from lobewise.work.limits import get_limits, has_memory, set_aside
from lobewise.work.overlap import Overlap
from lobewise.work.progress import FILTER, WRITE, Watcher, enter_stage, follow_file, watch_call

if TYPE_CHECKING:
    from lobewise.recipes.files.upsampler import UpsampleRequest

FileT = TypeVar("FileT")
Request: TypeAlias = "FileRequest | UpsampleRequest"


class FileFilter(Protocol[FileT]):
    """How files are read, filtered and written."""

    def foretell(self, path: Path) -> Need:
        """Return the memory that a file takes. Raises LobewiseError if that is unknown."""

    def read(self, path: Path) -> FileT:
        """Return the content of a file."""

    def make_filter(self) -> SequenceFilter[FileT, FileResult]:
        """Return a new filter."""

    def write(self, target: Path, result: FileResult, file: FileT) -> None:
        """Write the result of a file."""


def open_filter(request: Request, source: Path, output: Path, remarks: Remarks) -> FileFilter[Any]:
    """Return what reads, filters and writes the files of a request."""
    if isinstance(request, FileRequest):
        return FileDenoiser(request, source, output, remarks)
    from lobewise.recipes.files.upsampler import FileUpsampler

    return FileUpsampler(request, source, output, remarks)


def denoise_files(
    source: PathLike,
    output: PathLike,
    request: FileRequest | None = None,
    *,
    numbers: Collection[int] | None = None,
    progress: Watcher | None = None,
    remark: Callable[[str], object] | None = None,
    **changes: Any,
) -> SequenceReport[FileResult]:
    """Denoise an EXR file, or every file of a sequence, as the command ``lobewise denoise`` does.

    The files that come out have the same bytes: all views, passes, light groups and opacity are denoised, every other
    part, channel and attribute is kept, and large files are filtered in bands. A frame of a sequence that cannot be
    denoised does not stop the others. A sequence that was stopped goes on with what is missing.

    Parameters
    ----------
    source, output : path
        Two files, or two patterns such as ``noisy.####.exr`` and ``clean.####.exr``.
    request : FileRequest, optional
        How files are read, filtered and written.
    numbers : collection of int, optional
        Only these frames of a sequence; by default all.
    progress : callable, optional
        Is called with a `lobewise.Progress`; False cancels.
    remark : callable, optional
        Is called with sentences on how the files were understood, and what their results lack.
    **changes
        Single fields of `FileRequest`, or of its `lobewise.DenoiseSettings`, that replace those of ``request``.

    Returns
    -------
    SequenceReport
        Counts, and the result of the last file in ``last``.

    Raises
    ------
    FileError, MissingChannelError
        As of `lobewise.read_frame` and `lobewise.write_result`; the files that are finished stay.
    LobewiseError
        After all other frames of a sequence, if some could not be denoised.
    InputError
        Also if a parameter is unknown or out of range, or an output would replace an input.
    CancelledError
        If ``progress`` has returned False.

    Examples
    --------
    >>> import lobewise
    >>> lobewise.denoise_files("noisy.####.exr", "clean.####.exr", window=2)  # doctest: +SKIP
    """
    source, output = as_path(source, "source"), as_path(output, "output")
    require_exr_name(output)
    asked = change_request(FileRequest() if request is None else request, changes)
    asked.check()
    if is_pattern(source) != is_pattern(output):
        expected, got = "two files, or two patterns", f"{str(source)!r} and {str(output)!r}"
        raise InputError("source and output", expected=expected, got=got, action="name both alike")
    if not is_pattern(source):
        if asked.window or numbers is not None:
            what, expected = "window" if asked.window else "numbers", "a sequence such as 'in.####.exr'"
            raise InputError(what, expected=expected, got=repr(str(source)), action="leave it out")
        require_other_files([output], [source])
    remarks = Remarks(remark)
    report = run_files(source, output, asked, remarks, numbers=numbers, progress=progress)
    report.require_all()
    return report


def change_request(request: FileRequest, changes: dict[str, Any]) -> FileRequest:
    """Return a request with other fields, or other settings. Raises InputError if one is unknown or out of range."""
    require_kind("request", request, FileRequest)
    own = {one.name for one in fields(request)}
    settings = {name: value for name, value in changes.items() if name not in own}
    mine = {name: value for name, value in changes.items() if name in own}
    request = replace(request, **mine)
    require_kind("settings", request.settings, DenoiseSettings)
    for name in settings:
        require_choice("setting", name, sorted(own | {one.name for one in fields(DenoiseSettings)}))
    return replace(request, settings=change_settings(request.settings, settings))


def add_gaps(remarks: Remarks, source: FramePattern) -> None:
    """Tell which frames of a sequence are missing between its first and its last, if any is."""
    if gaps := describe_gaps([number for number, _ in source.find()]):
        remarks.add(gaps)


def open_records(
    source: Path, output: Path, request: Request, *, context: str = "", numbers: Collection[int] | None = None
) -> Ledger:
    """Return the records of a run over a sequence; see `run_files`."""
    environment = describe_environment(with_oidn=request.asks_for_oidn)
    settings = [
        request.anchor().fingerprint,
        context,
        measure_all(request.list_shared_sources()),
        environment,
    ]
    return open_ledger(FramePattern.parse(source), FramePattern.parse(output), numbers, settings)


def run_files(
    source: Path,
    output: Path,
    request: Request,
    remarks: Remarks,
    *,
    context: str = "",
    numbers: Collection[int] | None = None,
    list_outputs: Callable[[int], Sequence[Path]] | None = None,
    after: Callable[[Path, FileResult], object] | None = None,
    progress: Watcher | None = None,
    files: FileFilter[Any] | None = None,
    ledger: Ledger | None = None,
    overlap: Overlap | None = None,
    following: Path | None = None,
) -> SequenceReport[FileResult]:
    """Filter one file, or every file of a pattern.

    Parameters
    ----------
    source, output, request, remarks, numbers, progress
        As of `denoise_files` and `open_filter`.
    context : str
        What the outputs depend on beside the files and the request.
    list_outputs : callable, optional
        Returns every file that is written for a frame of a sequence; by default the one of ``output``.
    after : callable, optional
        Is called with every output and its result, after it is written.
    files : FileFilter, optional
        The filter, if it was opened before.
    ledger : Ledger, optional
        The records of a sequence, if somebody holds their lock; by default this run holds and at last removes them.
    overlap : Overlap, optional
        What read a single file ahead, and reads the ``following`` one, which the next call filters in the same way.
    """
    files = files or open_filter(request, source, output, remarks)

    def write(target: Path, result: FileResult, file: Any, path: Path) -> None:
        files.write(target, result, file)
        remarks.add_result(result, look_up_number(path, source))
        if after is not None:
            after(target, result)

    def run(ledger: Ledger, remark: Callable[[str], object] | None = None) -> SequenceReport[FileResult]:
        return filter_sequence(
            source,
            output,
            files.make_filter,
            read=files.read,
            write=write,
            ledger=ledger,
            remembers=request.remembers,
            list_sources=lambda number, _: request.list_sources(number, source),
            list_outputs=list_outputs,
            foretell=files.foretell,
            progress=progress,
            remark=remark,
            numbers=numbers,
        )

    if is_pattern(source):
        if ledger is not None:
            return run(ledger)
        if numbers is None:
            add_gaps(remarks, FramePattern.parse(source))
        require_frames(FramePattern.parse(source).find(numbers), FramePattern.parse(output))
        ledger = open_records(source, output, request, context=context, numbers=numbers)
        with ledger.hold():
            report = run(ledger, remarks.add)
            if not report.failures:
                ledger.remove()
        return report
    require_writable(output)
    with watch_call(progress), follow_file(source.name), nullcontext(overlap) if overlap else Overlap() as beside:
        return _run_file(source, files, partial(write, output), beside, following)


def _run_file(
    source: Path,
    files: FileFilter[Any],
    write: Callable[[FileResult, Any, Path], None],
    overlap: Overlap,
    following: Path | None,
) -> SequenceReport[FileResult]:
    """Filter one file, and begin to read the ``following`` one; see `run_files`."""
    before = dict(overlap.seconds)
    file = overlap.read(source, partial(files.read, source))
    aside = _read_ahead(files, source, following, overlap)
    enter_stage(FILTER)
    with overlap.time(FILTER), set_aside(aside), name_file(source):
        result = files.make_filter().add(file)
    enter_stage(WRITE)
    overlap.write(partial(write, result, file, source), lambda: None, behind=False)
    seconds = {stage: spent - before[stage] for stage, spent in overlap.seconds.items()}
    return SequenceReport(frames=1, written=1, last=result, stage_seconds=seconds)


def _read_ahead(files: FileFilter[Any], source: Path, following: Path | None, overlap: Overlap) -> float:
    """Begin to read the ``following`` file, where there is memory for it. Return the memory that it takes, bytes."""
    if following is not None and math.isinf(get_limits().deadline):
        # A limit of time is that of one file.
        with suppress(LobewiseError):
            own, other = files.foretell(source), files.foretell(following)
            if has_memory(own.held + own.work + other.held):
                overlap.read_ahead(following, partial(files.read, following))
                return other.held
    return 0.0
