"""From how far away a pixel can be told anything: every link of the chain, then the whole."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.denoising.automatic import ask, resolve_all
from lobewise.denoising.bad_pixels import mark_bad_pixels, refill
from lobewise.denoising.chain import Filtered, filter_rows
from lobewise.denoising.passes import DIFFUSE_PASSES, SPECULAR_PASSES, make_passes
from lobewise.denoising.plan import compute_steps_reach
from lobewise.denoising.refining.whole_image import WholeImage
from lobewise.features import ScreenFeature
from lobewise.filters import compositing, fireflies, highlights, noise_guides, specks
from lobewise.filters.compositing import composite_light
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.dual_buffer import PassRequest, filter_dual_buffer
from lobewise.filters.fireflies import bound_fireflies
from lobewise.filters.forms import ATROUS_REACH
from lobewise.filters.highlights import split_highlights
from lobewise.filters.noise import evidence
from lobewise.filters.noise.evidence import estimate_noisy_share
from lobewise.filters.noise_guides import make_noise_guide
from lobewise.filters.specks import choose_sharing
from lobewise.records.frame import FloatArray, Frame
from tests.streaming.frames import change_radiance, make_scene

pytestmark = pytest.mark.nightly  # every quality and form, whole and in bands

WIDE: dict[str, Any] = {"similarity": "normal", "normal_exponent": 1.0, "position_sigma": 1e4}
"""Weights that fall off so slowly that the kernel's edge counts."""
HEIGHT, WIDTH, MIDDLE = 61, 9, 30


def draw(seed: int, low: float = 0.5, high: float = 1.5) -> FloatArray:
    """Return a noisy image."""
    return np.random.default_rng(seed).uniform(low, high, (HEIGHT, WIDTH, 3)).astype(np.float32)


def alter(image: FloatArray, value: float = 9.0) -> FloatArray:
    """Return an image with another row in its middle."""
    changed = image.copy()
    changed[MIDDLE] = value
    return changed


