"""The exported plan "balanced": C++ agrees with Python, for its passes and for what the samples tell afterwards."""

from itertools import pairwise
from typing import Any

import numpy as np

from lobewise import engine
from lobewise.denoising.automatic import resolve_all
from lobewise.denoising.bad_pixels import fill_holes, mark_bad_pixels
from lobewise.denoising.chain import filter_rows, keep_light
from lobewise.denoising.evidence import load_networks
from lobewise.exporting.pipeline.driver import write_driver
from lobewise.exporting.pipeline.recording import make_pipeline
from lobewise.exporting.pipeline.sample import make_settings, prepare_frame
from lobewise.exporting.pipeline.scene import make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.filters.glue import define_with_highlights

SETTINGS: dict[str, Any] = {"radius": 2, "plan": "balanced"}


def test_every_stage_changes_the_example() -> None:
    """The example is taken back, brightened and filled, so that agreement with Python tells about each stage."""
    settings = PipelineSettings(**SETTINGS)
    frame = prepare_frame(settings, make_frame(0, halves=True))
    taken = filter_rows(frame, resolve_all(frame, make_settings(settings)), (), mark_bad_pixels(frame))
    kept = keep_light(taken)
    images = [taken.taken_from.image, taken.image, kept.image, fill_holes(*kept.mark_holes(), frame)]
    for before, after in pairwise(map(np.nan_to_num, images)):
        assert np.abs(after - before).max() > 1e-3


def test_network_is_compiled_in() -> None:
    driver = write_driver(make_pipeline(PipelineSettings(plan="balanced")))
    network = load_networks()["noisy"]
    begin = driver.index("HELD_VALUES_shares_centre[] = {")
    words = driver[begin : driver.index("};", begin)].split("{")[1].replace("f", "").split(",")
    np.testing.assert_array_equal(np.array(words, np.float64).astype(np.float32), network.mean)


def test_stages_are_those_of_the_plan() -> None:
    stages = [name for name, _ in make_pipeline(PipelineSettings(plan="balanced")).stages]
    assert "diffuse: 7x7 taps, lobes to the power 4, 40 variances" in stages
    assert stages[-4:] == ["take the noisy image back", "share out the light of fireflies", "fill holes", "results"]


def test_highlights_are_added_where_there_is_light(rng: np.random.Generator) -> None:
    image, kept = rng.random((2, 9, 40, 3)).astype(np.float32)
    lit = rng.random((9, 40)) < 0.5
    (found,) = engine.pixels(define_with_highlights, {"image": image, "kept": kept, "lit": lit}, {})
    np.testing.assert_array_equal(found, np.where(lit[..., None], image + kept, image))
