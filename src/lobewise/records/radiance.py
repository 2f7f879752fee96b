"""Light of one image: in total, by part, and by the lobe that scattered it first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lobewise.errors import InputError, require_choice
from lobewise.records.images import ABSENT, FloatArray, Images, MaybeImage, as_images, name_maker
from lobewise.work.chunks import Chunk, run_chunks

MAX_EXCESS_SHARE = 0.02
"""Largest share of the image's light by which parts may exceed the image. Above it, they are not its parts."""


@dataclass(frozen=True, repr=False)
class Radiance(Images):
    """Linear radiance of one image, in total and by part; also used for its variance.

    Parameters
    ----------
    color : array_like, shape (height, width, 3)
        Total radiance, linear, scene-referred. It may be below 0, as colours outside of the gamut are.
    diffuse, specular : array_like, shape (height, width, 3), optional
        The light whose first bounce was diffuse, or specular. The rest, ``color - diffuse - specular``, is emission and
        background.
    direct, indirect : array_like, shape (height, width, 3), optional
        The light that came straight from a light source to the first surface, and the rest.

    Attributes
    ----------
    maker : str
        What makes arrays of the type that ``color`` had, see `lobewise.records.images.name_maker`. Results have this
        type.

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
    maker: ClassVar[str] = ""

    if TYPE_CHECKING:  # the constructor takes more types than the fields have

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
        names, color = ("color", "diffuse", "specular", "direct", "indirect"), self.color
        self.check_images(dict.fromkeys(names, 3), lights=names)
        maker = name_maker(color)
        if maker:
            object.__setattr__(self, "maker", maker)

    @property
    def parts(self) -> tuple[FloatArray, FloatArray] | None:
        """Diffuse and specular radiance; None if one of them is missing."""
        return None if self.diffuse is None or self.specular is None else (self.diffuse, self.specular)


LOBES = ("diffuse", "subsurface", "volume", "glossy", "coat", "transmission")
"""Kinds of first scattering that a layer of light can have."""
DIFFUSE_LOBES = LOBES[:3]
"""Kinds that scatter so widely that pixels are compared as for diffuse light. "glossy" and "coat" follow the specular
lobe."""


@dataclass(frozen=True, repr=False)
class RadianceLayer(Images):
    """Light with one kind of first scattering, which is filtered by itself.

    Parameters
    ----------
    name : str
        Name of the layer in results.
    lobe : {"diffuse", "subsurface", "volume", "glossy", "coat", "transmission"}
        Kind of the first scattering.
    radiance : array_like, shape (height, width, 3)
        Linear, albedo included.
    albedo : array_like, shape (height, width, 3), optional
        The radiance is divided by it before the filter and multiplied by it after, in [0, 1].
    half_a, half_b : array_like, shape (height, width, 3), optional
        The radiance from one half of the samples each.
    parts : mapping of str to array_like, shape (height, width, 3)
        Images that belong to the layer (its direct and its indirect light, the light of every lamp) and are filtered
        with its weights. Parts that sum to the layer before the filter also do so after it.

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
        lights = ("radiance", "half_a", "half_b")
        self.check_images(dict.fromkeys((*lights, "albedo"), 3), lights=lights)
        object.__setattr__(self, "parts", as_images(f"layer {self.name!r}, part", self.parts, self.shape))

    @property
    def is_diffuse(self) -> bool:
        """Whether its pixels are compared as for diffuse light."""
        return self.lobe in DIFFUSE_LOBES

    @property
    def is_transmitted(self) -> bool:
        """Whether its pixels are compared by normals: transmitted light also depends on the surfaces behind."""
        return self.lobe == "transmission"


def sum_layers(layers: Sequence[RadianceLayer], field: str, *, diffuse: bool) -> FloatArray | None:
    """Return the sum of the image ``field`` over the diffuse layers, or over all others.

    ``field`` is ``radiance``, ``albedo``, ``half_a`` or ``half_b``. The result is None where there is no such layer, or
    where a layer lacks the image.
    """
    images = [getattr(layer, field) for layer in layers if layer.is_diffuse == diffuse]
    if not images or any(image is None for image in images):
        return None
    return np.asarray(reduce(np.add, images))


def measure_excess(color: FloatArray, known: FloatArray) -> float:
    """Return the light of ``known`` above the image, as a share of the image's light."""
    sums: list[tuple[float, float]] = []

    def add(chunk: Chunk) -> None:
        light, apart = compare_light(color[chunk], known[chunk])
        above = np.maximum(-apart, np.float32(0.0))
        sums.append((float(light.sum(dtype=np.float64)), float(above.sum(dtype=np.float64))))

    run_chunks(add, *color.shape[:2])
    # The order of the threads must not change the sums.
    total, excess = (math.fsum(each) for each in zip(*sums, strict=True))
    return excess / total if total > 0.0 else 0.0


def compare_light(color: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an image and what it has beyond ``known``, both with 0 where one of the two is not finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        apart = color - known
        good = np.isfinite(apart)
    if good.all():
        return color, apart
    return np.where(good, color, np.float32(0.0)), np.where(good, apart, np.float32(0.0))
