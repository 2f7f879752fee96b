"""The functions that formulas need of numbers, so that one text serves NumPy, Halide and Dr.Jit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np


class Namespace(Protocol):
    """The functions of one kind of numbers, with NumPy's names.

    The numbers are NumPy arrays, Halide expressions or Dr.Jit values. They have their own ``+``, ``*`` and comparisons,
    so these are no functions here. A formula takes its namespace first, as ``xp``.
    Image kernels use the same formulas: the order of operations in a formula determines their bits.
    """

    def number(self, value: float, /) -> Any:
        """Return a constant as a number of this kind; needed for constants that float32 does not hold exactly."""

    def where(self, condition: Any, first: Any, second: Any, /) -> Any:
        """Return ``first`` where the condition holds, else ``second``."""

    def sqrt(self, value: Any, /) -> Any: ...

    def expm1(self, value: Any, /) -> Any: ...

    def minimum(self, a: Any, b: Any, /) -> Any: ...

    def maximum(self, a: Any, b: Any, /) -> Any: ...

    def abs(self, value: Any, /) -> Any: ...


class _Numpy:
    """The functions of arrays; ``number`` is the type of constants."""

    where = staticmethod(np.where)
    sqrt = staticmethod(np.sqrt)
    expm1 = staticmethod(np.expm1)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    abs = staticmethod(np.abs)

    def __init__(self, number: Callable[[float], Any]) -> None:
        self.number = number


NUMPY: Namespace = _Numpy(float)
"""For arrays of any float type: Python's floats adopt the type of the arrays."""
NUMPY_SINGLE: Namespace = _Numpy(np.float32)
"""For arrays of float32, with constants rounded to float32."""
