"""Light that is lost with fireflies is told where the noise of the image's mean does not explain it, and only there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lobewise.cli.program import run
from lobewise.denoising import denoise, light_loss
from lobewise.denoising.light_loss import (
    MAX_GAIN_PER_FIREFLY,
    MIN_STANDARD_ERRORS,
    brighten,
    compute_gain,
    compute_loss,
    compute_share_missing,
    describe_loss,
    sum_light,
    sum_missing,
)
from lobewise.io import write_frame
from lobewise.records.frame import Frame, GBuffer, Radiance

SHAPE = 65, 65


def make_frame(rng: np.random.Generator, spots: int, total: float) -> Frame:
    """Return a gray wall with little noise and some equal fireflies far apart, that together have ``total`` of it."""
    light = rng.normal(1.0, 0.02, SHAPE)
    rows, columns = np.meshgrid(np.arange(6, 65, 13), np.arange(6, 65, 13))
    light[rows.flat[:spots], columns.flat[:spots]] += total * light.size / spots
    normal = np.broadcast_to([0.0, 0.0, 1.0], (*SHAPE, 3))
    return Frame(Radiance(np.repeat(light[..., None], 3, axis=-1)), GBuffer(normal=normal))


def list_losses(frame: Frame) -> list[str]:
    """Return what is told of lost light."""
    return [note for note in denoise(frame, quality="balanced").notes if "of the light was shared out" in note]


@pytest.mark.parametrize(
    ("spots", "total", "told"),
    [
        # The mean of the scene may be right without it as well as with it.
        (1, 0.04, False),
        (4, 0.04, False),
        # What the mean has of so many is known to a fifth of it.
        (25, 0.04, True),
        (25, 0.2, True),
        # Nobody misses so little.
        (25, 0.008, False),
        (0, 0.0, False),
    ],
)
def test_only_what_was_clearly_lost_is_told(spots: int, total: float, told: bool, rng: np.random.Generator) -> None:
    frame = make_frame(rng, max(spots, 1), total)
    result = denoise(frame, quality="balanced")
    kept = result.image.mean(dtype=np.float64) / frame.radiance.color.mean(dtype=np.float64)
    assert result.energy_lost == pytest.approx(1.0 - kept, abs=1e-4)
    if spots == 1:
        # One pixel tells nothing of the mean: none of its light is shared out.
        assert kept == pytest.approx(1.0 - 0.04 / 1.04, abs=2e-3)
    else:
        assert kept == pytest.approx(1.0, abs=0.005)
    found = list_losses(frame)
    assert len(found) == told


@pytest.mark.sampled("False-balanced", "True-balanced")
@pytest.mark.parametrize("quality", ["balanced", "high"])
@pytest.mark.parametrize("apart", [False, True])
def test_the_light_of_every_layer_is_kept(quality: str, apart: bool, rng: np.random.Generator) -> None:
    frame = make_frame(rng, 25, 0.2)
    color = frame.radiance.color
    if apart:
        # Unlike albedos: what is kept is light, not light over albedo.
        albedo = np.where(np.arange(65)[:, None, None] < 30, 0.2, 0.9) * np.ones((*SHAPE, 3))
        diffuse, specular = (albedo * color).astype(np.float32), (0.3 * np.flip(albedo) * color).astype(np.float32)
        guides = replace(frame.gbuffer, diffuse_albedo=albedo, specular_albedo=0.3 * np.flip(albedo))
        frame = frame.with_changes(radiance=Radiance(diffuse + specular + 0.1, diffuse, specular), gbuffer=guides)
    result = denoise(frame, quality=quality, similarity="normal")
    pairs = [(frame.radiance.color, result.image)]
    if apart:
        pairs += [(frame.radiance.diffuse, result.diffuse), (frame.radiance.specular, result.specular)]
    for noisy, clean in pairs:
        assert clean.mean(dtype=np.float64) == pytest.approx(noisy.mean(dtype=np.float64), rel=0.002)
    if not apart:
        # Nowhere in a spot. The network of "high" leaves a faint one of a firefly on a wall without noise.
        assert result.image.max() < {"balanced": 1.1, "high": 1.25}[quality] * np.median(result.image)


@pytest.mark.parametrize(("fireflies", "lost"), [(1, 300.0), (2, 10.0), (3, 30.0), (100, 20.0)])
def test_so_much_is_shared_out_as_the_noise_leaves_sure(fireflies: int, lost: float) -> None:
    """A layer of light 3000 and some fireflies that lost as much each."""
    whole, missing = 3000.0, lost * fireflies
    rows = np.array([[whole + missing, missing, fireflies * lost**2, whole, lost]])
    shared = max(missing * (1.0 - fireflies**-2.0), min(missing - lost, 0.01 * whole))
    assert compute_gain(rows) * whole == pytest.approx(shared)
    assert compute_share_missing([compute_loss(rows)]) == pytest.approx((missing - shared) / (whole + missing))
    # In two parts the same.
    halves = np.repeat(rows * [0.5, 0.5, 0.5, 0.5, 1.0], 2, axis=0)
    assert compute_gain(halves) == compute_gain(rows)


@pytest.mark.parametrize("count", [1, 2, 3, 10])
@pytest.mark.parametrize("light", [1e6, 1e30])
def test_a_few_hot_pixels_do_not_brighten_an_image(count: int, light: float, rng: np.random.Generator) -> None:
    frame = make_frame(rng, 1, 0.0)
    spoilt = np.array(frame.radiance.color)
    # So far apart that they do not vouch for each other.
    rows, columns = np.meshgrid(np.arange(3, 65, 14), np.arange(3, 65, 14))
    spoilt[rows.flat[:count], columns.flat[:count]] = light
    clean, result = (
        denoise(frame.with_changes(radiance=Radiance(color)), quality="balanced").image
        for color in (frame.radiance.color, spoilt)
    )
    assert np.isfinite(result).all()
    assert 0.99 < np.median(result) / np.median(clean) < 1.01 + 2.0 * MAX_GAIN_PER_FIREFLY * count


def test_what_is_no_part_of_a_layer_stays_as_it_is(rng: np.random.Generator) -> None:
    frame = make_frame(rng, 25, 0.2)
    normal, depth = np.array(frame.gbuffer.normal), np.ones(SHAPE)
    normal[40:], depth[40:] = 0.0, 0.0
    result = denoise(frame.with_changes(gbuffer=GBuffer(normal=normal, depth=depth)), quality="balanced")
    np.testing.assert_array_equal(result.image[40:], frame.radiance.color[40:])
    assert result.image.sum(dtype=np.float64) == pytest.approx(frame.radiance.color.sum(dtype=np.float64), rel=0.005)


def test_light_that_was_added_is_taken_away() -> None:
    rows = np.array([[1000.0, -100.0, 10.0, 1100.0, 0.0]])
    assert compute_gain(rows) == pytest.approx(-100.0 / 1100.0, rel=1e-5)
    assert compute_share_missing([compute_loss(rows)]) == 0.0


def test_nothing_is_shared_out_over_nothing() -> None:
    for sums in ([0.0] * 5, [10.0, 10.0, 5.0, 0.0, 5.0], [np.inf, np.inf, np.inf, 1.0, np.inf]):
        assert compute_gain(np.array([sums])) == 0.0


def test_one_firefly_changes_no_light() -> None:
    """A hundredth of the light would else be shared out in this frame, and none in the next one."""
    firefly, noise, whole = 1e4, 0.4, 800.0
    rows = np.array([[1000.0, firefly + noise, firefly**2 + noise**2, whole, firefly]])
    assert compute_gain(rows) < 0.0025


def test_pixels_that_do_not_count_tell_no_loss() -> None:
    light, mask = np.full((2, 4, 3), 1.0, np.float32), np.ones((2, 4), bool)
    part, uncounted = 0.5 * light, np.zeros((2, 4), bool)
    part[0, 0], uncounted[0, 0] = 30.0, True
    rows = sum_missing(light, part, mask, uncounted=uncounted)
    np.testing.assert_allclose(rows[:, 1], [3 * 1.5, 4 * 1.5])
    np.testing.assert_allclose(sum_missing(light, part, mask, slice(0, 1), uncounted=uncounted), rows[:1])
    assert sum_missing(light, part, mask)[0, 1] < 0.0


def test_pixels_outside_the_layer_take_nothing() -> None:
    part, mask = np.ones((2, 3, 3), np.float32), np.zeros((2, 3), bool)
    mask[0] = True
    np.testing.assert_allclose(brighten(part, part, mask, 0.25)[..., 1], [[1.25] * 3, [1.0] * 3])
    assert sum_missing(2.0 * part, part, mask)[:, 3].tolist() == [9.0, 0.0]


@pytest.mark.parametrize(("shared", "ratio"), [(False, 1.0), (True, 1.15)])
def test_the_error_of_the_mean_is_that_of_repeated_renders(
    shared: bool, ratio: float, rng: np.random.Generator
) -> None:
    """Of heavy-tailed noise on a slope and an edge; shared noise is spread by a Gaussian of half a pixel.

    At whole pixels that has 2.44 pixels' noise in one, and not the 3.2 of a filter that samples see everywhere.
    """
    ramp = np.linspace(1.0, 3.0, 48) + np.where(np.arange(48) > 20, 4.0, 0.0)
    means, errors = [], []
    for _ in range(150):
        noise = rng.exponential(1.0, (48, 48))
        if shared:
            share = np.exp(-0.5 * (np.arange(-2, 3) / 0.5) ** 2)
            share /= share.sum()
            for axis in (0, 1):
                noise = sum(s * np.roll(noise, k - 2, axis) for k, s in enumerate(share))
        image = np.repeat((noise * ramp)[..., None], 3, axis=-1).astype(np.float32)
        frame = Frame(Radiance(image), noise_is_shared=shared)
        rows = sum_light(frame, image, np.zeros((48, 48), bool))
        noisy, done, squared = rows.sum(axis=0)
        assert noisy == pytest.approx(done)
        means.append(noisy)
        errors.append(squared)
    # Pixels at the frame stand for their neighbours, the noise of 150 renders is known to 6 %.
    assert np.sqrt(np.mean(errors)) == pytest.approx(ratio * np.std(means), rel=0.15)


def test_bad_pixels_count_on_neither_side(rng: np.random.Generator) -> None:
    frame = make_frame(rng, 25, 0.2)
    whole = sum_light(frame, frame.radiance.color, np.zeros(SHAPE, bool))
    color = np.array(frame.radiance.color)
    color[10, 10], color[20, 30], color[40, 40] = np.nan, np.inf, -1.0
    spoilt = sum_light(
        frame.with_changes(radiance=Radiance(color)), np.nan_to_num(color, posinf=1e9), ~np.isfinite(color[..., 0])
    )
    assert np.isfinite(spoilt).all()
    assert spoilt[:, 0] == pytest.approx(spoilt[:, 1])
    np.testing.assert_allclose(spoilt.sum(axis=0), whole.sum(axis=0), rtol=0.01)


@pytest.mark.parametrize("rows", [1, 7, 128])
def test_rows_of_a_part_are_those_of_the_whole(
    rows: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = make_frame(rng, 25, 0.2)
    color, bad = frame.radiance.color, np.zeros(SHAPE, bool)
    part = frame.with_changes(radiance=Radiance(color[8:40]), gbuffer=GBuffer(normal=frame.gbuffer.normal[8:40]))
    whole = sum_light(frame, color, bad)
    monkeypatch.setattr(light_loss, "ROWS_AT_ONCE", rows)
    assert sum_light(frame, color, bad).tobytes() == whole.tobytes()
    found = sum_light(part, color[8:40], bad[8:40], slice(2, 30))
    assert found.tobytes() == whole[10:38].tobytes()


def test_the_sentence_needs_a_change_beyond_the_errors() -> None:
    def tell(lost: float, error: float, share: float = 0.1) -> tuple[str, ...]:
        return describe_loss(np.array([[50.0, 50.0 * (1.0 - lost), 0.5 * (100.0 * error) ** 2]] * 2), share)

    assert tell(0.2, 0.05)[0].startswith(
        "20 % of the light was shared out over the image, more than its noise explains (5 %)"
    )
    assert tell(0.2, 0.2 / MIN_STANDARD_ERRORS * 1.01) == ()
    assert tell(0.2, 0.05, share=0.0) == ()
    assert tell(0.009, 0.0001) == ()
    assert tell(-0.2, 0.0) == ()
    assert tell(np.nan, 0.05) == ()
    assert describe_loss(np.zeros((0, 3)), 1.0) == ()


def test_a_sequence_is_told_once(tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]) -> None:
    """The figures of its frames differ; the first frame's are told."""
    for number, total in ((1, 0.2), (2, 0.4)):
        write_frame(tmp_path / f"in.{number}.exr", make_frame(rng, 25, total))
    assert run(["denoise", str(tmp_path / "in.#.exr"), "-o", str(tmp_path / "out.#.exr"), "--offline"]) == 0
    told = capsys.readouterr().err
    assert told.count("% of the light was shared out") == 1
