"""Progress on a terminal: one line on standard error that disappears when the work is done."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from datetime import timedelta
from types import TracebackType
from typing import TYPE_CHECKING, Any

from lobewise.backend.watching import watch_compiling
from lobewise.cli.terminal.lines import write_line
from lobewise.work.progress import DONE
from lobewise.work.progress import Progress as Record

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_shown: list[Progress] = []
"""Displays that are shown now, one at most."""
MIN_SECONDS_WITH_BAR = 2.0
"""Time that a single file takes before its bar is shown, seconds."""
COMPILING = "Compiling kernels, which is done once on a machine"


class Steps:
    """Shows the current step of the work, with a bar where it is known how much is done.

    While kernels are compiled, the line says so instead. Nothing is shown where standard error is not a terminal that
    can erase a line, or ``progress`` is "off". With "json" records are lines of JSON.
    """

    def __init__(self, progress: str = "auto") -> None:
        self._progress = progress
        self._begun = time.monotonic()
        self._display: Progress | None = None
        self._task: TaskID | None = None
        self._told: tuple[str, float, float | None, dict[str, Any]] | None = None
        self._context = ExitStack()

    def __enter__(self) -> Steps:
        self._begun = time.monotonic()
        if self._progress == "auto":
            self._display = _make_display()
        if self._display is not None:
            _shown.append(self._display)
            self._display.start()
            self._context.enter_context(watch_compiling(self._tell_compiling))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.close()
        if self._display is not None:
            _shown.remove(self._display)
            self._display.stop()
        self._display = self._task = self._told = None

    def tell(self, what: str, done: float = 0, total: float | None = None) -> None:
        """Show a step in place of the step before; ``total`` is None where it is unknown how much is done."""
        is_new, self._told = self._told is None or self._told[0] != what, (what, done, total, {})
        self._show(what, done, total, {}, is_new=is_new)

    def follow(self, record: Record) -> None:
        """Show a record of `lobewise.work.progress`: a bar where there are several frames, or the work takes long."""
        if record.stage == DONE:
            return
        if self._progress == "json":
            write_line(**asdict(record))
            return
        several, what = record.frames > 1, ": ".join(filter(None, [record.frame, record.stage]))
        is_long = several or time.monotonic() - self._begun >= MIN_SECONDS_WITH_BAR
        fields = {"frames": several, "left": record.seconds_left}
        is_first, done = self._told is None, record.share * record.frames
        self._told = what, done, record.frames if is_long else None, fields
        self._show(*self._told, is_new=is_first)

    def finish(self, **facts: Any) -> None:
        """Write the facts of the result as the last line, where lines of JSON are written."""
        if self._progress == "json":
            write_line(stage=DONE, share=1.0, **facts)

    def _show(self, what: str, done: float, total: float | None, fields: dict[str, Any], *, is_new: bool) -> None:
        if self._display is None:
            return
        if self._task is not None and is_new:
            self._display.remove_task(self._task)
            self._task = None
        if self._task is None:
            # What is done already says nothing of the speed.
            self._task = self._display.add_task(what, total=total, completed=int(done), **fields)
        # A step that is quickly over is shown as well.
        is_other = self._display.tasks[-1].description != what
        self._display.update(self._task, description=what, completed=done, total=total, refresh=is_other, **fields)

    def _tell_compiling(self, begins: bool) -> None:
        if begins:
            self._show(COMPILING, 0, None, {}, is_new=True)
        elif self._told is not None:
            self._show(*self._told, is_new=True)


@contextmanager
def pause_steps() -> Iterator[None]:
    """Erase the line of progress while something else is printed."""
    for display in _shown:
        display.stop()
    yield
    for display in _shown:
        display.start()


def erase_steps() -> None:
    """Erase the line of progress that a crashed process left on this one's terminal, and show the cursor again."""
    if sys.stderr is None or not sys.stderr.isatty():
        return
    from rich.console import Console
    from rich.control import Control
    from rich.segment import ControlType

    erase = Control(ControlType.CARRIAGE_RETURN, (ControlType.ERASE_IN_LINE, 2), ControlType.SHOW_CURSOR)
    Console(stderr=True).control(erase)


def _format_rate(rate: float) -> str:
    return f"{rate:.0f}" if rate >= 10.0 else f"{rate:.1f}"


def _make_display() -> Progress | None:
    if sys.stderr is None or not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    class Amount(ProgressColumn):
        """Share that is done, speed and time left; the time since the start where the total is unknown."""

        def render(self, task: Task) -> Text:
            if task.total is None:
                return Text(f"{task.elapsed or 0.0:.0f} s")
            seconds = task.fields.get("left", task.time_remaining)
            left = "" if seconds is None else f", {timedelta(seconds=int(seconds))} left"
            speed = task.finished_speed or task.speed
            rate = f", {_format_rate(60.0 * speed)} frames a minute" if task.fields.get("frames") and speed else ""
            return Text(f"{task.percentage:3.0f} %{rate}{left}")

    console = Console(stderr=True)
    if not console.is_interactive:
        return None
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), Amount())
    return Progress(*columns, console=console, transient=True)
