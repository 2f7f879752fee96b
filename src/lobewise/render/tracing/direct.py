"""Direct light on first surfaces, with shadows: one light sample and, for narrow lobes, one BSDF sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.records.frame import LobeKind
from lobewise.records.sparse_frame import list_places
from lobewise.render.bridge import dr, follow, mi, starts_as
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_share, dispatch_surface, dispatch_transmission
from lobewise.render.materials.surface import Surface
from lobewise.render.tracing.light_sampling import meet_emitter, scatter
from lobewise.render.tracing.points import MAX_LAYERS, Points, assign_to_lobes, can_be_transparent
from lobewise.render.tracing.rays import hides_emitters

PATTERN = 4
"""Width of a block of pixels that draw different samples. All blocks draw the same samples."""

MIN_LIGHT_SHARE = 1.0 / 1024.0
"""Share of the light that transparent surfaces let through, below which the surfaces behind them are not lit."""

MAX_NARROW_ALPHA = 0.3
"""Alpha below which a lobe is also sampled by the BSDF. For wider lobes light samples are enough."""

MAX_BOXES = 4
"""Number of boxes around lamps that each BSDF sample is tested against. More lamps share one box."""
BOX_MARGIN = 1e-4
"""Distance of a box from its lamp, over the largest coordinate of the scene: rounding must not miss a lamp."""

# Roberts 2018, "The unreasonable effectiveness of quasirandom sequences": 1/g and 1/g^2, g the plastic number.
_STEP_X, _STEP_Y = 0.7548776662466927, 0.5698402909980532
_FRAME_STEPS = (0.6180339887498949, 0.41421356237309515)

Boxes = list[tuple[Any, Any]]
"""The lower and the upper corner of each box (Dr.Jit arrays)."""


@dataclass
class Direct:
    """Light that was scattered at most once (Dr.Jit arrays; a PyTree).

    ``emitted`` comes directly from a light or the background. ``diffuse`` and ``specular`` were scattered once, by the
    lobe of this name. All are Color3f, linear, >= 0, albedo included.
    """

    emitted: Any
    diffuse: Any
    specular: Any


@dataclass
class _Numbers:
    """The random numbers of a pixel: points of the unit square for the light and for the BSDF, and for its lobe."""

    light: Any
    bsdf: Any
    choice: Any


@dataclass
class _Layers:
    """State of the walk through transparent surfaces. ``light`` is the share that the surfaces in front let through."""

    ray: Any
    light: Any = starts_as("Color3f", 1)
    count: Any = starts_as("UInt32")
    active: Any = starts_as("Bool", True)
    emitted: Any = starts_as("Color3f")
    diffuse: Any = starts_as("Color3f")
    specular: Any = starts_as("Color3f")


@dataclass
class _Met:
    """The light of lamps that BSDF samples meet."""

    active: Any
    diffuse: Any = starts_as("Color3f")
    specular: Any = starts_as("Color3f")


def list_lamps(scene: Any) -> list[Any] | None:
    """Return the shapes whose light a ray may meet; None if the scene has a sky, which rays meet in all directions."""
    return None if scene.environment() is not None else [shape for shape in scene.shapes() if shape.is_emitter()]


def list_lamp_boxes(scene: Any, lamps: Sequence[Any] | None) -> Boxes | None:
    """Return opaque boxes around the lamps of `list_lamps`, where they are now; None if there is a sky."""
    if lamps is None:
        return None
    corners = [np.array([list(each.bbox().min), list(each.bbox().max)]) for each in lamps]
    if len(corners) > MAX_BOXES:
        corners = [np.stack([np.min(corners, axis=(0, 1)), np.max(corners, axis=(0, 1))])]
    around = scene.bbox()
    margin = BOX_MARGIN * max(map(abs, (*around.min, *around.max)))

    def give(corner: NDArray[np.float64]) -> Any:
        return mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in corner))

    return [(give(low - margin), give(high + margin)) for low, high in corners]


def _may_meet_lamp(ray: Any, boxes: Boxes | None) -> Any:
    """Return whether rays hit a box around a lamp; True if there is a sky."""
    if boxes is None:
        return mi.Bool(True)
    hits = (mi.BoundingBox3f(*corners).ray_intersect(ray) for corners in boxes)
    return reduce(or_, (hit & (end >= 0) for hit, _, end in hits), mi.Bool(False))


def shade_direct(
    scene: Any,
    materials: dict[int, Material],
    points: Points,
    width: Any,
    shifts: Sequence[Any],
    boxes: Boxes | None,
) -> Direct:
    """Return the direct light on first surfaces, one light sample per pixel, not evaluated yet.

    The 4x4 pixels of a block draw 16 well distributed samples. All blocks draw the same, so that a filter of this size
    averages stratified noise (interleaved sampling: Keller and Heidrich 2001). A surface with a narrow lobe, or under a
    sky, also traces one ray sampled from the BSDF. The power heuristic weighs both samples (Veach 1997). ``width`` is
    the opaque width of the image; ``shifts`` are those of `draw_shifts`, ``boxes`` those of `list_lamp_boxes`.

    Where surfaces let light pass (masks, panes), all surfaces on the camera's ray are lit, each as strongly as those in
    front of it let its light through.
    """
    light_point = _draw(points.pixel, width, shifts[0], shifts[1])
    bsdf_point = _draw(points.pixel, width, shifts[2], shifts[3])
    numbers = _Numbers(light_point, bsdf_point, _fract(bsdf_point.x * 16.0 + bsdf_point.y))
    if not can_be_transparent(materials):
        return _shade_surface(scene, materials, points.si, points.bsdf, points.surface, points.active, numbers, boxes)

    def shade_layer(state: _Layers) -> None:
        si = scene.ray_intersect(state.ray, state.active)
        is_hit = state.active & si.is_valid()
        bsdf = si.bsdf(state.ray)
        surface = dispatch_surface(materials, bsdf, si, is_hit)
        light = _shade_surface(scene, materials, si, bsdf, surface, is_hit, numbers, boxes)
        state.emitted += dr.select(state.active, state.light * light.emitted, 0.0)
        state.diffuse += dr.select(is_hit, state.light * light.diffuse, 0.0)
        state.specular += dr.select(is_hit, state.light * light.specular, 0.0)
        state.light *= dispatch_transmission(materials, bsdf, si, is_hit)
        state.ray = si.spawn_ray(state.ray.d)
        state.count += 1
        state.active = is_hit & (dr.max(state.light) > MIN_LIGHT_SHARE) & (state.count < MAX_LAYERS)

    end = follow(_Layers(points.ray), shade_layer, "layers")
    return Direct(end.emitted, *assign_to_lobes(points.surface, end.diffuse, end.specular))


def _shade_surface(
    scene: Any,
    materials: dict[int, Material],
    si: Any,
    bsdf: Any,
    surface: Surface,
    active: Any,
    numbers: _Numbers,
    boxes: Boxes | None,
) -> Direct:
    """Return the light of one surface per lane. Light that passes the surface unscattered does not count."""
    lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    # A sky is too large for light samples alone.
    has_lobe = surface.lobe_kind != float(LobeKind.NONE)
    narrow = has_lobe & (dr.minimum(surface.alpha_u, surface.alpha_v) < MAX_NARROW_ALPHA)
    # Light samples never meet a mirror's only direction, and the guides may describe another lobe than the mirror's.
    flags = mi.BSDFFlags
    narrow |= mi.has_flag(bsdf.flags(), flags.DeltaReflection) | mi.has_flag(bsdf.flags(), flags.DeltaTransmission)
    shiny = active & (narrow | (scene.environment() is not None))
    choice = dr.select(active, numbers.choice, 0.0)
    # A surface that traces no BSDF sample takes the light sample with its full weight.
    scattering = scatter(scene, si, bsdf, active, lit=lit, numbers=(numbers.light, choice, numbers.bsdf), alone=~shiny)
    seen = dr.select(scattering.lit, scattering.value * scattering.radiance * scattering.weight, 0.0)
    share = dispatch_share(materials, bsdf, si, scattering.to_light, scattering.lit)
    diffuse, specular = seen * share, seen * (1.0 - share)

    ray = scattering.ray
    following = shiny & (dr.max(scattering.factor) > 0) & ~scattering.is_null & _may_meet_lamp(ray, boxes)

    def meet(state: _Met) -> None:
        emission, weight = meet_emitter(scene, scene.ray_intersect(ray, state.active), scattering.vertex, state.active)
        hit_share = dispatch_share(materials, bsdf, si, scattering.chosen.wo, state.active & ~scattering.is_delta)
        hit_share = dr.select(scattering.is_delta, 0.0, hit_share)
        light = scattering.factor * emission * weight
        state.diffuse, state.specular = light * hit_share, light * (1.0 - hit_share)
        state.active = mi.Bool(False)

    # Most reflections miss the lamps. A loop that ends at once skips vectors of them, where a mask would compute them.
    met = follow(_Met(following), meet, "lamps")

    emitted = si.emitter(scene).eval(si, mi.Bool(True))
    if hides_emitters(scene):
        emitted = dr.select(si.is_valid(), emitted, 0.0)
    return Direct(
        emitted=emitted,
        diffuse=diffuse + met.diffuse,
        specular=specular + met.specular,
    )


def draw_shifts(seed: int) -> list[float]:
    """Return four shifts in [0, 1) of all samples of a frame, for `shade_direct`. Use another seed for every frame.

    The steps from seed to seed are irrational, and in another direction than the steps from pixel to pixel.
    """
    return [(seed * step + 0.5 * dimension) % 1.0 for dimension in range(2) for step in _FRAME_STEPS]


def _draw(pixel: Any, width: Any, shift_x: Any, shift_y: Any) -> Any:
    """Return a point of the unit square for each pixel, chosen by the pixel's place in its 4x4 block."""
    order = list_places(PATTERN)
    rank = [order.index((k // PATTERN, k % PATTERN)) for k in range(PATTERN**2)]
    place = (pixel // width % PATTERN) * PATTERN + pixel % width % PATTERN
    count = mi.Float(0)
    for k, number in enumerate(rank):
        count = dr.select(place == k, mi.Float(number), count)
    return mi.Point2f(_fract(shift_x + count * _STEP_X), _fract(shift_y + count * _STEP_Y))


def _fract(value: Any) -> Any:
    return dr.minimum(value - dr.floor(value), 1.0 - 2.0**-24)