def measure(before: FloatArray, after: FloatArray) -> int:
    """Return how many rows away from the middle two images differ at most."""
    different = np.flatnonzero((before != after).reshape(len(before), -1).any(axis=1))
    return int(np.abs(different - len(before) // 2).max())


def test_fireflies_see_their_window() -> None:
    reach = fireflies.FIREFLY_REACH
    image = np.random.default_rng(1).uniform(0.5, 1.5, (HEIGHT, 4 * reach, 3)).astype(np.float32)
    # Alone in their windows, but for what comes into the middle row: those just near enough, and those just not.
    for distance, column in ((reach, 3), (reach + 1, 3 * reach)):
        image[[MIDDLE - distance, MIDDLE + distance], column] = 100.0
    dim, mask = np.full_like(image, 0.01), np.ones(image.shape[:2], bool)
    before, after = (bound_fireflies((each, dim), None, mask).a for each in (image, alter(image, 30.0)))
    assert measure(before, after) == reach


def test_highlights_see_their_surroundings_and_what_is_beside_them() -> None:
    reach = highlights.HIGHLIGHT_REACH
    image = np.full((HEIGHT, 4 * reach, 3), 1.0, np.float32)
    for distance, column in ((reach - 1, 4), (reach, 3 * reach)):
        # Three pixels of a block, two of which see the middle row or just not; what is beside one is further away.
        image[MIDDLE + distance, column : column + 2] = image[MIDDLE + distance + 1, column] = 30.0
        image[MIDDLE + distance + 1, column + 2] = 4.0
    mask = np.ones(image.shape[:2], bool)
    before, after = (split_highlights((each, each), None, mask).a for each in (image, alter(image, 60.0)))
    assert measure(before, after) == reach


def test_specks_are_shared_out_no_further() -> None:
    def share(light: np.ndarray, blur: np.ndarray, spp: int) -> np.ndarray:
        return choose_sharing(light, blur, spp).apply(light)

    light, blur = draw(4, 0.0, 3.0), np.full((HEIGHT, WIDTH), 100.0, np.float32)
    before, after = (share(each, blur, 1) for each in (light, alter(light, 60.0)))
    assert specks.MAX_TURNS <= measure(before, after) <= specks.SPECK_REACH
    # The bright row in the middle tells whether the dark rows below it share with the bright rows below them.
    light[:] = 0.0
    light[MIDDLE], light[MIDDLE + specks.VIEW_RADIUS + 1 :] = 1.0, 1.0
    before, after = (share(each, blur, 1) for each in (light, alter(light, 0.0)))
    assert specks.MAX_TURNS + specks.VIEW_RADIUS <= measure(before, after) <= specks.SPECK_REACH
    assert compute_steps_reach(resolve_all(make_scene((8, 8)), ask(None, {}))) > specks.SPECK_REACH


def test_guides_blur_their_variance() -> None:
    a, b = draw(2), draw(3)
    assert measure(make_noise_guide(a, b, 1.0), make_noise_guide(alter(a), b, 1.0)) == noise_guides.BLUR_RADIUS


@pytest.mark.parametrize("radius", [0, 3, 8])
def test_passes_reach_their_last_tap(radius: int) -> None:
    a, b, mask = draw(2), draw(3), np.ones((HEIGHT, WIDTH), bool)
    request = PassRequest(halves=(a, b), mask=mask, place=[ScreenFeature(50.0)], radius=radius)
    changed = replace(request, halves=(alter(a), b))
    before, after = (filter_dual_buffer(each).a for each in (request, changed))
    assert measure(before, after) == radius


def test_coverage_reaches_the_neighbours() -> None:
    light, lit = draw(1), np.ones((HEIGHT, WIDTH), bool)
    shares = np.full((HEIGHT, WIDTH, 9), 1.0 / 9.0, np.float32)
    before, after = (composite_light([image], lit, draw(2), draw(3), shares) for image in (light, alter(light)))
    assert measure(before, after) == compositing.COVERAGE_REACH


def test_levels_reach_twice_as_far_as_the_ones_before() -> None:
    size = (2 * ATROUS_REACH + 7, 5)
    image = np.random.default_rng(1).uniform(0.5, 1.5, (*size, 3)).astype(np.float32)
    changed = image.copy()
    changed[size[0] // 2] = 1e4
    everywhere = np.ones(size, bool)
    before, after = (run_filter(each, everywhere, (), form="atrous", radius=0).image for each in (image, changed))
    assert measure(before, after) == ATROUS_REACH


def test_holes_are_filled_from_near() -> None:
    size = (2 * ATROUS_REACH + 41, 3)
    image, holes = np.ones((*size, 3), np.float32), np.ones(size, bool)
    middle = size[0] // 2
    holes[middle] = False
    mean = np.full(3, 7.0, np.float32)
    bright = image.copy()
    bright[middle] = 2.0
    before, after = (refill(each, holes, mean) for each in (image, bright))
    found = measure(before, after)
    # The furthest weights are 0.
    assert 8 < found <= ATROUS_REACH
    far = np.abs(np.arange(size[0]) - middle) > found
    np.testing.assert_array_equal(after[far], np.broadcast_to(mean, after[far].shape))


@pytest.mark.parametrize(
    ("form", "radius", "expected"), [("full", 8, 8), ("full", 0, 0), ("separable", 5, 5), ("atrous", 8, ATROUS_REACH)]
)
def test_fast_reaches_exactly_so_far(form: str, radius: int, expected: int) -> None:
    settings = {"quality": "fast", "form": form, "radius": radius, **WIDE}
    assert expected == measure_reach(settings, find=True)


@pytest.mark.parametrize("halves", [True, False], ids=["halves", "checkerboard"])
@pytest.mark.parametrize(("quality", "radius"), [("balanced", 8), ("balanced", 3), ("high", 4)])
def test_nothing_further_away_tells_on_a_pixel(quality: str, radius: int, halves: bool) -> None:
    settings = {"quality": quality, "radius": radius, "screen_sigma": 400.0, **WIDE}
    reach = measure_reach(settings, find=True)
    found = measure_reach(settings, halves=halves)
    # Blurs' and windows' edges together are less than the rounding of what they change.
    kernels = (4 + 5) * radius // 8
    assert kernels <= found <= reach


def measure_reach(settings: dict[str, Any], *, halves: bool = True, find: bool = False) -> int:
    """Return how far away the output differs where one row of samples does; or how far it is said to."""
    frame = make_scene((241, 9), halves=halves)
    chosen = resolve_all(frame, ask(None, settings))
    if find and chosen.quality != "fast":
        return compute_steps_reach(chosen)
    whole = WholeImage(levels=(0.5, 0.5), brightness=0.5, mean_log_depth=0.0, tau=0.01)

    def run(given: Frame) -> Filtered:
        return filter_rows(given, chosen, (), mark_bad_pixels(given), whole=whole)

    before = run(frame)
    found = 0
    for factor in (0.0, 1e3):
        brighter = change_radiance(frame, [120], slice(None), lambda old, factor=factor: old * np.float32(factor))
        found = max(found, measure(before.image, run(brighter).image))
    if find:
        assert found == compute_steps_reach(chosen)
    return found


@pytest.mark.parametrize(("quality", "expected"), [("balanced", 66), ("high", 250)])
def test_the_reach_is_the_sum_of_the_links(quality: str, expected: int) -> None:
    frame = make_scene((8, 8))
    chosen = resolve_all(frame, ask(None, {"quality": quality}))
    # Fireflies, highlights, residuals, the lobes beside a pixel's; kernels each behind a blurred guide: pilot and
    # wide ones; coverage; the refining network, and the edges that it sees; detail: local light, products two
    # pixels apart, four blurs.
    kernels, blur = (4, 5), 3
    refinement = {"balanced": 0, "high": 182 + 2}[quality]
    doubt = 2 + 2 + 2 * (1 + 2 + 4 + 8)
    assert (
        compute_steps_reach(chosen)
        == 6 + 7 + 2 + 1 + sum(kernels) + blur * len(kernels) + 1 + refinement + doubt
        == expected
    )


def test_evidence_reaches_its_widest_neighbourhood() -> None:
    filtered, a, b = (np.random.default_rng(k).uniform(1.0, 2.0, (121, WIDTH, 3)).astype(np.float32) for k in range(3))
    # Far from what was filtered, so that there is a share everywhere.
    noisy = filtered + np.float32(3.0) + 0.5 * (a - b)
    changed = filtered.copy()
    changed[60] += 1.0
    given = {"halves": (noisy + a - b, noisy + b - a)}
    before, after = (estimate_noisy_share(each, noisy, floor=1e-4, **given)[..., None] for each in (filtered, changed))
    assert measure(before, after) == evidence.EVIDENCE_REACH


def test_passes_grow_with_the_radius() -> None:
    for is_diffuse, passes in ((True, DIFFUSE_PASSES), (False, SPECULAR_PASSES)):
        for radius in (0, 1, 8, 16, 64):
            scaled = make_passes(radius, is_diffuse=is_diffuse)
            assert [each.radius for each in scaled] == [round(each.radius * radius / 8) for each in passes]
