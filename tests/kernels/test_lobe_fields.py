"""The lobe field's kernel against the field in NumPy, which has its own tests against the reference lobes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.errors import InputError, MissingChannelError
from lobewise.frame import GBuffer, LobeKind
from lobewise.guides.lobe_fields import make_lobe_field
from lobewise.lobes.field import LobeField, build_lobe_field

CAMERA = Camera(position=(0.5, -0.3, 5.0), forward=(-0.1, 0.05, -1.0), up=(0.0, 1.0, 0.1), fov_y=0.8, fov_x=0.9)
REPRESENTATIONS = ["sg", "ggx", "asg"]
STRANGE = np.float32([0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-30, 1e-42, 3.4e38])
# float32 in another order; at grazing views rays, normals and tangents are differences of what is nearly equal. Over
# 10^5 pixels of the garbage below: axes 9e-6, sharpness 6e-6, covariances over their trace 8e-6, determinants 4e-5.
AXIS, SHARPNESS, COVARIANCE, DETERMINANT = 3e-5, 2e-5, 3e-5, 1.5e-4

Guides = dict[str, NDArray[Any]]


def make_garbage(rng: np.random.Generator, size: tuple[int, int], number: int) -> Guides:
    """Return guides full of zeros, huge and tiny numbers, NaN and infinities; ``number`` says which ones there are."""

    def junk(*channels: int) -> NDArray[np.float32]:
        values = rng.normal(size=(*size, *channels)).astype(np.float32)
        where = rng.random(values.shape) < 0.15
        values[where] = rng.choice(STRANGE, where.sum())
        return values

    guides = {"normal": junk(3), "alpha_u": junk(), "tangent": junk(3)}
    guides["position" if number % 2 else "depth"] = junk(3) if number % 2 else np.abs(junk())
    if number % 3:
        guides["alpha_v"] = guides["alpha_u"] if number % 3 == 1 else junk()
    if number % 4:
        guides["lobe_kind"] = rng.choice([0.0, 1.0, 1.0, 2.0, 3.0, 7.0, np.nan], size)
    return guides


def make_both(guides: Guides, representation: str, fallback: bool = True, tau: float = 0.01) -> list[LobeField]:
    options: dict[str, Any] = {"tau": tau, "representation": representation, "diffuse_fallback": fallback}
    return [make(GBuffer(**guides), CAMERA, **options) for make in (make_lobe_field, build_lobe_field)]


def assert_near(field: LobeField, oracle: LobeField) -> None:
    np.testing.assert_array_equal(field.valid, oracle.valid)
    valid = oracle.valid
    for name, tolerance in (
        ("axis", AXIS),
        ("sharpness", SHARPNESS),
        ("tangent_axis", AXIS),
        ("covariance", COVARIANCE),
        ("determinant", DETERMINANT),
    ):
        given, expected = getattr(field, name), getattr(oracle, name)
        assert (given is None) == (expected is None), name
        if given is None:
            continue
        assert given.shape == expected.shape
        assert given.dtype == np.float32
        assert given.flags.c_contiguous
        np.testing.assert_array_equal(given[~valid], expected[~valid])
        scale = np.abs(expected[valid]) if name in ("sharpness", "determinant") else 1.0
        if name == "covariance":
            scale = expected[valid][:, [0, 3, 5]].sum(axis=-1, keepdims=True)
        assert (np.abs(given[valid] - expected[valid].astype(np.float64)) <= tolerance * scale).all(), name


@pytest.mark.parametrize("representation", REPRESENTATIONS)
def test_garbage(rng: np.random.Generator, representation: str) -> None:
    seen = 0
    for number in (0, 1, 2, 5, 7, 10):
        guides = make_garbage(rng, (31, 37), number)
        field, oracle = make_both(guides, representation, fallback=number % 5 > 0)
        assert_near(field, oracle)
        seen += int(field.valid.sum())
    assert seen > 1000


@pytest.mark.parametrize("representation", REPRESENTATIONS)
@pytest.mark.parametrize("number", [1, 2, 5])
def test_narrow_images(rng: np.random.Generator, representation: str, number: int) -> None:
    assert_near(*make_both(make_garbage(rng, (90, 7), number), representation))


def test_grazing_views_and_normals_that_face_away() -> None:
    # A row of normals that swings from the viewer to the opposite, of every roughness.
    width = 721
    rays = CAMERA.make_ray_directions(width, 1).astype(np.float64)
    side = np.cross(rays, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    angle = np.linspace(0.0, np.radians(150.0), width)[None, :, None]
    normal = np.repeat(-rays * np.cos(angle) + side * np.sin(angle), 5, axis=0)
    alpha = np.broadcast_to(np.array([0.0, 0.05, 0.3, 0.7, 1.0])[:, None], (5, width))
    guides = {"depth": np.full((5, width), 3.0), "normal": normal, "alpha_u": alpha}
    for kind in (LobeKind.GGX, LobeKind.BECKMANN):
        guides["lobe_kind"] = np.full((5, width), kind)
        for extra in ({}, {"alpha_v": alpha[::-1], "tangent": np.repeat(np.cross(rays, side), 5, axis=0)}):
            for representation in REPRESENTATIONS:
                field, oracle = make_both({**guides, **extra}, representation)
                assert field.valid.all()
                assert_near(field, oracle)


@pytest.mark.parametrize("representation", REPRESENTATIONS)
@pytest.mark.parametrize("tau", [1e-5, 1.0])
def test_the_ends_of_the_band_limit(rng: np.random.Generator, representation: str, tau: float) -> None:
    assert_near(*make_both(make_garbage(rng, (31, 37), 5), representation, tau=tau))


def test_a_crop_has_the_bits_of_the_whole(rng: np.random.Generator) -> None:
    guides = make_garbage(rng, (40, 61), 5)
    whole = make_both(guides, "ggx")[0]
    part = np.s_[3:29, 2:45]
    crop = make_both({name: image[part] for name, image in guides.items()}, "ggx")[0]
    for name in ("valid", "tangent_axis", "covariance", "determinant"):
        np.testing.assert_array_equal(getattr(crop, name), getattr(whole, name)[part])


def test_what_is_missing_is_told(rng: np.random.Generator) -> None:
    guides = make_garbage(rng, (4, 5), 5)
    del guides["tangent"]
    with pytest.raises(MissingChannelError, match="channel tangent"):
        make_both(guides, "ggx")
    assert_near(*make_both(guides, "sg"))
    with pytest.raises(InputError, match="tau: expected an angle from 1e-5 to 1 radian"):
        make_both(guides, "sg", tau=2.0)
