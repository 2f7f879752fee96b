"""The similarities a second time: NumPy, float64, from the definition of each feature and not from its planes."""

import math
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from lobewise.features import (
    BandLimitFeature,
    DiffuseFeature,
    Feature,
    GgxFeature,
    HitDistanceFeature,
    NormalFeature,
    PlaneFeature,
    PositionFeature,
    ScreenFeature,
    SgFeature,
    SgMixtureFeature,
    TentFeature,
)
from tests.lobes.oracles import mixture, sg, tangent

FloatImage = NDArray[np.float64]
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Rows and columns of some pixels, two arrays of one shape."""


@singledispatch
def get_similarity(feature: Feature, i: Pixels, j: Pixels) -> FloatImage:
    """Return the similarity of pixels i and j to the power beta."""
    raise TypeError(f"{type(feature).__name__} has no oracle: register one in {__name__}")


def take(array: NDArray[np.float32], *pixels: Pixels) -> list[FloatImage]:
    """Return the values of an array at each of these lists of pixels."""
    return [array[each].astype(np.float64) for each in pixels]


def get_screen_distance_squared(i: Pixels, j: Pixels) -> FloatImage:
    """Return the squared distance on the screen, pixels^2."""
    return np.asarray(sum((p - q).astype(np.float64) ** 2 for p, q in zip(i, j, strict=True)))


def join_covariance(feature: GgxFeature, pixels: Pixels) -> tangent.TangentLobe:
    """Return the lobes of some pixels with the six numbers of their covariances."""
    planes = [take(plane, pixels)[0] for plane in feature.lobe]
    axis, t, (large, small) = np.stack(planes[:3], -1), np.stack(planes[3:6], -1), planes[6:]
    across = np.eye(3) - axis[..., :, None] * axis[..., None, :]
    matrix = small[..., None, None] * across + t[..., :, None] * t[..., None, :]
    rows, columns = np.triu_indices(3)
    return tangent.TangentLobe(axis, matrix[..., rows, columns], large * small)


@get_similarity.register
def _(feature: ScreenFeature, i: Pixels, j: Pixels) -> FloatImage:
    return np.exp(-get_screen_distance_squared(i, j) / (2.0 * feature.sigma**2))


@get_similarity.register
def _(feature: TentFeature, i: Pixels, j: Pixels) -> FloatImage:
    down, right = (
        np.maximum(1.0 - np.abs(p.astype(np.float64) - q) / feature.width, 0.0) for p, q in zip(i, j, strict=True)
    )
    return np.asarray(down * right)


@get_similarity.register
def _(feature: PositionFeature, i: Pixels, j: Pixels) -> FloatImage:
    p, q = take(feature.place, i, j)
    squared = np.sum((q - p) ** 2, axis=-1) if feature.place.ndim == 3 else (q - p) ** 2
    footprints = math.prod(take(feature.depth, i, j)) * feature.pixel_angle**2
    return np.asarray(np.exp(-squared / (2.0 * feature.sigma**2 * footprints)))


@get_similarity.register
def _(feature: PlaneFeature, i: Pixels, j: Pixels) -> FloatImage:
    p, q = take(feature.position, i, j)
    squared = sum(np.sum(normal * (q - p), axis=-1) ** 2 for normal in take(feature.normal, i, j))
    return np.asarray(np.exp(-squared / (4.0 * feature.sigma**2 * math.prod(take(feature.footprint, i, j)))))


@get_similarity.register
def _(feature: NormalFeature, i: Pixels, j: Pixels) -> FloatImage:
    cosine = np.sum(math.prod(take(feature.normal, i, j)), axis=-1)
    return np.asarray(np.exp(-feature.exponent * (1.0 - cosine)))


@get_similarity.register
def _(feature: BandLimitFeature, i: Pixels, j: Pixels) -> FloatImage:
    sigmas = (feature.scale / (np.sqrt(each) * feature.pixel_angle) for each in take(feature.sharpness, i, j))
    precision = sum(1.0 / np.minimum(sigma, feature.largest_sigma) ** 2 for sigma in sigmas)
    return np.asarray(np.exp(-0.25 * get_screen_distance_squared(i, j) * precision))


@get_similarity.register
def _(feature: DiffuseFeature, i: Pixels, j: Pixels) -> FloatImage:
    cosine = np.sum(math.prod(take(feature.normal, i, j)), axis=-1)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    overlap = ((math.pi - angle) * np.cos(angle) + np.sin(angle)) / math.pi
    return np.asarray(np.maximum(overlap, 0.0) ** feature.beta)


@get_similarity.register
def _(feature: HitDistanceFeature, i: Pixels, j: Pixels) -> FloatImage:
    p, q = take(feature.inverse_distance, i, j)
    change = (p - q) / np.maximum(np.maximum(p, q), 1e-12)
    return np.asarray(np.exp(-(change**2) / (2.0 * math.prod(take(feature.tolerance, i, j)))))


@get_similarity.register
def _(feature: SgFeature, i: Pixels, j: Pixels) -> FloatImage:
    (axis_i, axis_j), (sharp_i, sharp_j) = take(feature.axis, i, j), take(feature.sharpness, i, j)
    return np.asarray(sg.sg_slide_similarity(axis_i, sharp_i, axis_j, sharp_j, beta=feature.beta))


@get_similarity.register
def _(feature: SgMixtureFeature, i: Pixels, j: Pixels) -> FloatImage:
    lobes = (
        mixture.SgMixture(axis.reshape(*axis.shape[:-1], -1, 3), sharpness, amplitude)
        for axis, sharpness, amplitude in zip(
            *(take(array, i, j) for array in (feature.axis, feature.sharpness, feature.amplitude)), strict=True
        )
    )
    return np.asarray(mixture.mixture_approx_similarity(*lobes, feature.beta))


@get_similarity.register
def _(feature: GgxFeature, i: Pixels, j: Pixels) -> FloatImage:
    lobes = (join_covariance(feature, pixels) for pixels in (i, j))
    return np.asarray(tangent.tangent_approx_similarity(*lobes, feature.beta))
