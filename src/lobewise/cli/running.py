"""How a verb filters one file, or every file of a sequence."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from lobewise.cli.options.common import Telling
from lobewise.cli.options.frames import choose_numbers
from lobewise.cli.options.writing import Picture, name_first_output
from lobewise.cli.terminal.outcome import Remarks, tell_gaps, tell_picture, tell_settings
from lobewise.cli.terminal.steps import Steps
from lobewise.work.progress import FILTER, WRITE, enter_stage, follow_file, watch_call

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from lobewise.cli.options.selections import DoneSeveral
    from lobewise.recipes.sequence import SequenceFilter, SequenceReport, State
    from lobewise.recipes.streaming import DenoisedFile
    from lobewise.records.frame import Result
    from lobewise.reporting.picture import Pictures

FileT = TypeVar("FileT")
ResultT = TypeVar("ResultT", bound="Result | DenoisedFile | DoneSeveral")


@dataclass(frozen=True, kw_only=True)
class Job:
    """The files that a verb filters, and how much it prints."""

    source: Path
    output: Path
    """Two files, or two patterns."""
    pictures: Pictures | None
    """Writes a picture beside each output, where pictures are asked for."""
    steps: Steps
    """Shows the progress."""
    verbose: bool
    """Whether to print the settings of the filter."""
    remarks: Remarks = field(default_factory=Remarks)
    tell_pixels: Callable[[str], None] | None = None
    """Takes the sentence on pixels that were shaded again; None prints it."""
    numbers: Collection[int] | None = None
    """The frames to filter; None for all."""

    @classmethod
    def plan(cls, source: Path, output: Path, frames: str | None, picture: Picture, telling: Telling) -> Job:
        """Return the job that the options ask for.

        See `lobewise.cli.options.frames.choose_numbers` and `lobewise.cli.options.writing.Picture.plan` for the errors.
        """
        numbers = choose_numbers(frames, source, picture)
        return cls(
            source=source,
            output=output,
            pictures=picture.plan(name_first_output(source, output, numbers)),
            steps=Steps(telling.progress),
            verbose=telling.verbose,
            numbers=numbers,
        )


class FileFilter(Protocol[FileT, ResultT]):
    """How a verb reads, filters and writes a file."""

    def read(self, path: Path) -> FileT:
        """Return the content of a file."""

    def make_filter(self) -> SequenceFilter[FileT, ResultT]:
        """Return a new filter."""

    def write(self, target: Path, result: ResultT, frame: FileT) -> None:
        """Write the result of ``frame`` to ``target``, and its picture."""


class Request(Protocol[FileT, ResultT]):
    """The options of a verb as plain data. Another process makes the same verb from them."""

    def make_verb(self, job: Job) -> FileFilter[FileT, ResultT]:
        """Return what reads, filters and writes the files of a job."""

    def anchor(self) -> Request[FileT, ResultT]:
        """Return the request with absolute paths, for processes that run in another folder."""

    def list_sources(self, number: int, source: Path) -> Sequence[Path]:
        """Return every file that the result of a frame of a pattern depends on.

        Frames before it count only where the filter does not remember them itself.
        """

    def list_shared_sources(self) -> Sequence[Path]:
        """Return every file, beside the frames, that results depend on."""

    @property
    def remembers(self) -> bool:
        """Whether a frame uses the frames before it."""

    @property
    def reads_neighbours(self) -> bool:
        """Whether a frame reads the files of the frames around it."""

    @property
    def asks_for_oidn(self) -> bool:
        """Whether results depend on Open Image Denoise being installed."""


class FilterAlone(Generic[FileT, ResultT]):
    """A sequence filter that filters every frame by itself."""

    def __init__(self, filter_one: Callable[[FileT], ResultT]) -> None:
        self._filter_one = filter_one

    def add(self, frame: FileT, *, cut: bool = False) -> ResultT:
        """Return the result of a frame."""
        return self._filter_one(frame)

    def get_state(self) -> State:
        """Return nothing: the filter remembers nothing."""
        return {}

    def set_state(self, state: State) -> None:
        """Do nothing."""


def run_filter(job: Job, request: Request[FileT, ResultT], fingerprint: Any) -> None:
    """Filter one file, or every file of a pattern, in this process, and print what was done.

    ``fingerprint`` holds every option that the results depend on: see `lobewise.recipes.sequence.filter_sequence`.
    """
    from lobewise.cli.output import describe_result, print_line
    from lobewise.farm.ledger import remove_records
    from lobewise.io.files import require_exr_name
    from lobewise.io.sequence import is_pattern

    require_exr_name(job.output)
    verb = request.make_verb(job)
    last: ResultT | None
    if is_pattern(job.source):
        report = _filter_sequence(job, verb, repr(fingerprint))
        last, frames, written = report.last, report.frames, report.written
        # Every frame was made: what a stopped farm has recorded is of no use any more.
        remove_records(job.output, job.numbers)
        counted = f"{written} of {frames} frames"
        counted += "" if last is None else f"; the last: {describe_result(last)}"
    else:
        last = result = _filter_file(job, verb)
        counted, frames, written = describe_result(result), 1, 1
    facts = {} if last is None else last.describe()
    job.steps.finish(output=str(job.output), frames=frames, written=written, **facts)
    print_line(f"Wrote {job.output}: {counted}.")
    tell_picture(job.output, job.pictures)
    tell_settings(last, job.verbose)


def _filter_file(job: Job, verb: FileFilter[FileT, ResultT]) -> ResultT:
    from lobewise.io.exr.layout import name_file
    from lobewise.io.files import require_writable

    require_writable(job.output)
    with job.steps as steps, watch_call(steps.follow), follow_file(job.source.name):
        frame = verb.read(job.source)
        enter_stage(FILTER)
        with name_file(job.source):
            result = verb.make_filter().add(frame)
        enter_stage(WRITE)
        verb.write(job.output, result, frame)
    job.remarks.tell_result(result)
    return result


def _filter_sequence(job: Job, verb: FileFilter[FileT, ResultT], fingerprint: str) -> SequenceReport[ResultT]:
    from lobewise.cli.output import print_note
    from lobewise.io.sequence import FramePattern
    from lobewise.recipes.sequence import filter_sequence

    def write(target: Path, result: ResultT, frame: FileT, path: Path) -> None:
        verb.write(target, result, frame)
        job.remarks.tell_result(result, pattern.read_number(path))

    pattern = FramePattern.parse(job.source)
    if job.numbers is None:
        tell_gaps(pattern)
    with job.steps as steps:
        return filter_sequence(
            job.source,
            job.output,
            verb.make_filter,
            read=verb.read,
            write=write,
            fingerprint=fingerprint,
            progress=steps.follow,
            remark=print_note,
            numbers=job.numbers,
        )
