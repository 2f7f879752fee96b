"""The refining network: its weights, and what it makes of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from lobewise import engine
from lobewise.denoising.layers import Layer
from lobewise.denoising.refining.inputs import collect_inputs, compute_lobes
from lobewise.denoising.refining.lamps import mark_refined, mark_shining
from lobewise.denoising.refining.whole_image import WholeImage
from lobewise.filters.refinement.run import pack_weights, refine_image
from lobewise.filters.refinement.steps import define_refined
from lobewise.records.frame import FloatArray, Frame

REFINEMENT_WEIGHTS = "refinement.npz"
"""File of the network, in the folder of the package `lobewise.denoising`."""
MAX_BLACK_FILTERED = 1e-36
"""Radiance up to which filtered light counts as black and stays so."""


@cache
def load_weights() -> FloatArray:
    """Return the weights of the network as the kernels read them."""
    with files("lobewise.denoising").joinpath(REFINEMENT_WEIGHTS).open("rb") as file:
        arrays = np.load(file, allow_pickle=False)
        return pack_weights({name: arrays[name].astype(np.float32) for name in arrays.files})


class Refined(NamedTuple):
    """The light of a frame after the network.

    Parameters
    ----------
    parts : sequence of (height, width, 3)
    rest : (height, width, 3), optional
        The light that no surface scatters.
    """

    parts: Sequence[FloatArray]
    rest: FloatArray | None


def refine_light(
    frame: Frame,
    layers: Sequence[Layer],
    noisy: Sequence[FloatArray],
    parts: Sequence[FloatArray],
    rest: FloatArray | None,
    whole: WholeImage,
) -> Refined:
    """Return the filtered layers and the other light, scaled so that they sum to what the network makes of the sum.

    Parameters
    ----------
    frame : Frame
    layers, noisy, parts : sequences
        The layers, their samples without fireflies, and what filters made of them.
    rest : (height, width, 3), optional
        The light that no surface scatters.
    whole : WholeImage
    """
    shining = None if rest is None else mark_shining(rest, parts)
    inputs: dict[str, Any] = vars(collect_inputs(frame, noisy, parts, rest))
    filtered = inputs["filtered"]
    inputs["lobe_axis"], inputs["lobe_sharpness"] = compute_lobes(frame, whole.tau)
    image = refine_image(
        inputs,
        load_weights(),
        brightness=whole.brightness,
        mean_log_depth=whole.mean_log_depth,
        shared=frame.noise_is_shared,
    )
    images = {
        "image": image,
        "filtered": filtered,
        "refined": mark_refined([layer.mask for layer in layers], shining),
        **{f"part{number}": part for number, part in enumerate(parts)},
        "rest": rest,
    }
    names = [*(f"{layer.name}_refined" for layer in layers), *([] if rest is None else ["rest_refined"])]
    text = "light as the network refined it"
    refined = engine.pixels(define_refined, images, {}, MAX_BLACK_FILTERED, names=names, text=text)
    return Refined(refined[: len(parts)], None if rest is None else refined[-1])
