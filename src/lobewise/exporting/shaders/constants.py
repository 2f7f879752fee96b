"""The constants of the chains: their meaning, and their values for a frame."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.exporting.shaders.language import Field, lay_out
from lobewise.exporting.shaders.passes import Constant
from lobewise.guides.lobe_fields import NORMAL_ERROR, default_tau
from lobewise.recipes.upsampling import DEFAULT_RADIUS
from lobewise.records.camera import Camera
from lobewise.settings import DenoiseSettings, ResolvedSettings, TemporalSettings, list_knobs

_PIXEL_TAU = f"sqrt(pixel_angle^2 + {2.0 * NORMAL_ERROR:g}^2)"


def declare(kind: type, setting: str, *, name: str = "", type: str = "float", python: str = "") -> Constant:
    """Return a setting of the library as a constant; ``python`` says how it is chosen where it is automatic."""
    knob = list_knobs(kind)[setting]
    return Constant(name or setting, type, knob.meaning, python or f"{knob.default:g}")


_ACROSS = "over the tangent of half its"
_CAMERA = (
    Constant("eye", "vec3", "position of the camera, world units", "camera.position"),
    Constant("pixel_angle", "float", "angle of a pixel, radians", "2 tan(fov_y / 2) / height: camera.get_pixel_angle"),
)
_BEFORE = (
    Constant("before", "vec3", "position of the camera in the frame before", "previous.position"),
    declare(TemporalSettings, "plane_sigma"),
    Constant("before_forward", "vec3", "unit direction in which that camera looked", "previous.forward"),
    Constant("tau_between", "float", "band-limit of lobes that are compared between frames, radians", _PIXEL_TAU),
    Constant(
        "before_right",
        "vec3",
        f"unit vector to the right of that camera, {_ACROSS} horizontal angle",
        "previous.right / tan(fov_x / 2)",
    ),
    declare(TemporalSettings, "beta", name="beta_between"),
    Constant(
        "before_up",
        "vec3",
        f"unit vector upwards from that camera, {_ACROSS} vertical angle",
        "previous.up / tan(fov_y / 2)",
    ),
    declare(TemporalSettings, "memory", python=f"{TemporalSettings.memory:g}; 0 at a cut and in the first frame"),
)
_SIZE = (
    Constant("width", "int", "width of the image, pixels", "frame.width"),
    Constant("height", "int", "height of the image, pixels", "frame.height"),
)
_KERNEL = (
    declare(DenoiseSettings, "screen_sigma", python="radius min(1, 0.6 (8 / spp)^(1/4)), at least 0.5"),
    declare(DenoiseSettings, "position_sigma"),
    declare(DenoiseSettings, "beta", python="2.5 spp^(1/3), from 1 to 64"),
    declare(DenoiseSettings, "diffuse_beta", python="as beta"),
    declare(DenoiseSettings, "tau", python=f"0.03 sqrt(4 / spp), at least {_PIXEL_TAU}"),
)
_RADIUS = declare(DenoiseSettings, "radius", type="int")
_HISTORY = (
    declare(TemporalSettings, "strictness", name="growth"),
    Constant(
        "own",
        "float",
        "weight of a pixel's own sample, at least 1; samples of other pixels that match fully have weight 1",
        "1 + 0.005 / (relative variance of the samples)",
    ),
)
_SPARSE = (
    Constant("scale", "int", "distance of neighbouring samples, pixels", "sparse_frame.scale"),
    Constant("column", "int", "column of the shaded pixel in its block, from 0", "sparse_frame.place[1]"),
    Constant("row", "int", "row of the shaded pixel in its block, from 0", "sparse_frame.place[0]"),
    Constant("columns", "int", "samples across", "ceil((width - column) / scale)"),
    Constant("rows", "int", "samples down", "ceil((height - row) / scale)"),
    declare(TemporalSettings, "history_radius", name="known_radius", type="int"),
    Constant("known_sigma", "float", "screen_sigma of that kernel, pixels", "screen_sigma * known_radius / radius"),
)
FILTER_CONSTANTS = (*_CAMERA, *_SIZE, *_KERNEL, _RADIUS)
HISTORY_CONSTANTS = (*_CAMERA, *_BEFORE, *_SIZE, *_KERNEL, _RADIUS, *_HISTORY)
UPSAMPLE_CONSTANTS = (
    *(*_CAMERA, *_BEFORE, *_SIZE, *_KERNEL),
    replace(_RADIUS, python=f"{DEFAULT_RADIUS}"),
    *(*_HISTORY, *_SPARSE),
)


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
        Result of `lobewise.recipes.temporal.recipe.compute_own_weight`.
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
        **{each.name: getattr(settings, each.name) for each in (*_KERNEL, _RADIUS)},
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
