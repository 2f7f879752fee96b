"""The quadrature itself: grids of different shape and size must give equal integrals, and known ones."""

import numpy as np
import pytest

from .quadrature import Surface, draw_pairs, measure_similarity, normalize, rotate, sphere_grid
from .tolerances import QUADRATURE, SIMILARITY


@pytest.mark.parametrize("width", [0.02, 0.3, 2.0])
def test_grid_covers_the_sphere_once(rng, width):
    axis = normalize(rng.normal(size=3))
    directions, weights = sphere_grid(axis, width, radial=400)
    assert np.sum(weights) == pytest.approx(4.0 * np.pi, rel=1e-6)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, rtol=0.0, atol=1e-12)
    # moments of degree 1 and 2: the centre of the sphere and isotropy
    np.testing.assert_allclose(weights @ directions, 0.0, atol=1e-5)
    np.testing.assert_allclose((directions.T * weights) @ directions, np.eye(3) * 4.0 * np.pi / 3.0, atol=1e-5)


def test_stretched_grid_integrates_the_same(rng):
    axis, other = normalize(rng.normal(size=(2, 3)))
    stretch = np.eye(3) - np.outer(axis, axis)
    stretch = rotate(axis, 0.4) @ np.diag([1.0, 0.3, 0.7]) @ stretch
    stretch = stretch - np.outer(axis, axis @ stretch)

    def integrate(directions, weights):
        return np.sum(weights * (directions @ other) ** 2 * np.exp(20.0 * (directions @ axis - 1.0)))

    plain = integrate(*sphere_grid(axis, 0.5))
    assert integrate(*sphere_grid(axis, 2.0, 200, 256, stretch)) == pytest.approx(plain, rel=QUADRATURE)


@pytest.mark.parametrize("anisotropy", ["none", "two"])
def test_similarity_does_not_depend_on_the_grid(anisotropy):
    for i, j in draw_pairs(10, anisotropy=anisotropy, seed=1):
        assert measure_similarity(i, j) == pytest.approx(measure_similarity(i, j, 160, 192), abs=SIMILARITY)


def test_similarity_agrees_with_a_plain_latitude_longitude_grid():
    view = normalize(np.array([0.6, 0.2, 0.7]))
    turn = rotate(np.array([0.0, 1.0, 0.0]), 0.2)
    i = Surface(np.eye(3), view, 0.4, 0.4)
    j = Surface(turn.T, view, 0.5, 0.3)
    theta = np.pi * (np.arange(400) + 0.5) / 400
    phi = 2.0 * np.pi * (np.arange(800) + 0.5) / 800
    sine = np.sin(theta)[:, None]
    directions = np.stack(
        [sine * np.cos(phi), sine * np.sin(phi), np.broadcast_to(np.cos(theta)[:, None], (400, 800))], axis=-1
    ).reshape(-1, 3)
    weights = np.repeat(np.sin(theta), 800)
    f, g = i.evaluate(directions), j.evaluate(directions)
    plain = np.sum(weights * f * g) / np.sqrt(np.sum(weights * f * f) * np.sum(weights * g * g))
    assert measure_similarity(i, j) == pytest.approx(plain, abs=SIMILARITY)


def test_similarity_of_a_lobe_with_itself_is_one():
    for i, _ in draw_pairs(3, seed=2):
        assert measure_similarity(i, i) == pytest.approx(1.0, abs=1e-12)
