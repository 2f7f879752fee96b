"""Light of one image: in total, by part, and by the lobe that scattered it first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lobewise.errors import InputError, require_choice
from lobewise.images import ABSENT, FloatArray, Images, MaybeImage, as_images


@dataclass(frozen=True, repr=False)
class Radiance(Images):
    """Linear radiance of one image, in total and by part; also used for its variance.

    Parameters
    ----------
    color : array_like, shape (height, width, 3)
        Total radiance, linear, scene-referred, >= 0.
    diffuse, specular : array_like, shape (height, width, 3), optional
        The part whose first bounce was diffuse, or specular. What neither holds (``color - diffuse - specular``)
        is emission and background.
    direct, indirect : array_like, shape (height, width, 3), optional
        The part that came straight from a light to the first surface, and the rest.

    Raises
    ------
    InputError
        If an array is not real, has the wrong shape, no pixels, or not the size of the others.
    """

    color: FloatArray
    diffuse: FloatArray | None = None
    specular: FloatArray | None = None
    direct: FloatArray | None = None
    indirect: FloatArray | None = None

    if TYPE_CHECKING:  # what it takes is more than what it keeps

        def __init__(
            self,
            color: ArrayLike,
            diffuse: ArrayLike | None = None,
            specular: ArrayLike | None = None,
            direct: ArrayLike | None = None,
            indirect: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        if self.color is None:
            raise InputError("color", expected="an image", got="nothing", action="pass the noisy radiance")
        self.check_images(dict.fromkeys(("color", "diffuse", "specular", "direct", "indirect"), 3))

    @property
    def parts(self) -> tuple[FloatArray, FloatArray] | None:
        """Diffuse and specular radiance where they are known apart, else None."""
        return None if self.diffuse is None or self.specular is None else (self.diffuse, self.specular)


LOBES = ("diffuse", "subsurface", "volume", "glossy", "coat", "transmission")
"""What a layer of light can follow."""
DIFFUSE_LOBES = LOBES[:3]
"""Those that scatter so widely that they are compared like diffuse light; glossy and coat follow the specular lobe."""


@dataclass(frozen=True, repr=False)
class RadianceLayer(Images):
    """Light that was first scattered in one way, filtered by itself.

    Parameters
    ----------
    name : str
        In results.
    lobe : {"diffuse", "subsurface", "volume", "glossy", "coat", "transmission"}
        What it follows.
    radiance : array_like, shape (height, width, 3)
        Linear, albedo included, >= 0.
    albedo : array_like, shape (height, width, 3), optional
        What it is divided by while it is filtered, in [0, 1].
    half_a, half_b : array_like, shape (height, width, 3), optional
        The same from one half of the samples each.
    parts : mapping of str to array_like, shape (height, width, 3)
        Images that belong to it (its direct and its indirect light, the light of every lamp) and are filtered by its
        weights; what sums to the layer before does so after.

    Raises
    ------
    InputError
        If an array is not real or has another size or shape, or the lobe is unknown.
    """

    name: str
    lobe: str
    radiance: FloatArray
    albedo: MaybeImage = ABSENT
    half_a: MaybeImage = ABSENT
    half_b: MaybeImage = ABSENT
    parts: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_choice(f"layer {self.name!r}, lobe", self.lobe, LOBES)
        if self.radiance is None:
            raise InputError(f"layer {self.name!r}", expected="an image", got="nothing", action="leave the layer out")
        self.check_images(dict.fromkeys(("radiance", "albedo", "half_a", "half_b"), 3))
        object.__setattr__(self, "parts", as_images(f"layer {self.name!r}, part", self.parts, self.shape))

    @property
    def is_diffuse(self) -> bool:
        """Whether it is compared like diffuse light."""
        return self.lobe in DIFFUSE_LOBES

    @property
    def is_transmitted(self) -> bool:
        """Whether it is compared by normals: the way of light through a surface hangs on those behind it as well."""
        return self.lobe == "transmission"


def sum_layers(layers: Sequence[RadianceLayer], field: str, *, diffuse: bool) -> FloatArray | None:
    """Return the sum of one image (``radiance``, ``albedo``, ``half_a``, ``half_b``) of the layers of one kind.

    None where there is no such layer, or one lacks the image.
    """
    images = [getattr(layer, field) for layer in layers if layer.is_diffuse == diffuse]
    if not images or any(image is None for image in images):
        return None
    return np.asarray(np.sum(images, axis=0, dtype=np.float32))
