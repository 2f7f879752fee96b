"""Mitsuba and Dr.Jit without types.

Their stubs describe one variant, know no broadcasting and miss overloads, and are absent where the packages are; so
that the checker says the same everywhere, the rest of this room takes the two modules from here. Importing this raises
`MissingDependencyError` where they are not installed.
"""

from __future__ import annotations

from typing import Any

from lobewise.errors import MissingDependencyError
from lobewise.lobes.numbers import Namespace

try:
    import drjit
    import mitsuba
except ImportError as error:
    raise MissingDependencyError(
        "rendering",
        expected="the packages mitsuba and drjit",
        got=f"no module {error.name!r}",
        action="pip install 'lobewise[mitsuba]'",
    ) from error

dr: Any = drjit
mi: Any = mitsuba


class _DrJit:
    """Dr.Jit's functions by NumPy's names: what the formulas of `lobewise.lobes` are written in."""

    number = staticmethod(float)
    where = staticmethod(dr.select)
    sqrt = staticmethod(dr.sqrt)
    minimum = staticmethod(dr.minimum)
    maximum = staticmethod(dr.maximum)
    abs = staticmethod(dr.abs)

    @staticmethod
    def expm1(value: Any) -> Any:
        """Return ``exp(value) - 1``, which loses digits near 0, where no formula here is."""
        return dr.exp(value) - 1.0


DRJIT: Namespace = _DrJit()
