"""Plans: the steps of a frame, how far they reach and what they cost; and the passes over a layer."""

import numpy as np
import pytest

from lobewise.denoising import denoise
from lobewise.denoising.also import bound_parts, filter_plain_layer
from lobewise.denoising.automatic import ask, resolve_all
from lobewise.denoising.layers import make_layers
from lobewise.denoising.noisy import (
    compute_layer_level,
    join_halves,
    make_bounded_layers,
    make_noisy_layers,
    measure_layer,
)
from lobewise.denoising.passes import filter_layer_halves
from lobewise.denoising.plan import (
    compute_steps_reach,
    count_bytes,
    estimate_seconds_per_megapixel,
    foretell,
    list_frame_steps,
)
from lobewise.filters.noise_guides import compute_mean_light
from lobewise.records.frame import Frame
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import QUALITIES as LIBRARY
from tests.denoising.test_denoising import make_frame


def resolve(frame: Frame, **changes: object) -> ResolvedSettings:
    """Return settings of a quality of ours with every "auto" replaced."""
    return resolve_all(frame, ask(None, {"with_oidn": False, "quality": "balanced", **changes}))


def test_the_level_of_a_layer_is_that_of_its_rows() -> None:
    for layer in make_bounded_layers(make_frame(), resolve(make_frame())):
        level = compute_layer_level(layer)
        assert level == compute_mean_light(measure_layer(layer)) > 0.0


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_other_images_are_filtered_by_the_weights_of_the_layer(count: int) -> None:
    frame = make_frame()
    settings = resolve(frame, similarity="normal")
    for noisy in make_noisy_layers(frame, settings, ()):
        joined = join_halves(noisy)
        shares = np.linspace(0.1, 1.0, count, dtype=np.float32)
        others = bound_parts(noisy, joined, [share * joined for share in shares])
        clean = filter_layer_halves(frame, noisy, settings, others)
        np.testing.assert_allclose(clean.image, filter_layer_halves(frame, noisy, settings).image, rtol=1e-5)
        assert len(clean.others) == count
        # The mean of filtered halves is the filtered mean.
        for share, image in zip(shares, clean.others, strict=True):
            np.testing.assert_allclose(image.image, share * clean.image, rtol=1e-4)


@pytest.mark.parametrize("count", [1, 5, 6])
def test_other_images_are_filtered_by_the_guides_of_the_layer(count: int) -> None:
    frame = make_frame()
    settings = resolve(frame, quality="fast", similarity="normal")
    for layer in make_layers(frame, settings, finest=True):
        shares = np.linspace(0.1, 1.0, count, dtype=np.float32)
        output, others = filter_plain_layer(layer, settings, [share * layer.radiance for share in shares])
        assert len(others) == count
        there = output.weight_sum > 0.0
        for share, other in zip(shares, others, strict=True):
            np.testing.assert_allclose(other.image[there], share * output.image[there], rtol=1e-4)
            np.testing.assert_array_equal(other.image[~there], share * layer.radiance[~there])


def test_an_image_without_a_good_pixel_takes_no_light_of_others() -> None:
    frame = make_frame()
    settings = resolve(frame, similarity="normal")
    for noisy in make_noisy_layers(frame, settings, ()):
        joined = join_halves(noisy)
        images = [joined] * 6
        images[1] = images[3] = np.full_like(joined, np.nan)
        clean = filter_layer_halves(frame, noisy, settings, bound_parts(noisy, joined, images))
        for number, other in enumerate(clean.others):
            assert bool(np.nan_to_num(other.image).any()) == (number not in (1, 3))


@pytest.mark.parametrize("quality", [name for name, each in LIBRARY.items() if not each.needs_oidn])
def test_a_printed_plan_names_every_step(quality: str) -> None:
    lines = foretell(make_frame(), DenoiseSettings(quality=quality, with_oidn=False))  # type: ignore[arg-type]
    near, far = list_frame_steps(make_frame(), resolve(make_frame(), quality=quality))
    for number, step in enumerate([*near, *far], 1):
        assert any(line.startswith(f"{number}. {step.text}") for line in lines)
        assert all(f"   {part}" in lines for part in step.parts)
    assert any("refine the image" in line for line in lines) == LIBRARY[quality].refines
    assert not any(step.reach for step in far)


def test_time_and_memory_follow_the_plan() -> None:
    frame = make_frame()

    def estimate(**changes: object) -> float:
        settings = resolve(frame, quality="high", **changes)
        return estimate_seconds_per_megapixel(list_frame_steps(frame, settings)[0], settings)

    assert estimate() == pytest.approx(LIBRARY["high"].seconds_per_megapixel)
    assert estimate(radius=16) > 2.0 * estimate()
    assert compute_steps_reach(resolve(frame, radius=16)) > compute_steps_reach(resolve(frame))
    assert count_bytes(frame) >= sum(getattr(frame.gbuffer, name).nbytes for name in frame.gbuffer.names)


def test_what_is_foretold_is_what_denoise_says() -> None:
    frame = make_frame()
    lines = foretell(frame, DenoiseSettings(quality="balanced"))
    assert denoise(frame, quality="balanced").method in lines[0]
    assert lines[-2].startswith("Memory: ")
    assert lines[-1].startswith("Time: ")
