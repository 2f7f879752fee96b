"""The constants of the chains: their meaning, and their values for a frame."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.exporting.shaders.language import Field, lay_out
from lobewise.exporting.shaders.passes import Constant
from lobewise.guides.lobe_fields import NORMAL_ERROR, default_tau
from lobewise.settings import DenoiseSettings, ResolvedSettings, TemporalSettings
from lobewise.upsampling import DEFAULT_RADIUS

_PIXEL_TAU = f"sqrt(pixel_angle^2 + {2.0 * NORMAL_ERROR:g}^2)"

_CAMERA = (
    Constant("eye", "vec3", "position of the camera, world units", python="camera.position"),
    Constant(
        "pixel_angle", "float", "angle of a pixel, radians", python="2 tan(fov_y / 2) / height: camera.get_pixel_angle"
    ),
)
_BEFORE = (
    Constant("before", "vec3", "position of the camera in the frame before", python="previous.position"),
    Constant(
        "plane_sigma",
        "float",
        "how far a surface may lie off its plane of a frame ago: a standard deviation, pixel footprints",
        python=f"{TemporalSettings.plane_sigma:g}",
    ),
    Constant("before_forward", "vec3", "unit direction in which that camera looked", python="previous.forward"),
    Constant(
        "tau_between",
        "float",
        "band-limit of lobes that are compared between frames, radians",
        python=_PIXEL_TAU,
    ),
    Constant(
        "before_right",
        "vec3",
        "unit vector to the right of that camera, over the tangent of half its horizontal angle",
        python="previous.right / tan(fov_x / 2)",
    ),
    Constant(
        "beta_between",
        "float",
        "exponent of the similarity of a pixel's lobe and the lobe a frame ago",
        python=f"{TemporalSettings.beta:g}",
    ),
    Constant(
        "before_up",
        "vec3",
        "unit vector upwards from that camera, over the tangent of half its vertical angle",
        python="previous.up / tan(fov_y / 2)",
    ),
    Constant(
        "memory",
        "float",
        "share of the history that stays, 0 to 1; 0 at a cut and in the first frame",
        python=f"{TemporalSettings.memory:g}",
    ),
)
_SIZE = (
    Constant("width", "int", "width of the image, pixels", python="frame.width"),
    Constant("height", "int", "height of the image, pixels", python="frame.height"),
)
_KERNEL = (
    Constant(
        "screen_sigma",
        "float",
        "standard deviation of the Gaussian over the distance on the screen, pixels",
        python="radius min(1, 0.6 (8 / spp)^(1/4)), at least 0.5",
    ),
    Constant(
        "position_sigma",
        "float",
        "standard deviation of the Gaussian over the distance in the scene, pixel footprints",
        python=f"{DenoiseSettings.position_sigma:g}",
    ),
    Constant(
        "beta",
        "float",
        "exponent of the similarity of specular lobes: larger keeps more detail and more noise",
        python="2.5 spp^(1/3), from 1 to 64",
    ),
    Constant("diffuse_beta", "float", "the same for diffuse lobes", python="as beta"),
    Constant(
        "tau",
        "float",
        "band-limit of lobes, radians: its square is added to the variances of every lobe",
        python=f"0.03 sqrt(4 / spp), at least {_PIXEL_TAU}",
    ),
)
_RADIUS = Constant("radius", "int", "pixels from the centre to the edge of the kernel", python="8")
_HISTORY = (
    Constant(
        "growth",
        "float",
        "how the kernel narrows as the history grows, 0 to 1",
        python=f"TemporalSettings.strictness: {TemporalSettings.strictness:g}",
    ),
    Constant(
        "own",
        "float",
        "weight of a pixel's own sample, at least 1; samples of other pixels that match fully have weight 1",
        python="1 + 0.005 / (relative variance of the samples)",
    ),
)

FILTER_CONSTANTS = (*_CAMERA, *_SIZE, *_KERNEL, _RADIUS)
HISTORY_CONSTANTS = (*_CAMERA, *_BEFORE, *_SIZE, *_KERNEL, _RADIUS, *_HISTORY)

_SPARSE = (
    Constant("scale", "int", "distance of neighbouring samples, pixels", python="sparse_frame.scale"),
    Constant("column", "int", "column of the shaded pixel in its block, from 0", python="sparse_frame.place[1]"),
    Constant("row", "int", "row of the shaded pixel in its block, from 0", python="sparse_frame.place[0]"),
    Constant("columns", "int", "samples across", python="ceil((width - column) / scale)"),
    Constant("rows", "int", "samples down", python="ceil((height - row) / scale)"),
    Constant(
        "known_radius",
        "int",
        "samples from the centre to the edge of the kernel where a pixel has a history, at most radius",
        python=f"{TemporalSettings.history_radius}",
    ),
    Constant(
        "known_sigma",
        "float",
        "standard deviation of the Gaussian over the distance on the screen there, pixels, at most screen_sigma",
        python="screen_sigma * known_radius / radius",
    ),
)
_SAMPLE_RADIUS = replace(
    _RADIUS, comment="samples from the centre to the edge of the kernel", python=f"{DEFAULT_RADIUS}"
)
UPSAMPLE_CONSTANTS = (*_CAMERA, *_BEFORE, *_SIZE, *_KERNEL, _SAMPLE_RADIUS, *_HISTORY, *_SPARSE)


def compute_constants(
    camera: Camera,
    size: tuple[int, int],
    settings: ResolvedSettings,
    *,
    previous: Camera | None = None,
    temporal: TemporalSettings | None = None,
    own: float = 1.0,
    scale: int = 1,
    place: tuple[int, int] = (0, 0),
) -> dict[str, Any]:
    """Return the constants of a frame by name, numbers and arrays of 3.

    Parameters
    ----------
    camera : Camera
    size : (int, int)
        Height and width of the image.
    settings : ResolvedSettings
        The settings of a result of `lobewise.denoise` or `TemporalFilter.add`.
    previous : Camera, optional
        Camera of the frame before. Without it the history counts for nothing.
    temporal : TemporalSettings, optional
    own : float
        Result of `lobewise.temporal.recipe.compute_own_weight`.
    scale, place
        Those of a `SparseFrame`.
    """
    height, width = size
    temporal = temporal or TemporalSettings()
    before = camera if previous is None else previous
    known = min(temporal.history_radius, settings.radius)
    half_width, half_height = before.get_half_extent(width, height)
    return {
        "eye": camera.position,
        "pixel_angle": camera.get_pixel_angle(height),
        "before": before.position,
        "before_forward": before.forward,
        "before_right": (before.right - before.shift[0] * before.forward) / half_width,
        "before_up": (before.up - before.shift[1] * before.forward) / half_height,
        "plane_sigma": temporal.plane_sigma,
        "tau_between": default_tau(camera, height),
        "beta_between": temporal.beta,
        "memory": 0.0 if previous is None else temporal.memory,
        "growth": temporal.strictness,
        "own": own,
        "width": width,
        "height": height,
        "screen_sigma": settings.screen_sigma,
        "position_sigma": settings.position_sigma,
        "beta": settings.beta,
        "diffuse_beta": settings.diffuse_beta,
        "tau": settings.tau,
        "radius": settings.radius,
        "scale": scale,
        "column": place[1],
        "row": place[0],
        "columns": -(-(width - place[1]) // scale),
        "rows": -(-(height - place[0]) // scale),
        "known_radius": known,
        "known_sigma": settings.screen_sigma * known / settings.radius if known else settings.screen_sigma,
    }


def pack_constants(fields: Sequence[Field], values: Mapping[str, Any]) -> bytes:
    """Return the block of constants, as the shaders read it from binding 0."""
    offsets = lay_out(fields)
    block = bytearray(offsets[""])
    for field in fields:
        numbers: NDArray[Any] = np.atleast_1d(np.asarray(values[field.name]))
        form = f"<{numbers.size}{'i' if field.kind.startswith('i') else 'f'}"
        struct.pack_into(form, block, offsets[field.name], *numbers.tolist())
    return bytes(block)
