"""Shading of surfaces by clusters of virtual lights in closed form, with visibility rays to drawn lights.

Source: Tokuyoshi 2015, "Virtual Spherical Gaussian Lights for Real-Time Glossy Indirect Illumination"; clusters are
drawn down a tree in proportion to their estimated light as in Tokuyoshi, Ikeda, Kulkarni and Harada 2024,
"Hierarchical Light Sampling with Accurate Spherical Gaussian Lighting".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lobewise.lobes.clusters import (
    bound_lobe,
    compute_cosine_variance,
    compute_mean_length,
    compute_positive_mean,
    compute_positive_share,
    convolve_sharpness,
    evaluate_gaussian,
    evaluate_lobe,
    project_covariance,
    project_direction,
)
from lobewise.lobes.gaussian import compute_share_on_sphere
from lobewise.lobes.vectors import LUMINANCE
from lobewise.render.bridge import DRJIT, dr, mi, repeat
from lobewise.render.materials.bsdfs import Material
from lobewise.render.virtual_lights.clusters import Clusters, Lights, make_clusters
from lobewise.render.virtual_lights.light_paths import LightSet, Visibility
from lobewise.render.virtual_lights.receivers import Receiver, read_lights, split, weigh_distance

SPREAD = 3.0
"""Variance of a cluster's Gaussian in reflections, over that of its lights. Lights fill a cell of width w, of variance
``w^2 / 12``; Gaussians of variance ``w^2 / 4`` around the centres of cells add up to a constant within 3 %."""
COSINE_SPREAD = 2.0
"""The same for light on diffuse surfaces, whose wide cosine hides gaps. A larger value makes corners darker."""
MIN_CHANCE = 0.1
"""Smallest probability of a half of a node, unless it is dark. It bounds the weight of clusters whose light is
underestimated. With 0.01 single pixels are much too bright; other pixels have no more noise."""
MIN_SHARPNESS, MAX_SHARPNESS = 1e-2, 1e6
"""Sharpness of directions in a node of the tree, inverse square radians."""
MIN_SQUARE_DISTANCE = 1e-12
"""Smallest squared distance to a node, in scene units; it avoids a division by 0."""
MIN_WEIGHT = 0.1
"""Smallest part of a node's light that its estimate supposes beyond the reach of a lobe."""
MIN_DEVIATION = 1e-5
"""Smallest standard deviation of the places of a node's lights, over the extent of all lights."""


