"""Average a denoised frame with its denoised neighbours in time: what a denoiser smears differs from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lobewise.filters.windows.weighing import compare_denoised
from lobewise.recipes.windows.gathering import Shown
from lobewise.records.frame import FloatArray, Result


def average_denoised(own: Result, others: Sequence[tuple[Shown, Result]]) -> Result:
    """Return a denoised frame, averaged with its denoised neighbours.

    A neighbour counts where it shows the same surface, and less the more its image differs. All images of a frame have
    the weights of its total, so that what summed to the total still does.

    Parameters
    ----------
    own : Result
    others : sequence of Shown and Result
        Where the neighbours show the surfaces of the frame, and what denoising made of them.
    """
    total, weights = np.ones(own.image.shape[:2], np.float32), []
    for shown, other in others:
        image, agreement = shown.gather(other.image)
        weights.append(agreement * compare_denoised(own.image, image))
        total = total + weights[-1]

    def average(first: FloatArray, name: str, group: str = "") -> FloatArray:
        mean = first
        for (shown, other), weight in zip(others, weights, strict=True):
            second = getattr(other, group).get(name) if group else getattr(other, name)
            if second is not None:
                values, _ = shown.gather(second)
                mean = mean + (weight / total)[..., None] * (values - first)
        # Sampling between pixels overshoots beside strong contrast.
        return np.asarray(np.maximum(mean, np.minimum(first, np.float32(0.0))), np.float32)

    return replace(
        own,
        image=average(own.image, "image"),
        diffuse=None if own.diffuse is None else average(own.diffuse, "diffuse"),
        specular=None if own.specular is None else average(own.specular, "specular"),
        layers={name: average(image, name, "layers") for name, image in own.layers.items()},
        also={name: average(image, name, "also") for name, image in own.also.items()},
    )
