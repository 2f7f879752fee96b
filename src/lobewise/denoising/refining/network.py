"""The refining network: its weights, and what it makes of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files

import numpy as np

from lobewise.denoising.refining.inputs import collect_inputs, find_lobes
from lobewise.denoising.refining.whole_image import WholeImage
from lobewise.filters.refinement.run import pack_weights, refine_image
from lobewise.frame import FloatArray, Frame

WEIGHTS = "refinement.npz"
"""File of the network, in the folder of the package `lobewise.denoising`."""
MAX_BLACK_RADIANCE = 1e-36
"""Radiance up to which filtered light counts as black and stays so."""


@cache
def load_weights() -> FloatArray:
    """Return the weights of the network as the kernels read them."""
    with files("lobewise.denoising").joinpath(WEIGHTS).open("rb") as file:
        arrays = np.load(file, allow_pickle=False)
        return pack_weights({name: arrays[name].astype(np.float32) for name in arrays.files})


def find_factor(
    frame: Frame, noisy: Sequence[FloatArray], parts: Sequence[FloatArray], whole: WholeImage
) -> FloatArray:
    """Return the refined light over the filtered light, (height, width, 3); 0 where the filtered light is black.

    Parameters
    ----------
    frame, noisy, parts
        As in `collect_inputs`; with the light that no surface scatters as the last of both, where there is any.
    whole : WholeImage
    """
    inputs = collect_inputs(frame, noisy, parts)
    axis, sharpness = find_lobes(frame, whole.tau)
    refined = refine_image(
        {**vars(inputs), "lobe_axis": axis, "lobe_sharpness": sharpness},
        load_weights(),
        brightness=whole.brightness,
        mean_log_depth=whole.mean_log_depth,
        shared=frame.noise_is_shared,
    )
    lit = inputs.filtered > MAX_BLACK_RADIANCE
    return np.divide(refined, inputs.filtered, out=np.zeros_like(inputs.filtered), where=lit)
