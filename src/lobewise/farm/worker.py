"""What runs on a worker: the check that it sees the files, and the filtering of one task at a time."""

from __future__ import annotations

import ctypes
import os
import sys
import threading
import traceback
import uuid
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from lobewise.errors import LobewiseError, make_printable
from lobewise.farm.tasks import Assignment, TaskLog, TaskResult
from lobewise.recipes.environment import describe_environment
from lobewise.recipes.ledger import TOKEN, refresh_folders

PROCESS = uuid.uuid4().hex
"""Name of this process. A worker that is started again may have the address of the one that ended."""
_one_task = threading.Lock()
"""Held while a task runs. Dask starts as many tasks as a worker has threads; here these threads share one frame."""
MAX_TOLD_LETTERS = 300
"""Longest description of an unexpected error, in letters."""
GIB = float(2**30)
KEPT_BYTES = 1 << 26
"""Freed memory that a process keeps. It is what glibc arrives at by itself, unless it is told otherwise."""
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's parameters in ``malloc.h``."""


def describe_worker(
    folder: Path, token: str, source: Path, size: int, with_oidn: bool
) -> tuple[str, dict[str, str], str]:
    """Return the name of this process, its versions, and why it cannot be used, in a few words; empty if it can.

    Parameters
    ----------
    folder : Path
        Folder of the records, beside the outputs.
    token : str
        What the client wrote there.
    source : Path
        The first source.
    size : int
        Its size where the client is, bytes.
    with_oidn : bool
        Whether the version of Open Image Denoise matters.
    """
    return PROCESS, describe_environment(with_oidn=with_oidn), _describe_fault(folder, token, source, size)


def _describe_fault(folder: Path, token: str, source: Path, size: int) -> str:
    # Network drives remember what a folder held; opening the folder makes them look again.
    refresh_folders(source.parent, folder.parent, folder)
    if not source.is_file():
        return f"it does not see the file {str(source)!r}"
    if source.stat().st_size != size:
        return f"it sees another file as {str(source)!r}"
    try:
        seen = (folder / TOKEN).read_text()
    except OSError:
        return f"it does not see the folder {str(folder.parent)!r}"
    if seen != token:
        return f"it sees another folder as {str(folder.parent)!r}"
    if not os.access(folder.parent, os.W_OK | os.X_OK):
        return f"it may not write to the folder {str(folder.parent)!r}"
    return ""


def run_assignment(assignment: Assignment, process: str) -> TaskResult:
    """Filter the frames of an assignment that are not done, and record them.

    After a lost connection the client may hand out what another worker was still at.

    Dask gives the assignments of a process that ended to the next one at the same address, which would end in the same
    way: so a process does only assignments that name it.
    """
    if process != PROCESS:
        return TaskResult(is_lost=True)
    with _one_task:
        worker = _get_dask_worker()
        if worker is not None:
            _keep_freed_memory()
            limit_threads(worker.state.nthreads)
        return _run(assignment)


def _run(assignment: Assignment) -> TaskResult:
    log, problem, trace = TaskLog(), "", ""
    with warnings.catch_warnings(record=True) as caught:
        try:
            log = assignment.work.filter_frames(
                assignment.task.numbers,
                memory=_look_up_memory(assignment.memory),
                ledger=assignment.ledger,
            )
        except LobewiseError as error:
            problem = str(error)
        except Exception as error:
            words = " ".join(f"{type(error).__name__}: {error}".split())[:MAX_TOLD_LETTERS]
            problem, trace = f"something went wrong inside lobewise ({words}).", traceback.format_exc()
    warnings_caught = tuple((str(one.message), str(one.message)) for one in caught)
    log = TaskLog(remarks=(*log.remarks, *warnings_caught), last=log.last, settings=log.settings)
    return TaskResult(log=log, problem=make_printable(problem), trace=trace)


@cache
def _keep_freed_memory() -> None:
    """Let the C library keep up to `KEPT_BYTES` of freed memory for the next image, as in a process without Dask.

    Dask tells it to give every piece of 64 KiB back to the system. A frame frees and takes hundreds of images, and the
    system clears each page anew: that took as long as filtering did.
    """
    with suppress(OSError, AttributeError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(M_MMAP_THRESHOLD, KEPT_BYTES // 2)
        library.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)


def limit_threads(threads: int) -> None:
    """Let kernels, NumPy's chunks and Open Image Denoise use as many threads as the worker has.

    Libraries read these variables once, before their first work. What the user sets stays.
    """
    for name in ("HL_NUM_THREADS", "OIDN_NUM_THREADS"):
        os.environ.setdefault(name, str(threads))
    # Workers of one machine would all choose the first cores.
    os.environ.setdefault("OIDN_SET_AFFINITY", "0")


def _look_up_memory(memory: float | None) -> float | None:
    """Return the GiB that this process may take: as the client says, else the limit of Dask's worker, else None."""
    worker = _get_dask_worker()
    if memory is not None or worker is None:
        return memory
    limit = worker.memory_manager.memory_limit
    return limit / GIB if limit else None


def _get_dask_worker() -> Any:
    """Return Dask's worker, None in a process of `lobewise.farm.processes`."""
    if "distributed" not in sys.modules:
        return None
    from distributed import get_worker

    return get_worker()