class GaussianLighting:
    """Shading by clusters of lights.

    ``size`` is the number of lights of a cluster.
    """

    def __init__(self, scene: Any, materials: dict[int, Material], lights: LightSet, *, size: int) -> None:
        described = read_lights(materials, lights)
        self.clusters = make_clusters(described, size)
        self._visibility = Visibility(scene, materials)
        self._arrays = _pack(self.clusters, described)
        self._numbers = {
            "count": dr.opaque(mi.UInt32, self.clusters.count),
            "levels": dr.opaque(mi.UInt32, self.clusters.count.bit_length() - 1),
            "width": dr.opaque(mi.Float, math.sqrt(SPREAD * self.clusters.compute_variance())),
            "size": dr.opaque(mi.UInt32, self.clusters.members.shape[1]),
        }

    @property
    def width(self) -> Any:
        """Standard deviation of the Gaussians of clusters in reflections, scene units (Float)."""
        return self._numbers["width"]

    @property
    def state(self) -> Any:
        """Arrays that shading reads beside the scene (a PyTree)."""
        return self._arrays, self._numbers

    def gather(self, si: Any, at: Receiver, start: Any, count: Any, rng: Any, active: Any) -> tuple[Any, Any]:
        """Return diffuse and specular radiance towards the viewer, from ``count`` drawn clusters.

        The clusters are drawn at equal distances in [0, 1) of their sums of chances, beginning at ``start`` in [0, 1)
        distances.
        """
        share = dr.rcp(mi.Float(count))

        def take(index: Any) -> tuple[Any, Any]:
            leaf, chance = self._draw(at, dr.minimum((mi.Float(index) + start) * share, 1.0 - 2.0**-24))
            return leaf, dr.select(chance > 0, share / chance, 0.0)

        return self._add_up(si, at, take, dr.select(active, count, 0), rng)

    def gather_all(self, si: Any, at: Receiver, rng: Any, active: Any) -> tuple[Any, Any]:
        """Return diffuse and specular radiance towards the viewer from all clusters."""
        end = dr.select(active, self._numbers["count"], 0)
        return self._add_up(si, at, lambda index: (index, mi.Float(1)), end, rng)

    def _add_up(
        self, si: Any, at: Receiver, take: Callable[[Any], tuple[Any, Any]], end: Any, rng: Any
    ) -> tuple[Any, Any]:
        """Return the light of ``end`` clusters; ``take`` returns the cluster and the weight of a number below it."""

        def add(index: Any, diffuse: Any, specular: Any, rng: Any) -> tuple[Any, ...]:
            leaf, weight = take(index)
            more = self._shine(si, at, leaf, rng.next_float32(), index < end)
            return diffuse + more[0] * weight, specular + more[1] * weight, rng

        diffuse, specular, used = repeat(add, mi.UInt32(0), end, mi.Color3f(0), mi.Color3f(0), rng, label="clusters")
        rng.state, rng.inc = used.state, used.inc
        return diffuse, specular

    def _draw(self, at: Receiver, place: Any) -> tuple[Any, Any]:
        """Return a cluster, drawn by a number in [0, 1), and its chance."""

        def descend(level: Any, node: Any, place: Any, chance: Any) -> tuple[Any, ...]:
            first, second = self._estimate(at, 2 * node), self._estimate(at, 2 * node + 1)
            total = first + second
            left = dr.select(total > 0, dr.clip(first / total, MIN_CHANCE, 1.0 - MIN_CHANCE), 0.5)
            left = dr.select((first <= 0) & (second > 0), 0.0, dr.select((second <= 0) & (first > 0), 1.0, left))
            goes = place < left
            part = dr.select(goes, left, 1.0 - left)
            place = dr.minimum(dr.select(goes, place, place - left) / part, 1.0 - 2.0**-24)
            return dr.select(goes, 2 * node, 2 * node + 1), place, chance * part

        node, _, chance = repeat(
            descend, mi.UInt32(0), self._numbers["levels"], mi.UInt32(1), mi.Float(place), mi.Float(1), label="tree"
        )
        return node - self._numbers["count"], chance

    def _estimate(self, at: Receiver, node: Any) -> Any:
        """Return an estimate of the light of a node at a receiver, above 0 if it has any flux."""
        data = [dr.gather(mi.Vector4f, self._arrays["nodes"], 4 * node + k) for k in range(4)]
        place = _Place(at, data)
        emitted = data[3].y * place.emit_diffuse() + data[3].z * place.emit_glossy()
        cosine, above = place.receive()
        received = mi.luminance(at.diffuse) * (dr.inv_pi * cosine * place.share)
        # Halves of the node may lie beyond the reach.
        shown = above * dr.maximum(weigh_distance(dr.rsqrt(place.inverse), at.reach), MIN_WEIGHT)
        x, y, _ = project_direction(
            DRJIT, split(at.axis), (split(at.basis[0]), split(at.basis[1])), split(place.towards)
        )
        variance = (SPREAD / COSINE_SPREAD) / place.sharpness
        lobe = bound_lobe(DRJIT, (x, y), split(at.lobe), variance)
        return emitted * place.inverse * (received + mi.luminance(at.specular) * (shown * lobe))

    def _shine(self, si: Any, at: Receiver, leaf: Any, place_in: Any, active: Any) -> tuple[Any, Any]:
        """Return diffuse and specular light of a cluster."""
        node = leaf + self._numbers["count"]
        data = [dr.gather(mi.Vector4f, self._arrays["nodes"], 4 * node + k, active) for k in range(4)]
        more = [dr.gather(mi.Vector4f, self._arrays["leaves"], 3 * leaf + k, active) for k in range(3)]
        covariance = [more[0].x, more[0].y, more[0].z, more[0].w, more[1].x, more[1].y]
        place = _Place(at, data)
        emitted = mi.Color3f(more[1].z, more[1].w, more[2].x) * place.emit_diffuse()
        emitted += mi.Color3f(more[2].y, more[2].z, more[2].w) * place.emit_glossy()
        arriving = emitted * place.inverse
        cosine, above = place.receive()
        diffuse = arriving * at.diffuse * (dr.inv_pi * cosine * place.share)
        axis, basis, towards = split(at.axis), (split(at.basis[0]), split(at.basis[1])), split(place.towards)
        x, y, twice = project_direction(DRJIT, axis, basis, towards)
        seen = [SPREAD * place.inverse * part for part in project_covariance(axis, basis, towards, twice, covariance)]
        lobe = evaluate_lobe(DRJIT, (x, y), split(at.lobe), seen, at.beckmann)
        specular = arriving * at.specular * (lobe * above * weigh_distance(dr.rsqrt(place.inverse), at.reach))
        some = active & (dr.max(diffuse + specular) > 0)
        through = self._see(si, leaf, place_in, some)
        return dr.select(some, diffuse * through, 0.0), dr.select(some, specular * through, 0.0)

    def _see(self, si: Any, leaf: Any, place: Any, active: Any) -> Any:
        """Return the visibility of one light of a cluster."""
        size = self._numbers["size"]
        slot = leaf * size + dr.minimum(mi.UInt32(place * mi.Float(size)), size - 1)
        light = dr.gather(mi.UInt32, self._arrays["members"], slot, active)
        position = dr.gather(mi.Point3f, self._arrays["positions"], light, active)
        normal = dr.gather(mi.Vector3f, self._arrays["normals"], light, active)
        return self._visibility.see(si, position, active & (dr.dot(si.p - position, normal) > 0))


