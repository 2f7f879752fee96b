"""No kernel reads or writes beyond its images, whatever their sizes: an access there would end the process."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.filters.guarded import FORMS

pytestmark = [
    pytest.mark.processor,
    pytest.mark.skipif(sys.platform != "linux", reason="pages are guarded by mprotect of Linux"),
]
KERNELS = {
    "full": "cross pass",
    "separable": "cross pass",
    "atrous": "cross pass",
    "balanced": "dual buffer",
    "high": "mixing",
    "upsampling": "accumulation",
    "history": "reprojection",
}
"""One kernel that a form must have run."""


def run(form: str, *sides: str) -> subprocess.CompletedProcess[str]:
    """Run a form in a process of its own."""
    command = [sys.executable, "-m", "tests.filters.guarded", form, *sides]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.parametrize("form", FORMS)
def test_kernels_stay_inside_their_images(form: str) -> None:
    done = run(form, "end", "start")
    assert done.returncode == 0, f"signal {-done.returncode}: {done.stderr}"
    assert KERNELS[form] in done.stdout


def test_a_read_beyond_is_caught() -> None:
    assert -run("full", "beyond").returncode in (signal.SIGSEGV, signal.SIGBUS)
