"""Which tests run in every build, and which before a release alone.

A test is for releases if it has the marker ``release`` or if `LIST` names it.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import pytest

LIST = Path(__file__).with_name("release_cases.txt")
SWITCH = "LOBEWISE_TEST_RELEASE"
"""Variable of the environment by which all tests run."""


def choose_for_release(cases: Collection[str], usual: Collection[str]) -> list[Any]:
    """Return the cases as parameters; those that are not ``usual`` are marked for releases."""
    assert set(usual) <= set(cases)
    return [case if case in usual else pytest.param(case, marks=pytest.mark.release) for case in cases]


def read_list() -> set[str]:
    """Return the names in `LIST`: paths from this folder, with or without parameters."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return {line for line in lines if line and not line.startswith("#")}


def name_test(node: str) -> tuple[str, str]:
    """Return the names by which the list may hold a test: with its parameters, and for all of its cases."""
    name = node.removeprefix("tests/")
    return name, name.partition("[")[0]


def skip_releases(items: Iterable[pytest.Item]) -> None:
    """Mark the tests that the list names, and skip all that are for releases, unless they are asked for."""
    listed = read_list()
    skip = pytest.mark.skip(reason=f"runs before a release; set {SWITCH}=1")
    for item in items:
        if not listed.isdisjoint(name_test(item.nodeid)):
            item.add_marker(pytest.mark.release)
        if SWITCH not in os.environ and item.get_closest_marker("release"):
            item.add_marker(skip)
