"""Records which kernels the package asks for, without compiling any.

Kernels that are recorded do not compute: they fill their outputs with fixed random numbers. So a recipe runs to its end
in milliseconds, and asks for every kernel on its way. Branches that depend on pixels are taken as these numbers say.
Kernels that look for faults find none with even seeds, and some with odd ones. Images that may be 0 everywhere
(`lobewise.engine.some`), such as highlights, are so with odd seeds. A history goes on twice, and is then cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from typing import Any
from unittest.mock import patch

import halide as hl
import numpy as np

from lobewise.backend import jit
from lobewise.backend.devices import make_target
from lobewise.backend.signature import Parameter, check_call, list_outputs
from lobewise.engine.here import Here
from lobewise.recipes.temporal import past

FAULT_FINDERS = ("odd", "lost", "filtered_sum")
"""Names of kernels that return whether a pixel is impossible."""


@dataclass(frozen=True)
class Wanted:
    """A kernel that somebody asked for.

    Parameters
    ----------
    key : hashable
        Key of the kernel; see `lobewise.backend.jit.get_kernel`.
    make : callable
        Returns the scheduled kernel for a target.
    strict : bool
        Whether float operations keep their order.
    """

    key: Any
    make: Callable[[hl.Target], jit.Scheduled]
    strict: bool


class _RecordedKernel(jit.Kernel):
    """A kernel that fills its outputs instead of computing them."""

    def __init__(self, name: str, parameters: list[Parameter], seed: int) -> None:
        self.name, self.parameters, self.outputs = name, tuple(parameters), list_outputs(parameters)
        self._random = np.random.default_rng(seed)
        self._largest = 0.0 if name in FAULT_FINDERS and seed % 2 == 0 else 2.0

    def __call__(self, **arguments: Any) -> None:
        check_call(self.name, self.parameters, arguments)
        for each in self.outputs:
            array = arguments[each.name].array
            values = self._random.uniform(0.0, self._largest, array.shape)
            array[...] = values.astype(array.dtype)


@contextmanager
def record_kernels(seed: int = 0) -> Iterator[dict[str, Wanted]]:
    """Record the processor's kernels that are asked for inside the ``with`` block, by identity.

    Kernels with features of other packages have no identity, and are not recorded.
    """
    found: dict[str, Wanted] = {}
    shapes: dict[tuple[str, Any], tuple[str, list[Parameter]]] = {}

    def take(key: Any, make: Callable[[hl.Target], jit.Scheduled], *, strict: bool) -> jit.Kernel:
        identity = jit.identify_kernel(key, make, strict=strict)
        if identity is not None:
            found.setdefault(identity, Wanted(key, make, strict))
        if (identity or "", key) not in shapes:
            signature = make(make_target("cpu")).signature
            shapes[identity or "", key] = signature.name, signature.parameters
        return _RecordedKernel(*shapes[identity or "", key], seed)

    shares = cycle((1.0, 1.0, 0.0))

    def some(_: Here, image: Any) -> Any:
        return None if seed % 2 else image

    with (
        patch.object(jit, "_look_up_prebuilt", take),
        patch.object(jit, "_kernels", {}),
        patch.object(Here, "some", some),
        patch.object(past, "measure_share", lambda *_: next(shares)),
    ):
        yield found
