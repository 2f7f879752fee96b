"""What each similarity and each quality is: one record for each name, which all other code asks instead of the name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

MAX_SCALE_PIXELS = 16
"""Largest distance between neighbouring shaded pixels of a sparse frame."""

QualityName = Literal["fast", "balanced", "high", "best"]
SimilarityName = Literal["normal", "sg", "sg_mixture", "ggx"]
FormName = Literal["full", "separable", "atrous"]

FORM_NAMES: tuple[FormName, ...] = get_args(FormName)

DEFAULT_SIMILARITY: SimilarityName = "ggx"
"""Similarity of "auto" for the quality "fast" where the frame has lobes: the winner of
benchmarks/results/similarities.json."""
GUIDED_SIMILARITY: SimilarityName = "sg"
"""The same for passes that are guided by the noise. There a covariance tells no more than a round lobe: on the frames
of tests/images the mean error of "high" is the same with both."""


@dataclass(frozen=True, kw_only=True)
class Similarity:
    """What a similarity compares on specular pixels, and which guides it needs for that.

    Parameters
    ----------
    name : str
        Its name in the settings.
    compares : str
        What it compares, in words that follow "comparing".
    needs : tuple of str
        Images of the G-buffer that a frame must have.
    has_lobes : bool
        Whether it compares reflection lobes, and needs the camera, the roughness and a place for that.
    has_covariance : bool
        Whether a lobe is a covariance across an axis, so that an anisotropic lobe keeps its direction.
    is_mixture : bool
        Whether several spherical Gaussians stand for a lobe.
    """

    name: SimilarityName
    compares: str
    needs: tuple[str, ...]
    has_lobes: bool = True
    has_covariance: bool = False
    is_mixture: bool = False


@dataclass(frozen=True, kw_only=True)
class Quality:
    """What a quality does with the noise, and what that costs.

    Parameters
    ----------
    name : str
        Its name in the settings.
    forms : tuple of str
        Forms of the kernel that it has.
    reads_halves : bool
        Whether several passes over both halves of the samples filter a frame, guided by what they tell of the noise.
    refines : bool
        Whether a network refines the filtered image; it reads the roughness.
    needs_oidn : bool
        Whether Open Image Denoise takes part, with more and slower calls than for "auto".
    work_bytes_per_pixel : int
        Memory that the filters hold beside the frame, bytes; measured (docs/developers/bands.md).
    seconds_per_megapixel : float
        Half of the processor time at radius 8 with diffuse and specular light apart: the time on two threads; measured
        (``benchmarks/results/budget.json``).
    """

    name: QualityName
    forms: tuple[FormName, ...] = ("full",)
    reads_halves: bool
    refines: bool = False
    needs_oidn: bool = False
    work_bytes_per_pixel: int
    seconds_per_megapixel: float


_LOBE_NEEDS = ("normal", "alpha_u")

SIMILARITIES: Mapping[str, Similarity] = {
    each.name: each
    for each in (
        Similarity(name="normal", compares="which way surfaces face", needs=("normal",), has_lobes=False),
        Similarity(name="sg", compares="what surfaces reflect", needs=_LOBE_NEEDS),
        Similarity(name="sg_mixture", compares="what surfaces reflect", needs=_LOBE_NEEDS, is_mixture=True),
        Similarity(name="ggx", compares="what surfaces reflect", needs=_LOBE_NEEDS, has_covariance=True),
    )
}
QUALITIES: Mapping[str, Quality] = {
    each.name: each
    for each in (
        Quality(
            name="fast", forms=FORM_NAMES, reads_halves=False, work_bytes_per_pixel=250, seconds_per_megapixel=0.58
        ),
        Quality(name="balanced", reads_halves=True, work_bytes_per_pixel=480, seconds_per_megapixel=1.27),
        Quality(name="high", reads_halves=True, refines=True, work_bytes_per_pixel=670, seconds_per_megapixel=2.75),
        Quality(name="best", reads_halves=True, needs_oidn=True, work_bytes_per_pixel=480, seconds_per_megapixel=1.27),
    )
}


def get_similarity(name: str) -> Similarity:
    """Return the record of a similarity."""
    return SIMILARITIES[name]


def get_quality(name: str) -> Quality:
    """Return the record of a quality."""
    return QUALITIES[name]
