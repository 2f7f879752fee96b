"""What Dask's exceptions do not print."""

import logging
import sys
from collections.abc import Callable

import pytest


@pytest.fixture(scope="module")
def is_told() -> Callable[[logging.LogRecord], bool]:
    """Return the filter of the log, imported when a test runs."""
    pytest.importorskip("distributed", reason="a farm needs Dask: pip install 'lobewise[farm]'")
    from lobewise.farm.connection import _is_not_of_dask

    return _is_not_of_dask


def make_record(problem: BaseException) -> logging.LogRecord:
    """Return what asyncio logs of a task whose exception nobody asked for."""
    try:
        raise problem
    except BaseException:
        return logging.LogRecord("asyncio", logging.ERROR, "", 0, "never retrieved", None, sys.exc_info())


def test_exceptions_of_dask_are_not_told(is_told: Callable[[logging.LogRecord], bool]) -> None:
    from distributed.client import AllExit
    from distributed.comm import CommClosedError

    assert not is_told(make_record(AllExit()))
    assert not is_told(make_record(CommClosedError("gone")))


def test_other_exceptions_are_told(is_told: Callable[[logging.LogRecord], bool]) -> None:
    assert is_told(make_record(ValueError("mistake")))
    assert is_told(logging.LogRecord("asyncio", logging.ERROR, "", 0, "slow", None, None))
