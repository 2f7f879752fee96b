"""How much of the noisy image is taken back: nothing by chance, what a filter blurs, more as samples grow."""

from dataclasses import replace

import numpy as np
import pytest

import lobewise
from lobewise.denoising import chain
from lobewise.denoising.automatic import ask, resolve_all
from lobewise.denoising.evidence import (
    estimate_share_lost,
    estimate_share_proved,
    takes_back,
)
from lobewise.filters.noise.evidence import estimate_noisy_share
from lobewise.metrics import rel_mse
from lobewise.records.frame import FloatArray, Frame, Radiance

SIZE = 96
FLOOR = 1e-4
FACING = lobewise.GBuffer(normal=np.float32([0.0, 0.0, 1.0]) * np.ones((SIZE, SIZE, 1), np.float32))
"""Guides that tell nothing."""


def draw_halves(truth: FloatArray, noise: float, rng: np.random.Generator) -> list[FloatArray]:
    """Return two halves of the samples, whose mean has the relative variance ``noise``; gamma noise is heavy-tailed."""
    shape = 0.5 / noise
    return [(truth * rng.gamma(shape, 1.0 / shape, truth.shape[:2])[..., None]).astype(np.float32) for _ in range(2)]


def make_texture() -> FloatArray:
    """Return stripes, light and dark every third pixel, in the left half of an image; the right half is even."""
    truth = np.full((SIZE, SIZE, 3), 1.0, np.float32)
    truth[:, : SIZE // 2 : 3] = 1.6
    return truth


def test_a_right_image_is_left_alone(rng: np.random.Generator) -> None:
    truth = np.full((SIZE, SIZE, 3), 0.7, np.float32)
    for noise in (4.0, 0.25, 0.01):
        a, b = draw_halves(truth, noise, rng)
        share = estimate_noisy_share(truth, 0.5 * (a + b), halves=(a, b), floor=FLOOR)
        # A mixture with the share s of an image of the variance v has the error s² v.
        assert np.square(share).mean() < 2e-3
        assert share.min() >= 0.0


def test_halves_prove_what_is_missing_without_a_network(rng: np.random.Generator) -> None:
    truth = make_texture()
    a, b = draw_halves(truth, 1e-3, rng)
    noisy, even = 0.5 * (a + b), np.full_like(truth, truth.mean())
    noisy[10, 20] = np.nan
    proved = estimate_share_proved(even, noisy, (a, b), level=1.0, shared=False)
    assert proved[8:-8, 8:40].mean() > 0.5
    assert proved[10, 20] == 0.0


def test_what_a_filter_blurs_is_taken_back(rng: np.random.Generator) -> None:
    truth = make_texture()
    blurred = np.where(np.arange(SIZE)[None, :, None] < SIZE // 2, truth[:, : SIZE // 2].mean(), truth)
    blurred = blurred.astype(np.float32)
    lost = float(np.square(blurred - truth)[:, :40].mean())
    shares = []
    for noise in (4.0 * lost, lost, 0.1 * lost, 0.01 * lost):
        a, b = draw_halves(truth, noise, rng)
        noisy = 0.5 * (a + b)
        share = estimate_noisy_share(blurred, noisy, halves=(a, b), floor=FLOOR)
        mixed = blurred + share[..., None] * (noisy - blurred)
        assert rel_mse(mixed, truth) < 1.02 * min(rel_mse(blurred, truth), 1.5 * rel_mse(noisy, truth))
        shares.append(float(share[8:-8, 8:40].mean()))
        assert np.square(share[:, 72:]).mean() < 2e-3
    assert shares == sorted(shares)
    assert shares[-1] > 0.9


def test_fireflies_are_no_evidence(rng: np.random.Generator) -> None:
    truth = np.full((SIZE, SIZE, 3), 0.7, np.float32)
    a, b = draw_halves(truth, 0.01, rng)
    for half in (a, b):
        half[tuple(rng.integers(0, SIZE, (2, 40)))] = 300.0
    share = estimate_noisy_share(truth, 0.5 * (a + b), halves=(a, b), floor=FLOOR)
    assert share.max() < 0.02


def test_bad_pixels_stay_out(rng: np.random.Generator) -> None:
    truth = make_texture()
    a, b = draw_halves(truth, 1e-4, rng)
    flat = np.full_like(truth, 1.2)
    whole = estimate_noisy_share(flat, 0.5 * (a + b), halves=(a, b), floor=FLOOR)
    for value in (np.nan, np.inf, -1.0):
        spoiled = a.copy()
        spoiled[10, 10], spoiled[50, 20] = value, value
        noisy = 0.5 * (spoiled + b)
        found = estimate_noisy_share(flat, noisy, halves=(spoiled, b), floor=FLOOR)
        assert np.isfinite(found).all()
        if value != -1.0:
            assert found[10, 10] == found[50, 20] == 0.0
        np.testing.assert_allclose(found[60:, 60:], whole[60:, 60:], rtol=1e-5)


@pytest.mark.parametrize("with_halves", [True, False])
@pytest.mark.parametrize("pattern", ["stripes", "checks", "tiles", "half"])
@pytest.mark.parametrize("quality", ["balanced", "high"])
def test_a_texture_that_no_guide_tells_comes_back(
    quality: str, pattern: str, with_halves: bool, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A filter alone has several times the error of its input; halves, or the order of the texture, bring it back.

    Half of an image of a strong texture comes out no worse than it went in.
    """
    rows, columns = np.mgrid[:SIZE, :SIZE]
    patterns = {
        "stripes": columns % 3 == 0,
        "checks": (columns // 2 + rows // 2) % 2 == 0,
        "tiles": ((columns + 1.5 * (rows // 3)) % 3 < 2) & (rows % 3 != 0),
    }
    truth = make_texture() if pattern == "half" else np.where(patterns[pattern], 1.2, 1.0)[..., None] * np.ones(3)
    truth = truth.astype(np.float32)
    a, b = draw_halves(truth, 1e-3, rng)
    halves = {"half_a": Radiance(a), "half_b": Radiance(b)} if with_halves else {}
    frame = Frame(Radiance(0.5 * (a + b)), FACING, **halves, spp=1024)
    noise = rel_mse(frame.radiance.color, truth)
    # Without halves the network of "high" softens tiles a little (docs/developers/quality.md, "Strengths and limits").
    most = 1.2 if (quality, pattern, with_halves) == ("high", "tiles", False) else 1.03 if pattern == "half" else 1.1
    assert rel_mse(lobewise.denoise(frame, quality=quality).image, truth) < most * noise
    if (quality, pattern) == ("high", "stripes") or pattern == "half":
        return  # the refining network keeps stripes itself
    monkeypatch.setattr(chain, "estimate_share_lost", lambda samples, *_, **__: np.zeros(samples.shape[:2], np.float32))
    assert rel_mse(lobewise.denoise(frame, quality=quality).image, truth) > 3.0 * noise


def test_error_along_an_edge_counts_there(rng: np.random.Generator) -> None:
    """A filter that is wrong in one column of pixels alone: more of that column is taken back."""
    truth = np.full((SIZE, SIZE, 3), 1.0, np.float32)
    blurred = truth.copy()
    blurred[:, 48] = 1.6
    a, b = draw_halves(truth, 0.01, rng)
    noisy = 0.5 * (a + b)
    share = estimate_noisy_share(blurred, noisy, halves=(a, b), floor=FLOOR)
    assert rel_mse(blurred + share[..., None] * (noisy - blurred), truth) < 0.5 * rel_mse(blurred, truth)
    assert share[:, 48].mean() > share[:, 45].mean() + 0.1


@pytest.mark.parametrize(
    ("halves", "with_oidn", "taken"),
    [(True, False, True), (True, True, False), (False, False, True), (False, True, True)],
)
def test_the_mixture_itself_takes_back_what_halves_prove(
    full_frame: Frame, halves: bool, with_oidn: bool, taken: bool
) -> None:
    frame = full_frame if halves else full_frame.with_changes(half_a=None, half_b=None)
    settings = replace(resolve_all(frame, ask(None, {"quality": "high"})), with_oidn=with_oidn)
    assert takes_back(frame, settings) == taken


@pytest.mark.parametrize(("spp", "trust"), [(None, 0.5), (4, 0.2), (16, 0.5), (1024, 0.985)])
def test_few_samples_without_halves_take_little_back(spp: int | None, trust: float, rng: np.random.Generator) -> None:
    truth = make_texture()
    noisy = draw_halves(truth, 1e-4, rng)[0]
    given = noisy, np.full_like(noisy, truth.mean()), 1.0
    share = estimate_share_lost(*given, halves=None, shared=False, spp=spp)
    all_of_it = estimate_share_lost(*given, halves=None, shared=False, spp=1 << 30)
    assert all_of_it.max() > 0.9
    np.testing.assert_allclose(share, trust * all_of_it, rtol=1e-2)
