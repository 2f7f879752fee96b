"""Clusters of virtual lights: a binary tree of groups of neighbouring lights, with the sums that describe each group.

Source: Tokuyoshi 2015, "Virtual Spherical Gaussian Lights for Real-Time Glossy Indirect Illumination". There the groups
are the texels of a filtered shadow map; here they are halves of halves in space, so that lights of many bounces count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.lobes.clusters import MAX_SHARPNESS, compute_mean_length, compute_sharpness_of_mean
from lobewise.lobes.numbers import NUMPY
from lobewise.lobes.vectors import LUMINANCE

Array = NDArray[np.float64]

NORMAL_SHARE = 0.3
"""Distance in units of the scene's radius that counts as much as perpendicular normals, when groups are split."""

_LUMINANCE = np.array(LUMINANCE)
_TINY = 1e-300
"""Divisor in place of 0."""


@dataclass(frozen=True)
class Lights:
    """What clusters need of virtual lights; each (count, 3) or (count,).

    ``diffuse`` and ``glossy`` are the emitted fluxes. The diffuse one leaves around ``normal``, and the glossy one is a
    spherical Gaussian about ``axis`` of a ``sharpness``. All directions are unit vectors in world space.
    """

    position: Array
    normal: Array
    axis: Array
    sharpness: Array
    diffuse: Array
    glossy: Array


@dataclass(frozen=True)
class Clusters:
    """A complete binary tree of clusters. Node 1 is the root, nodes 2 k and 2 k + 1 are the halves of node k.

    The last half of the nodes are the leaves, the clusters. ``members`` (leaves, size) are numbers of lights, each
    drawn as often as its share of the cluster's flux; a cluster without light names any.
    """

    position: Array
    """Mean place, (nodes, 3)."""
    covariance: Array
    """Covariance of places, (nodes, 6): xx, xy, xz, yy, yz, zz."""
    diffuse: Array
    """Diffuse flux, (nodes, 3)."""
    normal: Array
    """Mean normal, (nodes, 3), unit vectors."""
    normal_length: Array
    """Length of the mean of the normals, (nodes,), 0 to 1."""
    glossy: Array
    """Glossy flux, (nodes, 3)."""
    axis: Array
    """Mean axis of the glossy flux, (nodes, 3), unit vectors."""
    sharpness: Array
    """Sharpness of the glossy flux, (nodes,)."""
    members: NDArray[np.uint32]

    @property
    def count(self) -> int:
        """Number of clusters."""
        return len(self.members)

    def compute_variance(self) -> float:
        """Return the mean variance of a cluster's places along its plane, weighted by flux, square scene units."""
        leaves = slice(-self.count, None)
        flux = (self.diffuse + self.glossy)[leaves].sum(axis=1)
        # A flat cluster varies in two directions.
        return float(np.average(0.5 * self.covariance[leaves][:, [0, 3, 5]].sum(axis=1), weights=flux + _TINY))


