"""The chain that upsamples sparse frames on a device, in three languages, against Python."""

from pathlib import Path
from typing import Any

import pytest

import lobewise
from lobewise.errors import InputError
from lobewise.exporting.shaders.chains import make_chain
from lobewise.records.sparse_frame import SparseFrame, list_places
from tests.exporting.chain_device import Player, give_images, make_constants
from tests.exporting.chain_scene import make_sparse_frame
from tests.exporting.test_chains import compare
from tests.exporting.test_chains_history import compare_sums
from tests.mistakes import refuses

SCALE = 3
FRAMES = 5


def make(number: int) -> SparseFrame:
    return make_sparse_frame(number, SCALE, list_places(SCALE)[number % SCALE**2], hits=True)


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
        compare_sums(player, recipe)
        previous = frame


def test_only_the_full_form() -> None:
    with refuses(InputError, "form of the chain 'upsample'"):
        make_chain("upsample", form="separable")
