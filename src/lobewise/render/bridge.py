"""Mitsuba and Dr.Jit as untyped modules, with helpers for their loops and for functions that they record.

Their type stubs describe one variant, know no broadcasting, miss overloads, and are absent if the packages are not
installed. The rest of this room imports the two modules from here, so that the type checker reports the same on every
machine. Importing this module raises `MissingDependencyError` if they are not installed.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import MissingDependencyError
from lobewise.lobes.numbers import Namespace
from lobewise.records.frame import FloatArray

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

ALIGNMENT_BYTES = 64
"""Width of the widest vectors of a processor."""

dr: Any = drjit
mi: Any = mitsuba


class _DrJit:
    """Dr.Jit's functions under NumPy's names, for the formulas of `lobewise.lobes`."""

    number = staticmethod(float)
    where = staticmethod(dr.select)
    sqrt = staticmethod(dr.sqrt)
    minimum = staticmethod(dr.minimum)
    maximum = staticmethod(dr.maximum)
    abs = staticmethod(dr.abs)

    @staticmethod
    def expm1(value: Any) -> Any:
        """Return ``exp(value) - 1``. It loses digits near 0, but the formulas used here take no values near 0."""
        return dr.exp(value) - 1.0


DRJIT: Namespace = _DrJit()


def starts_as(kind: str, value: Any = 0) -> Any:
    """Return a dataclass field whose default is a new array of a Mitsuba type, found by name once a variant is set."""

    def make() -> Any:
        return getattr(mi, kind)(value) if value else dr.zeros(getattr(mi, kind))

    return field(default_factory=make)


@contextmanager
def hold_garbage() -> Iterator[None]:
    """Let Python's garbage collection wait while Dr.Jit records, also as a decorator.

    A recording calls every BSDF that is alive, those of other scenes included. If an old scene is freed between two
    calls, Dr.Jit writes one function twice, LLVM refuses it ("invalid redefinition of function"), and Dr.Jit ends the
    process. Garbage is collected at any moment, so this happened by chance.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@hold_garbage()
def follow(state: Any, step: Callable[[Any], Any], label: str) -> Any:
    """Return a state, a dataclass, after calling ``step`` on it, in place, while its field ``active`` is true."""

    def take(state: Any) -> tuple[Any]:
        step(state)
        return (state,)

    return dr.while_loop((state,), lambda state: state.active, take, label=label)[0]


@hold_garbage()
def repeat(take: Callable[..., tuple[Any, ...]], first: Any, end: Any, *state: Any, label: str) -> tuple[Any, ...]:
    """Return the state after ``state = take(index, *state)`` for each index from ``first`` to below ``end``."""

    def step(index: Any, *state: Any) -> tuple[Any, ...]:
        return index + 1, *take(index, *state)

    _, *end_state = dr.while_loop((first, *state), lambda index, *_: index < end, step, label=label)
    return tuple(end_state)


def take_vectors(kind: Any, values: NDArray[Any]) -> Any:
    """Return vectors or colours of a Mitsuba type from an array (3, count).

    Dr.Jit's own conversion compiles a kernel for every count, and so does that of `give_vectors`.
    """
    return kind(*(take_numbers(mi.Float, row) for row in values))


def take_numbers(kind: Any, values: NDArray[Any]) -> Any:
    """Return an array of Dr.Jit, `mi.Float` or `mi.UInt32`, from numbers (count,).

    Dr.Jit reads the memory of NumPy in place, and compiles a kernel for each combination of arrays that begin on a
    border of `ALIGNMENT_BYTES` and arrays that do not. So the numbers are copied to such a border.
    """
    dtype = np.dtype(np.uint32 if kind is mi.UInt32 else np.float32)
    memory = np.empty(values.size * dtype.itemsize + ALIGNMENT_BYTES, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT_BYTES
    numbers = memory[start : start + values.size * dtype.itemsize].view(dtype)
    numbers[:] = values
    return kind(numbers)


def give_vectors(values: Any) -> NDArray[np.float32]:
    """Return vectors or colours as an array (3, count)."""
    dr.eval(values)
    return np.stack([np.array(row, dtype=np.float32) for row in values])


UNRECORDABLE = "The frozen function included a virtual function call"
"""Dr.Jit's message for a function that it cannot record because it calls nested objects, such as BSDFs under a map."""

MAX_RECORDINGS = 32
"""Number of recordings of one function that are kept, for sizes and kinds of arrays that differ."""
WARN_AFTER = 200
"""Number of recordings of one function from which on Dr.Jit warns: a scene that moves needs new ones now and then."""


class Recorded:
    """A Dr.Jit function that is recorded once and then replayed. If Dr.Jit cannot record it, it runs every time.

    ``function`` takes Dr.Jit arrays and returns a PyTree of them. ``get_state`` returns the objects that ``function``
    reads beside its arguments, such as the scene and other Dr.Jit arrays. With ``records`` false nothing is recorded.
    """

    def __init__(self, function: Callable[..., Any], get_state: Callable[[], Any], *, records: bool = True) -> None:
        self._plain = function
        self._get_state = get_state
        self._records = records
        self.forget()

    def forget(self) -> None:
        """Record the function again at its next call."""
        self._run = self._plain
        if self._records:
            self._run = dr.freeze(
                self._plain, state_fn=lambda *_, **__: self._get_state(), limit=MAX_RECORDINGS, warn_after=WARN_AFTER
            )

    @hold_garbage()
    def run(self, *arguments: Any) -> Any:
        """Return the results as Dr.Jit arrays."""
        try:
            return self._run(*arguments)
        except RuntimeError as error:
            if UNRECORDABLE not in str(error.__cause__):
                raise
            self._run = self._plain
            return self._plain(*arguments)


class Frozen(Recorded):
    """A recorded function that returns a list of arrays."""

    def __call__(self, *arguments: Any) -> list[FloatArray]:
        """Return the results as NumPy arrays of one dimension."""
        # Flatten the results outside the recording: where each vector goes depends on the number of lanes.
        results = [_flatten(result) for result in self.run(*arguments)]
        dr.eval(results)
        # On the CPU these are views that keep Dr.Jit's memory alive.
        return [result.numpy() for result in results]


def _flatten(value: Any) -> Any:
    """Return an array of vectors as an array of numbers, lane after lane."""
    return dr.ravel(value) if dr.depth_v(value) > 1 else value
