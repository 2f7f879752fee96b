"""Mitsuba and Dr.Jit without types.

Their stubs describe one variant, know no broadcasting and miss overloads, and are absent where the packages are; so
that the checker says the same everywhere, the rest of this room takes the two modules from here. Importing this raises
`MissingDependencyError` where they are not installed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
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


def starts_as(kind: str, value: Any = 0) -> Any:
    """Return a field of a dataclass whose default is a new array of a type of Mitsuba's, which a variant brings."""

    def make() -> Any:
        return getattr(mi, kind)(value) if value else dr.zeros(getattr(mi, kind))

    return field(default_factory=make)


def follow(state: Any, step: Callable[[Any], Any], label: str) -> Any:
    """Return a state, a dataclass, after ``step`` changed it in place again and again while its lane is ``active``."""

    def take(state: Any) -> tuple[Any]:
        step(state)
        return (state,)

    return dr.while_loop((state,), lambda state: state.active, take, label=label)[0]


def repeat(take: Callable[..., tuple[Any, ...]], first: Any, end: Any, *state: Any, label: str) -> tuple[Any, ...]:
    """Return the state after ``state = take(index, *state)`` for each index from ``first`` to below ``end``."""

    def step(index: Any, *state: Any) -> tuple[Any, ...]:
        return index + 1, *take(index, *state)

    _, *found = dr.while_loop((first, *state), lambda index, *_: index < end, step, label=label)
    return tuple(found)
