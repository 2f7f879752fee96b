"""The kernel that makes what the refining network reads: light on a compressed scale, guides, and what is known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.planes import C, X, Y
from lobewise.filters.refinement.shape import PLANES, VECTORS
from lobewise.filters.scheduling import schedule_stencil

MIN_TINT = 0.1
"""Smallest albedo that light is divided by."""
LIGHT_GAIN, LIGHT_SCALE = 10.0, 0.5
"""Light is compressed to ``LIGHT_SCALE * ln(1 + LIGHT_GAIN * light / brightness)``."""
MAX_LIGHT = 1e20
"""Largest light over the tint and over the brightness of the image: sums of larger numbers might overflow."""
MAX_LOG_DEPTH = 4.0
"""Largest natural logarithm of the depth over the mean depth, on both sides; also that of pixels without a surface."""
DEPTH_PLANE_SCALE = 0.25
NORMAL_SCALE, DEPTH_SCALE, LOBE_SCALE = 0.66, 1.2, 0.37
"""Factors of the vectors that similarities compare, so that exponents near 1 are useful."""
OPTIONAL = {
    "albedo": COLORS,
    "normal": 3,
    "depth": 0,
    "roughness": 0,
    "specular_share": 0,
    "change": COLORS,
    "lobe_axis": 3,
    "lobe_sharpness": 0,
}
"""Images that a frame may lack, and their channels; 0 for images of two axes."""


@dataclass(frozen=True)
class PlanesKey:
    """Everything that changes the kernel's code: the names of the images that are known."""

    known: tuple[str, ...] = field(default=())


def make_planes(key: PlanesKey, target: hl.Target) -> Scheduled:
    """Return the kernel."""
    # Signature
    signature, size = Signature("refinement planes"), ("height", "width")
    noisy, filtered = (signature.image(name, *size, COLORS) for name in ("noisy", "filtered"))
    images = {
        name: signature.image(name, *size, *[channels] * bool(channels))
        for name, channels in OPTIONAL.items()
        if name in key.known
    }
    brightness, mean_log_depth, shared = (
        signature.number(name) for name in ("brightness", "mean_log_depth", "noise_is_shared")
    )
    for name, count in (("planes", PLANES), ("light", 2 * COLORS), ("vectors", VECTORS)):
        signature.output(name, "height", count, "width")
    signature.output("tint", *size, COLORS)

    # Algorithm
    def read(name: str) -> list[hl.Expr]:
        channels = OPTIONAL[name]
        if name not in images:
            return [hl.f32(0.0)] * max(channels, 1)
        return [images[name][k, X, Y] for k in range(channels)] if channels else [images[name][X, Y]]

    def compress(light: hl.Expr) -> hl.Expr:
        return hl.f32(LIGHT_SCALE * math.log(2.0)) * expressions.log2(hl.f32(1.0) + hl.f32(LIGHT_GAIN) * light)

    albedo, normal = read("albedo"), read("normal")
    is_tinted = "albedo" in images
    tint = [hl.max(value, hl.f32(MIN_TINT)) if is_tinted else hl.f32(1.0) for value in albedo]

    def divide(light: list[hl.Expr]) -> list[hl.Expr]:
        """Return light over the brightness of the image and over the tint."""
        return [hl.min(each / brightness / over, hl.f32(MAX_LIGHT)) for each, over in zip(light, tint, strict=True)]

    before, after = (divide([image[k, X, Y] for k in range(COLORS)]) for image in (noisy, filtered))
    (depth,) = read("depth")
    log_depth = _compute_log_depth(depth, mean_log_depth) if "depth" in images else hl.f32(0.0)
    change = sum(divide(read("change")), hl.f32(0.0))
    flags = [hl.f32(float(name in images)) for name in ("albedo", "depth", "roughness", "change")]
    planes = [
        *map(compress, before),
        *map(compress, after),
        *albedo,
        *normal,
        hl.f32(DEPTH_PLANE_SCALE) * log_depth,
        *read("roughness"),
        *read("specular_share"),
        compress(hl.f32(1.0 / COLORS) * change),
        *flags,
        shared,
    ]
    (sharpness,) = read("lobe_sharpness")
    length = hl.f32(LOBE_SCALE) * hl.pow(hl.f32(2.0), hl.f32(0.5) * (sharpness - hl.f32(1.0)))
    lobes = [*(length * value for value in read("lobe_axis")), hl.f32(LOBE_SCALE) * sharpness]
    vectors = [*(hl.f32(NORMAL_SCALE) * value for value in normal), hl.f32(DEPTH_SCALE) * log_depth, *lobes]
    values = {"planes": planes, "light": [*before, *after], "vectors": vectors, "tint": [brightness * v for v in tint]}
    outputs = {name: hl.Func(name) for name in values}
    for name, out in outputs.items():
        out[(C, X, Y) if name == "tint" else (X, C, Y)] = hl.mux(C, values[name])

    # Schedule
    for name, out in outputs.items():
        schedule_stencil(out, len(values[name]), target)
    return Scheduled(list(outputs.values()), signature)


def _compute_log_depth(depth: hl.Expr, mean: hl.Expr) -> hl.Expr:
    """Return the logarithm of the depth over the mean depth."""
    bound = hl.f32(MAX_LOG_DEPTH)
    logarithm = hl.f32(math.log(2.0)) * expressions.log2(hl.max(depth, hl.f32(1e-20))) - mean
    return hl.select(depth > hl.f32(0.0), hl.clamp(logarithm, -bound, bound), bound)
