"""Fixtures of the package's tests that those of the benchmarks use as well."""

from tests.conftest import full_frame, make_frame, mi, rng

__all__ = ["full_frame", "make_frame", "mi", "rng"]
