"""The help of every verb, made by one mechanism: short, in groups, nothing cut; rare options on request."""

import inspect
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
import typer

from lobewise.cli.commands import app
from lobewise.cli.options.spreading import with_groups
from lobewise.cli.program import run
from lobewise.cli.terminal.help import EXAMPLES, RARE, RESULT

MAX_LINES_OF_PLAIN_HELP = 60


@dataclass(frozen=True)
class Size:
    """A group of options."""

    width: int = 1
    height: int = 1


def list_verbs(command: Any, before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words of every verb, and its command."""
    yield before, command
    for name, child in getattr(command, "commands", {}).items():
        yield from list_verbs(child, (*before, name))


VERBS = dict(list_verbs(typer.main.get_command(app)))
every_verb = pytest.mark.parametrize("words", VERBS, ids=lambda words: " ".join(words) or "lobewise")


def ask(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert run(list(words)) == 0
    return capsys.readouterr().out


def list_options(command: Any) -> list[Any]:
    return [one for one in command.params if one.param_type_name == "option"]


@every_verb
@pytest.mark.parametrize("width", [80, 120])
def test_the_plain_help_fits(
    words: tuple[str, ...], width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    lines = ask(capsys, *words, "--help").splitlines()
    assert len(lines) <= MAX_LINES_OF_PLAIN_HELP
    assert max(map(len, lines)) <= width
    assert not any("…" in line for line in lines)


@every_verb
def test_all_options_are_in_the_long_help_and_the_usual_ones_in_the_plain_help(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    plain, everything = (ask(capsys, *words, word) for word in ("--help", "--help-all"))
    assert plain == ask(capsys, *words, "-h")
    for one in list_options(VERBS[words]):
        for name in (*one.opts, *one.secondary_opts):
            heads = [re.search(rf"^  .*{re.escape(name)}\b", text, re.MULTILINE) for text in (plain, everything)]
            assert heads[1]
            assert bool(heads[0]) == (one.rich_help_panel not in RARE)
        assert " ".join(one.help.split()) in " ".join(everything.split())
    for verb in getattr(VERBS[words], "commands", {}):
        assert re.search(rf"^  {verb}\b", plain, re.MULTILINE)
    assert not any(f"\n{title}:" in plain for title in RARE)


def test_the_long_help_says_more(capsys: pytest.CaptureFixture[str]) -> None:
    plain, everything = (ask(capsys, "denoise", word) for word in ("--help", "--help-all"))
    for text, is_in in ((plain, False), (everything, True)):
        assert ("--similarity" in text) == is_in
        assert ("refines the image by" in " ".join(text.split())) == is_in
    assert "rare options" in plain
    assert "normal=N.X,N.Y,N.Z" in plain


@pytest.mark.parametrize("verb", EXAMPLES)
def test_examples_stand_whole_and_name_what_there_is(
    verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    before = tuple(verb.split())
    lines = ask(capsys, *before, "--help").splitlines()
    known = {name for one in list_options(VERBS[before]) for name in one.opts}
    for example in EXAMPLES[verb].splitlines():
        assert f"  {example}" in lines
        words = shlex.split(example)
        assert words[: len(before) + 1] == ["lobewise", *before]
        assert {word for word in words if word.startswith("-")} <= known
        # The verb accepts the command line; only its files do not exist.
        VERBS[before].make_context(verb, words[len(before) + 1 :], resilient_parsing=False)


def test_options_of_a_group_arrive_as_one_dataclass() -> None:
    got = []

    def verb(*, size: Size, name: str = "a") -> None:
        got.append((size, name))

    spread = with_groups(verb)
    assert list(inspect.signature(spread).parameters) == ["width", "height", "name"]
    spread(width=3, height=2, name="b")
    assert got == [(Size(3, 2), "b")]


def test_what_is_written_stands_together(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in ("denoise", "upsample"):
        group = ask(capsys, verb, "--help").partition(f"\n{RESULT}:\n")[2].partition("\n\n")[0]
        assert [name in group for name in ("--png", "--exposure", "--overwrite")] == [True] * 3
