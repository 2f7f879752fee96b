"""Lobe tables for the places of a texture: those of the nodes, and some between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lobewise.fitting.blending import blend_tables
from lobewise.lobe_table import LobeTable
from lobewise.render.materials.places import Places

STEPS = 4
"""Number of steps from one node of a texture to the next, at which there are lobe tables."""


def make_tables(places: Places, nodes: Sequence[LobeTable]) -> tuple[tuple[LobeTable, ...], NDArray[np.uint32]]:
    """Return the tables that some place needs, and for each edge and step the index of the nearest one.

    ``nodes`` holds the tables of the nodes. They come first. Tables between two nodes are made only where places lie.
    The indices have the shape (K - 1, STEPS + 1). Steps go from the first node of an edge to the second one.
    """
    tables = list(nodes)
    numbers = np.zeros((len(places.edges), STEPS + 1), dtype=np.uint32)
    edge, step = places.visited[:, 0].astype(int), np.rint(places.visited[:, 1] * STEPS).astype(int)
    for row, (first, second) in enumerate(places.edges.tolist()):
        one, two = nodes[first], nodes[second]
        made = {0: first, STEPS: second}
        # Velvet may be seen from other views at one node than at the other; then there is nothing between them.
        if one.axis.shape == two.axis.shape and np.array_equal(one.cosine, two.cosine):
            for index in sorted(set(step[edge == row].tolist()) - {0, STEPS}):
                made[index] = len(tables)
                tables.append(blend_tables(one, two, index / STEPS))
        numbers[row] = [made[min(made, key=lambda known: abs(known - index))] for index in range(STEPS + 1)]
    return tuple(tables), numbers