class _Place:
    """A node of the tree as a receiver sees it, from the floats that describe it; see `_pack`.

    The places of the node's lights vary alike along its plane, and less across it.
    """

    def __init__(self, at: Receiver, data: list[Any]) -> None:
        self._at = at
        position, variance = mi.Point3f(data[0].x, data[0].y, data[0].z), COSINE_SPREAD * data[0].w
        self._normal, self._normal_length = mi.Vector3f(data[1].x, data[1].y, data[1].z), data[1].w
        self._axis, self._axis_sharpness = mi.Vector3f(data[2].x, data[2].y, data[2].z), data[2].w
        self._flatness = data[3].x
        away = position - at.position
        square = dr.squared_norm(away)
        self.inverse = dr.rcp(dr.maximum(square, MIN_SQUARE_DISTANCE))
        self.towards = away * dr.sqrt(self.inverse)
        self.sharpness = dr.clip(square / variance, MIN_SHARPNESS, MAX_SHARPNESS)
        # A light all around gives a surface no more than its own radiance.
        self.share = compute_share_on_sphere(DRJIT, self.sharpness)
        self._length = compute_mean_length(DRJIT, self.sharpness)
        self._along = dr.dot(self.towards, self._normal)

    def _compute_variance(self, cosine: Any, tilt: Any) -> Any:
        """Return the variance of the cosine of a vector whose cosine with the node's normal is ``tilt``."""
        part = 1.0 - dr.square(cosine) - self._flatness * dr.square(tilt - cosine * self._along)
        across = self._length / self.sharpness
        return compute_cosine_variance(cosine, self._length, across, dr.maximum(part, 0.0))

    def receive(self) -> tuple[Any, Any]:
        """Return the mean positive cosine of the receiver, and which part of the node is above its horizon."""
        cosine = dr.dot(self._at.normal, self.towards)
        mean = self._length * cosine
        positive = compute_positive_mean(
            DRJIT, mean, self._compute_variance(cosine, dr.dot(self._at.normal, self._normal))
        )
        return positive, compute_positive_share(mean, positive)

    def emit_diffuse(self) -> Any:
        """Return the radiant intensity towards the receiver per diffuse flux."""
        # The normals of a node spread by (1 - length^2) / 2 along each direction across their mean.
        turned = 0.5 * (1.0 - dr.square(self._normal_length)) * (1.0 - dr.square(self._along))
        variance = self._compute_variance(self._along, 1.0) + turned
        mean = -self._along * self._length * self._normal_length
        return dr.inv_pi * compute_positive_mean(DRJIT, mean, variance)

    def emit_glossy(self) -> Any:
        """Return the radiant intensity towards the receiver per glossy flux."""
        sharpness = convolve_sharpness(self.sharpness, self._axis_sharpness)
        return evaluate_gaussian(DRJIT, -dr.dot(self.towards, self._axis), sharpness)


def _pack(clusters: Clusters, lights: Lights) -> dict[str, Any]:
    """Return what kernels read of clusters: rows of 16 floats of nodes and of 12 more of leaves, and the lights."""
    luminance = np.array(LUMINANCE)
    xx, xy, xz, yy, yz, zz = clusters.covariance.T
    x, y, z = clusters.normal.T
    across = x * x * xx + y * y * yy + z * z * zz + 2.0 * (x * y * xy + x * z * xz + y * z * yz)
    floor = (MIN_DEVIATION * np.ptp(lights.position, axis=0).max()) ** 2
    along = np.maximum(0.5 * (xx + yy + zz - across), floor + np.finfo(np.float32).tiny)
    columns = [
        clusters.position,
        along,
        clusters.normal,
        clusters.normal_length,
        clusters.axis,
        np.maximum(clusters.sharpness, MIN_SHARPNESS),
        np.clip(1.0 - across / along, -10.0, 1.0),
        clusters.diffuse @ luminance,
        clusters.glossy @ luminance,
        np.zeros(len(along)),
    ]
    leaves = np.concatenate([clusters.covariance, clusters.diffuse, clusters.glossy], axis=1)[-clusters.count :]
    return {
        "nodes": _copy(mi.Float, np.column_stack(columns).astype(np.float32)),
        "leaves": _copy(mi.Float, leaves.astype(np.float32)),
        "members": _copy(mi.UInt32, clusters.members),
        "positions": _copy(mi.Float, lights.position.astype(np.float32)),
        "normals": _copy(mi.Float, lights.normal.astype(np.float32)),
    }


def _copy(kind: Any, values: Any) -> Any:
    """Return values in memory of Dr.Jit. It compiles other code for the memory of NumPy, which is aligned by chance."""
    copied = kind(values.ravel()) + dr.opaque(kind, 0)
    dr.eval(copied)
    return copied
