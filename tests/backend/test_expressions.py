"""The polynomials of a tap against NumPy, with the errors that their docstrings state."""

from collections.abc import Callable

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend import expressions
from lobewise.records.frame import FloatArray


def evaluate(function: Callable[[hl.Expr], hl.Expr], values: FloatArray) -> FloatArray:
    """Return ``function`` of every value, computed by Halide."""
    x = hl.Var("x")
    source = hl.Buffer(values)
    result = hl.Func("result")
    result[x] = function(source[x])
    out = np.empty_like(values)
    result.realize(hl.Buffer(out))
    return out


def test_exp2_has_the_stated_error() -> None:
    values = np.linspace(-100.0, 0.0, 200_001, dtype=np.float32)
    exact = np.exp2(values.astype(np.float64))
    assert np.max(np.abs(evaluate(expressions.exp2, values) / exact - 1.0)) < 1e-5


def test_exp2_is_between_0_and_1_everywhere() -> None:
    values = np.array([-np.inf, -1e30, -128.0, -127.0, 1e-3, 5.0, 1e30, np.inf], dtype=np.float32)
    out = evaluate(expressions.exp2, values)
    assert (out[:4] == 0.0).all()
    np.testing.assert_allclose(out[4:], 1.0, rtol=1e-5)


def test_log2_has_the_stated_error() -> None:
    values = np.exp2(np.linspace(-100.0, 100.0, 200_001)).astype(np.float32)
    exact = np.log2(values.astype(np.float64))
    assert np.max(np.abs(evaluate(expressions.log2, values) - exact)) < 1.2e-4
    assert evaluate(expressions.log2, np.array([np.inf], np.float32))[0] > 127.0


def test_log2_has_no_steps() -> None:
    powers = np.exp2(np.arange(-60.0, 60.0)).astype(np.float32)
    below, above = (evaluate(expressions.log2, np.nextafter(powers, np.float32(end))) for end in (0.0, np.inf))
    # Between neighbours a logarithm near 60 changes by what rounding does to it.
    assert np.max(np.abs(above - below)) < 1e-5


def test_bad_values_are_told_by_their_bits() -> None:
    values = np.array([0.0, -0.0, 1e-40, 3.4e38, np.inf, -np.inf, np.nan, -np.nan, -1e-40, -1.0], dtype=np.float32)
    flags: NDArray[np.bool_] = evaluate(lambda v: hl.select(expressions.is_bad(v), hl.f32(1), hl.f32(0)), values) > 0.5
    assert flags.tolist() == [False] * 4 + [True] * 6
