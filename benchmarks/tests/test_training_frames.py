"""benchmarks/training/frames.py and rendering.py: stored values, scenes kept aside, exposure."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.training import frames
from tests.streaming.frames import make_scene


def test_bad_pixels_are_stored_as_0_and_large_ones_clipped() -> None:
    image = np.array([np.nan, np.inf, -np.inf, 1e6, -1e6, 0.5])
    np.testing.assert_array_equal(frames.make_half(image), [0.0, 0.0, 0.0, 60000.0, -60000.0, 0.5])


def test_a_fifth_of_the_seeds_is_for_validation() -> None:
    assert [seed for seed in range(1, 21) if frames.is_validation(seed)] == [5, 10, 15, 20]


@pytest.mark.mitsuba
def test_all_light_of_a_frame_is_exposed(mi: object, rng: np.random.Generator) -> None:
    from benchmarks.training.rendering import expose

    frame = make_scene((24, 16))
    emission = rng.random((*frame.shape, 3), dtype=np.float32)
    frame = replace(frame, gbuffer=replace(frame.gbuffer, mean_emission=emission))
    found = expose(frame, 4.0)
    np.testing.assert_array_equal(found.gbuffer.mean_emission, 4.0 * emission)
    np.testing.assert_array_equal(found.radiance.color, 4.0 * frame.radiance.color)
    np.testing.assert_array_equal(found.gbuffer.diffuse_albedo, frame.gbuffer.diffuse_albedo)
