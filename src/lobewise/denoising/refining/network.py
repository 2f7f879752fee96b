"""The refining network: its weights, and the layers that it scales."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.refining.inputs import collect_inputs, find_lobes
from lobewise.denoising.refining.whole_image import WholeImage
from lobewise.filters.refinement.run import flatten_weights, refine_image
from lobewise.frame import FloatArray, Frame

WEIGHTS = "refinement.npz"
"""File of the network, in the folder of the package `lobewise.denoising`."""
MAX_BLACK_RADIANCE = 1e-36
"""Radiance up to which filtered light counts as black and stays so."""


@cache
def load_weights() -> FloatArray:
    """Return the weights of the network as the kernel reads them."""
    with files("lobewise.denoising").joinpath(WEIGHTS).open("rb") as file:
        arrays = np.load(file, allow_pickle=False)
        return flatten_weights({name: arrays[name].astype(np.float32) for name in arrays.files})


def refine_parts(
    frame: Frame,
    noisy: Sequence[FloatArray],
    parts: Sequence[FloatArray],
    surface: NDArray[np.bool_],
    whole: WholeImage,
    device: str,
) -> list[FloatArray]:
    """Return the filtered layers, scaled to the refined image.

    Parameters
    ----------
    frame, noisy, parts
        As in `collect_inputs`.
    surface : (height, width), bool
        Where a layer was filtered. Other pixels stay as they are.
    whole : WholeImage
    device : str
        A name from `list_devices`.
    """
    inputs = collect_inputs(frame, noisy, parts)
    axis, sharpness = find_lobes(frame, whole.tau)
    refined = refine_image(
        {**vars(inputs), "lobe_axis": axis, "lobe_sharpness": sharpness},
        load_weights(),
        brightness=whole.brightness,
        mean_log_depth=whole.mean_log_depth,
        shared=frame.noise_is_shared,
        device=device,
    )
    scattered = inputs.filtered > MAX_BLACK_RADIANCE
    factor = np.divide(refined, inputs.filtered, out=np.zeros_like(inputs.filtered), where=scattered)
    factor[~surface] = 1.0
    with np.errstate(invalid="ignore", over="ignore"):  # bad pixels of a part stay bad
        return [part * factor for part in parts]
