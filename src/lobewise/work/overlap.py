"""Read the next file and write the one before while a file is filtered.

Reading and writing have a thread each, with the limits of the thread that starts them. The thread that filters alone
tells progress, and it tells the notes of each file after those of the files before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from dataclasses import dataclass, field
from threading import Event
from types import TracebackType
from typing import Any, TypeVar

from lobewise.work.limits import check_limits
from lobewise.work.progress import FILTER, MIN_SECONDS_BETWEEN, READ, WRITE, enter_stage, plan_stages, watch_call

T = TypeVar("T")
Note = Callable[[], object]
"""A call that tells something about a file."""

_take_note: ContextVar[Callable[[Note], object] | None] = ContextVar("take_note", default=None)
"""What takes the notes of this thread; None where each is told at once."""


def tell_in_turn(note: Note) -> None:
    """Call ``note`` when everything about the files before is told: at once, unless files are read ahead."""
    take = _take_note.get()
    if take is None:
        note()
    else:
        take(note)


@dataclass(frozen=True)
class _Task:
    """A call in another thread."""

    key: Hashable
    notes: list[Note] = field(default_factory=list)
    stopped: Event = field(default_factory=Event)
    future: Future[Any] = field(default_factory=Future)

    def run(self, stage: str, call: Callable[[], Any]) -> None:
        """Call a function, and keep what it returns and its seconds, or what it raises."""
        _take_note.set(self.notes.append)
        start = time.perf_counter()
        try:
            with watch_call(lambda _: not self.stopped.is_set()), plan_stages({stage: 1.0}):
                enter_stage(stage)
                result = call()
            self.future.set_result((result, time.perf_counter() - start))
        except BaseException as problem:
            self.future.set_exception(problem)

    def wait(self) -> None:
        """Wait for the end of the call. Meanwhile tell how far this thread is, and raise as `check_limits`."""
        while not wait([self.future], MIN_SECONDS_BETWEEN).done:
            check_limits()


class Overlap:
    """Reads one file ahead and writes one behind, beside the thread that filters. A ``with`` block ends its threads.

    What is under way when the block ends is written, also behind an error or a Ctrl-C. What is read ahead is dropped.
    """

    def __init__(self) -> None:
        self.seconds = dict.fromkeys((READ, FILTER, WRITE), 0.0)
        """Time of reading, filtering and writing, each by itself, seconds."""
        self._pool = ThreadPoolExecutor(2)
        self._reading: _Task | None = None
        self._writing: tuple[_Task, Callable[[], object]] | None = None
        self._notes: list[Note] = []
        """Notes of the file that is filtered, while the one before is written."""

    def __enter__(self) -> Overlap:
        self._token = _take_note.set(self._take)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._reading is not None:
                self._reading.stopped.set()
                wait([self._reading.future])
            if self._writing is not None:
                # The limits would end this wait as they ended the block.
                wait([self._writing[0].future])
            self.finish()
        except Exception:
            if kind is None:
                raise
        finally:
            _take_note.reset(self._token)
            self._pool.shutdown(wait=False)

    def read(self, key: Hashable, call: Callable[[], T]) -> T:
        """Return what was read ahead with this key; read it now if it was not. Raises what reading raises."""
        task = self._reading
        if task is not None and task.key == key:
            task.wait()
            self._reading = None
            for note in task.notes:
                self._take(note)
            result: T
            result, spent = task.future.result()
            self.seconds[READ] += spent
            return result
        self._reading = None
        if task is not None:
            # Another file than was foretold. Stopped readers would leave what they share half done.
            task.wait()
        with self.time(READ):
            return call()

    def read_ahead(self, key: Hashable, call: Callable[[], object]) -> None:
        """Begin to read the next file, for `read`."""
        self._reading = self._start(key, READ, call)

    def write(self, call: Callable[[], object], then: Callable[[], object], *, behind: bool) -> None:
        """Write a file, and then call ``then`` in this thread; ``behind`` while the next file is filtered.

        Raises what writing this file or the file before raises.
        """
        self.finish()
        task = self._start(None, WRITE, call) if behind else None
        if task is not None:
            self._writing = task, then
            return
        with self.time(WRITE):
            call()
        then()

    def finish(self) -> None:
        """Wait for the file that is written, and tell the notes that wait for it. Raises what writing it raises."""
        if self._writing is None:
            return
        task, then = self._writing
        task.wait()
        self._writing = None
        waiting, self._notes = self._notes, []
        try:
            for note in task.notes:
                note()
            _, spent = task.future.result()
            self.seconds[WRITE] += spent
            then()
        finally:
            for note in waiting:
                note()

    @contextmanager
    def time(self, stage: str) -> Iterator[None]:
        """Count the time of the ``with`` block for a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - start

    def _start(self, key: Hashable, stage: str, call: Callable[[], object]) -> _Task | None:
        """Return a call that begins in another thread; None where the system refuses a thread."""
        task = _Task(key)
        try:
            self._pool.submit(copy_context().run, task.run, stage, call)
        except RuntimeError:
            # The call stays in the queue of the other thread.
            task.stopped.set()
            return None
        return task

    def _take(self, note: Note) -> None:
        if self._writing is None:
            note()
        else:
            self._notes.append(note)
