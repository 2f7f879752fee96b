"""What makes the lobes of an exported filter from its guides: the definition that is compiled, here and elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.backend.pointwise import Grid, Vector
from lobewise.guides.lobe_fields import define_lobes
from lobewise.guides.mixture_fields import define_mixture


def define_guides(grid: Grid, similarity: str, lobes: int) -> Sequence[Vector]:
    """Return the outputs of the function that makes lobes, in order: the mask, the axis, and what else there is."""
    return define_mixture(grid, lobes) if similarity == "sg_mixture" else define_lobes(grid, similarity, False)
