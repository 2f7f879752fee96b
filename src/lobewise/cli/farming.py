"""How a verb filters the frames of a sequence on a farm: what workers do, and what the user is told."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from lobewise.cli.options.farming import Farm
from lobewise.cli.output import describe_result, describe_settings, print_line, print_note
from lobewise.cli.running import Job, list_outputs, write_picture
from lobewise.cli.terminal.outcome import tell_failures, tell_picture
from lobewise.farm.running import FarmJob, FarmReport, filter_on_farm
from lobewise.farm.tasks import TaskLog
from lobewise.io.sequence import FramePattern, name_frames
from lobewise.recipes.files.remarks import Remarks
from lobewise.recipes.files.running import FileFilter, Request, add_gaps, open_filter, open_records, run_files
from lobewise.recipes.ledger import Ledger
from lobewise.reporting.picture import Pictures
from lobewise.work.limits import limit_call


@dataclass(frozen=True, kw_only=True)
class FrameWork:
    """What a worker does with a frame: what the verb does with it in a single process. It is plain data."""

    request: Request
    source: Path
    output: Path
    pictures: Pictures | None
    """Writes a picture beside each output, where pictures are asked for."""

    def list_sources(self, number: int, path: Path) -> Sequence[Path]:
        """Return every file that the result of a frame depends on."""
        return self.request.list_sources(number, self.source)

    def list_outputs(self, number: int) -> Sequence[Path]:
        """Return every file that is written for a frame."""
        return list_outputs(self.output, self.pictures is not None, number)

    def filter_frames(self, numbers: Sequence[int], *, memory: float | None, ledger: Ledger) -> TaskLog:
        """Filter frames into their files; see `lobewise.farm.tasks.Work`."""
        files, remarks = _open_filter(pickle.dumps(self))
        before = set(remarks.sentences)
        with limit_call(max_memory=memory):
            report = run_files(
                self.source,
                self.output,
                self.request,
                remarks,
                numbers=numbers,
                list_outputs=self.list_outputs,
                after=None if self.pictures is None else partial(write_picture, self.pictures),
                files=files,
                ledger=ledger,
            )
        report.require_all()
        last = report.last
        return TaskLog(
            remarks=tuple(remark for remark in remarks.sentences.items() if remark[0] not in before),
            last="" if last is None else describe_result(last),
            settings="" if last is None else describe_settings(last),
        )

    def open_filter(self) -> tuple[FileFilter[Any], Remarks]:
        """Return what filters frames, and the remarks that it collects; see `filter_frames`."""
        remarks = Remarks()
        return open_filter(self.request, self.source, self.output, remarks), remarks


@lru_cache(maxsize=1)
def _open_filter(pickled: bytes) -> tuple[FileFilter[Any], Remarks]:
    """Return what filters the frames of a run. A worker keeps it for the next frame: opening it may load a scene."""
    opened: tuple[FileFilter[Any], Remarks] = pickle.loads(pickled).open_filter()
    return opened


def run_on_farm(job: Job, request: Request, context: str, farm: Farm) -> None:
    """Filter every file of a pattern on a farm, and print what was done.

    ``context`` is what the outputs depend on beside the files and the request.

    Raises
    ------
    LobewiseError
        If a frame could not be filtered, at the end; see `lobewise.farm.running.filter_on_farm` for others.
    """
    source, output = job.source.absolute(), job.output.absolute()
    request = request.anchor()
    work = FrameWork(
        request=request,
        source=source,
        output=output,
        pictures=job.pictures,
    )
    farm_job = FarmJob(
        source=FramePattern.parse(source),
        output=FramePattern.parse(output),
        work=work,
        ledger=open_records(source, output, request, context=context, numbers=job.numbers),
        by_shot=request.remembers,
        by_runs=request.reads_neighbours,
        with_oidn=request.asks_for_oidn,
        memory=farm.memory,
        numbers=job.numbers,
    )
    if job.numbers is None:
        add_gaps(job.remarks, farm_job.source)
    with job.steps as steps:
        report = filter_on_farm(
            farm_job,
            farm.open(),
            tell=print_note,
            remark=job.remarks.add,
            progress=steps.follow,
        )
    job.steps.finish(output=str(job.output), frames=report.frames, written=report.written)
    counted = f"{report.written} of {report.frames} frames"
    counted += f"; the last: {report.last.last}" if report.last.last else ""
    print_line(f"Wrote {job.output}: {counted}.")
    tell_picture(job.output, job.pictures)
    if job.verbose and report.last.settings:
        print_note(f"Settings: {report.last.settings}.")
    _tell_failures(report)


def _tell_failures(report: FarmReport) -> None:
    """Print why frames could not be filtered, and raise an error if there are any.

    Raises
    ------
    LobewiseError
        If files or settings are to blame.
    RuntimeError
        If a mistake of the program is to blame. Its cause shows the traceback of the worker.
    """
    if not report.failures:
        return
    failures = sorted(report.failures, key=lambda failed: failed.numbers)
    sentences = [f"{name_frames(each.numbers)}, worker {each.worker}: {each.problem}" for each in failures]
    numbers = sorted(number for failure in failures for number in failure.numbers)
    problem = tell_failures(sentences, numbers, report.frames)
    traces = [failure.trace for failure in report.failures if failure.trace]
    if traces:
        raise RuntimeError(str(problem)) from RuntimeError(f"on a worker:\n{traces[0]}")
    raise problem
