"""The list of tests that run before a release alone names tests that exist, and leaves a relative in every build."""

from __future__ import annotations

import pytest

from tests.releases import name_test, read_list


def list_whole_files(request: pytest.FixtureRequest) -> dict[str, list[pytest.Item]]:
    """Return the tests of this run by file; skip if only parts of files were asked for."""
    config = request.config
    if any("::" in arg for arg in config.args) or config.option.keyword or config.option.markexpr:
        pytest.skip("only parts of files run")
    found: dict[str, list[pytest.Item]] = {}
    for item in request.session.items:
        found.setdefault(name_test(item.nodeid)[0].partition("::")[0], []).append(item)
    return found


def test_every_name_is_that_of_a_test(request: pytest.FixtureRequest) -> None:
    files = list_whole_files(request)
    known = {name for items in files.values() for item in items for name in name_test(item.nodeid)}
    assert {name for name in read_list() if name.partition("::")[0] in files} <= known


def test_every_file_with_such_tests_runs_others_too(request: pytest.FixtureRequest) -> None:
    files = list_whole_files(request)
    for file in {name.partition("::")[0] for name in read_list()} & set(files):
        assert any(item.get_closest_marker("release") is None for item in files[file]), file
