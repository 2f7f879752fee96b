"""Sparse rendering: the shaded pixels have the bits of the whole frame."""

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.render import load_scene, render_frame, render_pixels, render_sparse_frame
from tests.mistakes import refuses

pytestmark = pytest.mark.mitsuba


@pytest.fixture(scope="module")
def scene():
    return load_scene("showroom", width=37, height=29)


@pytest.fixture(scope="module")
def whole(scene):
    return render_frame(scene, spp=2, seed=3)


@pytest.mark.sampled("4-place0")
@pytest.mark.parametrize(("scale", "place"), [(4, (1, 2)), (3, (0, 0))])
def test_radiance_is_that_of_the_whole_frame(scene, whole, scale, place):
    sparse = render_sparse_frame(scene, spp=2, scale=scale, place=place, guide_spp=2, seed=3)
    assert sparse.shape == whole.shape
    for part in ("radiance", "variance"):
        for name in ("color", "diffuse", "specular"):
            expected = getattr(getattr(whole, part), name)[sparse.shaded]
            np.testing.assert_array_equal(getattr(getattr(sparse, part), name), expected)
    for name in ("normal", "depth", "alpha_u", "lobe_kind"):
        np.testing.assert_array_equal(getattr(sparse.gbuffer, name), getattr(whole.gbuffer, name))
    assert (sparse.scale, sparse.place, sparse.spp) == (scale, place, 2)


def test_progress_counts_shaded_samples(scene):
    seen = []
    render_sparse_frame(scene, spp=1, scale=8, guide_spp=1, progress=lambda done, total: seen.append((done, total)))
    assert seen[0] == (0, 5 * 4)
    assert seen[-1] == (5 * 4, 5 * 4)


@pytest.mark.parametrize(("change", "what"), [({"scale": 0}, "scale"), ({"place": (4, 0)}, "place[0]")])
def test_numbers_are_checked(scene, change, what):
    with refuses(InputError, what):
        render_sparse_frame(scene, **{"spp": 1, "scale": 4, **change})


def test_single_pixels_have_the_bits_of_the_whole_frame(scene, whole):
    rows, columns = np.array([0, 28, 13, 13]), np.array([36, 0, 5, 5])
    some = render_pixels(scene, rows, columns, spp=2, seed=3)
    for name in ("color", "diffuse", "specular", "direct", "indirect"):
        np.testing.assert_array_equal(getattr(some, name)[:, 0], getattr(whole.radiance, name)[rows, columns])


def test_parts_of_single_pixels_are_independent(scene, whole):
    rows, columns = np.array([0, 28, 13, 5]), np.array([36, 0, 5, 7])
    parts = render_pixels(scene, rows, columns, spp=8, seed=3, parts=4)
    assert parts.color.shape == (4, 4, 3)
    assert parts.diffuse.shape == (4, 4, 3)
    for name in ("color", "diffuse", "specular", "direct", "indirect"):
        np.testing.assert_array_equal(getattr(parts, name)[:, 0], getattr(whole.radiance, name)[rows, columns])
    luminance = parts.color.sum(axis=-1)
    assert len(np.unique(luminance)) == luminance.size


@pytest.mark.parametrize("parts", [0, 3, 9])
def test_parts_divide_the_samples(scene, parts):
    with refuses(InputError, "parts", expected="a divisor of 8 spp"):
        render_pixels(scene, [0], [0], spp=8, parts=parts)


@pytest.mark.parametrize(("rows", "columns"), [([29], [0]), ([0], [-1]), ([], []), ([1, 2], [1]), ([0.5], [1.0])])
def test_pixels_outside_are_refused(scene, rows, columns):
    with refuses(InputError, "rows and columns"):
        render_pixels(scene, rows, columns, spp=1)
