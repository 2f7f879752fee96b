"""A scheduler that is killed or falls silent in the middle of a run, and stays away: one sentence, and nothing left."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lobewise.errors import LobewiseError
from lobewise.farm.tasks import Task
from lobewise.recipes.environment import describe_environment
from tests.farm.conftest import NUMBERS, read_outputs
from tests.farm.processes import MAX_SECONDS, Farm, count_outputs, run_program, start_program, wait_until
from tests.farm.test_dispatching import FakeFarm
from tests.farm.test_two_runs import make_job, run_job
from tests.mistakes import refuses

MAX_SECONDS_TO_NOTICE = 15.0


@pytest.mark.nightly
@pytest.mark.processor
@pytest.mark.usefixtures("dask")
@pytest.mark.parametrize("name", ["SIGKILL", "SIGSTOP"])
def test_a_scheduler_that_stays_away_ends_the_run_and_the_next_one_goes_on(
    name: str, sources: Path, expected: dict[str, bytes], farm: Farm, folder: Path
) -> None:
    program = start_program(sources, folder, "--farm", farm.address)
    wait_until(lambda: count_outputs(folder) >= 3)
    farm.scheduler.send_signal(signal.Signals[name])
    begin = time.monotonic()
    out, err = program.communicate(timeout=MAX_SECONDS)
    assert time.monotonic() - begin < MAX_SECONDS_TO_NOTICE
    assert (program.returncode, out) == (2, "")
    assert err.splitlines()[-1] == (
        f"lobewise: --farm: expected the scheduler {farm.address} until the end, got no answer in the middle of the "
        "run; start it, and give the same command again, which filters only what is missing."
    )
    with pytest.raises(ProcessLookupError):
        os.killpg(program.pid, 0)
    left = count_outputs(folder)
    assert 3 <= left < len(NUMBERS)
    farm.restart_scheduler()
    done = run_program(sources, folder, "--farm", farm.address)
    assert done.returncode == 0, done.stderr
    assert f" of {len(NUMBERS)} frames are done, as " in done.stderr
    assert read_outputs(folder) == expected
    assert [path for path in folder.iterdir() if path.is_dir()] == []


def test_what_workers_had_begun_when_the_scheduler_went_is_cleaned_up(tmp_path: Path) -> None:
    program = (
        "import sys, pathlib; from lobewise.io.replacing import name_temporary; "
        "name_temporary(pathlib.Path(sys.argv[1])).touch()"
    )

    def die(worker: str, task: Task) -> bool:
        subprocess.run([sys.executable, "-c", program, str(tmp_path / f"out.{task.numbers[0]}.exr")], check=True)
        assert len(list(tmp_path.glob(".out.*.part"))) == 1
        farm.is_gone = True
        return False

    farm = FakeFarm({"a": describe_environment(with_oidn=False)}, on_task=die)
    with refuses(LobewiseError, "--farm"):
        run_job(make_job(tmp_path), farm)
    assert list(tmp_path.glob(".out.*.part")) == []
