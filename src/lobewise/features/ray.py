"""The feature that weighs a sample by the pixel's own lobe along the sample's ray."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import HALIDE
from lobewise.features.base import DeclaredFeature, Offset, Stage, Vector
from lobewise.lobes.directions import compute_tangent, face_viewer
from lobewise.lobes.vectors import cross, dot, scale
from lobewise.records.frame import FloatArray

LOBE_SPREAD = 0.1
"""Alpha by which lobes are widened before their values along a ray are compared. Without it a neighbour's ray meets a
sharp lobe seldom, so that few rays count and the result is noisy."""
MAX_RAY_WEIGHT = 4.0
"""Largest factor of a weight, which bounds fireflies."""
MIN_RAY_COSINE = 1e-3
"""Smallest cosine of the angle between normal and viewing direction."""
NO_RAY = -1.0
"""Inverse value of a lobe where no ray is known."""


class RayPlanes(NamedTuple):
    """The planes of a pixel's widened lobe, and of the ray of its sample."""

    view: Vector
    """Towards the camera."""
    u: Vector
    """Tangent over alpha."""
    v: Vector
    """Bitangent over its alpha."""
    normal: Vector
    scale: hl.Expr
    direction: Vector
    inverse: hl.Expr
    """One over the value of the sample's own lobe along its ray, or `NO_RAY`."""


@dataclass(frozen=True, eq=False, repr=False)
class RayFeature(DeclaredFeature):
    """The ratio of two lobes along the ray of a sample: the lobe of the pixel over the lobe of the sample's pixel.

    The value of a lobe is ``D(h) / (4 cos_v)`` with the GGX distribution D of the half vector h between the ray and the
    viewing direction. Masking and Fresnel are left out: they hardly differ between pixels whose lobes are alike. Both
    lobes are widened: ``spread^2`` is added to the square of each alpha. The ratio is at most ``most``. A pixel's own
    ray has ratio 1.

    Source: Stachowiak 2015, "Stochastic Screen-Space Reflections", who weighs neighbours' rays by the pixel's BRDF over
    their density; Walter et al. 2007, equation 33 (D); Burley 2012 (its two alphas).
    Departs: the density is taken as the sample's own lobe, and what the sample differs from it is in its weight; lobes
    are widened; rays are taken from the pixel's own place, without a shift to where the neighbour's ray arrives.

    Parameters
    ----------
    view : array, shape (height, width, 3)
        Unit vectors towards the camera.
    normal : array, shape (height, width, 3)
        Unit normals; see `lobewise.lobes.directions.face_viewer`.
    tangent : array, shape (height, width, 3)
        Direction of ``alpha_u``, of any length; see `lobewise.lobes.directions.compute_tangent`.
    alpha_u, alpha_v : array, shape (height, width)
        Clamped to [0, 1].
    direction : array, shape (height, width, 3)
        Unit direction of the sample's ray, at shaded pixels; 0 without a ray.
    spread : float
        Alpha by which lobes are widened, > 0.
    most : float
        Largest ratio, > 0.
    """

    name = "ray"
    has_factor: ClassVar[bool] = True
    view: FloatArray
    normal: FloatArray
    tangent: FloatArray
    alpha_u: FloatArray
    alpha_v: FloatArray
    direction: FloatArray
    spread: float = LOBE_SPREAD
    most: float = MAX_RAY_WEIGHT

    @property
    def neutral(self) -> tuple[float, ...]:
        return 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0

    def prepare(self, inputs: Vector, parameters: Vector) -> RayPlanes:
        view, raw_normal, raw_tangent, *alphas, direction = self.split(inputs)
        normal, cosine = face_viewer(HALIDE, raw_normal, view)
        tangent, _ = compute_tangent(HALIDE, raw_tangent, normal)
        one = hl.f32(1.0)
        widening = square(parameters[0])
        inverses = [one / hl.sqrt(square(hl.clamp(alpha, hl.f32(0.0), one)) + widening) for alpha in alphas]
        size = inverses[0] * inverses[1] / hl.max(cosine, hl.f32(MIN_RAY_COSINE))
        u, v = scale(tangent, inverses[0]), scale(cross(normal, tangent), inverses[1])
        lobe = RayPlanes(view, u, v, normal, size, direction, one)
        known = dot(direction, direction) > hl.f32(0.5)
        return lobe._replace(inverse=hl.select(known, one / evaluate_ray_lobe(lobe, direction), hl.f32(NO_RAY)))

    def make_factor(self, i: RayPlanes, j: RayPlanes, parameters: Vector) -> hl.Expr:
        ratio = hl.min(evaluate_ray_lobe(i, j.direction) * j.inverse, parameters[1])
        return hl.select(j.inverse > hl.f32(0.0), ratio, hl.f32(1.0))

    def log2_similarity(self, i: RayPlanes, j: RayPlanes, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        return hl.f32(0.0)


def square(value: hl.Expr) -> hl.Expr:
    return value * value


def evaluate_ray_lobe(lobe: RayPlanes, direction: Vector) -> hl.Expr:
    """Return ``D(h) / (4 cos_v)`` times ``4 pi``, > 0."""
    half = [p + q for p, q in zip(direction, lobe.view, strict=True)]
    slopes = square(dot(half, lobe.u)) + square(dot(half, lobe.v)) + square(dot(half, lobe.normal))
    # A ray towards the camera's back has no half vector; its value is that of a grazing half vector.
    length = hl.max(dot(half, half), hl.f32(1e-6))
    return lobe.scale * square(length / hl.max(slopes, hl.f32(1e-9) * length))
