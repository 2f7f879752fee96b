"""How the planes of a pixel lie in a kernel: one after the other, whatever names a feature has given them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import halide as hl

from lobewise.features.base import Pixel


class Layout:
    """Where the planes of a feature lie among all, and how they are put together again.

    Parameters
    ----------
    prepared : what `Feature.prepare` returned
        Says how.
    start : int
        The first of its planes.
    """

    def __init__(self, prepared: Pixel, start: int = 0) -> None:
        self._like = prepared
        self.start = start
        self.stop = start + len(flatten(prepared))

    def read(self, take: Callable[[int], hl.Expr]) -> Pixel:
        """Return the planes of a pixel as `Feature.log2_similarity` takes them; ``take`` returns the k-th of all."""
        return _rebuild(self._like, map(take, range(self.start, self.stop)))


def flatten(prepared: Pixel) -> list[hl.Expr]:
    """Return the planes one after the other."""
    if isinstance(prepared, (list, tuple)):
        return [value for part in prepared for value in flatten(part)]
    return [] if prepared is None else [prepared]


def _rebuild(like: Any, values: Iterator[hl.Expr]) -> Any:
    """Return the next values in the places of those in ``like``."""
    if not isinstance(like, (list, tuple)):
        return None if like is None else next(values)
    parts = [_rebuild(part, values) for part in like]
    return type(like)(*parts) if hasattr(like, "_fields") else parts
