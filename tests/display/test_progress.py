"""The progress bar: what it shows in a terminal, and nothing where nobody looks. Notebooks: tests/test_site.py."""

import io
import sys

import pytest

import lobewise
from lobewise.errors import InputError
from tests.mistakes import refuses


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("names", [(), ("filtering",)])
def test_terminal_shows_title_step_and_share(monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...]) -> None:
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    bar = lobewise.ProgressBar("frame 1")
    for done in range(5):
        bar(*names, done, 4)
    shown = stream.getvalue()
    assert ": ".join(["frame 1", *names]) in shown
    assert "100%" in shown


def test_what_the_program_prints_meanwhile_stays_where_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bar on a terminal, and standard output in a file."""
    terminal, output = Terminal(), io.StringIO()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setenv("TERM", "xterm")
    bar = lobewise.ProgressBar("frame 1")
    bar(1, 4)
    print("a line of the program")
    bar(4, 4)
    assert output.getvalue() == "a line of the program\n"


def test_nothing_is_printed_where_no_terminal_is(capsys: pytest.CaptureFixture[str]) -> None:
    bar = lobewise.ProgressBar("frame 1")
    bar(0, 0)
    bar(1, 3)
    bar("a", 3, 3)
    assert capsys.readouterr() == ("", "")


def test_wrong_calls_get_a_sentence() -> None:
    with refuses(InputError, "progress"):
        lobewise.ProgressBar()(1)
    with refuses(InputError, "title"):
        lobewise.ProgressBar(3)  # type: ignore[arg-type]
