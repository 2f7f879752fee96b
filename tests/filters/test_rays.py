"""Samples that are weighed by the pixel's own lobe along their rays, against lobes in local frames."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.features import RayFeature, ScreenFeature
from lobewise.features.ray import LOBE_SPREAD, MAX_RAY_WEIGHT
from lobewise.filters.history.accumulation import SampleGrid, run_upsampling

SHAPE, SCALE, PLACE, RADIUS = (16, 24), 4, (1, 2), 2
ROWS, COLUMNS = 4, 6
SIGMA = 8.0
Array = NDArray[np.float64]


def normalize(vectors: Array) -> Array:
    """Return the vectors with length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def make_feature(seed: int, *, known: float = 1.0) -> RayFeature:
    """Return the rays of a rough, bumpy surface; each sample knows its ray with the probability ``known``."""
    rng = np.random.default_rng(seed)
    view = normalize(np.array([0.2, -0.1, 1.0]) + 0.05 * rng.normal(size=(*SHAPE, 3)))
    normal = normalize(np.array([0.0, 0.0, 1.0]) + 0.1 * rng.normal(size=(*SHAPE, 3)))
    tangent = normalize(np.array([1.0, 0.5, 0.0]) + 0.1 * rng.normal(size=(*SHAPE, 3)))
    u, v = rng.uniform(0.05, 0.5, SHAPE), rng.uniform(0.05, 0.5, SHAPE)
    mirror = 2.0 * (normal * view).sum(axis=-1, keepdims=True) * normal - view
    direction = normalize(mirror + 0.2 * rng.normal(size=(*SHAPE, 3)))
    direction[rng.random(SHAPE) >= known] = 0.0
    return RayFeature(*(each.astype(np.float32) for each in (view, normal, tangent, u, v, direction)))


def evaluate_ggx(feature: RayFeature, at: tuple[int, int], direction: Array) -> float:
    """Return ``D(h) / (4 cos_v)`` of a pixel by angles of the half vector in its local frame.

    Source: Walter et al. 2007, equation 33; Burley 2012 (two alphas).
    """
    view, normal, raw = (np.asarray(each[at], np.float64) for each in (feature.view, feature.normal, feature.tangent))
    tangent = normalize(raw - (raw @ normal) * normal)
    half = normalize(view + direction)
    x, y, z = half @ tangent, half @ np.cross(normal, tangent), half @ normal
    au, av = (np.sqrt(float(each[at]) ** 2 + LOBE_SPREAD**2) for each in (feature.alpha_u, feature.alpha_v))
    theta, phi = np.arccos(z), np.arctan2(y, x)
    slope = np.tan(theta) ** 2 * (np.cos(phi) ** 2 / au**2 + np.sin(phi) ** 2 / av**2)
    return float(1.0 / (np.pi * au * av * np.cos(theta) ** 4 * (1.0 + slope) ** 2) / (4.0 * (normal @ view)))


def upsample(light: Any, weights: Any, feature: RayFeature) -> Any:
    """Return the output of samples (rows, columns) without albedo."""
    image = np.repeat(np.asarray(light, np.float32)[..., None], 3, axis=-1)
    given = None if weights is None else np.asarray(weights, np.float32)
    features = [ScreenFeature(SIGMA), feature]
    options: dict[str, Any] = {"scale": SCALE, "place": PLACE, "radius": RADIUS, "weights": given}
    return run_upsampling(image, np.ones(SHAPE, bool), features, **options)


def compute_screen_weights() -> Array:
    """Return the weight of the screen's distance between samples and pixels, (samples, height, width)."""
    y, x = np.indices(SHAPE)
    rows, columns = (each.ravel()[:, None, None] for each in np.indices((ROWS, COLUMNS)))
    square = (y - SCALE * rows - PLACE[0]) ** 2 + (x - SCALE * columns - PLACE[1]) ** 2
    return np.asarray(np.exp(-0.5 * square / SIGMA**2))


def read_weights(feature: RayFeature) -> Array:
    """Return the weight of every sample for every pixel over the weight of the screen's distance."""
    found = np.zeros((ROWS * COLUMNS, *SHAPE))
    for number in range(ROWS * COLUMNS):
        impulse = np.zeros(ROWS * COLUMNS)
        impulse[number] = 1.0
        out = upsample(impulse.reshape(ROWS, COLUMNS), None, feature)
        found[number] = out.image[..., 0] * out.weight_sum
    return found / compute_screen_weights()


