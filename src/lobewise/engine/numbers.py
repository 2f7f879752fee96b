"""Numbers that a pipeline computes for every frame: floats that remember the C expression that they came from."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np


class Number(float):
    """A number with its C expression.

    The value is that of an example. Arithmetic with other numbers writes the expression. Functions of `math` would lose
    it; `take_root`, `raise_to`, `choose_smaller` and `choose_larger` keep it.

    Parameters
    ----------
    value : float
        Example value.
    code : str
        C expression of type double. It is an atom: a name, a call, or an expression in brackets.
    is_single : bool
        Whether the value is rounded to single precision.
    """

    code: str
    is_single: bool

    def __new__(cls, value: float, code: str, *, is_single: bool = False) -> Number:
        number = super().__new__(cls, value)
        number.code, number.is_single = code, is_single
        return number

    def _join(self, other: Any, sign: str, compute: Callable[[float, float], float], *, turned: bool = False) -> Number:
        pair = (write_number(self), write_number(other))
        first, second = pair[::-1] if turned else pair
        values = (float(other), float(self)) if turned else (float(self), float(other))
        return Number(compute(*values), f"({first} {sign} {second})")

    def __add__(self, other: float) -> Number:
        return self._join(other, "+", lambda a, b: a + b)

    def __radd__(self, other: float) -> Number:
        return self._join(other, "+", lambda a, b: a + b, turned=True)

    def __sub__(self, other: float) -> Number:
        return self._join(other, "-", lambda a, b: a - b)

    def __rsub__(self, other: float) -> Number:
        return self._join(other, "-", lambda a, b: a - b, turned=True)

    def __mul__(self, other: float) -> Number:
        return self._join(other, "*", lambda a, b: a * b)

    def __rmul__(self, other: float) -> Number:
        return self._join(other, "*", lambda a, b: a * b, turned=True)

    def __truediv__(self, other: float) -> Number:
        return self._join(other, "/", lambda a, b: a / b)

    def __rtruediv__(self, other: float) -> Number:
        return self._join(other, "/", lambda a, b: a / b, turned=True)

    def __eq__(self, other: object) -> bool:
        return self.code == other.code if isinstance(other, Number) else float(self) == other

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash(float(self))

    def __pow__(self, other: float, modulus: None = None) -> Number:
        if other == 2:
            return self * self
        return Number(math.pow(self, other), f"pow({self.code}, {write_number(other)})")


class Condition(str):
    """A condition that a pipeline judges for every frame: an expression of C."""


def write_number(number: float) -> str:
    """Return a number as a C expression of type double."""
    if isinstance(number, Number):
        return number.code
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{value} is no constant of C")
    return f"({value!r})" if value < 0.0 else repr(value)


def _call(name: str, compute: Callable[..., float], *numbers: float) -> float:
    """Return a function of numbers: a `Number` if one of them is, else a plain float."""
    value = float(compute(*map(float, numbers)))
    if not any(isinstance(number, Number) for number in numbers):
        return value
    return Number(value, f"{name}({', '.join(map(write_number, numbers))})")


def take_root(number: float) -> float:
    """Return the square root."""
    return _call("sqrt", math.sqrt, number)


def raise_to(number: float, power: float) -> float:
    """Return a power, with an exponent that need not be whole."""
    return _call("pow", math.pow, number, power)


def choose_smaller(first: float, second: float) -> float:
    """Return the smaller of two numbers."""
    return _call("fmin", min, first, second)


def choose_larger(first: float, second: float) -> float:
    """Return the larger of two numbers."""
    return _call("fmax", max, first, second)


def compute_hypotenuse(first: float, second: float) -> float:
    """Return the root of the sum of two squares."""
    return _call("hypot", np.hypot, first, second)


def round_single(number: float) -> Number:
    """Return a number rounded to single precision, which kernels take as float32."""
    return Number(float(np.float32(number)), f"(double)(float){write_number(number)}", is_single=True)


def make_single(value: Any) -> Any:
    """Return a number or a vector in single precision, as `lobewise.engine.pixels` takes it."""
    if isinstance(value, Number):
        return round_single(value)
    if isinstance(value, list):
        return [make_single(each) for each in value]
    return np.asarray(value, np.float32)


def square_single(value: float) -> Any:
    """Return a square: factors and product in single precision."""
    single = np.float32(value)
    if not isinstance(value, Number):
        return single * single
    return Number(float(single * single), f"(double)((float){value.code} * (float){value.code})", is_single=True)


def choose_given(setting: Number, automatic: float) -> Number:
    """Return a setting where the user of the pipeline gave one (it is above 0), else its automatic value."""
    value = float(setting) if setting > 0.0 else float(automatic)
    return Number(value, f"({setting.code} > 0.0 ? {setting.code} : {write_number(automatic)})")
