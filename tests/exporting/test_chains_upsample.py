"""The chain that upsamples sparse frames on a device, in three languages, against Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.errors import InputError
from lobewise.exporting.shaders.chains import make_chain
from lobewise.filters.history.accumulation import KnownKernel, SampleGrid
from lobewise.sparse_frame import SparseFrame, list_places
from lobewise.temporal.recipe import compute_own_weight, make_named_layers
from tests.exporting.chain_device import Player, fill, give_images, make_constants
from tests.exporting.chain_scene import make_sparse_frame
from tests.exporting.test_chains import RTOL, WEIGHT_RTOL, compare
from tests.exporting.test_chains_history import LAYERS, split

SCALE = 3
FRAMES = 5


def make(number: int) -> SparseFrame:
    return make_sparse_frame(number, SCALE, list_places(SCALE)[number % SCALE**2], hits=True)


@pytest.mark.sampled("wgsl-diffuse")
@pytest.mark.parametrize("name", LAYERS)
def test_passes(graphics: Any, language: str, folder: Path, name: str) -> None:
    """Trust and upsampling of one frame, from the same history."""
    recipe = lobewise.TemporalFilter()
    for number in range(3):
        recipe.add(make(number))
    frame, past = make(3), recipe._past
    assert past is not None
    chosen = recipe._resolve(frame)
    layer = make_named_layers(frame, chosen, (), None, compute_own_weight(frame))[name]
    # A history in half of the image, so that both radii occur; pixels without light have none.
    half = (np.arange(frame.shape[1]) < frame.shape[1] // 2)[:, None]
    history = np.where(layer.mask[..., None] & half, past.sums[name], np.float32(0.0))
    own, growth = compute_own_weight(frame), recipe.temporal.strictness
    grid = SampleGrid(layer.mask, layer.features, scale=SCALE, place=frame.place, albedo=layer.albedo)
    trust = grid.compute_trust(layer.radiance, history, own)
    constants = make_constants(recipe, frame, make(2))
    known = KnownKernel(constants["known_radius"], chosen.screen_sigma, constants["known_sigma"])
    expected = grid.accumulate(
        layer.radiance, radius=chosen.radius, history=history, trust=trust, growth=growth, own=own, known=known
    )
    player = Player(graphics, make_chain("upsample"), language, folder)
    given = {**give_images(frame), **player.run_pass("guides", give_images(frame), constants)}
    light, more = split(history)
    given |= {f"{name}_history_light": light, f"{name}_history_more": more}
    found = player.run_pass(f"{name}_trust", given, constants)
    np.testing.assert_allclose(found[f"{name}_trust"][..., 0], trust, rtol=0.0, atol=RTOL)
    found = player.run_pass(f"{name}_upsample", {**given, f"{name}_trust": fill(trust)}, constants)
    sums = np.dstack([found[f"{name}_kept_light"], found[f"{name}_kept_more"][..., :3]])
    for k in range(7):
        compare(sums[..., k], expected.sums[..., k], WEIGHT_RTOL)
    lit = expected.weight_sum > 0.0
    assert layer.albedo is not None
    compare((sums[..., :3] / np.maximum(sums[..., 3:4], 1e-30) * layer.albedo)[lit], expected.image[lit])


@pytest.mark.sampled("wgsl-ggx")
@pytest.mark.parametrize("similarity", ["ggx", "sg"])
def test_sequence(graphics: Any, language: str, folder: Path, similarity: Any) -> None:
    recipe = lobewise.TemporalFilter(similarity=similarity)
    player = Player(graphics, make_chain("upsample", similarity=similarity), language, folder)
    previous = None
    for number in range(FRAMES):
        frame = make(number)
        image = player.run(give_images(frame), make_constants(recipe, frame, previous))
        compare(image[..., :3], recipe.add(frame).image)
        previous = frame


def test_only_the_full_form() -> None:
    with pytest.raises(InputError, match=r"form of the chain 'upsample'.*full"):
        make_chain("upsample", form="separable")
