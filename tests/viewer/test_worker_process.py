"""The process that renders, from outside: latest request first, everyone in turn, death and end."""

import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lobewise.cli.program import run
from lobewise.errors import InputError, LobewiseError, MissingDependencyError
from lobewise.interactive.settings import InteractiveSettings
from lobewise.viewer import FrameViewer, Viewer, worker_process
from lobewise.viewer.http.site import choose_port
from lobewise.viewer.messages import Opened, Picture, Problem, Request, SavedFile, Target, Window
from lobewise.viewer.worker_process import MAX_RESTARTS, WorkerProcess
from tests.interrupts import start_program
from tests.mistakes import refuses
from tests.viewer.slow_worker import CAMERA, SECONDS, run_slow_worker

PATIENCE = 120.0


def wait_until(condition: Callable[[], object], patience: float = PATIENCE) -> None:
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def ask(client: int, number: int, *, fresh: bool = True) -> Request:
    return Request(client, number, Window(4, 4), InteractiveSettings(), CAMERA, fresh=fresh)


def is_alive(process: int) -> bool:
    """Return whether a process runs; one that ended and was not waited for does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def start_worker(monkeypatch):
    """Return a function that starts the slow worker behind its pipe, with all that it reports."""
    monkeypatch.setattr(worker_process, "run_worker", run_slow_worker)
    workers: list[WorkerProcess] = []

    def start(name: str = "thing") -> tuple[WorkerProcess, list[Any], list[Any]]:
        reports: list[Any] = []
        remarks: list[Any] = []
        workers.append(WorkerProcess(Target(name), reports.append, lambda *told: remarks.append(told)))
        workers[-1].start()
        wait_until(lambda: reports)
        return workers[-1], reports, remarks

    yield start
    for one in workers:
        one.stop()


def get_numbers(reports: list[Any], client: int) -> list[int]:
    return [report.number for report in reports if isinstance(report, Picture) and report.client == client]


class TestMailbox:
    def test_only_the_latest_request_is_kept(self, start_worker):
        one, reports, _ = start_worker()
        assert isinstance(reports[0], Opened)
        for number in range(1, 40):
            one.submit(ask(1, number))
        wait_until(lambda: 39 in get_numbers(reports, 1))
        assert get_numbers(reports, 1) == [1, 39]
        # The report is handed on before the order is struck off.
        wait_until(lambda: not one.is_waiting(1))

    def test_browsers_take_turns(self, start_worker):
        one, reports, _ = start_worker()
        for number in range(1, 6):
            for client in (1, 2, 3):
                one.submit(ask(client, number))
            time.sleep(SECONDS)
        wait_until(lambda: all(5 in get_numbers(reports, client) for client in (1, 2, 3)))
        counts = [len(get_numbers(reports, client)) for client in (1, 2, 3)]
        assert max(counts) - min(counts) <= 1

    def test_showing_anew_does_not_cancel_a_frame(self, start_worker):
        one, reports, _ = start_worker()
        one.submit(ask(1, 1))
        one.submit(ask(1, 2))
        one.submit(ask(1, 3, fresh=False))
        wait_until(lambda: 3 in get_numbers(reports, 1))
        assert [report.accumulated for report in reports if isinstance(report, Picture)] == [1, 1]

    def test_submitting_does_not_wait(self, start_worker):
        one, _, _ = start_worker()
        start = time.perf_counter()
        for number in range(1, 200):
            one.submit(ask(1, number))
        assert time.perf_counter() - start < SECONDS

    def test_who_leaves_is_forgotten(self, start_worker):
        one, reports, _ = start_worker()
        one.submit(ask(1, 1))
        one.submit(ask(2, 1))
        one.forget(2)
        one.save(1, "exr")
        wait_until(lambda: any(isinstance(report, SavedFile) for report in reports))
        assert [report.data for report in reports if isinstance(report, SavedFile)] == [b"[2]"]
        assert get_numbers(reports, 2) == []

    def test_a_problem_ends_nothing(self, start_worker):
        one, reports, remarks = start_worker()
        one.submit(ask(1, 13))
        wait_until(lambda: any(isinstance(report, Problem) for report in reports))
        one.submit(ask(1, 14))
        wait_until(lambda: 14 in get_numbers(reports, 1))
        assert remarks == []


class TestDeath:
    def test_it_is_started_again_with_the_latest_requestes(self, start_worker):
        one, reports, remarks = start_worker()
        one.submit(ask(1, 5, fresh=False))
        wait_until(lambda: 5 in get_numbers(reports, 1))
        before = one.process_id
        os.kill(before, signal.SIGKILL)
        wait_until(lambda: get_numbers(reports, 1) == [5, 5])
        assert one.process_id != before
        assert remarks == [("The renderer was killed by signal 9 and was started again.", None)]
        # A new process has nothing to show anew.
        assert reports[-1].accumulated == 1

    def test_not_for_ever(self, start_worker):
        one, _, remarks = start_worker()
        one.submit(ask(1, 666))
        wait_until(lambda: remarks and remarks[-1][1])
        assert len(remarks) == MAX_RESTARTS + 1
        assert "exit code 7" in remarks[-1][0]

    def test_what_cannot_be_opened_is_told(self, start_worker):
        _, reports, remarks = start_worker("missing")
        assert [str(report.error) for report in reports] == ["there is no such thing; look elsewhere."]
        time.sleep(0.2)
        assert remarks == []

    @pytest.mark.skipif(sys.platform != "linux", reason="reads /proc for the signals that a process blocks")
    def test_it_never_sees_ctrl_c(self, start_worker):
        one, _, _ = start_worker()
        blocked = re.search(r"SigBlk:\s*([0-9a-f]+)", Path(f"/proc/{one.process_id}/status").read_text())
        assert int(blocked[1], 16) >> (signal.SIGINT - 1) & 1
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])

    def test_stopping_in_mid_frame(self, start_worker):
        one, _, remarks = start_worker()
        process = one.process_id
        one.submit(ask(1, 1))
        one.stop()
        assert not is_alive(process)
        assert remarks == []


class TestEnd:
    @pytest.mark.sampled("interrupt")
    @pytest.mark.skipif(sys.platform != "linux", reason="reads /proc to find child processes")
    @pytest.mark.parametrize(
        ("number", "code"),
        [(signal.SIGINT, 0), (signal.SIGTERM, -signal.SIGTERM), (signal.SIGKILL, -signal.SIGKILL)],
        ids=["interrupt", "end", "kill"],
    )
    @pytest.mark.mitsuba
    def test_no_process_is_left(self, number, code):
        pytest.importorskip("viser", reason="pip install 'lobewise[viewer]'")
        running = start_program("view", "showroom", "--port", 0, "--similarity", "none")
        line = running.stdout.readline()
        assert re.match(r"Showing showroom at http://127\.0\.0\.1:\d+/\?token=[\w-]{40,} ", line)
        assert line.endswith(" (only this machine can reach it); Ctrl-C ends it.\n")
        children = [
            int(word)
            for task in Path(f"/proc/{running.pid}/task").iterdir()
            for word in (task / "children").read_text().split()
        ]
        assert children
        running.send_signal(number)
        out, err = running.communicate(timeout=PATIENCE)
        assert (running.returncode, out, err) == (code, "", "")
        wait_until(lambda: not any(map(is_alive, children)))


@pytest.fixture
def slow(monkeypatch):
    """Let viewers start the slow worker."""
    pytest.importorskip("viser", reason="pip install 'lobewise[viewer]'")
    monkeypatch.setattr(worker_process, "run_worker", run_slow_worker)


class TestViewer:
    def test_what_cannot_be_opened_ends_it(self, tmp_path):
        pytest.importorskip("viser", reason="pip install 'lobewise[viewer]'")
        path = tmp_path / "broken.xml"
        path.write_bytes(b"no scene")
        with Viewer(str(path), port=0) as viewer, refuses(LobewiseError, "broken.xml"):
            viewer.wait()

    @pytest.mark.parametrize("options", [[], ["--map", "normal=N.X,N.Y,N.Z"]], ids=["damaged", "no such channel"])
    def test_a_frame_is_checked_before_there_is_a_url(self, options, floor_file, tmp_path, capsys):
        path = tmp_path / "broken.exr"
        content = floor_file.read_bytes()
        path.write_bytes(content if options else content[: len(content) // 2])
        assert run(["view", str(path), "--port", "0", *options]) == 2
        told = capsys.readouterr()
        assert told.out == ""
        assert re.fullmatch(r"lobewise: .*broken\.exr.*\n", told.err)

    def test_without_viser_it_says_what_to_install(self, monkeypatch):
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
        with refuses(MissingDependencyError, action="pip install 'lobewise[viewer]'"):
            Viewer("thing").start()

    def test_mistakes_of_ours_are_told_apart(self, slow):
        for name, kind in (("missing", LobewiseError), ("broken", RuntimeError)):
            with Viewer(name, port=0) as viewer, pytest.raises(kind):
                viewer.wait()

    def test_a_renderer_that_dies_again_and_again_ends_it(self, slow):
        with Viewer("thing", port=0) as viewer:
            viewer.wait_until_open()
            viewer._browsers.worker.submit(ask(1, 666))
            with refuses(LobewiseError, "scene 'thing'", "the end of Mitsuba's process by exit code 7"):
                viewer.wait()

    def test_it_leaves_the_process_to_others(self, slow, monkeypatch, capfd):
        """Another thread prints while the page starts and ends: every line is there, and nothing else."""
        lines, over = [], threading.Event()

        def print_lines() -> None:
            while not over.is_set():
                lines.append(f"line {len(lines)}")
                print(lines[-1])
                time.sleep(0.001)

        printing = threading.Thread(target=print_lines)
        printing.start()
        before = signal.getsignal(signal.SIGINT)
        monkeypatch.setattr(signal, "signal", None)
        try:
            with Viewer("thing", port=0):
                assert signal.getsignal(signal.SIGINT) is before
        finally:
            over.set()
            printing.join()
        out, err = capfd.readouterr()
        assert out.splitlines() == lines
        assert err == ""

    def test_the_page_of_the_manual_runs(self, monkeypatch, floor_file):
        text = (Path(__file__).parents[2] / "docs" / "viewer.md").read_text()
        (block,) = re.findall(r"```python\n(.*?)```", text, flags=re.S)
        waited = []
        monkeypatch.setattr(FrameViewer, "wait", lambda viewer: waited.append(viewer.url))
        monkeypatch.chdir(floor_file.parent)
        exec(compile(block.replace("frame.exr", floor_file.name), "viewer.md", "exec"), {"__name__": "__main__"})
        assert waited[0].startswith("http://127.0.0.1:")

    def test_a_port_that_is_taken(self):
        import socket

        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            port = taken.getsockname()[1]
            assert port < choose_port("127.0.0.1", port) <= port + 100

    def test_an_address_of_another_machine(self):
        with refuses(InputError, "--host and --port"):
            choose_port("192.0.2.1", 8080)

    @pytest.mark.parametrize(
        ("host", "private"),
        [("127.0.0.1", True), ("127.0.0.3", True), ("::1", True), ("localhost", True), ("0.0.0.0", False)],
    )
    def test_who_can_reach_it(self, host, private):
        assert Viewer("thing", host=host).is_private is private
