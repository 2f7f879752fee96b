"""Random but plausible guides for the kernel tests: smooth normals, lobes of every width, real depth."""

import numpy as np
from numpy.typing import NDArray

from lobewise.features import (
    BandLimitFeature,
    DiffuseFeature,
    Feature,
    GgxFeature,
    GgxLobe,
    HitDistanceFeature,
    NormalFeature,
    PlaneFeature,
    PositionFeature,
    ScreenFeature,
    SgFeature,
    SgMixtureFeature,
    TentFeature,
)
from lobewise.records.frame import FloatArray

KINDS = [
    "screen",
    "tent",
    "position",
    "depth",
    "plane",
    "normal",
    "band_limit",
    "diffuse",
    "hit_distance",
    "sg",
    "ggx",
    "mixture",
    "coaxial",
]


def make_directions(rng: np.random.Generator, shape: tuple[int, int], spread: float) -> FloatArray:
    """Return unit vectors within about ``spread`` radians of a direction that is no axis."""
    vectors = rng.normal(size=(*shape, 3)) * spread + np.array([0.5, -0.3, 0.8])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), dtype=np.float32)


def make_ggx_lobe(rng: np.random.Generator, axis: FloatArray, low: float, high: float) -> GgxLobe:
    """Return covariances across ``axis`` with standard deviations in [low, high]."""
    z = axis.astype(np.float64)
    helper = np.where(np.abs(z[..., :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    x = np.cross(z, helper)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y = np.cross(z, x)
    turn = rng.uniform(0.0, np.pi, z.shape[:2])[..., None]
    e1, e2 = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    deviations = np.exp(rng.uniform(np.log(low), np.log(high), (2, *z.shape[:2])))
    small, large = np.sort(deviations**2, axis=0)
    t = np.sqrt(large - small)[..., None] * np.where((deviations[0] > deviations[1])[..., None], e1, e2)
    planes = (*np.moveaxis(z, -1, 0), *np.moveaxis(t, -1, 0), large, small)
    return GgxLobe(*(np.ascontiguousarray(plane, np.float32) for plane in planes))


def make_feature(kind: str, shape: tuple[int, int], *, beta: float = 4.0, seed: int = 5) -> Feature:
    """Return one feature of a random frame of ``shape``."""
    rng = np.random.default_rng([seed, *shape])
    depth = rng.uniform(3.9, 4.1, shape).astype(np.float32)
    place = (rng.uniform(-0.05, 0.05, (*shape, 3)) + np.array([1.0, 2.0, 3.0])).astype(np.float32)
    normal = make_directions(rng, shape, 0.15)
    sharpness = np.exp(rng.uniform(np.log(2.0), np.log(500.0), shape)).astype(np.float32)
    if kind == "screen":
        return ScreenFeature(3.0)
    if kind == "tent":
        return TentFeature(4.0)
    if kind == "position":
        return PositionFeature(place, depth, pixel_angle=0.002, sigma=9.0)
    if kind == "depth":
        return PositionFeature(depth, depth, pixel_angle=0.002, sigma=9.0)
    if kind == "plane":
        footprint = rng.uniform(0.006, 0.01, shape).astype(np.float32)
        return PlaneFeature(place, normal, footprint, 5.0)
    if kind == "normal":
        return NormalFeature(normal, 20.0)
    if kind == "band_limit":
        return BandLimitFeature(sharpness, pixel_angle=0.02, scale=1.0, largest_sigma=6.0)
    if kind == "diffuse":
        return DiffuseFeature(make_directions(rng, shape, 0.5), beta)
    # Some see nothing.
    inverse = rng.uniform(0.0, 4.0, shape).astype(np.float32)
    inverse[inverse < 1.0] = 0.0
    if kind == "hit_distance":
        return HitDistanceFeature(inverse, rng.uniform(0.2, 0.6, shape).astype(np.float32))
    if kind == "sg":
        return SgFeature(normal, sharpness, beta)
    if kind == "ggx":
        return GgxFeature(make_ggx_lobe(rng, normal, 0.08, 0.4), beta)
    if kind in ("mixture", "coaxial"):
        lobes = 3
        axes = [normal] if kind == "coaxial" else [make_directions(rng, shape, 0.15) for _ in range(lobes)]
        widths = np.exp(rng.uniform(np.log(2.0), np.log(300.0), (*shape, lobes))).astype(np.float32)
        amplitude = rng.uniform(0.1, 1.0, (*shape, lobes)).astype(np.float32)
        amplitude[..., 1:][rng.random((*shape, lobes - 1)) < 0.3] = 0.0  # pixels have different numbers of lobes
        return SgMixtureFeature(np.concatenate(axes, axis=-1), widths, amplitude, beta)
    raise ValueError(kind)


def make_radiance(shape: tuple[int, int], seed: int = 3) -> FloatArray:
    """Return positive noise (height, width, 3) with a long tail."""
    return np.random.default_rng([seed, *shape]).exponential(1.0, (*shape, 3)).astype(np.float32)


def make_mask(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return a mask in which every pixel counts."""
    return np.ones(shape, dtype=bool)
