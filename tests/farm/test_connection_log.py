"""What Dask's exceptions do not print."""

from __future__ import annotations

import logging
import sys

import pytest

pytest.importorskip("distributed", reason="a farm needs Dask: pip install 'lobewise[farm]'")

from lobewise.farm.connection import _is_not_of_dask


def make_record(problem: BaseException) -> logging.LogRecord:
    """Return what asyncio logs of a task whose exception nobody asked for."""
    try:
        raise problem
    except BaseException:
        return logging.LogRecord("asyncio", logging.ERROR, "", 0, "never retrieved", None, sys.exc_info())


def test_exceptions_of_dask_are_not_told():
    from distributed.client import AllExit
    from distributed.comm import CommClosedError

    assert not _is_not_of_dask(make_record(AllExit()))
    assert not _is_not_of_dask(make_record(CommClosedError("gone")))


def test_other_exceptions_are_told():
    assert _is_not_of_dask(make_record(ValueError("mistake")))
    assert _is_not_of_dask(logging.LogRecord("asyncio", logging.ERROR, "", 0, "slow", None, None))
