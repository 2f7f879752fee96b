"""The schedule of a network of `lobewise.filters.mixing`, for processors."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.backend.compiler import hl
from lobewise.filters.mixing_pass import Stage
from lobewise.filters.planes import PIXEL


def schedule_network(stages: Sequence[Stage], out: hl.Func, column: hl.Var, lanes: int) -> None:
    """Compute the stages of a network for one vector of pixels at a time, in the loop ``column`` of ``out``."""
    x, y, c = PIXEL
    for stage in stages:
        func = stage.func.compute_at(out, column).bound(c, 0, stage.channels)
        func.reorder_storage(x, c, y).reorder(x, c, y).vectorize(x, lanes)
        if stage.inputs is not None:
            func.update().reorder(x, stage.inputs.x, c, y).vectorize(x, lanes)
