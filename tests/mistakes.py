"""Asks errors for their type and fields, and holds their sentences in one table, `TABLE`.

``pytest --write-sentences FILES`` makes the table anew for the test files that it runs. In the table, # stands for a
number and … for any words: write it where the words of another library differ from version to version. It stays.
"""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from lobewise.errors import LobewiseError, hide_numbers

TABLE = Path(__file__).with_name("sentences.txt")
FOLDER = "tests/"
"""Folder of the test files that the table names."""
HEAD = "# Sentences of the errors that each test file asks for. Made by: pytest --write-sentences FILES\n"
_FOLDERS = re.compile(r"(?<![\w:/\\.~])(?:[A-Za-z]:)?[/\\](?:[^\s'\"/\\]*[/\\])+(?=[^\s'\"/\\])")
"""The folders of a path from the root."""
_POWER_OF_TEN = re.compile(r"#e[-+]?#")
_LONG_RUN = re.compile(r"(\w)\1{9,}")
_seen: dict[str, set[str]] = defaultdict(set)
"""Sentences that the tests of this process asked for, by test file."""
_incomplete: set[str] = set()
"""Test files of which some tests did not run or did not pass."""


@contextmanager
def refuses(
    kind: type[LobewiseError] | tuple[type[LobewiseError], ...],
    what: str | None = None,
    got: str | None = None,
    expected: str | None = None,
    **fields: str,
) -> Iterator[pytest.ExceptionInfo[LobewiseError]]:
    """Fail unless the block raises an error of a kind with these fields; see `check_fields`."""
    with pytest.raises(kind) as caught:
        yield caught
    check_fields(caught.value, what, got, expected, **fields)


def check_fields(
    problem: LobewiseError,
    what: str | None = None,
    got: str | None = None,
    expected: str | None = None,
    **fields: str,
) -> None:
    """Fail unless an error has the fields that are given, whatever the folders of paths. Keep its sentence."""
    given = {"what": what, "got": got, "expected": expected, **fields}
    wanted = {name: cut_folders(text) for name, text in given.items() if text is not None}
    assert {name: cut_folders(getattr(problem, name)) for name in wanted} == wanted
    assert str(problem).isprintable()
    file = os.environ["PYTEST_CURRENT_TEST"].partition("::")[0]
    plain = _POWER_OF_TEN.sub("#", hide_numbers(cut_folders(str(problem))))
    _seen[file].add(_LONG_RUN.sub(r"\1…", plain))


def cut_folders(text: str) -> str:
    """Return a text whose paths from the root lack their folders, which differ from machine to machine."""
    return _FOLDERS.sub("", text)


def read_table() -> dict[str, set[str]]:
    """Return the sentences of the table by test file."""
    table: dict[str, set[str]] = {}
    sentences: set[str] = set()
    for line in TABLE.read_text(encoding="utf-8").splitlines() if TABLE.exists() else ():
        if line.startswith(" "):
            sentences.add(line.strip())
        elif line and not line.startswith("#"):
            sentences = table[f"{FOLDER}{line}"] = set()
    return table


def write_table(table: dict[str, set[str]]) -> None:
    """Write the table, sorted."""
    parts = [
        "".join(f"{line}\n" for line in (file.removeprefix(FOLDER), *(f"  {each}" for each in sorted(table[file]))))
        for file in sorted(table)
        if table[file]
    ]
    TABLE.write_text("\n".join([HEAD, *parts]), encoding="utf-8")


def pytest_deselected(items: list[pytest.Item]) -> None:
    """Remember files of which not every test runs."""
    _incomplete.update(item.nodeid.partition("::")[0] for item in items)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Remember files of which not every test passes."""
    if not report.passed:
        _incomplete.add(report.nodeid.partition("::")[0])


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take what a worker of xdist has seen."""
    seen, incomplete = node.workeroutput.get("sentences", ({}, ()))
    _incomplete.update(incomplete)
    for file, sentences in seen.items():
        _seen[file].update(sentences)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the table, or fail the run if a sentence is not in it."""
    if hasattr(session.config, "workeroutput"):
        seen = {file: sorted(sentences) for file, sentences in _seen.items()}
        session.config.workeroutput["sentences"] = (seen, sorted(_incomplete))
        return
    table = read_table()
    if session.config.option.write_sentences:
        picked = {each.partition("::")[0] for each in session.config.args if "::" in each}
        for file, sentences in _seen.items():
            known = table.get(file, set())
            table[file] = {find_line(one, known) or one for one in sentences}
            if file in _incomplete | picked:
                table[file] |= known
        write_table(table)
    elif _list_new(table) and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the sentences that are not in the table."""
    if new := _list_new(read_table()):
        terminalreporter.section("sentences that tests/sentences.txt lacks", red=True)
        for line in new:
            terminalreporter.line(line)
        files = " ".join(sorted({line.partition(": ")[0] for line in new}))
        terminalreporter.line(f"Read them; if they are right: pytest --write-sentences {files}")


def _list_new(table: dict[str, set[str]]) -> list[str]:
    return sorted(
        f"{file}: {one}"
        for file, sentences in _seen.items()
        for one in sentences
        if not find_line(one, table.get(file, set()))
    )


def find_line(sentence: str, lines: set[str]) -> str | None:
    """Return the line that is a sentence, or that stands for it with …."""
    if sentence in lines:
        return sentence
    patterns = {line: ".*".join(map(re.escape, line.split("…"))) for line in lines if "…" in line}
    return next((line for line, pattern in patterns.items() if re.fullmatch(pattern, sentence)), None)