def make_clusters(lights: Lights, size: int) -> Clusters:
    """Return clusters of at most ``size`` neighbouring lights with similar normals, and all nodes above them.

    The number of clusters is the smallest power of 2. Groups are split at the median of the place or normal that varies
    most. ``size`` is at least 1, and there is at least one light.
    """
    count = len(lights.position)
    leaves = 1
    while leaves * size < count:
        leaves *= 2
    order, real = _sort(lights, leaves)
    weight = real * ((lights.diffuse + lights.glossy) @ _LUMINANCE)[order]
    center = lights.position.mean(axis=0)
    nodes = [_sum_leaves(lights, order, real, weight, center)]
    while len(nodes[0]) > 1:
        nodes.insert(0, nodes[0].reshape(len(nodes[0]) // 2, 2, -1).sum(axis=1))
    # No node has the number 0.
    sums = np.concatenate([np.zeros((1, nodes[0].shape[1])), *nodes])
    return _describe(sums, center, _draw(order, weight))


def _sort(lights: Lights, leaves: int) -> tuple[NDArray[np.intp], Array]:
    """Return numbers of lights by leaf, (leaves, size), and 1 or, for fillers that only make leaves equal, 0."""
    count = len(lights.position)
    center = lights.position.mean(axis=0)
    radius = max(float(np.linalg.norm(lights.position - center, axis=1).max()), 1e-12)
    features = np.concatenate([(lights.position - center) / radius, (NORMAL_SHARE / np.sqrt(2.0)) * lights.normal], 1)
    size = -(-count // leaves)
    # Fillers are spread over all lights, so that no leaf has many.
    extra = np.arange(leaves * size - count) * count // max(leaves * size - count, 1)
    order = np.concatenate([np.arange(count), extra])[None]
    real = np.concatenate([np.ones(count), np.zeros(len(extra))])[None]
    while len(order) < leaves:
        groups, group_size = order.shape
        values = features[order]
        widest = values.var(axis=1).argmax(axis=1)
        key = np.take_along_axis(values, widest[:, None, None], axis=2)[..., 0]
        rank = np.argsort(key, axis=1, kind="stable")
        order, real = (
            np.take_along_axis(part, rank, axis=1).reshape(2 * groups, group_size // 2) for part in (order, real)
        )
    return order, real


def _sum_leaves(lights: Lights, order: NDArray[np.intp], real: Array, weight: Array, center: Array) -> Array:
    """Return the sums of each leaf, (leaves, 25), in the order in which `_describe` reads them."""
    place = (lights.position - center)[order]
    diffuse, glossy = real[..., None] * lights.diffuse[order], real[..., None] * lights.glossy[order]
    # The mean of a lobe is shorter the wider the lobe, so sums of means convolve lobes with the spread of their axes.
    length = compute_mean_length(NUMPY, lights.sharpness[order])
    parts = [
        weight[..., None],
        weight[..., None] ** 2,
        weight[..., None] * place,
        weight[..., None] * _square(place),
        diffuse,
        weight[..., None] * lights.normal[order],
        glossy,
        ((glossy @ _LUMINANCE) * length)[..., None] * lights.axis[order],
    ]
    sums: Array = np.concatenate(parts, axis=-1).sum(axis=1)
    return sums


def _describe(sums: Array, center: Array, members: NDArray[np.uint32]) -> Clusters:
    """Return all nodes by their sums, of places around ``center``."""
    weight, squared, place, squares, diffuse, normals, glossy, axes = np.split(
        sums, np.cumsum([1, 1, 3, 6, 3, 3, 3]), axis=1
    )
    safe = np.maximum(weight, _TINY)
    mean = place / safe
    # The covariance of few samples is too small (Bessel); equal weights count as many samples as there are.
    samples = weight**2 / np.maximum(squared, _TINY)
    bessel = np.where(samples > 1.5, samples / np.maximum(samples - 1.0, 0.5), 0.0)
    normal, normal_length = _normalise(normals, weight[:, 0])
    axis, axis_length = _normalise(axes, glossy @ _LUMINANCE)
    return Clusters(
        position=mean + center,
        covariance=bessel * (squares / safe - _square(mean)),
        diffuse=diffuse,
        normal=normal,
        normal_length=normal_length,
        glossy=glossy,
        axis=axis,
        sharpness=np.minimum(compute_sharpness_of_mean(NUMPY, axis_length), MAX_SHARPNESS),
        members=members,
    )


def _square(vectors: Array) -> Array:
    """Return the products xx, xy, xz, yy, yz, zz of the components of vectors."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x * x, x * y, x * z, y * y, y * z, z * z], axis=-1)


def _normalise(total: Array, weight: Array) -> tuple[Array, Array]:
    """Return unit vectors, and the length of the mean, 0 to 1, of sums with a weight."""
    length = np.linalg.norm(total, axis=1)
    unit = np.where(length[:, None] > 0.0, total / np.maximum(length, _TINY)[:, None], [0.0, 0.0, 1.0])
    return unit, np.clip(length / np.maximum(weight, _TINY), 0.0, 1.0)


def _draw(order: NDArray[np.intp], weight: Array) -> NDArray[np.uint32]:
    """Return the lights of each leaf, evenly drawn by their weights."""
    size = order.shape[1]
    total = weight.sum(axis=1, keepdims=True)
    reached = np.where(total > 0.0, weight.cumsum(axis=1) / np.maximum(total, _TINY), (np.arange(size) + 1.0) / size)
    places = (np.arange(size) + 0.5) / size
    slot = (reached[:, None, :] < places[None, :, None]).sum(axis=2)
    drawn = np.take_along_axis(order, np.minimum(slot, size - 1), axis=1)
    return drawn.astype(np.uint32)
