"""What a worker of a test does wrong: Dask imports this module while the worker starts, beside the product's own.

``LOBEWISE_TEST_HURT`` names a mischief and its number:

- ``die 3``: frame 3 kills its worker, as a crash or the system does where memory is short. Standard error says so.
- ``full 4096``: this worker writes no file of more than so many bytes. The system refuses, as on a full disk.
"""

import os
import resource
import signal
import sys
from pathlib import Path
from typing import Any

from lobewise.farm import worker as product

HURT = "LOBEWISE_TEST_HURT"
DEATH = "A frame kills its worker."
_run = product._run


def make_hurt(mischief: str) -> dict[str, str]:
    """Return the environment of a worker that does a mischief."""
    paths = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {
        HURT: mischief,
        "PYTHONPATH": os.pathsep.join(paths),
        "DASK_DISTRIBUTED__WORKER__PRELOAD": "tests.farm.hurting",
    }


def hurt_local_processes() -> None:
    """Let the processes of ``--workers`` do wrong."""
    from lobewise.farm import processes

    processes.prepare_process = prepare_process


def prepare_process(threads: int) -> None:
    """Prepare a process of ``--workers`` that does wrong."""
    from lobewise.farm.processes import prepare_process as prepare

    prepare(threads)
    dask_setup(None)


def dask_setup(worker: Any) -> None:
    """Prepare a worker that does wrong."""
    mischief, number = os.environ[HURT].split()
    if mischief == "full":
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(number), int(number)))
        return

    def run(assignment: Any) -> Any:
        if int(number) in assignment.task.numbers:
            print(DEATH, file=sys.stderr, flush=True)
            os.kill(os.getpid(), signal.SIGKILL)
        return _run(assignment)

    product._run = run
