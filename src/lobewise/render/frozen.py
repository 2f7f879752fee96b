"""Functions of Dr.Jit that are recorded once and then replayed without running any Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lobewise.records.frame import FloatArray
from lobewise.render.bridge import dr, hold_garbage

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
