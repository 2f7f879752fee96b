"""A sequence on real processes: killed workers, a restarted scheduler, failing frames and Ctrl-C lose nothing."""

import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

from lobewise import write_sparse_frame
from lobewise.errors import LobewiseError
from lobewise.farm import processes
from lobewise.farm.calls import WorkerLostError
from lobewise.recipes.ledger import TOKEN
from lobewise.records.sparse_frame import list_places, make_sparse
from tests.farm.conftest import NUMBERS, read_outputs, require_frame_3_failed, require_only_frame_3_is_filtered
from tests.farm.processes import MAX_SECONDS, PROGRAM, Farm, count_outputs, run_program, start_program, wait_until
from tests.mistakes import refuses
from tests.streaming.frames import make_scene

pytestmark = [pytest.mark.nightly, pytest.mark.processor, pytest.mark.usefixtures("dask")]


def test_a_killed_worker_loses_no_frame(sources: Path, expected: dict[str, bytes], folder: Path, farm: Farm) -> None:
    program = start_program(sources, folder, "--farm", farm.address)
    wait_until(lambda: count_outputs(folder) >= 3)
    farm.kill_worker()
    out, err = program.communicate(timeout=MAX_SECONDS)
    assert program.returncode == 0, err
    assert f"{len(NUMBERS)} of {len(NUMBERS)} frames" in out
    assert read_outputs(folder) == expected
    assert [path.name for path in folder.iterdir() if path.is_dir()] == []
    # What every frame's filtering tells is told once.
    assert err.count("Used: ") == 1
    assert "Traceback" not in err


def test_local_workers_write_what_one_process_writes(sources: Path, expected: dict[str, bytes], folder: Path) -> None:
    done = run_program(sources, folder, "--workers", "2")
    assert (done.returncode, read_outputs(folder)) == (0, expected)
    assert done.stderr.count("Used: ") == 1


def test_a_frame_that_fails_does_not_stop_the_others(
    sources: Path, expected: dict[str, bytes], folder: Path, tmp_path: Path
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    for path in sources.iterdir():
        os.link(path, mine / path.name)
    broken = mine / "in.0003.exr"
    broken.unlink()
    broken.write_bytes((sources / "in.0003.exr").read_bytes()[:5000])
    done = run_program(mine, folder, "--workers", "2")
    assert "Frame 3, worker process " in done.stderr
    assert f": input {str(broken)!r}: " in done.stderr
    require_frame_3_failed(done, folder, expected)
    broken.write_bytes((sources / "in.0003.exr").read_bytes())
    require_only_frame_3_is_filtered(mine, folder, expected)


def test_shots_over_time_have_the_bits_of_one_process(tmp_path: Path) -> None:
    frame = make_scene((83, 19), seed=1)
    for number in (1, 2, 4):
        write_sparse_frame(tmp_path / f"in.{number}.exr", make_sparse(frame, 4, list_places(4)[number]))
    for name, more in (("out", ["--workers", "2"]), ("one", [])):
        names = [str(tmp_path / "in.#.exr"), "-o", str(tmp_path / f"{name}.#.exr")]
        subprocess.run([*PROGRAM, "upsample", *names, "--temporal", *more], check=True, timeout=MAX_SECONDS)
    for number in (1, 2, 4):
        assert (tmp_path / f"out.{number}.exr").read_bytes() == (tmp_path / f"one.{number}.exr").read_bytes()


@pytest.mark.parametrize(("options", "files"), [(("--window", "1", "--quality", "fast"), 1), (("--png",), 2)], ids=str)
def test_frames_that_hang_on_others_have_the_bits_of_one_process(
    options: tuple[str, ...], files: int, sources: Path, folder: Path, tmp_path: Path
) -> None:
    """A window has neighbours, and all pictures have one exposure."""
    alone = tmp_path / "alone"
    alone.mkdir()
    assert run_program(sources, alone, *options).returncode == 0
    done = run_program(sources, folder, *options, "--workers", "2")
    assert done.returncode == 0, done.stderr
    assert len(read_outputs(alone)) == files * len(NUMBERS)
    assert read_outputs(folder) == read_outputs(alone)


def interrupt(program: subprocess.Popen[str]) -> None:
    """Press Ctrl-C, and raise AssertionError unless the program ends with its sentence."""
    os.killpg(program.pid, signal.SIGINT)
    _, err = program.communicate(timeout=MAX_SECONDS)
    assert program.returncode == 130
    assert err.endswith("lobewise: interrupted; every output is whole, or as it was.\n")
    assert "Traceback" not in err


def test_an_interrupt_leaves_whole_files_and_the_same_command_goes_on(
    sources: Path, expected: dict[str, bytes], folder: Path
) -> None:
    program = start_program(sources, folder, "--workers", "2")
    wait_until(lambda: count_outputs(folder) >= 3)
    interrupt(program)
    left = read_outputs(folder)
    assert 3 <= len(left) < len(NUMBERS)
    assert left.items() <= expected.items()
    done = run_program(sources, folder, "--workers", "2")
    assert done.returncode == 0, done.stderr
    assert "Going on: " in done.stderr
    assert read_outputs(folder) == expected


def test_an_interrupt_while_workers_start_leaves_nothing(sources: Path, folder: Path) -> None:
    program = start_program(sources, folder, "--workers", "2")
    # The folder of records is there, and workers are about to start.
    wait_until((folder / "out.lobewise-done" / TOKEN).exists)
    interrupt(program)
    assert list(folder.iterdir()) == []


def test_processes_end_with_a_killed_client(sources: Path, folder: Path) -> None:
    program = start_program(sources, folder, "--workers", "2")
    wait_until(lambda: count_outputs(folder) >= 2)
    program.kill()
    program.wait()

    def is_over() -> bool:
        try:
            os.killpg(program.pid, 0)
        except ProcessLookupError:
            return True
        return False

    try:
        wait_until(is_over, 20.0)
    finally:
        # A process that is left would keep the pipes open.
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
        program.communicate()


def test_processes_that_end_at_once_end_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    # Called with the number of threads, as a process begins.
    monkeypatch.setattr(processes, "prepare_process", os._exit)
    with processes.start_local(1) as workers:
        for _ in range(processes.MAX_FALSE_STARTS):
            (name,) = workers.list_workers()
            call = workers.call(name, os.getpid)
            assert workers.wait_for_finished(MAX_SECONDS) == [call.key]
            with pytest.raises(WorkerLostError):
                call.fetch()
        with refuses(LobewiseError, "--workers", expected="1 processes that start"):
            workers.list_workers()
