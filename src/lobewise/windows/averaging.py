"""Average a denoised frame with its denoised neighbours in time: what a denoiser smears differs from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lobewise.filters.windows.weighing import compare_denoised
from lobewise.frame import FloatArray, Result
from lobewise.windows.gathering import Neighbour
from lobewise.windows.shots import Shot


def average_denoised(shot: Shot, shots: Mapping[int, Shot], near: Mapping[int, Neighbour]) -> Result:
    """Return a frame denoised by itself, averaged with its neighbours denoised by themselves.

    A neighbour counts where it shows the same surface, and less the more its image differs. All images of a frame have
    the weights of its total, so that what summed to the total still does.

    Parameters
    ----------
    shot : Shot
    shots : mapping of int to Shot
        All frames by number.
    near : mapping of int to Neighbour
        The neighbours by number.
    """
    own = shot.alone
    total, others = np.ones(own.image.shape[:2], np.float32), []
    for number, neighbour in near.items():
        image, agreement = neighbour.gather_guide(shots[number].alone.image)
        weight = agreement * compare_denoised(own.image, image)
        total = total + weight
        others.append((neighbour, shots[number].alone, weight))

    def average(first: FloatArray, name: str, group: str = "") -> FloatArray:
        mean = first
        for neighbour, other, weight in others:
            second = getattr(other, group).get(name) if group else getattr(other, name)
            if second is not None:
                values, _ = neighbour.gather_guide(second)
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
