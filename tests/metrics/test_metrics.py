"""Every metric against a second definition, written as a plain loop or taken from another library."""

import math
import sys
import tracemalloc

import numpy as np
import pytest

from lobewise import metrics
from lobewise.errors import InputError, MissingChannelError, MissingDependencyError
from lobewise.records.frame import GBuffer
from tests.mistakes import refuses

NUMBERS = ("mse", "rel_mse", "smape", "psnr")


@pytest.fixture
def pair(rng):
    reference = rng.gamma(0.5, 1.0, (6, 5, 3))
    reference[0, 0] = 0.0
    return reference + rng.normal(0.0, 0.2, reference.shape), reference


def loop(pair, mask, term):
    """Return the mean of ``term(a, r)`` over chosen pixels and channels, one number at a time."""
    terms = [
        term(float(a), float(r))
        for y, x in np.ndindex(mask.shape)
        if mask[y, x]
        for a, r in zip(pair[0][y, x], pair[1][y, x], strict=True)
    ]
    return math.fsum(terms) / len(terms)


@pytest.mark.parametrize("masked", [False, True])
def test_numbers_agree_with_loops(pair, masked, rng):
    mask = rng.random((6, 5)) < 0.4 if masked else np.ones((6, 5), dtype=bool)
    given = (mask,) if masked else ()
    square = loop(pair, mask, lambda a, r: (a - r) * (a - r))
    assert metrics.mse(*pair, *given) == pytest.approx(square, rel=1e-12)
    relative = loop(pair, mask, lambda a, r: (a - r) * (a - r) / (r * r + 0.01))
    assert metrics.rel_mse(*pair, *given) == pytest.approx(relative, rel=1e-12)
    symmetric = loop(pair, mask, lambda a, r: abs(a - r) / (abs(a) + abs(r) + 0.01))
    assert metrics.smape(*pair, *given) == pytest.approx(symmetric, rel=1e-12)
    assert metrics.psnr(*pair, *given) == pytest.approx(-10.0 * math.log(square, 10.0), rel=1e-12)
    assert metrics.psnr(*pair, *given, peak=4.0) == pytest.approx(10.0 * math.log(16.0 / square, 10.0), rel=1e-12)


def test_equal_images_have_no_error(pair):
    reference = pair[1]
    assert metrics.evaluate(reference, reference, metrics=NUMBERS) == {
        "mse": 0.0, "rel_mse": 0.0, "smape": 0.0, "psnr": math.inf,
    }  # fmt: skip


@pytest.mark.parametrize("metric", ["mse", "rel_mse", "smape"])
def test_error_map_averages_to_the_metric(pair, metric):
    image = metrics.make_error_map(*pair, metric)
    assert image.shape == (6, 5)
    assert float(image.astype(np.float64).mean()) == pytest.approx(getattr(metrics, metric)(*pair), rel=1e-5)
    a, r = pair[0].copy(), pair[1]
    a[...] = r
    a[3, 2] += 1.0
    assert np.argwhere(metrics.make_error_map(a, r, metric)).tolist() == [[3, 2]]


