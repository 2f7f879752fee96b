"""Halide expressions for filter taps: a fast base-2 exponential and logarithm, and tests for bad numbers.

A tap needs one exponential and at most one logarithm. Both are polynomials of the mantissa, without tables, branches or
changes of the rounding mode, so that every target vectorises them. The coefficients are minimax fits made by
``benchmarks/performance/fit_expressions.py`` at the tag ``trials-2026-11``; their errors are stated and tested.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lobewise.backend.compiler import hl
from lobewise.lobes.numbers import Namespace

LOG2_E = math.log2(math.e)

# Relative minimax polynomial of 2^f on [0, 1], degree 4, highest power first: error 2.7e-6.
EXP2_COEFFICIENTS = (0.013534168, 0.0520114623, 0.241442754, 0.693003835, 1.00000259)
# Absolute minimax polynomial of log2(m) - (m - 1) on [1, 2], degree 4, highest power first: error 1.2e-4. It is 0 at
# both ends, so that the logarithm has no step at powers of two.
LOG2_COEFFICIENTS = (-0.0821306989, 0.64971174, -2.13413502, 3.08638335, -1.51982938)

_EXPONENT_BIAS = 127
_ONE_BITS = 0x3F800000
_MANTISSA_MASK = 0x007FFFFF
_MANTISSA_SCALE = 2.0**-23


def _evaluate_polynomial(coefficients: Sequence[float], x: hl.Expr) -> hl.Expr:
    """Return the polynomial with ``coefficients`` (highest power first) at ``x``, by Horner's rule."""
    value = hl.f32(coefficients[0])
    for coefficient in coefficients[1:]:
        value = value * x + hl.f32(coefficient)
    return value


def exp2(x: hl.Expr) -> hl.Expr:
    """Return ``2**min(x, 0)`` as float32; exactly 0 below -127, relative error 1e-5 above -100.

    The result is in [0, 1 + 3e-6] for every ``x`` that is not NaN. The filter relies on both ends: a similarity is at
    most 1 up to the polynomial's error, and a tap that is switched off has weight exactly 0.
    """
    shifted = hl.clamp(x + hl.f32(_EXPONENT_BIAS), hl.f32(0.0), hl.f32(_EXPONENT_BIAS))
    whole = hl.i32(shifted)
    fraction = shifted - hl.f32(whole)
    power = hl.reinterpret(hl.Float(32), whole << 23)
    return power * _evaluate_polynomial(EXP2_COEFFICIENTS, fraction)


def log2(x: hl.Expr) -> hl.Expr:
    """Return ``log2(x)`` for normal positive x as float32, continuous, absolute error 1.2e-4; about 128 for infinity.

    Continuity matters near 1: mixtures take the logarithm of almost 1 for a pixel and itself, where a step
    would show as noise.
    """
    bits = hl.reinterpret(hl.Int(32), x)
    # The integer value of a float's bits is its logarithm, linear between powers of two.
    linear = hl.f32(bits - _ONE_BITS) * hl.f32(_MANTISSA_SCALE)
    mantissa = hl.reinterpret(hl.Float(32), (bits & _MANTISSA_MASK) | _ONE_BITS)
    return linear + _evaluate_polynomial(LOG2_COEFFICIENTS, mantissa)


def is_bad(x: hl.Expr) -> hl.Expr:
    """Return whether a float32 is NaN, infinite or negative, tested on its bits: safe under fast-math."""
    bits = hl.reinterpret(hl.UInt(32), x)
    return (bits >= hl.u32(0x7F800000)) & (bits != hl.u32(0x80000000))


def is_good(color: Sequence[hl.Expr]) -> hl.Expr:
    """Return whether no channel of three is NaN, infinite or negative."""
    bad = [is_bad(value) for value in color]
    return ~(bad[0] | bad[1] | bad[2])


class _Halide:
    """The functions of Halide expressions of float32."""

    # Functions that look Halide up when they are called: the module is imported also where Halide is absent.
    number = staticmethod(lambda value: hl.f32(value))
    where = staticmethod(lambda condition, first, second: hl.select(condition, first, second))
    sqrt = staticmethod(lambda value: hl.sqrt(value))
    minimum = staticmethod(lambda a, b: hl.min(a, b))
    maximum = staticmethod(lambda a, b: hl.max(a, b))
    abs = staticmethod(lambda value: hl.abs(value))

    @staticmethod
    def expm1(value: hl.Expr) -> hl.Expr:
        """Return ``exp(value) - 1``. It loses digits near 0, where no formula uses it."""
        return hl.exp(value) - 1.0


HALIDE: Namespace = _Halide()
