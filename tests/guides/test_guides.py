"""What guides say of surfaces, against the definitions in NumPy, strange numbers among them."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.guides.stand_ins import stand_in_normals
from lobewise.guides.surfaces import (
    compute_footprints,
    compute_inverse_hits,
    compute_points,
    compute_tolerances,
    mark_surface_pixels,
    put_backdrop,
)
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance

CAMERA = Camera(position=(0.5, -0.3, 5.0), forward=(-0.1, 0.05, -1.0), up=(0.0, 1.0, 0.1), fov_y=0.8, fov_x=0.9)
SIZE = (23, 41)
STRANGE = np.float32([0.0, -0.0, -1.0, np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-30, 1e-42, 3.4e38])
# Some operations in float32.
ROUNDING = 1e-6


@pytest.fixture
def junk(rng: np.random.Generator) -> dict[str, NDArray[np.float32]]:
    def make(*channels: int) -> NDArray[np.float32]:
        values = rng.uniform(0.1, 2.0, (*SIZE, *channels)).astype(np.float32)
        where = rng.random(values.shape) < 0.15
        values[where] = rng.choice(STRANGE, where.sum())
        return values

    return {"depth": make(), "position": make(3), "normal": make(3), "distance": make(), "u": make(), "v": make()}


@pytest.mark.parametrize("names", [("depth",), ("position",), ("normal",), ("depth", "position", "normal")], ids=str)
def test_surfaces(junk: dict[str, NDArray[np.float32]], names: tuple[str, ...]) -> None:
    expected = np.ones(SIZE, bool)
    with np.errstate(all="ignore"):
        if "depth" in names:
            expected &= np.isfinite(junk["depth"]) & (junk["depth"] > 0.0)
        if "position" in names:
            expected &= np.isfinite(junk["position"].sum(axis=-1))
        if "normal" in names:
            square = np.sum(junk["normal"] ** 2, axis=-1)
            expected &= np.isfinite(square) & (square > 0.01)
    assert 0.2 < expected.mean() < 0.9
    found = mark_surface_pixels(GBuffer(**{name: junk[name] for name in names}), SIZE)
    np.testing.assert_array_equal(found, expected)


def test_without_guides_everything_is_a_surface() -> None:
    assert mark_surface_pixels(GBuffer(), SIZE).all()


def test_places_from_depth_and_from_position(rng: np.random.Generator) -> None:
    depth = rng.uniform(0.0, 9.0, SIZE).astype(np.float32)
    depth[3, 4], depth[5, 6] = 0.0, np.nan
    rays = CAMERA.make_ray_directions(SIZE[1], SIZE[0]).astype(np.float64)
    expected = CAMERA.position + depth[..., None] * rays
    position, same = compute_points(GBuffer(depth=depth), CAMERA)
    np.testing.assert_allclose(position, expected, atol=ROUNDING * 9.0)
    np.testing.assert_array_equal(same, depth)
    given, distance = compute_points(GBuffer(position=expected), CAMERA)
    np.testing.assert_array_equal(given, expected.astype(np.float32))
    np.testing.assert_allclose(distance, depth, atol=ROUNDING * 9.0)


def test_inverse_hits(junk: dict[str, NDArray[np.float32]]) -> None:
    distance = junk["distance"]
    with np.errstate(all="ignore"):
        plain = np.where(distance > 0.0, 1.0 / distance, 0.0)
    plain[~np.isfinite(plain)] = 0.0
    np.testing.assert_allclose(compute_inverse_hits(distance), plain, rtol=ROUNDING)


def test_tolerances(junk: dict[str, NDArray[np.float32]]) -> None:
    u, v = junk["u"], junk["v"]
    u[0, :3], v[0, :3] = (0.5, 0.1, np.nan), (0.2, 0.4, 0.3)
    both = compute_tolerances(u, v, 0.1, 2.0)
    np.testing.assert_allclose(both[0, :3], [1.1, 0.9, 0.1], rtol=ROUNDING)
    known = np.isfinite(u) & np.isfinite(v) & (np.maximum(np.abs(u), np.abs(v)) < 1e30)
    np.testing.assert_allclose(both[known], 0.1 + 2.0 * np.maximum(np.maximum(u, v), 0.0)[known], rtol=ROUNDING)
    assert (both >= np.float32(0.1)).all()
    np.testing.assert_allclose(compute_tolerances(u, None, 0.1, 2.0)[0, :3], [1.1, 0.3, 0.1], rtol=ROUNDING)


def test_footprints(rng: np.random.Generator) -> None:
    depth, allowance = rng.uniform(1.0, 5.0, (2, *SIZE)).astype(np.float32)
    surface = rng.random(SIZE) < 0.5
    depth[~surface] = np.inf
    plain = compute_footprints(surface, depth, 0.02, None, 0.5)
    np.testing.assert_allclose(plain, np.where(surface, 0.02 * depth, 1.0), rtol=ROUNDING)
    wider = compute_footprints(surface, depth, 0.02, allowance, 0.5)
    np.testing.assert_allclose(wider, np.where(surface, plain * (1.0 + 0.5 * allowance), 1.0), rtol=ROUNDING)


def test_backdrop(rng: np.random.Generator) -> None:
    normal, position = rng.normal(size=(2, *SIZE, 3)).astype(np.float32)
    surface = rng.random(SIZE) < 0.5
    normal[~surface] = np.nan
    rays = CAMERA.make_ray_directions(SIZE[1], SIZE[0])
    there = surface[..., None]
    wall = put_backdrop(surface, normal, position, CAMERA, 1e4)
    np.testing.assert_allclose(wall.facing, np.where(there, normal, -rays), atol=ROUNDING)
    np.testing.assert_array_equal(wall.normal, np.where(there, normal, 0.0))
    away = CAMERA.position + 1e4 * rays
    np.testing.assert_allclose(wall.position, np.where(there, position, away), rtol=ROUNDING, atol=1e4 * ROUNDING)


def test_backdrop_without_a_camera() -> None:
    surface = np.zeros(SIZE, bool)
    wall = put_backdrop(surface, np.zeros((*SIZE, 3), np.float32), None, None, 1e4)
    assert wall.position is None
    np.testing.assert_array_equal(wall.facing, np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (*SIZE, 3)))


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["above", "below"])
@pytest.mark.parametrize("known", ["depth", "position"])
def test_normals_of_the_surface_through_places_are_on_the_side_of_the_camera(known: str, side: float) -> None:
    """A floor below the camera, or a ceiling above it, that the camera looks at aslant."""
    camera = Camera(position=(0.5, 2.0 * side, 5.0), forward=(-0.1, -0.6 * side, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.5)
    depth = (-camera.position[1] / camera.make_ray_directions(*SIZE[::-1])[..., 1]).astype(np.float32)
    places = {"depth": depth} if known == "depth" else {"position": camera.make_positions(depth)}
    filled, _ = stand_in_normals(Frame(Radiance(np.ones((*SIZE, 3))), GBuffer(**places), camera))
    expected = np.broadcast_to([0.0, side, 0.0], (*SIZE, 3))
    np.testing.assert_allclose(filled.gbuffer.normal, expected, atol=1e-3)
