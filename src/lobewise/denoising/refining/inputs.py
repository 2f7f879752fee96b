"""What the refining network reads of a frame whose layers are filtered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise import engine
from lobewise.backend.pointwise import give_channels
from lobewise.denoising.bad_pixels import blacken_bad
from lobewise.filters.refinement.steps import define_inputs, define_known_lobes
from lobewise.guides.lobe_fields import make_sg_field
from lobewise.records.frame import FloatArray, Frame

MIN_ALBEDO_SUM = 1e-4
"""Sum of both luminances up to which no lobe has a share of the albedo."""
MIN_KNOWN_SHARPNESS = 1e-6
"""Smallest sharpness of a lobe."""


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


def collect_inputs(
    frame: Frame,
    noisy: Sequence[FloatArray],
    parts: Sequence[FloatArray],
    rest: FloatArray | None = None,
) -> RefinementInputs:
    """Return what the refining network reads.

    Parameters
    ----------
    frame : Frame
        The noisy frame.
    noisy, parts : sequence of arrays, shape (height, width, 3)
        Samples of every layer without fireflies, and the filtered layers. Values that are not finite count as no light
        of a filtered layer. Where the samples are not finite, the filtered light stands for them.
    rest : array, shape (height, width, 3), optional
        The light that no surface scatters.
    """
    guides, a, b = frame.gbuffer, frame.half_a, frame.half_b
    halves = {} if a is None or b is None else {"half_a": a.color, "half_b": b.color}
    images: dict[str, Any] = {
        **{f"noisy{number}": image for number, image in enumerate(noisy)},
        **{f"part{number}": image for number, image in enumerate(parts)},
        "rest": rest,
        "diffuse": guides.diffuse_albedo if guides.mean_diffuse_albedo is None else guides.mean_diffuse_albedo,
        "specular": guides.specular_albedo if guides.mean_specular_albedo is None else guides.mean_specular_albedo,
        "normal": guides.normal if guides.mean_normal is None else guides.mean_normal,
        "depth": guides.depth,
        "alpha_u": guides.alpha_u,
        "alpha_v": guides.alpha_v,
        **halves,
    }

    def knows(*names: str) -> bool:
        return all(images.get(name) is not None for name in names)

    is_known = {
        "albedo": knows("diffuse") or knows("specular"),
        "normal": knows("normal"),
        "depth": knows("depth"),
        "roughness": knows("alpha_u") or knows("alpha_v"),
        "specular_share": knows("diffuse", "specular"),
        "change": knows("half_a", "half_b"),
    }
    names, text = ["noisy", "filtered", *(name for name, known in is_known.items() if known)], "what the network reads"
    inputs = engine.pixels(define_inputs, images, {}, MIN_ALBEDO_SUM, names=names, text=text)
    return RefinementInputs(**dict(zip(names, inputs, strict=True)))


def compute_lobes(frame: Frame, tau: float) -> tuple[FloatArray | None, FloatArray | None]:
    """Return axis and base-2 logarithm of the sharpness of the specular lobes, 0 where there is none.

    None both where the frame has no roughness, or no camera with places of surfaces.
    """
    if frame.camera is None or not frame.is_placed or frame.gbuffer.alpha_u is None:
        return None, None
    field = make_sg_field(frame.gbuffer, frame.camera, tau=tau, diffuse_fallback=False)
    images = {**give_channels("axis", field.axis), "sharpness": field.sharpness, "valid": field.valid}
    names, text = ["lobe_axis", "lobe_sharpness"], "lobes that the network reads"
    axis, sharpness = engine.pixels(define_known_lobes, images, {}, MIN_KNOWN_SHARPNESS, names=names, text=text)
    return axis, sharpness


def sum_parts(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the sum of the parts, finite and >= 0."""
    total = blacken_bad(parts[0])
    for part in parts[1:]:
        total = total + blacken_bad(part)
    return np.maximum(blacken_bad(total), np.float32(0.0))
