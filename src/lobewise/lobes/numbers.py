"""What the formulas ask of the numbers they are given: one text serves NumPy, Halide and Dr.Jit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np


class Namespace(Protocol):
    """The functions of one kind of numbers, by NumPy's names. Operators are the numbers' own.

    NumPy arrays, Halide expressions and Dr.Jit values are such numbers; a formula takes its namespace first, as ``xp``.
    The text of a formula is that of the image kernels: the order of its operations is what their bits rest on.
    """

    def number(self, value: float, /) -> Any:
        """Return a constant that float32 does not hold exactly as the numbers' own kind."""

    def where(self, condition: Any, first: Any, second: Any, /) -> Any:
        """Return ``first`` where the condition holds, else ``second``."""

    def sqrt(self, value: Any, /) -> Any: ...

    def expm1(self, value: Any, /) -> Any: ...

    def minimum(self, a: Any, b: Any, /) -> Any: ...

    def maximum(self, a: Any, b: Any, /) -> Any: ...

    def abs(self, value: Any, /) -> Any: ...


class _Numpy:
    """Arrays; constants are of type ``number``."""

    where = staticmethod(np.where)
    sqrt = staticmethod(np.sqrt)
    expm1 = staticmethod(np.expm1)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    abs = staticmethod(np.abs)

    def __init__(self, number: Callable[[float], Any]) -> None:
        self.number = number


NUMPY: Namespace = _Numpy(float)
"""Arrays of any floats: Python's floats take the type of the arrays that they meet."""
NUMPY_SINGLE: Namespace = _Numpy(np.float32)
"""Arrays of float32, and constants that are rounded before they meet."""
