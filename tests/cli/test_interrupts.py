"""Ctrl-C at any moment after the interpreter has started ends the program with one line and exit code 130."""

import os
import signal
import subprocess
import sys

import pytest

from lobewise.cli.terminal.interrupts import hold_interrupts
from tests.interrupts import LISTEN

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

PROGRAM = """
import os, signal, sys
from lobewise.cli import main

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
{more}
main(["denoise", "missing.exr", "-o", "out.exr"])
"""


def run(module: str, more: str = "") -> subprocess.CompletedProcess[str]:
    program = LISTEN + PROGRAM.format(module=module, more=more)
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)


@pytest.mark.parametrize(
    "module", ["typer", "lobewise.cli.program", "lobewise.cli.terminal.help", "lobewise.cli.filtering"]
)
def test_while_modules_are_imported(module: str) -> None:
    done = run(module)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "lobewise: interrupted; every output is whole, or as it was.\n"


def test_an_interrupt_that_a_library_turned_into_an_error() -> None:
    more = (
        "import lobewise.io.sequence as sequence\n"
        "def is_pattern(path):\n"
        "    try:\n        os.kill(os.getpid(), signal.SIGINT); signal.sigtimedwait([], 5)\n"
        "    except KeyboardInterrupt:\n        raise ImportError('what a library says') from None\n"
        "sequence.is_pattern = is_pattern"
    )
    done = run("", more)
    assert (done.returncode, done.stderr) == (130, "lobewise: interrupted; every output is whole, or as it was.\n")


def test_when_all_is_done() -> None:
    more = "import atexit; atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))"
    done = run("", more)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_who_ignores_interrupts_goes_on_ignoring_them() -> None:
    """A command in the background of a shell, or under nohup, ignores Ctrl-C."""
    program = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)" + PROGRAM.format(module="typer", more="")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 2
    assert "no such file" in done.stderr


def test_ctrl_c_can_wait() -> None:
    done = []

    def start() -> None:
        with hold_interrupts():
            signal.raise_signal(signal.SIGINT)
            done.append("started")

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            start()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert done == ["started"]
