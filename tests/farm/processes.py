"""Processes of a farm that tests may kill: a scheduler, workers, and the program itself."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from tests.interrupts import LISTEN

PROGRAM = [sys.executable, "-c", "from lobewise.cli import main; main()"]
DASK = [sys.executable, "-m", "dask"]
MAX_SECONDS = 240.0
"""Longest time that a test waits for anything, seconds."""


def make_command(sources: Path, folder: Path, *options: str) -> list[str]:
    """Return the command line that denoises the sequence of a folder into another one."""
    names = [str(sources / "in.####.exr"), "-o", str(folder / "out.####.exr")]
    return [sys.executable, "-c", LISTEN + PROGRAM[-1], "denoise", *names, "--quality", "balanced", *options]


def run_program(sources: Path, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run the program to its end."""
    command = make_command(sources, folder, *options)
    return subprocess.run(command, capture_output=True, text=True, timeout=MAX_SECONDS)


def start_program(sources: Path, folder: Path, *options: str) -> subprocess.Popen[str]:
    """Start the program in a group of its own, so that a signal reaches it and its workers as Ctrl-C does."""
    command = make_command(sources, folder, *options)
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def wait_until(is_so: Callable[[], bool], seconds: float = MAX_SECONDS) -> None:
    """Wait until a condition holds; fail after some seconds."""
    end = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.01)


def count_outputs(folder: Path) -> int:
    """Return the number of outputs in a folder."""
    return len(list(folder.glob("out.*.exr")))


class Farm:
    """A scheduler and two workers. A worker that ends is started again, as a cluster's manager does."""

    def __init__(self, folder: Path, workers: int = 2, *, more: dict[str, str] | None = None) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self._port}"
        self._folder = folder
        self._environment = {**os.environ, **(more or {})}
        self._is_open = True
        self.scheduler = self._start_scheduler()
        self.workers = [self._start_worker() for _ in range(workers)]
        self._keeper = threading.Thread(target=self._keep_workers)
        self._keeper.start()

    def __enter__(self) -> Farm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_open = False
        self._keeper.join()
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()

    def restart_scheduler(self) -> None:
        """Kill the scheduler and start another one at the same address."""
        self.scheduler.kill()
        self.scheduler.wait()
        self.scheduler = self._start_scheduler()

    def kill_worker(self) -> None:
        """Kill the first worker; another one is started soon."""
        self.workers[0].send_signal(signal.SIGKILL)

    def _start_scheduler(self) -> subprocess.Popen[bytes]:
        return self._start("scheduler", "--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard")

    def _start_worker(self) -> subprocess.Popen[bytes]:
        return self._start("worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard")

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        where = self._folder / "dask.log"
        with where.open("ab") as log:
            return subprocess.Popen([*DASK, *words], stdout=log, stderr=log, env=self._environment, cwd=self._folder)

    def _keep_workers(self) -> None:
        while self._is_open:
            for place, process in enumerate(self.workers):
                if process.poll() is not None and self._is_open:
                    self.workers[place] = self._start_worker()
            time.sleep(0.1)
