"""Halide's functions by NumPy's names: what the formulas of `lobewise.lobes` are written in."""

from __future__ import annotations

import halide as hl

from lobewise.lobes.numbers import Namespace


class _Halide:
    """Expressions of float32."""

    number = staticmethod(hl.f32)
    where = staticmethod(hl.select)
    sqrt = staticmethod(hl.sqrt)
    minimum = staticmethod(hl.min)
    maximum = staticmethod(hl.max)
    abs = staticmethod(hl.abs)

    @staticmethod
    def expm1(value: hl.Expr) -> hl.Expr:
        """Return ``exp(value) - 1``, which loses digits near 0, where no formula here is."""
        return hl.exp(value) - 1.0


HALIDE: Namespace = _Halide()