class TestFlip:
    """FLIP itself is another program: its ends, its order and our handling are tested."""

    @pytest.fixture(autouse=True)
    def _needs_flip(self):
        pytest.importorskip("flip_evaluator", reason="flip_evaluator is not installed: pip install 'lobewise[compare]'")

    def test_ends(self, pair):
        _, reference = pair
        assert metrics.flip(reference, reference) == 0.0
        black = np.zeros_like(reference)
        assert metrics.flip(black, black) == 0.0
        assert 0.5 < metrics.flip(np.ones_like(reference), black) <= 1.0
        assert 0.0 < metrics.flip(*pair) < metrics.flip(pair[1] + 4.0 * (pair[0] - pair[1]), pair[1])

    def test_ldr_black_against_white_is_the_published_maximum(self):
        # Andersson et al. 2020: black against white is the largest colour difference, and edges add nothing here.
        black, white = np.zeros((40, 40, 3)), np.ones((40, 40, 3))
        assert metrics.flip(black, white, hdr=False) == pytest.approx(1.0, abs=0.05)
        with refuses(InputError, "flip", expected="values in [0, 1] with hdr=False"):
            metrics.flip(black, 2.0 * white, hdr=False)

    def test_the_reference_is_the_reference(self, pair):
        import flip_evaluator

        a, r = (np.maximum(10.0 * x, 0.0).astype(np.float32) * scale for x, scale in zip(pair, (1.0, 0.1), strict=True))
        expected = flip_evaluator.evaluate(r, a, "HDR", applyMagma=False)[1]
        assert metrics.flip(a, r) == pytest.approx(expected, rel=1e-4)
        assert flip_evaluator.evaluate(a, r, "HDR", applyMagma=False)[1] != pytest.approx(expected, rel=1e-3)

    def test_mask_and_map(self, pair, rng):
        mask = rng.random((6, 5)) < 0.4
        image = metrics.make_error_map(*pair, "flip")
        assert metrics.flip(*pair) == pytest.approx(float(image.mean()), rel=1e-5)
        assert metrics.flip(*pair, mask) == pytest.approx(float(image[mask].mean()), rel=1e-5)

    def test_input_order_in_memory_does_not_matter(self, pair):
        turned = tuple(np.asfortranarray(x) for x in pair)
        assert metrics.flip(*turned) == metrics.flip(*pair)

    def test_missing_package_is_named(self, pair, monkeypatch):
        monkeypatch.setitem(sys.modules, "flip_evaluator", None)
        with refuses(MissingDependencyError, "flip"):
            metrics.flip(*pair)


