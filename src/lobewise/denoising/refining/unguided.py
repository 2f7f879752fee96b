"""Where the guides of a frame are noise: there an image that was filtered by its color alone is mixed in.

A filter that compares guides keeps apart whatever they keep apart. Out of focus, in fog, in hair and in grass the
normals of neighbouring pixels differ by chance, so that hardly any neighbour is like its pixel, and the noise stays.
A pixel is isolated if it is further from both its neighbours in the row than they are from each other. Of white noise
a third of the pixels are; edges, curved surfaces and textures wider than a pixel have hardly any. Where no surface is
known the light is looked at instead: a sky is smooth, and the light of fog is not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.refining.whole_image import RowSums
from lobewise.filters.specks import MIN_BLUR_RADIUS
from lobewise.guides.squares import average_square, compute_square_maximum
from lobewise.guides.surfaces import mark_surface_pixels
from lobewise.lobes.vectors import compute_image_luminance
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance

Mask = NDArray[np.bool_]

MIN_SQUARED_DIFFERENCE = 0.003
"""Squared difference of unit normals from which a pixel can be isolated, about 3 degrees."""
MIN_RELATIVE_DIFFERENCE = 0.1
"""Difference of luminance, over the larger one, from which a pixel without a surface can be isolated."""
MAX_SHARE = 0.4
"""Largest share of the image of the color alone where there are surfaces."""
SHARE_ISOLATED = 1.0 / 15.0
"""Share of isolated pixels, of all surfaces or of all pixels without one, from which `MAX_SHARE` is mixed in. Factor
and share were chosen on frames of Blender, LuxCore and Mitsuba outside of the validation kinds
(benchmarks/foreign/factory)."""
MIN_SHARE = 0.05
"""Largest share of an image below which the image of the color alone is not made: it takes half as long again."""
MIN_SHARE_WITHOUT_SURFACE = 0.01
"""Share of the pixels below which those without a surface say nothing of the whole image."""
NOISY_RADIUS, NOISY_FROM, NOISY_TO = 7, 0.08, 0.18
"""Radius of the square, pixels, and the shares of isolated ones among its pixels without a surface from which, and up
to which, the image of the color alone replaces theirs."""
DISC_RADIUS = 8
"""Distance, rows or columns, from light of no surface out of focus, within which such light is out of focus, too."""
LEFT_OUT = (
    "Guides are noise or a lens blurs lamps here, and bands leave out what helps: without bands an image filtered by "
    "its color alone is mixed in."
)
"""What a user of bands is told."""


def compute_unguided_share(color: FloatArray, guides: GBuffer) -> FloatArray:
    """Return the share of the image of the color alone at every pixel, (height, width), in [0, 1].

    Parameters
    ----------
    color : (height, width, 3)
        The noisy image.
    guides : GBuffer
        As the file has them: nothing stands in for missing ones.
    """
    isolated = _mark_isolated(color, guides)
    least = np.full(color.shape[:2], judge_guides(_count_rows(isolated)), np.float32)
    if isolated.surface.all():
        return least
    known = average_square(isolated.background.astype(np.float32), NOISY_RADIUS)
    noisy = average_square(isolated.noisy_background.astype(np.float32), NOISY_RADIUS)
    share = noisy / np.maximum(known, np.float32(1e-6))
    rise = np.clip((share - np.float32(NOISY_FROM)) / np.float32(NOISY_TO - NOISY_FROM), 0.0, 1.0)
    return np.where(isolated.surface, least, rise)


def limit_to_noise(
    share: FloatArray, rest: FloatArray, image: FloatArray, blur_radius: FloatArray | None
) -> FloatArray:
    """Return the share of the image of the color alone, (height, width), where part of the light met no surface.

    In focus that part has no noise and stays. A lens makes salt of it (`lobewise.filters.specks`), which guides do not
    tell apart: there the image of the color alone has at least the part's share.

    Parameters
    ----------
    share : (height, width)
        As `compute_unguided_share` has it.
    rest : (height, width, 3)
        Emission and background.
    image : (height, width, 3)
        The filtered image, ``rest`` included.
    blur_radius : (height, width), optional
        As `lobewise.GBuffer.blur_radius`.
    """
    light, tiny = compute_image_luminance(rest), np.float32(np.finfo(np.float32).tiny)
    part: FloatArray = np.clip(
        light / np.maximum(compute_image_luminance(image), tiny), np.float32(0.0), np.float32(1.0)
    )
    in_focus = share - share * part
    if blur_radius is None:
        return in_focus
    # The disc of a lamp lies before surfaces in focus, too: there most samples of a pixel meet the surface.
    blurred = blur_radius >= MIN_BLUR_RADIUS
    blurred |= compute_square_maximum(blurred & (light > 0.0), DISC_RADIUS)
    salted = np.where(blurred, np.maximum(share, part), in_focus)
    return np.where(np.isnan(blur_radius), share, salted)


def compute_salt_share(rest: FloatArray, image: FloatArray, blur_radius: FloatArray) -> FloatArray:
    """Return the share of the light that is the salt of lamps out of focus, (height, width); see `limit_to_noise`."""
    return limit_to_noise(np.zeros(image.shape[:2], np.float32), rest, image, blur_radius)


def count_isolated(color: FloatArray, guides: GBuffer) -> RowSums:
    """Return for each row what `judge_guides` reads, (height, 4): see `compute_unguided_share`."""
    return _count_rows(_mark_isolated(color, guides))


def judge_guides(rows: RowSums) -> float:
    """Return the share of the image of the color alone on surfaces, from 0 to `MAX_SHARE`.

    Parameters
    ----------
    rows : (height, 4)
        Pixels of surfaces, isolated ones among them, pixels without a surface, and isolated ones among these.
    """
    surfaces, noisy, others, noisy_others = map(float, rows.sum(axis=0))
    isolated = noisy / max(surfaces, 1.0)
    if others >= MIN_SHARE_WITHOUT_SURFACE * (surfaces + others):
        isolated = max(isolated, noisy_others / max(others, 1.0))
    return MAX_SHARE * min(isolated / SHARE_ISOLATED, 1.0)


class _Isolated(NamedTuple):
    """Pixels that see a surface; then those with both neighbours of their kind, and the isolated ones among these."""

    surface: Mask
    compared: Mask
    noisy: Mask
    background: Mask
    noisy_background: Mask


def _mark_isolated(color: FloatArray, guides: GBuffer) -> _Isolated:
    shape = color.shape[:2]
    if guides.normal is None or shape[1] < 3:
        nothing = np.zeros(shape, np.bool_)
        return _Isolated(nothing, nothing, nothing, nothing, nothing)
    surface = mark_surface_pixels(guides, shape)
    with np.errstate(invalid="ignore", over="ignore"):  # a bad pixel is isolated from nothing
        compared, noisy = _mark_odd(guides.normal, surface, MIN_SQUARED_DIFFERENCE, is_relative=False)
        if surface.all():
            nothing = np.zeros(shape, np.bool_)
            return _Isolated(surface, compared, noisy, nothing, nothing)
        light = compute_image_luminance(color)
        others = _mark_odd(light[..., None], ~surface, MIN_RELATIVE_DIFFERENCE**2, is_relative=True)
    return _Isolated(surface, compared, noisy, *others)


def _count_rows(isolated: _Isolated) -> RowSums:
    return np.stack([np.count_nonzero(mask, axis=1) for mask in isolated[1:]], axis=1).astype(np.float64)


def _mark_odd(image: FloatArray, mask: Mask, least: float, *, is_relative: bool) -> tuple[Mask, Mask]:
    """Return which pixels have both neighbours in the row inside the mask, and which of them are isolated.

    ``least`` is the smallest squared difference to both neighbours; with ``is_relative`` over the largest square of the
    three.
    """
    left, middle, right = image[:, :-2], image[:, 1:-1], image[:, 2:]
    compared, odd = np.zeros(mask.shape, np.bool_), np.zeros(mask.shape, np.bool_)
    compared[:, 1:-1] = mask[:, :-2] & mask[:, 1:-1] & mask[:, 2:]
    near = np.minimum(_square(left - middle), _square(right - middle))
    unit = np.maximum(np.maximum(_square(left), _square(middle)), _square(right)) if is_relative else np.float32(1.0)
    odd[:, 1:-1] = compared[:, 1:-1] & (near > _square(right - left)) & (near > np.float32(least) * unit)
    return compared, odd


def _square(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...k,...k->...", vectors, vectors))


def forget_guides(frame: Frame) -> Frame:
    """Return a frame of the color alone, as filters can take it."""
    color, half_a, half_b = (
        None if radiance is None else Radiance(radiance.color)
        for radiance in (frame.radiance, frame.half_a, frame.half_b)
    )
    assert color is not None
    bare = Frame(color, half_a=half_a, half_b=half_b, spp=frame.spp, noise_is_shared=frame.noise_is_shared)
    normal = np.zeros((*frame.shape, 3), np.float32)
    normal[..., 2] = 1.0
    return replace(bare, gbuffer=GBuffer(normal=normal))
