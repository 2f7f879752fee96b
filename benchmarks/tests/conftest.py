"""Fixtures of the package's tests that those of the benchmarks use as well, and PyTorch."""

import importlib
import os
from typing import Any

import pytest

from tests.conftest import full_frame, make_frame, mi, rng

__all__ = ["full_frame", "make_frame", "mi", "rng", "torch"]


@pytest.fixture(scope="session")
def torch() -> Any:
    """Return PyTorch on one thread, or skip and say how to get it; where CI is set that is a failure."""
    try:
        found = importlib.import_module("torch")
    except ImportError:
        message = "training needs PyTorch: pip install 'lobewise[train]'"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    found.set_num_threads(1)
    return found
