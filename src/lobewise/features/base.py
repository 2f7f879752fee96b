"""The base classes of features, which define how similar two pixels are.

A feature is a distribution per pixel. The similarity of two pixels is the L2-normalised product integral of their
distributions, to the power beta (Tokuyoshi 2015). The filter multiplies the similarities of its features by adding
their base-2 logarithms, so that a tap costs one exponential for any number of features.

To write a feature, derive from `Feature`: return the per-pixel arrays, and the log-similarity of two pixels as an
expression. The feature then runs in every form and on every device. docs/developers/features.md explains how;
`examples/` has two.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from dataclasses import fields
from numbers import Real
from typing import Any, ClassVar, TypeAlias

from lobewise.backend.buffers import Image
from lobewise.backend.compiler import hl
from lobewise.errors import InputError

Vector: TypeAlias = "Sequence[hl.Expr]"
Pixel = Any
"""The planes of one pixel as `Feature.prepare` returned them: an expression, a list, a `NamedTuple`, or nested ones."""
Offset: TypeAlias = "tuple[hl.Expr, hl.Expr]"
Stage: TypeAlias = "Callable[[hl.Expr], hl.Expr]"
"""Stores an intermediate value of a row of taps in cache, which splits a long log-similarity into shorter loops."""


class Feature(ABC):
    """A distribution per pixel.

    A feature holds the arrays of one frame. Kernels are compiled once per class and `structure`, and run on arrays of
    any size.
    """

    name: ClassVar[str] = "own"

    @property
    def neutral(self) -> tuple[float, ...]:
        """One value per input channel, which replaces pixels without meaning, so that no tap reads NaN."""
        return (0.0,) * sum(count_channels(self))

    @property
    def structure(self) -> Hashable:
        """Everything besides the class that changes the expressions."""
        return ()

    @abstractmethod
    def get_arrays(self) -> tuple[Image, ...]:
        """Return the input arrays, each float32 of shape (height, width) or (height, width, channels)."""

    def get_parameters(self) -> tuple[float, ...]:
        """Return the scalars of the feature; new values do not compile again."""
        return ()

    def prepare(self, inputs: Vector, parameters: Vector) -> Pixel:
        """Return the planes that taps read, from the input channels of one pixel in the order of the arrays.

        Planes are computed once per pixel, so everything that does not need both pixels belongs here.
        """
        return list(inputs)

    @abstractmethod
    def log2_similarity(self, i: Pixel, j: Pixel, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        """Return the base-2 logarithm of the similarity, in (-inf, 0], to the power beta.

        It must be symmetric: swapping i and j and negating the offset must not change it. Some passes use one value for
        both pixels of a pair.

        Parameters
        ----------
        i, j : Pixel
            Planes of the centre pixel and of the tap, as `prepare` returned them.
        parameters : sequence of halide.Expr
            The scalars of `get_parameters`.
        offset : pair of halide.Expr
            Tap minus centre in pixels, x right and y down, float32.
        stage : callable
            Wrap a long intermediate value in ``stage(...)`` to compute it in a separate loop, with fewer registers.
        """


class DeclaredFeature(Feature):
    """A feature whose arrays and numbers are the fields of a dataclass, in order. Numbers must be above 0.

    A field may be a named tuple of arrays. Fields that are None are left out.

    Raises
    ------
    InputError
        If a number is not finite or not above 0.
    """

    def __post_init__(self) -> None:
        for name, value in self._list_fields():
            if isinstance(value, Real):
                # A number of a recorded recipe is a float that remembers more.
                number = value if isinstance(value, float) else float(value)
                if not (number > 0.0 and math.isfinite(number)):
                    what, expected = f"{self.name} {name}".replace("_", " "), "a finite number above 0"
                    raise InputError(what, expected=expected, got=str(value), action="raise it")
                object.__setattr__(self, name, number)

    def _list_fields(self) -> list[tuple[str, Any]]:
        return [(field.name, getattr(self, field.name)) for field in fields(self)]  # type: ignore[arg-type]

    def get_arrays(self) -> tuple[Image, ...]:
        arrays: list[Image] = []
        for _, value in self._list_fields():
            if isinstance(value, tuple):
                arrays.extend(value)
            elif value is not None and not isinstance(value, Real):
                arrays.append(value)
        return tuple(arrays)

    def get_parameters(self) -> tuple[float, ...]:
        return tuple(value for _, value in self._list_fields() if isinstance(value, float))

    def split(self, inputs: Vector) -> list[Any]:
        """Return the input channels of a pixel by array: an expression, or a list for an array with channels."""
        parts: list[Any] = []
        first = 0
        for array, count in zip(self.get_arrays(), count_channels(self), strict=True):
            parts.append(inputs[first] if array.ndim == 2 else list(inputs[first : first + count]))
            first += count
        return parts


def count_channels(feature: Feature) -> list[int]:
    """Return the number of channels of each array of a feature."""
    return [1 if array.ndim == 2 else int(array.shape[2]) for array in feature.get_arrays()]


def describe_structure(feature: Feature) -> Hashable:
    """Return the part of a kernel's key that identifies the code of a feature."""
    return type(feature), feature.structure, tuple(a.shape[2:] for a in feature.get_arrays())
