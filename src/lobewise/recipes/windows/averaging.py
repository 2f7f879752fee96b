"""Average a denoised frame with its denoised neighbours in time: what a denoiser smears differs from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lobewise.filters.windows.weighing import compare_denoised, compute_brightness_factor
from lobewise.recipes.windows.gathering import Shown
from lobewise.records.frame import FloatArray, Result
from lobewise.records.images import list_packed

MIN_UNIT = 0.05
"""Added to the albedo that light is divided by. As a least albedo, as for samples, films have up to 3 % more error."""


class Windowed(NamedTuple):
    """What denoising made of a joined frame, and the albedo of all its light, (height, width, 3), if it is known."""

    result: Result
    albedo: FloatArray | None

    @property
    def unit(self) -> FloatArray:
        """What light is divided by, (height, width, 3)."""
        return np.ones_like(self.result.image) if self.albedo is None else self.albedo + np.float32(MIN_UNIT)


def average_denoised(own: Windowed, others: Sequence[tuple[Shown, Windowed]]) -> Result:
    """Return a denoised frame, averaged with its denoised neighbours.

    Light over the albedo is averaged: textures have no part in it, and are not blurred. A neighbour counts where it
    shows the same surface, and less the more its image differs. All images of a frame have the weights of its total, so
    that what summed to the total still does. Images that are no light, such as the opacity, are averaged as they are.

    Parameters
    ----------
    own : Windowed
    others : sequence of Shown and Windowed
        Where the neighbours show the surfaces of the frame, and what denoising made of them.
    """
    unit, units = own.unit, [other.unit for _, other in others]
    total, weights, factors = np.ones(own.result.image.shape[:2], np.float32), [], []
    for (shown, other), its_unit in zip(others, units, strict=True):
        light, agreement = shown.gather(other.result.image / its_unit)
        factors.append(compute_brightness_factor(own.result.image, light * unit, agreement))
        weights.append(agreement * compare_denoised(own.result.image, light * (factors[-1] * unit)))
        total = total + weights[-1]

    def average(first: FloatArray, name: str, group: str = "", *, is_light: bool = True) -> FloatArray:
        mean = first
        for (shown, other), its_unit, weight, factor in zip(others, units, weights, factors, strict=True):
            second = getattr(other.result, group).get(name) if group else getattr(other.result, name)
            if second is not None:
                values, _ = shown.gather(second / its_unit if is_light else second)
                share = (weight / total)[..., None] if first.ndim == 3 else weight / total
                mean = mean + share * ((values * (factor * unit) if is_light else values) - first)
        # Sampling between pixels overshoots beside strong contrast.
        return np.asarray(np.maximum(mean, np.minimum(first, np.float32(0.0))), np.float32)

    def average_all(group: str) -> dict[str, FloatArray]:
        images: dict[str, FloatArray] = getattr(own.result, group)
        lights = {name: len(list_packed(name)) == 1 for name in images}
        return {name: average(image, name, group, is_light=lights[name]) for name, image in images.items()}

    diffuse, specular, alpha = own.result.diffuse, own.result.specular, own.result.alpha
    return replace(
        own.result,
        image=average(own.result.image, "image"),
        diffuse=None if diffuse is None else average(diffuse, "diffuse"),
        specular=None if specular is None else average(specular, "specular"),
        alpha=None if alpha is None else np.minimum(average(alpha, "alpha", is_light=False), np.float32(1.0)),
        layers=average_all("layers"),
        also=average_all("also"),
    )