@pytest.mark.parametrize("metric", metrics.METRICS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("which", [0, 1])
def test_pixels_that_are_not_finite_are_refused(pair, metric, value, which):
    pair[which][4, 3, 1] = value
    name = ("image", "reference")[which]
    with refuses(InputError, name, "1 of 30 pixels that are NaN or infinite, the first at x=3, y=4"):
        getattr(metrics, metric)(*pair)


def test_masked_out_pixels_must_be_finite_too(pair):
    pair[0][4, 3] = np.nan
    mask = np.ones((6, 5), dtype=bool)
    mask[4, 3] = False
    with refuses(InputError, "image"):
        metrics.mse(*pair, mask)


@pytest.mark.parametrize("metric", metrics.METRICS)
def test_sizes_must_match(pair, metric):
    with refuses(InputError, "image", "4x6", "the size of the reference, 5x6 pixels"):
        getattr(metrics, metric)(pair[0][:, :4], pair[1])


@pytest.mark.parametrize("shape", [(6, 5), (6, 5, 4), (0, 5, 3), (6, 0, 3), (6, 15)])
def test_shapes_other_than_images_are_refused(shape):
    with refuses(InputError, "image"):
        metrics.mse(np.zeros(shape), np.zeros(shape))


@pytest.mark.parametrize("mask", [np.zeros((6, 5), dtype=bool), np.ones((5, 6), dtype=bool), np.ones((6, 5))])
def test_masks_must_be_booleans_that_choose_something(pair, mask):
    with refuses(InputError, "mask"):
        metrics.mse(*pair, mask)


def test_unknown_names_and_peaks(pair):
    with refuses(InputError, "metric", "'relmse'"):
        metrics.evaluate(*pair, metrics=["relmse"])
    with refuses(InputError, "metric", "'psnr'"):
        metrics.make_error_map(*pair, "psnr")
    for peak in (0.0, -1.0, math.nan, math.inf):
        with refuses(InputError, "peak"):
            metrics.psnr(*pair, peak=peak)


def test_specular_pixels():
    kinds = GBuffer(lobe_kind=[[0.0, 1.0, 2.0, 3.0, 0.2, 0.8]], specular_albedo=np.zeros((1, 6, 3)))
    assert metrics.find_specular_pixels(kinds).tolist() == [[False, True, True, True, False, True]]
    albedos = GBuffer(specular_albedo=[[[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]]])
    assert metrics.find_specular_pixels(albedos).tolist() == [[False, True]]
    with refuses(MissingChannelError, "specular pixels"):
        metrics.find_specular_pixels(GBuffer())


class TestFlicker:
    @pytest.fixture
    def film(self, rng):
        """Return five noisy frames and their references."""
        references = rng.gamma(0.5, 1.0, (5, 4, 3, 3))
        return references + rng.normal(0.0, 0.2, references.shape), references

    def test_it_agrees_with_a_loop(self, film):
        terms = []
        for t, y, x, c in np.ndindex(4, 4, 3, 3):
            a, b, r, s = (float(images[t + k, y, x, c]) for images in film for k in (1, 0))
            terms.append((a - b - r + s) ** 2 / ((r * r + s * s) / 2.0 + 0.01))
        assert metrics.flicker(*film) == pytest.approx(math.fsum(terms) / len(terms), rel=1e-12)

    def test_one_by_one_with_a_cut(self, film):
        steps = metrics.Flicker()
        each = [steps.add(a, r, cut=t == 2) for t, (a, r) in enumerate(zip(*film, strict=True))]
        assert [t for t, step in enumerate(each) if step is None] == [0, 2]
        pairs = [metrics.flicker(film[0][t - 1 : t + 1], film[1][t - 1 : t + 1]) for t in (1, 3, 4)]
        assert [step for step in each if step is not None] == pytest.approx(pairs, rel=1e-12)
        assert steps.get_mean() == pytest.approx(np.mean(pairs), rel=1e-12)

    def test_only_the_frame_before_is_kept(self, rng):
        frame = rng.random((40, 50, 3))
        tracemalloc.start()
        try:
            steps = metrics.Flicker()
            sizes = []
            for _ in range(6):
                steps.add(frame, frame)
                sizes.append(tracemalloc.get_traced_memory()[0])
        finally:
            tracemalloc.stop()
        assert sizes[5] - sizes[1] < frame.nbytes

    def test_mistakes(self, film):
        images, references = film
        for few in ([], images[:1]):
            with refuses(InputError, "flicker"):
                metrics.flicker(few, references[: len(few)])
        for count in (3, 5):
            with refuses(InputError, "references"):
                metrics.flicker(images[:4], references[:count])
        with refuses(InputError, "image", "2x4", "the size of the frame before, 3x4 pixels"):
            metrics.flicker([images[0], images[1][:, :2]], [references[0], references[1][:, :2]])
        images[1, 2, 1, 0] = np.nan
        with refuses(InputError, "image", "1 of 12 pixels that are NaN or infinite, the first at x=1, y=2"):
            metrics.flicker(images, references)


class TestGhosting:
    def test_only_what_came_into_view_counts(self, pair, rng):
        mask = rng.random((6, 5)) < 0.4
        expected = loop(pair, mask, lambda a, r: (a - r) * (a - r) / (r * r + 0.01))
        assert metrics.ghosting(*pair, mask) == pytest.approx(expected, rel=1e-12)
        pair[0][~mask] = 1e6
        assert metrics.ghosting(*pair, mask) == pytest.approx(expected, rel=1e-12)

    def test_nothing_came_into_view(self, pair):
        assert math.isnan(metrics.ghosting(*pair, np.zeros((6, 5), dtype=bool)))

    @pytest.mark.parametrize("mask", [np.zeros((5, 6), dtype=bool), np.ones((5, 6), dtype=bool), np.zeros((6, 5)), []])
    def test_masks_of_another_kind_are_refused(self, pair, mask):
        with refuses(InputError, "mask"):
            metrics.ghosting(*pair, mask)

    def test_bad_pixels_are_refused_even_where_nothing_counts(self, pair):
        pair[0][0, 0] = np.nan
        with refuses(InputError, "image"):
            metrics.ghosting(*pair, np.zeros((6, 5), dtype=bool))
