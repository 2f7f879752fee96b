"""What a call may take of memory and time; for services, which cannot let one file take the machine."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path

from lobewise.errors import InputError, LimitError, TimeLimitError
from lobewise.work.progress import work_in_progress

GIB = float(2**30)
MIN_MEMORY_GIB = 1.0
"""Smallest limit of memory, GiB: program and kernels alone take half of it."""
PROGRAM_GIB = 0.5
"""Memory that program, libraries and kernels take beside a band or a frame, GiB (docs/developers/bands.md)."""
MAX_SHARE_OF_MEMORY = 0.9
"""Share of its memory that a process with a limit plans to take: Dask ends a worker that takes 0.95."""


@dataclass(frozen=True)
class Limits:
    """What calls may take.

    Parameters
    ----------
    memory : float or None
        Memory of this process, GiB; None for no limit.
    seconds : float or None
        Time in all, seconds; None for no limit.
    deadline : float
        When the time is over, by `time.monotonic`.
    aside : float
        Memory that other frames hold, bytes.
    """

    memory: float | None = None
    seconds: float | None = None
    deadline: float = float("inf")
    aside: float = 0.0

    @property
    def left_gib(self) -> float | None:
        """Memory for frames and filters beside the program, GiB; None for no limit."""
        return None if self.memory is None else MAX_SHARE_OF_MEMORY * self.memory - PROGRAM_GIB - self.aside / GIB


_NONE = Limits()
_limits: ContextVar[Limits] = ContextVar("limits", default=_NONE)


def get_limits() -> Limits:
    """Return the limits of this thread."""
    return _limits.get()


@contextmanager
def limit_call(*, max_memory: float | None = None, max_seconds: float | None = None) -> Iterator[None]:
    """Limit the memory and the time of all calls of lobewise inside the context.

    The memory is planned, not watched: before a file is read, and before a frame is filtered, its need is compared with
    the limit. `denoise_file` chooses bands that fit, and Open Image Denoise works in tiles that fit. The time is looked
    at before every kernel and every piece of a file. A context inside another keeps the tighter limits. Threads that
    are started inside the context have none.

    Parameters
    ----------
    max_memory : float, optional
        Memory that this process may take, program included, GiB >= `MIN_MEMORY_GIB`.
    max_seconds : float, optional
        Time of all calls together, seconds > 0.

    Raises
    ------
    InputError
        If a limit is out of range.
    LimitError
        From calls inside: if a frame would take more memory, or the time is over. Outputs stay as they were.

    Examples
    --------
    >>> import lobewise
    >>> with lobewise.limit_call(max_memory=4.0, max_seconds=60.0):  # doctest: +SKIP
    ...     clean = lobewise.denoise(lobewise.read_frame("frame.exr"))
    """
    if max_memory is not None and not max_memory >= MIN_MEMORY_GIB:
        expected = f"GiB, at least {MIN_MEMORY_GIB:g}"
        raise InputError("max_memory", expected=expected, got=repr(max_memory), action="give more, or leave it out")
    if max_seconds is not None and not max_seconds > 0.0:
        raise InputError("max_seconds", expected="seconds > 0", got=repr(max_seconds), action="leave it out")
    limits = get_limits()
    if max_memory is not None:
        limits = replace(limits, memory=max_memory if limits.memory is None else min(max_memory, limits.memory))
    if max_seconds is not None:
        deadline = time.monotonic() + max_seconds
        if deadline < limits.deadline:
            limits = replace(limits, seconds=max_seconds, deadline=deadline)
    token = _limits.set(limits)
    try:
        yield
    finally:
        _limits.reset(token)


@contextmanager
def set_aside(held_bytes: float) -> Iterator[None]:
    """Count memory that other frames hold in the calls inside the context."""
    if held_bytes:
        require_memory(held_bytes)
    limits = get_limits()
    token = _limits.set(replace(limits, aside=limits.aside + held_bytes))
    try:
        yield
    finally:
        _limits.reset(token)


def check_limits() -> None:
    """Tell how far the call is. Raise LimitError if its time is over, CancelledError if its caller cancels it."""
    work = work_in_progress.get()
    if work is not None:
        work.tick()
    limits = get_limits()
    if time.monotonic() > limits.deadline:
        raise TimeLimitError(
            "max_seconds",
            expected=f"an end within {limits.seconds:g} seconds",
            got="more work",
            action="allow more time, choose a faster quality, or give a smaller image",
        )


def require_memory(needed_bytes: float) -> None:
    """Raise LimitError if frames and filters would take more bytes than are left."""
    limits = get_limits()
    if limits.left_gib is not None and needed_bytes > limits.left_gib * GIB:
        enough = math.ceil(((needed_bytes + limits.aside) / GIB + PROGRAM_GIB) / MAX_SHARE_OF_MEMORY * 10.0) / 10.0
        raise LimitError(
            "memory",
            expected=f"a frame that can be filtered within {limits.memory:.3g} GiB",
            got=f"one that needs {enough:g} GiB",
            action="allow more memory, choose a faster quality, or give a smaller image",
        )


def has_memory(needed_bytes: float) -> bool:
    """Return whether the limit, or without one the machine, leaves so many bytes for frames and filters."""
    limits, machine = get_limits(), measure_machine_memory()
    if limits.memory is None and machine is not None:
        limits = replace(limits, memory=machine / GIB)
    return limits.left_gib is None or needed_bytes <= limits.left_gib * GIB


def measure_machine_memory() -> int | None:
    """Return the memory of the machine, or of the container if this is less, in bytes; None where it is unknown."""
    known = []
    if hasattr(os, "sysconf"):
        known.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with suppress(OSError, ValueError):
        known.append(int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return min(known, default=None)
