"""The passes of a history on a device, in three languages, against Python: whole sequences, and the sums they keep."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.exporting.shaders.chains import make_chain
from lobewise.records.frame import Frame
from tests.exporting.chain_device import Player, give_images, make_constants
from tests.exporting.chain_scene import make_clean_image, make_frame
from tests.exporting.test_chains import WEIGHT_RTOL, compare

LAYERS = "diffuse", "specular"
FRAMES = 4
"""Frames before the one with a shadow that is new."""
SETTINGS: dict[str, Any] = {"form": "separable", "radius": 6}


def make_last(hits: bool) -> Frame:
    """Return the frame after the others. Half of it lies in a shadow that is new."""
    frame = make_frame(FRAMES, hits=hits)
    shadow = np.where(np.arange(frame.width)[:, None] < frame.width // 2, np.float32(0.2), np.float32(1.0))
    parts = {name: getattr(frame.radiance, name) * shadow for name in LAYERS}
    color = frame.radiance.color - frame.radiance.diffuse - frame.radiance.specular + sum(parts.values())
    return frame.with_changes(radiance=lobewise.Radiance(color, **parts))


def compare_sums(player: Player, recipe: lobewise.TemporalFilter) -> None:
    """Assert that what both keep for the next frame agrees: light, weights, squared weights, moments and frames."""
    for name in LAYERS:
        found = np.dstack([player.images[f"{name}_kept_light"], player.images[f"{name}_kept_more"][..., :3]])
        for k, expected in enumerate(np.moveaxis(recipe._past.sums[name], -1, 0)):
            compare(found[..., k], expected, WEIGHT_RTOL)


@pytest.mark.sampled("wgsl-separable-True-ggx")
@pytest.mark.parametrize(
    ("form", "hits", "similarity"), [("separable", True, "ggx"), ("atrous", False, "ggx"), ("separable", True, "sg")]
)
def test_sequence(graphics: Any, language: str, folder: Path, form: Any, hits: bool, similarity: Any) -> None:
    """A moving camera, a moving object, a light that changes: every frame is as Python's."""
    recipe = lobewise.TemporalFilter(form=form, radius=6, similarity=similarity)
    player = Player(graphics, make_chain("history", form=form, similarity=similarity), language, folder)
    previous = None
    images = []
    for number in range(FRAMES + 2):
        frame = make_last(hits) if number == FRAMES else make_frame(number, hits=hits)
        constants = make_constants(recipe, frame, previous)
        image = player.run(give_images(frame), constants)
        result = recipe.add(frame)
        compare(image[..., :3], result.image)
        if form == "separable":  # the weights of five passes multiply, which squares and moments show
            compare_sums(player, recipe)
        images.append(image[..., :3])
        previous = frame
    # The history pays: the fourth frame has less noise than the first.
    noise = [np.mean((images[number] - make_clean_image(number)) ** 2) for number in (0, FRAMES - 1)]
    assert noise[1] < 0.8 * noise[0]


def test_a_cut_forgets(graphics: Any, folder: Path) -> None:
    """With ``memory`` 0 a frame is as the first one of a sequence."""
    recipe = lobewise.TemporalFilter(**SETTINGS)
    player = Player(graphics, make_chain("history", form="separable"), "wgsl", folder)
    player.run(give_images(make_frame(0)), make_constants(recipe, make_frame(0), None))
    frame = make_frame(1)
    image = player.run(give_images(frame), {**make_constants(recipe, frame, make_frame(0)), "memory": 0.0})
    compare(image[..., :3], lobewise.TemporalFilter(**SETTINGS).add(frame).image)
