"""Processes of a farm that tests may kill: a scheduler, workers, and the program itself."""

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

from lobewise.farm.connection import connect
from tests.interrupts import LISTEN

PROGRAM = [sys.executable, "-c", "from lobewise.cli import main; main()"]
DASK = [sys.executable, "-m", "dask"]
MAX_SECONDS = 240.0
"""Longest time that a test waits for anything, seconds."""


def make_command(sources: Path, folder: Path, *options: str, before: str = "") -> list[str]:
    """Return the command line that denoises the sequence of a folder into another one, after a line of Python."""
    names = [str(sources / "in.####.exr"), "-o", str(folder / "out.####.exr")]
    program = f"{LISTEN}{before}\n{PROGRAM[-1]}"
    return [sys.executable, "-c", program, "denoise", *names, "--quality", "balanced", *options]


def run_program(
    sources: Path, folder: Path, *options: str, before: str = "", more: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the program to its end, after a line of Python and with more variables of the environment."""
    command = make_command(sources, folder, *options, before=before)
    environment = {**os.environ, **(more or {})}
    return subprocess.run(command, capture_output=True, text=True, timeout=MAX_SECONDS, env=environment)


def start_program(sources: Path, folder: Path, *options: str, before: str = "") -> subprocess.Popen[str]:
    """Start the program in a group of its own, so that a signal reaches it and its workers as Ctrl-C does."""
    command = make_command(sources, folder, *options, before=before)
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


def find_port() -> int:
    """Return a free port of this machine."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


class Farm:
    """A scheduler and two workers. A worker that ends is started again, as a cluster's manager does."""

    def __init__(
        self, folder: Path, workers: int = 2, *, more: dict[str, str] | None = None, has_nannies: bool = False
    ) -> None:
        self._port = find_port()
        self.address = f"tcp://127.0.0.1:{self._port}"
        self._folder = folder
        self._environment = {**os.environ, **(more or {})}
        self._is_open = True
        self._has_nannies = has_nannies
        self.scheduler = self._start_scheduler()
        self.workers = [self._start_worker() for _ in range(workers)]
        self._keeper = threading.Thread(target=self._keep_workers)
        self._keeper.start()

    def __enter__(self) -> "Farm":
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

    def wait_for_scheduler(self) -> None:
        """Wait until the scheduler listens: on a busy machine it starts longer than a client waits for its answer."""

        def is_open() -> bool:
            with socket.socket() as client:
                return client.connect_ex(("127.0.0.1", self._port)) == 0

        wait_until(is_open)

    def kill_worker(self) -> None:
        """Kill the first worker; another one is started soon."""
        self.workers[0].send_signal(signal.SIGKILL)

    def add_worker(self, **more: str) -> None:
        """Start a worker with variables of its own, and wait until the scheduler has all workers."""
        self.workers.append(self._start_worker(more))
        self.wait_for_scheduler()
        with connect(self.address) as connection:
            wait_until(lambda: len(connection.list_workers()) == len(self.workers))

    def _start_scheduler(self) -> subprocess.Popen[bytes]:
        return self._start("scheduler", "--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard")

    def _start_worker(self, more: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        # A nanny starts a lost worker again at the same address.
        words = ("--worker-port", str(find_port())) if self._has_nannies else ("--no-nanny",)
        return self._start("worker", self.address, "--nthreads", "1", "--no-dashboard", *words, more=more)

    def _start(self, *words: str, more: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        where = self._folder / "dask.log"
        with where.open("ab") as log:
            environment = {**self._environment, **(more or {})}
            return subprocess.Popen([*DASK, *words], stdout=log, stderr=log, env=environment, cwd=self._folder)

    def _keep_workers(self) -> None:
        while self._is_open:
            for place, process in enumerate(self.workers):
                if process.poll() is not None and self._is_open:
                    self.workers[place] = self._start_worker()
            time.sleep(0.1)
