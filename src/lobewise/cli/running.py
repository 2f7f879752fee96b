"""How a verb filters one file, or every file of a sequence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from lobewise.cli.options.common import Telling
from lobewise.cli.options.frames import choose_numbers
from lobewise.cli.options.writing import Picture, name_first_output
from lobewise.cli.terminal.outcome import make_remarks, tell_failures, tell_picture, tell_settings
from lobewise.cli.terminal.steps import Steps

if TYPE_CHECKING:
    from collections.abc import Collection

    from lobewise.cli.options.naming import Turn
    from lobewise.recipes.files import FileResult
    from lobewise.recipes.files.remarks import Remarks
    from lobewise.recipes.files.running import Request
    from lobewise.reporting.picture import Pictures


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
    remarks: Remarks
    numbers: Collection[int] | None = None
    """The frames to filter; None for all."""
    turn: Turn | None = None
    """The place of the source among several."""

    @classmethod
    def plan(
        cls,
        source: Path,
        output: Path,
        frames: str | None,
        picture: Picture,
        telling: Telling,
        remarks: Remarks | None = None,
        turn: Turn | None = None,
    ) -> Job:
        """Return the job that the options ask for, and make the folder of a sequence's outputs.

        ``remarks`` are those of the files before, whose notes are not told again.

        See `lobewise.cli.options.frames.choose_numbers` and `lobewise.cli.options.writing.Picture.plan` for the errors.
        """
        from lobewise.io.files import make_folder
        from lobewise.io.sequence import is_pattern

        remarks = remarks or make_remarks()
        if turn is not None:
            remarks.file = turn.label
        numbers = choose_numbers(frames, source, picture)
        if is_pattern(source) and is_pattern(output):
            make_folder(output.parent)
        return cls(
            source=source,
            output=output,
            pictures=picture.plan(name_first_output(source, output, numbers)),
            steps=Steps(telling.progress),
            remarks=remarks,
            verbose=telling.verbose,
            numbers=numbers,
            turn=turn,
        )

    def expose(self, request: Request, context: str) -> None:
        """Choose the exposure of the pictures of a sequence once, or read it from one that a stopped run wrote.

        ``context`` is that of `run_files`.
        """
        from lobewise.io.sequence import FramePattern
        from lobewise.recipes.files import FileRequest
        from lobewise.recipes.files.running import open_records
        from lobewise.reporting.picture import measure_exposure, read_exposure

        if self.pictures is None or self.pictures.exposure is not None:
            return
        known = None
        ledger = open_records(self.source, self.output, request, context=context, numbers=self.numbers)
        for number in sorted(ledger.list_recorded()):
            outputs = list_outputs(self.output, True, number)
            proof = ledger.prove([(number, self.source)], lambda each, _: request.list_sources(each, self.source))
            if ledger.is_done(number, proof[number], outputs):
                known = read_exposure(outputs[-1])
                break
        if known is None:
            paths = [path for _, path in FramePattern.parse(self.source).find()]
            if isinstance(request, FileRequest):
                known = measure_exposure(paths, preset=request.preset, mapping=request.mapping)
            else:
                known = measure_exposure(paths, sparse=True)
        self.pictures.exposure = known


def run_files(job: Job, request: Request, context: str) -> None:
    """Filter one file, or every file of a pattern, in this process, and print what was done.

    ``context`` is what the outputs depend on beside the files and the request.
    """
    from lobewise.cli.output import describe_result, print_line
    from lobewise.io.sequence import is_pattern
    from lobewise.recipes.files.running import run_files as run

    with job.steps as steps:
        report = run(
            job.source,
            job.output,
            request,
            job.remarks,
            context=context,
            numbers=job.numbers,
            list_outputs=partial(list_outputs, job.output, job.pictures is not None),
            after=None if job.pictures is None else partial(write_picture, job.pictures),
            progress=steps.follow,
            overlap=None if job.turn is None else job.turn.overlap,
            following=None if job.turn is None else job.turn.following,
        )
    last = report.last
    counted = "" if last is None else describe_result(last)
    if is_pattern(job.source):
        counted = f"{report.written} of {report.frames} frames{'; the last: ' if counted else ''}{counted}"
    facts = {} if last is None else last.describe()
    facts["stage_seconds"] = report.stage_seconds
    if problem := report.common_problem:
        raise problem
    job.steps.finish(output=str(job.output), frames=report.frames, written=report.written, **facts)
    print_line(f"Wrote {job.output}: {counted}.")
    tell_picture(job.output, job.pictures)
    tell_settings(report, job.verbose)
    if is_pattern(job.source) and report.failures:
        sentences = [f"Frame {failure.number}: {failure.problem}" for failure in report.failures]
        raise tell_failures(sentences, [failure.number for failure in report.failures], report.frames)


def list_outputs(output: Path, has_pictures: bool, number: int) -> list[Path]:
    """Return every file that is written for a frame of a sequence."""
    from lobewise.io.sequence import name_frame
    from lobewise.reporting.picture import name_picture

    target = name_frame(output, number)
    return [target, name_picture(target)] if has_pictures else [target]


def write_picture(pictures: Pictures, target: Path, result: FileResult) -> None:
    """Write the picture of a file that was written."""
    if result.image is None:
        pictures.write_from_file(target)
    else:
        pictures.write(target, result.image)
