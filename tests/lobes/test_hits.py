"""The hit-distance term: laws, the flat mirror, and the true similarity of two footprints on a plane."""

import numpy as np
import pytest

from lobewise.fitting import ggx
from lobewise.fitting.arrays import normalize

from .oracles import brdf
from .oracles.hits import compute_hit_shift
from .oracles.sg import sg_slide_similarity
from .oracles.tangent import make_tangent_lobe, tangent_approx_similarity
from .quadrature import gauss

Z = np.array([0.0, 0.0, 1.0])


def test_is_antisymmetric_and_across_the_lobes():
    rng = np.random.default_rng(0)
    axis = normalize(rng.normal(size=(2, 50, 3)))
    position = rng.normal(size=(2, 50, 3))
    inverse = rng.uniform(0.0, 2.0, (2, 50))
    there = compute_hit_shift(axis[0], axis[1], position[0], position[1], inverse[0], inverse[1])
    back = compute_hit_shift(axis[1], axis[0], position[1], position[0], inverse[1], inverse[0])
    np.testing.assert_allclose(there, -back, atol=1e-14)
    np.testing.assert_allclose(np.sum(there * (axis[0] + axis[1]), axis=-1), 0.0, atol=1e-13)


def test_nothing_seen_changes_nothing():
    shift = compute_hit_shift(Z, normalize(np.array([0.1, 0.0, 1.0])), Z, -Z, 0.0, 0.0)
    assert not shift.any()
    assert compute_hit_shift(Z, -Z, Z, -Z, 1.0, 1.0).shape == (3,)  # opposite axes have no middle


@pytest.mark.parametrize("distance", [0.5, 3.0, 50.0])
def test_mirror_shows_the_virtual_image(distance):
    # a mirror seen straight from height D: a step p turns the reflection by p / D and moves the footprint (D + t) p / D
    depth, step = 4.0, 1e-3
    points = np.array([[0.0, 0.0, 0.0], [step, 0.0, 0.0]])
    view = normalize(np.array([0.0, 0.0, depth]) - points)
    axis = brdf.reflect(view, np.broadcast_to(Z, view.shape))
    shift = compute_hit_shift(axis[0], axis[1], points[0], points[1], 1.0 / distance, 1.0 / distance)
    apart = np.linalg.norm(axis[1] - axis[0] + shift)
    assert apart == pytest.approx(step / depth * (depth + distance) / distance, rel=1e-5)


@pytest.mark.parametrize("alpha", [0.05, 0.1])
@pytest.mark.parametrize("height", [0.5, 3.0, 100.0])
def test_similarity_of_footprints_on_a_plane(alpha, height):
    # two points of a floor see a ceiling at ``height``; truth: L2 similarity of what they gather there, by area
    depth, cosine = 3.0, 0.8
    eye = depth * np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
    width = 2.0 * alpha * cosine * depth * height / (depth + height)  # a footprint, on the floor
    points = np.array([[0.0, 0.0, 0.0], [0.0, width, 0.0]])
    view = normalize(eye - points)
    lobes = [make_tangent_lobe(v, Z, alpha) for v in view]
    inverse = [lobe.axis[2] / height for lobe in lobes]
    shift = compute_hit_shift(lobes[0].axis, lobes[1].axis, points[0], points[1], *inverse)
    value = tangent_approx_similarity(*lobes, shift=shift)

    # polar nodes on the ceiling about the middle of both footprints
    hits = [p + lobe.axis * (height / lobe.axis[2]) for p, lobe in zip(points, lobes, strict=True)]
    middle = np.mean(hits, axis=0)
    t, w = gauss(160)
    phi = 2.0 * np.pi * (np.arange(128) + 0.5) / 128
    scale = 4.0 * alpha * height
    r, dr = scale * t / (1.0 - t), scale / (1.0 - t) ** 2 * w
    target = middle + r[:, None, None] * np.stack([np.cos(phi), np.sin(phi), 0.0 * phi], axis=-1)
    area = (r * dr)[:, None] * np.full(128, 2.0 * np.pi / 128)
    gathered = []
    for point, v in zip(points, view, strict=True):
        to = target - point
        square = np.sum(to * to, axis=-1)
        light = to / np.sqrt(square)[..., None]
        gathered.append(ggx.ggx_brdf(v, light, alpha) * light[..., 2] * light[..., 2] / square)
    pairs = (gathered[0], gathered[1]), (gathered[0], gathered[0]), (gathered[1], gathered[1])
    products = [np.sum(a * b * area) for a, b in pairs]
    truth = products[0] / np.sqrt(products[1] * products[2])
    assert 0.3 < truth < 0.95
    assert value == pytest.approx(truth, abs=0.03)
    if height < 1.0:
        assert tangent_approx_similarity(*lobes) > truth + 0.1  # what directions alone would say


def test_slide_similarity_takes_the_shift():
    value = sg_slide_similarity(Z, 100.0, Z, 100.0, shift=np.array([0.1, 0.0, 0.0]))
    assert value == pytest.approx(np.exp(-50.0 * 0.5 * 0.01))