@pytest.mark.nightly
def test_weight_is_the_ratio_of_the_lobes_along_the_ray() -> None:
    feature = make_feature(0, known=0.8)
    weights = read_weights(feature)
    seen, bounded = 0, 0
    for number in range(ROWS * COLUMNS):
        row, column = divmod(number, COLUMNS)
        shaded = SCALE * row + PLACE[0], SCALE * column + PLACE[1]
        ray = np.asarray(feature.direction[shaded], np.float64)
        for at in np.ndindex(SHAPE):
            if max(abs(at[0] // SCALE - row), abs(at[1] // SCALE - column)) > RADIUS:
                assert weights[number][at] == 0.0
                continue
            expected = 1.0
            if ray.any():
                expected = min(evaluate_ggx(feature, at, ray) / evaluate_ggx(feature, shaded, ray), MAX_RAY_WEIGHT)
            assert weights[number][at] == pytest.approx(expected, rel=2e-4)
            seen, bounded = seen + 1, bounded + (expected == MAX_RAY_WEIGHT)
    assert seen > 1000
    assert 0 < bounded < 0.5 * seen


def test_own_ray_has_ratio_1() -> None:
    weights = read_weights(make_feature(1))
    for number in range(ROWS * COLUMNS):
        row, column = divmod(number, COLUMNS)
        assert weights[number][SCALE * row + PLACE[0], SCALE * column + PLACE[1]] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.nightly
def test_constant_environment_comes_out_whatever_the_rays_and_their_weights() -> None:
    weights = np.random.default_rng(2).choice([0.0, 0.3, 1.0, 7.0], (ROWS, COLUMNS))
    out = upsample(2.5 * weights, weights, make_feature(2))
    assert np.allclose(out.image, 2.5, rtol=1e-5)


def test_sample_counts_by_the_weight_of_its_ray() -> None:
    rng = np.random.default_rng(3)
    feature, light = make_feature(3), rng.uniform(0.1, 2.0, (ROWS, COLUMNS))
    weights = rng.choice([0.0, 0.5, 1.0, 4.0], (ROWS, COLUMNS))
    total = read_weights(feature) * compute_screen_weights() * weights.ravel()[:, None, None]
    out = upsample(weights * light, weights, feature)
    assert np.allclose(out.weight_sum, total.sum(axis=0), rtol=1e-3)
    assert np.allclose(out.image[..., 0], np.einsum("kyx,k->yx", total, light.ravel()) / total.sum(axis=0), rtol=1e-3)
    assert np.allclose(out.effective_samples, total.sum(axis=0) ** 2 / (total**2).sum(axis=0), rtol=2e-3)


def test_ray_of_weight_0_tells_nothing() -> None:
    weights = np.ones((ROWS, COLUMNS))
    weights[1, 2] = 0.0
    light = weights.copy()
    without = upsample(light, weights, make_feature(4)).image
    light[1, 2] = 100.0
    assert np.array_equal(upsample(light, weights, make_feature(4)).image, without)


def make_grid() -> SampleGrid:
    return SampleGrid(np.ones(SHAPE, bool), [ScreenFeature(SIGMA), make_feature(5)], scale=SCALE, place=PLACE)


@pytest.mark.nightly
def test_samples_of_chance_weights_confirm_a_history_of_the_light_along_rays() -> None:
    weights = np.random.default_rng(5).choice([0.0, 5.0], (ROWS, COLUMNS), p=[0.8, 0.2]).astype(np.float32)
    samples = np.repeat(weights[..., None], 3, axis=-1)
    history = np.zeros((*SHAPE, 7), np.float32)
    history[..., [0, 1, 2, 3, 5, 6]] = 4.0
    history[..., 4] = 4.0
    same = make_grid().compute_trust(samples, history, 1.0, weights)
    assert np.array_equal(same, np.ones((ROWS, COLUMNS)))
    history[..., :3] *= 2.0
    other = make_grid().compute_trust(samples, history, 1.0, weights)
    known = weights > 0.0
    assert known.sum() > 2
    assert (other[known] == 0.0).all()


def test_own_sample_without_noise_shows_the_light_along_its_ray() -> None:
    rng = np.random.default_rng(6)
    weights, light = rng.uniform(0.2, 3.0, (ROWS, COLUMNS)), rng.uniform(0.1, 2.0, (ROWS, COLUMNS))
    samples = np.repeat((weights * light)[..., None], 3, axis=-1).astype(np.float32)
    found = make_grid().accumulate(samples, radius=RADIUS, own=1e8, weights=weights.astype(np.float32))
    assert np.allclose(found.image[PLACE[0] :: SCALE, PLACE[1] :: SCALE, 0], light, rtol=1e-4)
