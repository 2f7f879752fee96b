"""Pixels by lane and vector, so that kernels can decide for a whole vector what to compute."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

from lobewise.backend.compiler import declare_vars, hl
from lobewise.filters.planes import X, Y

LANE, VECTOR = declare_vars("lane", "vector")
"""Pixel within a vector, and number of the vector within its row."""

Place: TypeAlias = "tuple[hl.Expr, hl.Expr]"
"""Column and row of a pixel."""


@dataclass
class Pixels:
    """The pixels of an image as functions of lane, vector and row, and the functions computed once per pixel.

    Parameters
    ----------
    width : halide.Expr
        Width of the image, at least ``lanes``.
    lanes : int
        Pixels of a vector; 1 for devices on which each pixel has a thread.
    """

    width: hl.Expr
    lanes: int
    once: list[hl.Func] = field(default_factory=list)
    """The functions computed once per pixel, each after those that it reads."""
    judged: list[hl.Func] = field(default_factory=list)
    """The functions computed once per vector from those of its lanes, each after those that it reads."""

    @property
    def at(self) -> tuple[hl.Var, hl.Var, hl.Var]:
        """The arguments of functions of a pixel."""
        return LANE, VECTOR, Y

    @property
    def place(self) -> Place:
        """Column and row of a pixel."""
        return self.compute_column(LANE, VECTOR), Y

    def compute_column(self, lane: hl.Expr, vector: hl.Expr) -> hl.Expr:
        """Return the column of a pixel. The last vector of a row ends with the row."""
        if self.lanes == 1:
            return vector
        return hl.min(vector * self.lanes, self.width - self.lanes) + lane

    def keep(self, name: str, *values: hl.Expr) -> list[hl.Expr]:
        """Compute values once per pixel. Expressions that repeat them would compile slowly."""
        func = hl.Func(name)
        func[self.at] = hl.Tuple(list(values))
        self.once.append(func)
        return _read(func, self.at)

    def compute_largest(self, name: str, value: hl.Func, least: int) -> hl.Expr:
        """Return the largest value of a vector's pixels, int32, or ``least``; the value itself without vectors."""
        if self.lanes == 1:
            return value[self.at]
        domain = hl.RDom([(0, self.lanes)], f"{name}_lanes")
        func = hl.Func(name)
        func[VECTOR, Y] = least
        func[VECTOR, Y] = hl.max(func[VECTOR, Y], value[domain.x, VECTOR, Y])
        self.judged.append(func)
        return func[VECTOR, Y]

    def write(self, *values: hl.Expr) -> hl.Func:
        """Return a function of column and row with values of a pixel; with vectors its update has the pixels."""
        self.keep("result", *values)
        out, result = hl.Func("out"), self.once[-1]
        if self.lanes == 1:
            out[X, Y] = hl.Tuple(_read(result, (0, X, Y)))
            return out
        domain = hl.RDom([(0, self.lanes), (0, (self.width + (self.lanes - 1)) / self.lanes)], "pixels")
        out[X, Y] = hl.Tuple([hl.undef(hl.Float(32))] * len(values))
        out[self.compute_column(domain.x, domain.y), Y] = hl.Tuple(_read(result, (domain.x, domain.y, Y)))
        return out


def _read(func: hl.Func, at: tuple[hl.Expr, ...]) -> list[hl.Expr]:
    """Return the values of a function at a place."""
    count = func.outputs()
    return [func[at][k] for k in range(count)] if count > 1 else [hl.Expr(func[at])]
