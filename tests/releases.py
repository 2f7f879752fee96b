"""Which cases of a long list run in every build, and which before a release alone."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pytest


def choose_for_release(cases: Collection[str], usual: Collection[str]) -> list[Any]:
    """Return the cases as parameters; those that are not ``usual`` are marked for releases."""
    assert set(usual) <= set(cases)
    return [case if case in usual else pytest.param(case, marks=pytest.mark.release) for case in cases]
