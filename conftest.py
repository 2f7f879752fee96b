"""Which tests run in every build: those that are not `nightly`. ``pytest -m ""`` runs all."""

from __future__ import annotations

from collections import defaultdict

import pytest
from hypothesis import HealthCheck, settings

FEW_EXAMPLES, MANY_EXAMPLES = 10, 100
"""Of a property: in every build, and where the tests are not restricted by a marker."""

pytest_plugins = ["tests.mistakes"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that makes the table of sentences anew; see `tests.mistakes`."""
    parser.addoption("--write-sentences", action="store_true", help="write tests/sentences.txt from what tests see")


def pytest_configure(config: pytest.Config) -> None:
    """Let Hypothesis draw the same examples in every run, however busy the machine is."""
    settings.register_profile(
        "repeatable",
        derandomize=True,
        deadline=None,
        max_examples=FEW_EXAMPLES if config.option.markexpr else MANY_EXAMPLES,
        suppress_health_check=[HealthCheck.function_scoped_fixture],
    )
    settings.load_profile("repeatable")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave to the night what ``sampled`` does not name, and what needs PyTorch, which is large."""
    found: dict[str, set[str]] = defaultdict(set)
    named: dict[str, set[str]] = {}
    for item in items:
        marker, name = item.get_closest_marker("sampled"), item.nodeid.partition("[")[0]
        if marker is not None:
            case = item.callspec.id  # type: ignore[attr-defined]
            found[name].add(case)
            named[name] = set(marker.args)
            if case not in marker.args:
                item.add_marker(pytest.mark.nightly)
        elif "torch" in getattr(item, "fixturenames", ()) or "[torch" in item.name:
            item.add_marker(pytest.mark.nightly)
    if any("::" in each for each in config.args):
        return
    for name, cases in named.items():
        if cases - found[name]:
            raise pytest.UsageError(f"{name}: sampled names cases that do not exist: {sorted(cases - found[name])}")
