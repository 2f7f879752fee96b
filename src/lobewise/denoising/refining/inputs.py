"""What the refining network reads of a frame whose layers are filtered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lobewise.denoising.bad_pixels import blacken_bad, find_good
from lobewise.frame import FloatArray, Frame, GBuffer
from lobewise.guides.lobe_fields import make_sg_field
from lobewise.lobes.vectors import LUMINANCE

MIN_ALBEDO_SUM = 1e-4
"""Sum of both luminances up to which no lobe has a share of the albedo."""


@dataclass(frozen=True, kw_only=True)
class RefinementInputs:
    """A frame as the refining network reads it; float32, (height, width, 3) unless said otherwise.

    Parameters
    ----------
    noisy : array
        Sum of the samples of all layers, fireflies bounded, finite and >= 0.
    filtered : array
        Sum of the filtered layers, finite and >= 0.
    albedo : array, optional
        Albedo of all lobes together, in [0, 1].
    normal : array, optional
        Shading normal, 0 where there is no surface; as a mean over the pixel's area it is shorter than 1.
    depth : (height, width), optional
        Distance along the ray, 0 where there is no surface.
    roughness : (height, width), optional
        Microfacet alpha, the geometric mean of both directions, in [0, 1].
    specular_share : (height, width), optional
        Luminance of the specular albedo over that of both albedos, in [0, 1].
    change : array, optional
        Half the difference between both halves of the samples, >= 0: about one standard deviation of the noise.
    """

    noisy: FloatArray
    filtered: FloatArray
    albedo: FloatArray | None = None
    normal: FloatArray | None = None
    depth: FloatArray | None = None
    roughness: FloatArray | None = None
    specular_share: FloatArray | None = None
    change: FloatArray | None = None


def collect_inputs(frame: Frame, noisy: Sequence[FloatArray], parts: Sequence[FloatArray]) -> RefinementInputs:
    """Return what the refining network reads.

    Parameters
    ----------
    frame : Frame
        The noisy frame.
    noisy, parts : sequence of arrays, shape (height, width, 3)
        Samples of every layer without fireflies, and the filtered layers. Values that are not finite count as no light
        of a filtered layer. Where the samples are not finite, the filtered light stands for them.
    """
    guides = frame.gbuffer
    filtered = sum_light(parts)
    with np.errstate(invalid="ignore", over="ignore"):
        samples: FloatArray = noisy[0] if len(noisy) == 1 else np.add.reduce(list(noisy), dtype=np.float32)
    samples = np.where(find_good(samples)[..., None], np.maximum(samples, np.float32(0.0)), filtered)
    diffuse = guides.diffuse_albedo if guides.mean_diffuse_albedo is None else guides.mean_diffuse_albedo
    specular = guides.specular_albedo if guides.mean_specular_albedo is None else guides.mean_specular_albedo
    return RefinementInputs(
        noisy=samples,
        filtered=filtered,
        albedo=_sum_albedos(diffuse, specular),
        normal=_replace_bad(guides.normal if guides.mean_normal is None else guides.mean_normal),
        depth=_replace_bad(guides.depth),
        roughness=_find_roughness(guides),
        specular_share=_find_specular_share(diffuse, specular),
        change=_find_change(frame),
    )


def find_lobes(frame: Frame, tau: float) -> tuple[FloatArray | None, FloatArray | None]:
    """Return axis and base-2 logarithm of the sharpness of the specular lobes, 0 where there is none.

    None both where the frame has no roughness, or no camera with places of surfaces.
    """
    if frame.camera is None or not frame.is_placed or frame.gbuffer.alpha_u is None:
        return None, None
    field = make_sg_field(frame.gbuffer, frame.camera, tau=tau, diffuse_fallback=False)
    known = field.valid & np.isfinite(field.sharpness)
    sharpness = np.where(known, np.log2(np.maximum(field.sharpness, np.float32(1e-6))), np.float32(0.0))
    return np.where(known[..., None], field.axis, np.float32(0.0)), np.asarray(sharpness, dtype=np.float32)


def sum_light(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the sum of the parts, finite and >= 0."""
    total = blacken_bad(parts[0])
    for part in parts[1:]:
        total = total + blacken_bad(part)
    return np.maximum(blacken_bad(total), np.float32(0.0))


def _replace_bad(image: FloatArray | None) -> FloatArray | None:
    return None if image is None else np.where(np.isfinite(image), image, np.float32(0.0))


def _sum_albedos(diffuse: FloatArray | None, specular: FloatArray | None) -> FloatArray | None:
    known = [albedo for albedo in (_replace_bad(diffuse), _replace_bad(specular)) if albedo is not None]
    if not known:
        return None
    total = known[0] if len(known) == 1 else known[0] + known[1]
    return np.clip(total, np.float32(0.0), np.float32(1.0))


def _find_roughness(guides: GBuffer) -> FloatArray | None:
    along, across = _replace_bad(guides.alpha_u), _replace_bad(guides.alpha_v)
    if along is None or across is None:
        return along if across is None else across
    return np.asarray(np.sqrt(np.maximum(along * across, np.float32(0.0))), dtype=np.float32)


def _find_specular_share(diffuse: FloatArray | None, specular: FloatArray | None) -> FloatArray | None:
    diffuse, specular = _replace_bad(diffuse), _replace_bad(specular)
    if diffuse is None or specular is None:
        return None
    weights = np.array(LUMINANCE, dtype=np.float32)
    first, second = np.maximum(diffuse, np.float32(0.0)) @ weights, np.maximum(specular, np.float32(0.0)) @ weights
    return np.asarray(second / np.maximum(first + second, np.float32(MIN_ALBEDO_SUM)), dtype=np.float32)


def _find_change(frame: Frame) -> FloatArray | None:
    if frame.half_a is None or frame.half_b is None:
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        change = np.abs(np.float32(0.5) * (frame.half_a.color - frame.half_b.color))
    return blacken_bad(change)
