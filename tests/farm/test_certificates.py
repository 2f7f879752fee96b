"""The commands of docs/farm.md for a farm with certificates do what the page says."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from tests.farm.conftest import read_outputs
from tests.farm.processes import MAX_SECONDS, find_port, wait_until

pytestmark = [pytest.mark.nightly, pytest.mark.processor, pytest.mark.usefixtures("dask")]
PAGE = Path(__file__).parents[2] / "docs" / "farm.md"
SCRIPTS = str(Path(sys.executable).parent)
"""Where ``dask`` and ``lobewise`` are."""


def list_commands(port: int) -> dict[str, str]:
    """Return the commands of the page by their kind, for a scheduler on this machine."""
    section = PAGE.read_text().partition("\n## Use several machines")[2].partition("\n### ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    words = ("openssl", "dask scheduler", "dask worker", "lobewise denoise")
    found = {word: next(block for block in blocks if word in block) for word in words}
    return {
        word: block.replace("://host:", "://127.0.0.1:").replace("8786", str(port)) for word, block in found.items()
    }


def make_environment() -> dict[str, str]:
    return {**os.environ, "PATH": os.pathsep.join((SCRIPTS, os.environ["PATH"]))}


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run commands of the page to their end."""
    words = ["bash", "-ec", command]
    return subprocess.run(
        words, cwd=folder, env=make_environment(), capture_output=True, text=True, timeout=MAX_SECONDS
    )


@contextmanager
def start(kind: str, commands: dict[str, str], folder: Path) -> Iterator[Path]:
    """Run commands of the page until the ``with`` block ends; return the file of what they print."""
    log = folder / f"{kind}.log"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            ["bash", "-ec", commands[kind]],
            cwd=folder,
            env=make_environment(),
            stdout=stream,
            stderr=stream,
            start_new_session=True,
        )
    try:
        yield log
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def openssl() -> None:
    """Skip without the program that makes certificates; where CI is set that is a failure."""
    if shutil.which("openssl") is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)("the program openssl is missing")


@pytest.mark.usefixtures("openssl")
def test_the_commands_of_the_page_filter_a_sequence_and_strangers_are_refused(
    sources: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    mine, strange = tmp_path / "mine", tmp_path / "strange"
    commands = list_commands(find_port())
    for folder in (mine, strange):
        folder.mkdir()
        for path in sources.iterdir():
            (folder / path.name).symlink_to(path)
        made = run(commands["openssl"], folder)
        assert made.returncode == 0, made.stderr
    filtering = commands["lobewise denoise"].rstrip() + " --quality balanced"
    with ExitStack() as stack:
        scheduler = stack.enter_context(start("dask scheduler", commands, mine))
        wait_until(lambda: "Scheduler at:" in scheduler.read_text())
        stack.enter_context(start("dask worker", commands, mine))
        done = run(filtering, mine)
        assert done.returncode == 0, done.stderr
        written = read_outputs(mine)
        assert {name: data for name, data in written.items() if name in expected} == expected
        # Certificates of another authority.
        refused = run(filtering, strange)
        assert refused.returncode == 2, refused.stderr
        assert "expected a Dask scheduler at tls://127.0.0.1:" in refused.stderr
        assert "check address, certificates and firewall" in refused.stderr
        assert list(strange.glob("out.*")) == []
        count = scheduler.read_text().count("Register worker")
        stranger = stack.enter_context(start("dask worker", commands, strange))
        wait_until(lambda: "certificate verify failed" in stranger.read_text().lower())
        assert scheduler.read_text().count("Register worker") == count
