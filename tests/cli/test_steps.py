"""Progress on a terminal while a frame is denoised, and no progress where there is no terminal."""

import io
import re
import shutil
import sys
from pathlib import Path

import pytest

from lobewise.backend.watching import tell_compiling
from lobewise.cli.output import print_line, print_note
from lobewise.cli.program import run
from lobewise.cli.terminal import steps as steps_module
from lobewise.cli.terminal.steps import COMPILING, Steps
from lobewise.work import progress
from lobewise.work.progress import Progress

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
CHEAP = ["--quality", "fast", "--similarity", "normal", "--radius", "1"]
ERASE = "\x1b[2K"


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self) -> bool:
        return True

    def list_steps(self) -> list[str]:
        """Return the steps in the order of their display, without bars and times."""
        lines = re.split(r"[\r\n]|\x1b\[2K|\x1b\[1A", self.getvalue())
        plain = [re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", line) for line in lines]
        words = [re.split(r" [━╸╺]", line)[0].strip() for line in plain]
        return [word for k, word in enumerate(words) if word and word != next(filter(None, reversed(words[:k])), "")]


def attach(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Replace standard error by a terminal and return it. Pytest replaces it for each phase, so it is no fixture."""
    for name, value in (("TERM", "xterm"), ("COLUMNS", "120")):
        monkeypatch.setenv(name, value)
    found = Terminal()
    monkeypatch.setattr(sys, "stderr", found)
    return found


@pytest.fixture
def frame(tmp_path: Path) -> Path:
    return Path(shutil.copy(FOREIGN / "blender_4.5_seed1.exr", tmp_path / "in.exr"))


def denoise(frame: Path, *more: str) -> int:
    return run(["denoise", str(frame), "-o", str(frame.with_name("out.exr")), *CHEAP, *more])


def test_a_terminal_shows_what_is_done(frame: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = attach(monkeypatch)
    # A busy machine takes longer.
    monkeypatch.setattr(steps_module, "MIN_SECONDS_WITH_BAR", 600.0)
    assert denoise(frame) == 0
    steps = [step for step in terminal.list_steps() if step.startswith("in.exr: ")]
    assert list(dict.fromkeys(steps)) == ["in.exr: reading", "in.exr: filtering", "in.exr: writing"]
    assert "%" not in terminal.getvalue()
    # The line is gone, and the terminal's cursor is back.
    assert terminal.getvalue().rindex(ERASE) > terminal.getvalue().rindex("writing")
    assert "\x1b[?25h" in terminal.getvalue()


def test_quiet_shows_notes_alone(frame: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = attach(monkeypatch)
    assert denoise(frame, "--progress", "off") == 0
    assert "Read as Blender Cycles" in terminal.getvalue()
    assert "in.exr: " not in terminal.getvalue()


@pytest.mark.parametrize("forced", [True, False])
def test_nothing_is_shown_in_a_pipe(
    forced: bool, frame: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if forced:
        monkeypatch.setenv("FORCE_COLOR", "1")
    assert denoise(frame) == 0
    err = capsys.readouterr().err
    assert "Read as Blender Cycles" in err
    assert "in.exr: " not in err


def test_what_takes_long_shows_how_much_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = attach(monkeypatch)
    monkeypatch.setattr(steps_module, "MIN_SECONDS_WITH_BAR", 0.0)
    monkeypatch.setattr(progress, "MIN_SECONDS", 0.0)
    from lobewise.io import write_frame
    from tests.streaming.frames import make_scene

    write_frame(tmp_path / "in.exr", make_scene((83, 19)))
    assert denoise(tmp_path / "in.exr", "--bands", "9") == 0
    assert "in.exr: filtering" in terminal.list_steps()
    assert re.search(r"[1-9]\d %, 0:00:0\d left", terminal.getvalue())


def test_frames_a_minute_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = attach(monkeypatch)
    with Steps() as steps:
        for done in range(3):
            steps.follow(Progress("filtering", done / 10, done=done, frames=10, seconds_left=80.0 - done))
    assert re.search(r"20 %, [0-9.]+ frames a minute, 0:01:18 left", terminal.getvalue())


def test_compiling_is_shown_in_place_of_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = attach(monkeypatch)
    with tell_compiling(), Steps():
        pass
    assert COMPILING not in terminal.getvalue()
    with Steps() as steps:
        steps.tell("Filtering", 1, 2)
        with tell_compiling():
            pass
        assert terminal.list_steps()[-3:] == ["Filtering", COMPILING, "Filtering"]
    assert terminal.getvalue().rindex("50 %") > terminal.getvalue().rindex(COMPILING)
    with tell_compiling():
        pass
    assert terminal.list_steps()[-2:] == [COMPILING, "Filtering"]


def test_a_remark_whose_reader_has_gone_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stderr", Gone())
    print_note("a remark")


@pytest.mark.parametrize("print_text", [print_line, print_note])
def test_what_is_printed_meanwhile_has_a_line_of_its_own(print_text: object, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = attach(monkeypatch)
    monkeypatch.setattr(sys, "stdout", terminal)
    with Steps() as steps:
        steps.tell("Filtering")
        print_text("A remark.")  # type: ignore[operator]
        after = terminal.getvalue().partition("Filtering")[2]
        steps.tell("Writing")
    before_remark, _, behind_remark = after.partition("A remark.")
    # The line of the step is erased before the remark, and comes back after it.
    assert re.sub(r"\x1b\[[0-9;?]*m", "", before_remark).endswith(ERASE)
    assert behind_remark.lstrip("\x1b[0m").startswith("\n")
    assert "Filtering" in behind_remark
