"""Finds where on a texture the reflection of a BSDF changes its shape, and how a hit tells its place.

The parameters of a BSDF need not be known: a BSDF may be written in Python. So a place is recognized by its answers.
The *signature* of a place holds square roots of the glossy values for some fixed pairs of directions, divided by their
norm. A texture that only scales the lobes does not change the signature; a texture of roughness does. The distance of
two signatures is a Hellinger distance, which is bounded. For microfacet lobes it is about proportional to the logarithm
of the ratio of their alphas.

A few places, the *nodes*, represent all places. They are chosen one after the other, each as the place that is farthest
from those before it (Gonzalez 1985, "Clustering to minimize the maximum intercluster distance"). The shortest tree
joins the nodes (Prim 1957). Every other place counts as the nearest point of the tree: two nodes and a share between
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.fitting.arrays import Array, make_view
from lobewise.fitting.nodes import make_upper_nodes
from lobewise.fitting.table import blend_tables
from lobewise.lobes.numbers import NUMPY, Namespace
from lobewise.lobes.vectors import LUMINANCE, dot, scale, subtract
from lobewise.records.lobe_table import LobeTable
from lobewise.render.materials.probe import Parts, evaluate_bsdf, spread_directions, spread_points
from lobewise.render.materials.tints import solve_nonnegative

MAX_NODES = 8
"""Number of places at which lobes are fitted. The fit of one takes about a second."""
STEPS = 4
"""Number of steps from one node of a texture to the next, at which there are lobe tables."""

# Number of places that are compared.
_PLACE_COUNT = 4096
# Distance of signatures. An alpha of 0.22 and one of 0.2 differ by 0.03, 0.25 and 0.2 by 0.07, 0.4 and 0.2 by 0.25.
_MAX_DISTANCE_TO_TREE, _MAX_DISTANCE_TO_NODE = 0.045, 0.15
# Share of the places that may be farther from the nodes, such as the texels between two squares of a checkerboard.
_MAX_SHARE_FAR = 0.005
# Glossy value, relative to the largest one, below which a place counts as black.
_MIN_RELATIVE_VALUE = 1e-3
# Angles of the half vectors from the normal, radians: about those of the alphas that are told apart.
_HALF_ANGLES = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
# n.v and azimuths, radians, of the views.
_VIEWS = ((0.95, 0.7), (0.6, 2.1))
# Largest number of pairs of directions that are evaluated at a hit. Fewer do if no place is farther than this from its
# place by all pairs, and no two nodes come nearer to each other than by this ratio.
_MAX_PROBES, _MAX_PLACE_ERROR, _MIN_RATIO = 6, 0.02, 0.5
# Number of places by which these pairs are chosen.
_CHOICE_COUNT = 256


@dataclass(frozen=True)
class TextureNodes:
    """The nodes of one BSDF, K of them, and M pairs of directions that tell them apart."""

    place: Array
    """The nodes, (K, 2 or 5): texture coordinates, and the position if the BSDF depends on it."""
    view: Array
    """Local unit vectors towards the viewer, (M, 3)."""
    light: Array
    """Local unit vectors towards the light, (M, 3)."""
    weight: Array
    """Weights (M,) >= 0. The *level* of a place is the sum of the glossy values times the cosine, times these weights.
    It is about the albedo, and is linear in what a texture multiplies."""
    signature: Array
    """Signatures of the nodes for these directions, (K, M)."""
    level: Array
    """Levels of the nodes, linear RGB, (K, 3)."""
    edges: NDArray[np.intp]
    """The two nodes of each edge of the tree, (K - 1, 2)."""
    visited: Array
    """For all places that are not black the edge, and the share of its second node, (n, 2)."""


def probe_texture(bsdf: Any, parts: Parts, extent: float = 1.0, *, most: int = MAX_NODES) -> TextureNodes | None:
    """Return the nodes of a BSDF's texture, or None if its glossy lobes have one shape.

    The first node is the centre of the texture, unless the centre is black. A BSDF that depends on the position is
    evaluated in the cube of coordinates from ``-extent`` to ``extent``. There are at most ``most`` nodes.
    """
    view, light = _list_probes()
    # The first of these points is the centre.
    place = spread_points(_PLACE_COUNT, 5 if parts.positional else 2)
    place[:, 2:] = extent * (2.0 * place[:, 2:] - 1.0)
    light, colors = _evaluate_places(bsdf, parts, view, light, place)
    values = colors @ np.asarray(LUMINANCE)
    total = values.sum(axis=1)
    seen = total > _MIN_RELATIVE_VALUE * total.max()
    place, colors, values = place[seen], colors[seen], values[seen]
    if not len(place):
        return None
    signature = make_signature(values)
    chosen = _choose_nodes(signature, most)
    if len(chosen) == 1:
        return None
    edges = _join_nodes(signature[chosen])
    some = np.concatenate([np.arange(0, len(place), max(1, len(place) // _CHOICE_COUNT)), chosen])
    probes = _choose_probes(values[some], values[chosen], edges)
    weight = _compute_weights(bsdf, parts, place[some[::4]], values[some[::4]][:, probes], bool(light[0, 2] < 0.0))
    short = make_signature(values[:, probes])
    spot = locate(NUMPY, short.T, short[chosen], edges)
    return TextureNodes(
        place=place[chosen],
        view=view[probes],
        light=light[probes],
        weight=weight,
        signature=short[chosen],
        level=weight @ colors[chosen][:, probes],
        edges=edges,
        visited=np.stack(np.broadcast_arrays(spot.edge, spot.share), axis=1),
    )


def make_signature(values: Array) -> Array:
    """Return signatures (n, M) from luminances (n, M) >= 0: square roots, each row of norm 1; 0 for a row of zeros."""
    total = values.sum(axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.divide(values, total, out=np.zeros_like(values), where=total > 0.0)))


class Spot(NamedTuple):
    """Places on the tree: numbers of NumPy or of Dr.Jit."""

    edge: Any
    first: Any
    """The node at the start of the edge."""
    second: Any
    """The node at its end."""
    share: Any
    """Share of the second node, 0 to 1."""
    gap: Any
    """Square of the distance from the edge."""
    level: Any = None
    """See `TextureNodes.weight`."""


def locate(xp: Namespace, signature: Any, nodes: Array, edges: NDArray[np.intp]) -> Spot:
    """Return the places on the tree of the nodes (K, M) that are nearest to signatures, given as M numbers each."""
    spots: list[Spot] = []
    for edge, (first, second) in enumerate(edges.tolist()):
        step = (nodes[second] - nodes[first]).tolist()
        apart = subtract(signature, nodes[first].tolist())
        share = dot(apart, step) * (1.0 / max(dot(step, step), 1e-12))
        # A share that is no number becomes 0.
        share = xp.where(share > 0.0, xp.minimum(share, 1.0), 0.0)
        away = subtract(apart, scale(step, share))
        spots.append(Spot(edge, first, second, share, dot(away, away)))
    best = spots[0]
    for spot in spots[1:]:
        nearer = spot.gap < best.gap
        best = Spot(*(xp.where(nearer, one, other) for one, other in zip(spot[:5], best[:5], strict=True)))
    return best


def _evaluate_places(bsdf: Any, parts: Parts, view: Array, light: Array, place: Array) -> tuple[Array, Array]:
    """Return the lights (M, 3), and glossy values times the cosine, linear RGB, (places, M, 3).

    If the BSDF only transmits, the lights are mirrored at the surface.
    """
    for side in (1.0, -1.0):
        sided = light * [1.0, 1.0, side]
        values = _evaluate_pairs(bsdf, parts, view, sided, place)
        if values.any():
            break
    return sided, values


def _evaluate_pairs(bsdf: Any, parts: Parts, view: Array, light: Array, place: Array) -> Array:
    """Return glossy values times the cosine, linear RGB, (places, M, 3); 0 where they are no numbers >= 0."""
    views, lights = np.tile(view, (len(place), 1)), np.tile(light, (len(place), 1))
    values = evaluate_bsdf(bsdf, views, lights, parts.glossy_lobes, place=np.repeat(place, len(view), axis=0))
    values = np.where(np.isfinite(values) & (values > 0.0), values, 0.0) * np.abs(lights[:, 2:])
    return np.asarray(values.reshape(len(place), len(view), 3))


def _compute_weights(bsdf: Any, parts: Parts, place: Array, values: Array, through: bool) -> Array:
    """Return weights (M,) whose sum with ``values`` (n, M) is nearest to the albedos of the places (n, 2 or 5).

    The albedos are means over the views of the probes; differences are relative.
    """
    albedo = np.zeros(len(place))
    for cosine, azimuth in _VIEWS:
        nodes = make_upper_nodes(cosine, azimuth)
        view = np.tile(make_view(cosine, azimuth), (len(nodes.light), 1))
        reflected = _evaluate_pairs(bsdf, parts, view, nodes.light * [1.0, 1.0, -1.0 if through else 1.0], place)
        albedo += (reflected @ np.asarray(LUMINANCE)) @ nodes.weight / len(_VIEWS)
    lit = albedo > 0.0
    return solve_nonnegative(values[lit] / albedo[lit, None], np.ones(int(lit.sum())))


def _list_probes() -> tuple[Array, Array]:
    """Return pairs of views and lights, (n, 3) each: lights ever farther from the mirror direction, and all around."""
    views, lights = [], []
    around = spread_directions(24)[:12]
    for cosine, azimuth in _VIEWS:
        view = make_view(cosine, azimuth)
        turns = azimuth + np.arange(4) * (0.25 * math.pi)
        angle, turn = (grid.ravel() for grid in np.meshgrid(_HALF_ANGLES, turns, indexing="ij"))
        half = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=-1)
        half = np.concatenate([[[0.0, 0.0, 1.0]], half])
        light = np.concatenate([2.0 * (half @ view)[:, None] * half - view, np.abs(around), view[None]])
        light = light[light[:, 2] > 0.05]
        views.append(np.tile(view, (len(light), 1)))
        lights.append(light)
    return np.concatenate(views), np.concatenate(lights)


def _choose_nodes(signature: Array, most: int) -> list[int]:
    """Return at most so many rows of signatures (n, M), the first one included, that are near to nearly all rows."""
    chosen = [0]
    while len(chosen) < most:
        nodes = signature[chosen]
        near = np.linalg.norm(signature[:, None] - nodes, axis=-1).min(axis=1)
        gap = near if len(chosen) == 1 else np.sqrt(locate(NUMPY, signature.T, nodes, _join_nodes(nodes)).gap)
        far = (near > _MAX_DISTANCE_TO_NODE) | (gap > _MAX_DISTANCE_TO_TREE)
        if far.mean() <= _MAX_SHARE_FAR:
            break
        chosen.append(int(np.where(far, near, 0.0).argmax()))
    return chosen


def _join_nodes(nodes: Array) -> NDArray[np.intp]:
    """Return the edges (K - 1, 2) of the shortest tree that joins all nodes (K, M)."""
    gaps = np.linalg.norm(nodes[:, None] - nodes, axis=-1)
    inside, edges = [0], []
    while len(inside) < len(nodes):
        outside = [index for index in range(len(nodes)) if index not in inside]
        part = gaps[np.ix_(inside, outside)]
        row, column = np.unravel_index(part.argmin(), part.shape)
        edges.append((inside[row], outside[column]))
        inside.append(outside[column])
    return np.asarray(edges, dtype=np.intp)


def _choose_probes(values: Array, nodes: Array, edges: NDArray[np.intp]) -> list[int]:
    """Return the fewest columns whose signatures place rows of ``values`` on the tree like those of all columns."""

    def place(columns: list[int]) -> Array:
        of_nodes = make_signature(nodes[:, columns])
        spot = locate(NUMPY, make_signature(values[:, columns]).T, of_nodes, edges)
        return np.asarray(whole_start[spot.edge] + spot.share[:, None] * whole_step[spot.edge])

    whole = make_signature(nodes)
    whole_start = whole[edges[:, 0]]
    whole_step = whole[edges[:, 1]] - whole_start
    everything = list(range(values.shape[1]))
    target = place(everything)
    pairs = np.triu_indices(len(nodes), 1)

    def compare(columns: list[int]) -> tuple[float, float]:
        """Return the largest error of a place, and the smallest ratio of two nodes' distances by these and all."""
        error = np.linalg.norm(place(columns) - target, axis=1).max()
        short = make_signature(nodes[:, columns])
        apart = [np.linalg.norm((each[:, None] - each)[pairs], axis=-1) for each in (short, whole)]
        return float(error), float((apart[0] / apart[1]).min())

    # The first column is the brightest one, so that no signature is 0.
    chosen = [int((nodes / nodes.max(axis=1, keepdims=True)).min(axis=0).argmax())]
    while len(chosen) < _MAX_PROBES:
        rest = [column for column in everything if column not in chosen]
        scores = [compare([*chosen, column]) for column in rest]
        costs = [error / _MAX_PLACE_ERROR + 1.0 / max(ratio, 1e-9) for error, ratio in scores]
        best = int(np.argmin(costs))
        chosen.append(rest[best])
        if scores[best][0] <= _MAX_PLACE_ERROR and scores[best][1] >= _MIN_RATIO:
            break
    return chosen


def make_tables(places: TextureNodes, nodes: Sequence[LobeTable]) -> tuple[tuple[LobeTable, ...], NDArray[np.uint32]]:
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
