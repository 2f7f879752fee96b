"""How a verb filters the frames of a sequence on a farm: what workers do, and what the user is told."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from lobewise.cli.options.bounding import Bounds
from lobewise.cli.options.farming import Farm
from lobewise.cli.output import describe_result, describe_settings, print_line, print_note
from lobewise.cli.running import Job, write_picture
from lobewise.cli.running import run_files as run_files_here
from lobewise.cli.terminal.outcome import tell_picture
from lobewise.display.views import View
from lobewise.errors import LobewiseError
from lobewise.farm.running import FarmJob, FarmReport, filter_on_farm
from lobewise.farm.tasks import TaskLog
from lobewise.io.files import require_exr_name
from lobewise.io.sequence import FramePattern, name_frames
from lobewise.recipes.files import FileResult
from lobewise.recipes.files.remarks import Remarks
from lobewise.recipes.files.running import FileFilter, Request, add_gaps, open_filter, run_files
from lobewise.reporting.picture import Pictures, name_picture
from lobewise.work.limits import limit_call

MAX_FAILURES_NAMED = 20
"""Most failures that are told one by one."""


@dataclass(frozen=True, kw_only=True)
class FrameWork:
    """What a worker does with a frame: what the verb does with it in a single process. It is plain data."""

    request: Request
    source: Path
    output: Path
    context: str
    """What the outputs depend on beside the files and the request."""
    has_pictures: bool
    stops: float | None
    """Exposure of the pictures, None where the first picture decides it."""
    view: View | None = None
    """What turns the light of the pictures into display values."""

    def list_sources(self, number: int, path: Path) -> Sequence[Path]:
        """Return every file that the result of a frame depends on."""
        return self.request.list_sources(number, self.source)

    def list_outputs(self, number: int) -> Sequence[Path]:
        """Return every file that is written for a frame."""
        target = FramePattern.parse(self.output).name(number)
        return [target, name_picture(target)] if self.has_pictures else [target]

    def filter_frames(
        self, numbers: Sequence[int], *, first: int, memory: float | None, checkpoint: Path, done: Callable[[int], None]
    ) -> TaskLog:
        """Filter frames into their files; see `lobewise.farm.tasks.Work`."""
        target = FramePattern.parse(self.output)
        files, remarks, pictures = _open_filter(pickle.dumps((self, first)))
        before = set(remarks.sentences)
        by_name = {target.name(number): number for number in numbers}

        def finish(path: Path, result: FileResult) -> None:
            if pictures is not None:
                write_picture(pictures, path, result)
            done(by_name[path])

        with limit_call(max_memory=memory):
            report = run_files(
                self.source,
                self.output,
                self.request,
                remarks,
                context=self.context,
                numbers=numbers,
                after=finish,
                files=files,
                checkpoint=checkpoint,
            )
        last = report.last
        return TaskLog(
            remarks=tuple(remark for remark in remarks.sentences.items() if remark[0] not in before),
            last="" if last is None else describe_result(last),
            settings="" if last is None else describe_settings(last),
        )

    def open_filter(self, first: int) -> tuple[FileFilter[Any], Remarks, Pictures | None]:
        """Return what filters frames, the remarks that it collects, and what writes pictures; see `filter_frames`."""
        remarks = Remarks()
        pictures = Pictures(stops=self.stops, first=FramePattern.parse(self.output).name(first), view=self.view)
        files = open_filter(self.request, self.source, self.output, remarks)
        return files, remarks, pictures if self.has_pictures else None


@lru_cache(maxsize=1)
def _open_filter(pickled: bytes) -> tuple[FileFilter[Any], Remarks, Pictures | None]:
    """Return what filters the frames of a run. A worker keeps it for the next frame: opening it may load a scene."""
    work, first = pickle.loads(pickled)
    opened: tuple[FileFilter[Any], Remarks, Pictures | None] = work.open_filter(first)
    return opened


def run_request(job: Job, request: Request, context: str, farm: Farm, bounds: Bounds) -> None:
    """Filter one file, or every file of a pattern, here or on a farm, and print what was done.

    ``context`` is what the outputs depend on beside the files and the request.

    Raises
    ------
    LobewiseError
        If a frame could not be filtered, on a farm at the end; see `lobewise.farm.running.filter_on_farm` for others.
    """
    require_exr_name(job.output)
    with bounds.limit():
        if farm.is_wanted:
            _run_on_farm(job, request, context, farm)
        else:
            run_files_here(job, request, context)


def _run_on_farm(job: Job, request: Request, context: str, farm: Farm) -> None:
    source, output = job.source.absolute(), job.output.absolute()
    request = request.anchor()
    shared = [(path.stat().st_size, path.stat().st_mtime_ns) for path in request.list_shared_sources()]
    work = FrameWork(
        request=request,
        source=source,
        output=output,
        context=context,
        has_pictures=job.pictures is not None,
        stops=None if job.pictures is None else job.pictures.stops,
        view=None if job.pictures is None else job.pictures.view,
    )
    farm_job = FarmJob(
        source=FramePattern.parse(source),
        output=FramePattern.parse(output),
        work=work,
        fingerprint=repr([request.fingerprint, context, shared]),
        by_shot=request.remembers,
        follows_first=work.has_pictures and work.stops is None,
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
    for failure in sorted(report.failures, key=lambda failed: failed.numbers)[:MAX_FAILURES_NAMED]:
        print_note(f"{name_frames(failure.numbers)}, worker {failure.worker}: {failure.problem}")
    numbers = sorted(number for failure in report.failures for number in failure.numbers)
    sentence = f"{len(numbers)} of {report.frames} frames could not be filtered ({name_frames(numbers).lower()})"
    traces = [failure.trace for failure in report.failures if failure.trace]
    if traces:
        raise RuntimeError(sentence) from RuntimeError(f"on a worker:\n{traces[0]}")
    raise LobewiseError(
        sentence, action="mend what is said above and give the same command again, which filters only these"
    )
