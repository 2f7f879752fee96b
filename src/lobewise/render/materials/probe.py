"""Evaluates and samples a single BSDF object, without a scene.

Directions are local: z is the normal, x the tangent. A *place* holds texture coordinates u and v, and after them maybe
a position in space, so 2 or 5 numbers. By default it is uv = (0.5, 0.5) at the origin. Attributes of meshes are 0. A
BSDF that cannot be evaluated or sampled raises `UnsupportedBsdfError`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import UnsupportedBsdfError
from lobewise.fitting.arrays import Array, make_turn
from lobewise.render.bridge import dr, mi

# Smallest cosine by which values are divided. Mitsuba's values include the cosine; dividing by less amplifies noise.
_MIN_COSINE = 1e-6
# Largest difference of two sets of values that count as equal, root mean square relative to the larger set.
_MAX_DIFFERENCE = 0.02
# Number of samples per view that measure what passes a surface, and largest difference that counts as their noise.
_NULL_SAMPLES, _MAX_NULL_DIFFERENCE = 1024, 0.03


def make_context(lobes: Any = None, *, importance: bool = False) -> Any:
    """Return the context that asks a BSDF for some of its lobes, or all.

    With ``importance`` refracted light is not scaled by the square of the index of refraction.
    """
    context = mi.BSDFContext()
    if lobes is not None:
        context.type_mask = lobes
    if importance:
        context.mode = mi.TransportMode.Importance
    return context


def make_hits(view: Array, place: Array | None = None) -> Any:
    """Return hits on a flat surface, at ``place`` (n, 2 or 5), seen from the local directions ``view`` (n, 3)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(view))
    si.t = 1.0
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    numbers = None if place is None else np.ascontiguousarray(place.T, dtype=np.float32)
    si.uv = mi.Point2f(0.5, 0.5) if numbers is None else mi.Point2f(numbers[:2])
    if numbers is not None and len(numbers) > 2:
        si.p = mi.Point3f(numbers[2:])
    si.wi = _to_vectors(view)
    return si


def evaluate_bsdf(bsdf: Any, view: Array, light: Array, lobes: Any = None, *, place: Array | None = None) -> Array:
    """Return the BRDF, without the cosine, for pairs of local unit vectors (n, 3), at ``place`` (n, 2 or 5).

    Shape (n, 3), 1/sr.
    """

    def run() -> Any:
        return mi.Color3f(bsdf.eval(make_context(lobes), make_hits(view, place), _to_vectors(light), mi.Bool(True)))

    cosine = np.maximum(np.abs(light[:, 2:]), _MIN_COSINE)
    return np.asarray(_to_colors(_try(bsdf, run), len(view)) / cosine)


def make_evaluate(
    bsdf: Any, lobes: Any = None, *, through: bool = False, turn: float = 0.0, place: Array | None = None
) -> Callable[..., Array]:
    """Return `evaluate_bsdf` of some or all of a BSDF's lobes as `lobewise.fitting.fit.Evaluate`.

    With ``through`` it is the transmission, mirrored at the surface. ``turn`` is the angle from the BSDF's tangent to
    the x of the directions, radians, counter-clockwise. The BSDF is evaluated at one ``place`` (2 or 5,).
    """
    matrix = make_turn(turn)
    flip = np.asarray([1.0, 1.0, -1.0 if through else 1.0])

    def evaluate(view: Array, light: Array) -> Array:
        return evaluate_bsdf(bsdf, view @ matrix, light @ matrix * flip, lobes, place=repeat_place(place, len(view)))

    return evaluate


def repeat_place(place: Array | None, count: int) -> Array | None:
    """Return one place (2 or 5,) ``count`` times, (count, 2 or 5); None stays None."""
    return None if place is None else np.tile(place, (count, 1))


@dataclass(frozen=True)
class Samples:
    """Samples that a BSDF drew: N samples for each of V views.

    ``light`` holds local directions (V, N, 3), ``weight`` (V, N, 3) the finite BSDF times cosine over density. ``null``
    and ``delta`` (V, N) tell whether the ray passed through unchanged, or took the only direction of a delta lobe.
    """

    light: Array
    weight: Array
    null: NDArray[np.bool_]
    delta: NDArray[np.bool_]


def sample_bsdf(bsdf: Any, view: Array, count: int, *, place: Array | None = None) -> Samples:
    """Return ``count`` samples of the BSDF for each local direction ``view`` (V, 3), the same at every call.

    The BSDF is sampled at ``place`` (V, 2 or 5). Weights of refraction are not scaled by the square of the index.
    """
    points = np.tile(spread_points(count, 3), (len(view), 1)).astype(np.float32)

    def run() -> Any:
        square = mi.Point2f(np.ascontiguousarray(points[:, 1:].T))
        hits = make_hits(np.repeat(view, count, axis=0), None if place is None else np.repeat(place, count, axis=0))
        choice = mi.Float(points[:, 0])
        drawn, weight = bsdf.sample(make_context(importance=True), hits, choice, square, mi.Bool(True))
        return mi.UInt32(drawn.sampled_type), mi.Vector3f(drawn.wo), mi.Color3f(weight)

    total = len(view) * count
    flags, light, weight = _try(bsdf, run)
    kind = np.broadcast_to(np.array(flags).astype(np.int64), (total,)).reshape(len(view), count)
    values = _to_colors(weight, total).reshape(len(view), count, 3)
    alive = np.asarray(np.isfinite(values).all(axis=-1))
    return Samples(
        light=_to_colors(light, total).reshape(len(view), count, 3),
        weight=np.where(alive[..., None], values, 0.0),
        null=(kind & int(mi.BSDFFlags.Null)) != 0,
        delta=(kind & int(mi.BSDFFlags.Delta)) != 0,
    )


@dataclass(frozen=True)
class Parts:
    """The lobes that a BSDF declares, and properties found by evaluating it."""

    diffuse: bool
    """Whether there are diffuse lobes that can be evaluated apart from glossy ones."""
    glossy: bool
    delta: bool
    obeys_context: bool
    """Whether the BSDF evaluates only the lobes that a context asks for."""
    behind: bool
    """Whether the BSDF reflects or transmits if seen from behind."""
    textured: bool
    """Whether the BSDF depends on uv or on the position."""
    knows_transmission: bool
    """Whether the BSDF's evaluation of what passes unscattered agrees with its samples."""
    positional: bool = False
    """Whether the BSDF depends on the position, at one uv."""

    @property
    def diffuse_lobes(self) -> Any:
        """Flags of the diffuse part for `make_context`; None for all lobes."""
        return mi.BSDFFlags.Diffuse if self.glossy else None

    @property
    def glossy_lobes(self) -> Any:
        """Flags of the glossy part for `make_context`; None for all lobes."""
        return mi.BSDFFlags.Glossy if self.diffuse else None


def list_parts(bsdf: Any, extent: float = 1.0) -> Parts:
    """Return the lobes and properties of a BSDF. ``extent`` is that of `is_positional`."""
    diffuse, glossy, delta = list_flags(bsdf)
    view, light = _make_probe_directions()
    lobe_sets = (None, mi.BSDFFlags.Diffuse, mi.BSDFFlags.Glossy)
    whole, *some = (evaluate_bsdf(bsdf, view, light, lobes) for lobes in lobe_sets)
    good = np.isfinite(whole)
    heeds = are_same((some[0] + some[1])[good], whole[good])
    flip = np.asarray([1.0, 1.0, -1.0])
    behind = bool(np.any(evaluate_bsdf(bsdf, view * flip, light * flip) > 0.0))
    behind = behind or bool(np.any(sample_bsdf(bsdf, view[:8] * flip, 32).weight > 0.0))
    elsewhere = evaluate_bsdf(bsdf, view, light, place=spread_points(len(view), 2))
    good = np.isfinite(whole) & np.isfinite(elsewhere)
    textured = not are_same(elsewhere[good], whole[good])
    knows, moves = _knows_transmission(bsdf, view[:8]), is_positional(bsdf, extent)
    return Parts(diffuse and (heeds or not glossy), glossy, delta, heeds, behind, textured or moves, knows, moves)


def is_positional(bsdf: Any, extent: float = 1.0) -> bool:
    """Return whether a BSDF depends on the position at one uv, in the cube from ``-extent`` to ``extent``."""
    view, light = _make_probe_directions()
    position = extent * (2.0 * spread_points(len(view), 3) - 1.0)
    values = [
        evaluate_bsdf(bsdf, view, light, place=np.concatenate([np.full((len(view), 2), 0.5), each], axis=1))
        for each in (0.0 * position, position)
    ]
    good = np.isfinite(values[0]) & np.isfinite(values[1])
    return not are_same(values[0][good], values[1][good])


def _knows_transmission(bsdf: Any, view: Array) -> bool:
    """Return whether ``eval_null_transmission`` agrees with the mean weight of samples that pass, for some views."""
    samples = sample_bsdf(bsdf, view, _NULL_SAMPLES)
    passing = np.where(samples.null[..., None], samples.weight, 0.0).mean(axis=1)
    try:
        known = _to_colors(mi.Color3f(bsdf.eval_null_transmission(make_hits(view))), len(view))
    except Exception:  # a BSDF written by a user need not have it
        return False
    return bool(np.abs(known - passing).max() <= _MAX_NULL_DIFFERENCE)


def digest_bsdf(bsdf: Any) -> str:
    """Return a digest of a BSDF's values for some hundred pairs of directions. Equal digests count as equal BSDFs."""
    view, light = _make_probe_directions()
    answers: list[NDArray[Any]] = [np.asarray(list_flags(bsdf))]
    answers += [evaluate_bsdf(bsdf, view, light, lobes) for lobes in (None, mi.BSDFFlags.Diffuse)]
    flip = np.asarray([1.0, 1.0, -1.0])
    answers.append(evaluate_bsdf(bsdf, view * flip, light * flip))
    answers.append(evaluate_bsdf(bsdf, view, light, place=spread_points(len(view), 2)))
    samples = sample_bsdf(bsdf, view[:8], 32)
    answers += [samples.weight, samples.light, samples.null, samples.delta]
    return hashlib.sha256(b"".join(np.ascontiguousarray(answer).tobytes() for answer in answers)).hexdigest()


def are_same(one: Array, two: Array) -> bool:
    """Return whether two sets of values agree within 2 % in the mean square, relative to the larger."""
    norm = max(float(np.linalg.norm(one)), float(np.linalg.norm(two)))
    return bool(np.linalg.norm(one - two) <= _MAX_DIFFERENCE * norm)


def list_flags(bsdf: Any) -> tuple[bool, bool, bool]:
    """Return whether a BSDF declares diffuse, glossy and delta lobes."""
    flags = _try(bsdf, bsdf.flags)
    # Mitsuba counts null transmission as a delta lobe; here it is no lobe.
    kinds = mi.BSDFFlags
    diffuse, glossy, mirror, clear = (
        bool(mi.has_flag(flags, kind))
        for kind in (kinds.Diffuse, kinds.Glossy, kinds.DeltaReflection, kinds.DeltaTransmission)
    )
    return diffuse, glossy, mirror or clear


def _try(bsdf: Any, run: Callable[[], Any]) -> Any:
    try:
        out = run()
        dr.eval(out)
    except Exception as error:  # a BSDF written by a user can raise anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UnsupportedBsdfError(
            f"BSDF {bsdf.id()!r}" if bsdf.id() else "a BSDF without an id",
            expected="a plugin that lobewise knows, or one that can be evaluated and sampled",
            got=f"{bsdf.class_name()}: {reason}",
            action="repair or replace it in the scene",
        ) from error
    return out


def _to_vectors(directions: Array) -> Any:
    return mi.Vector3f(np.ascontiguousarray(directions.T, dtype=np.float32))


def _to_colors(value: Any, count: int) -> Array:
    """Return three numbers per lane, shape (count, 3). Dr.Jit stores a uniform value with a width of 1."""
    return np.array(np.broadcast_to(np.array(value, dtype=np.float64).reshape(3, -1).T, (count, 3)))


def _make_probe_directions() -> tuple[Array, Array]:
    """Return views above the horizon, and lights on the whole sphere and ever nearer to the mirror direction."""
    view = spread_directions(64)
    view[:, 2] = np.abs(view[:, 2])
    half = np.asarray([0.0, 0.0, 1.0]) + np.geomspace(1e-3, 1.0, 8)[:, None, None] * spread_directions(128)[::2]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    mirrored = 2.0 * np.sum(view * half, axis=-1, keepdims=True) * half - view
    around = np.roll(spread_directions(64), 17, axis=0)
    light = np.concatenate([mirrored.reshape(-1, 3), around])
    return np.tile(view, (9, 1)), light


def spread_points(count: int, dimensions: int) -> Array:
    """Return evenly spread points of the unit cube of 2, 3 or 5 dimensions, (count, dimensions), always the same.

    Source: Roberts 2018, "The unreasonable effectiveness of quasirandom sequences", the additive recurrence R_d: the
    steps are powers of the root above 1 of ``x^(d + 1) = x + 1``.
    """
    root = {2: 1.324717957244746, 3: 1.2207440846057596, 5: 1.1347241384015194}[dimensions]
    return np.mod(0.5 + np.outer(np.arange(count), root ** -np.arange(1.0, dimensions + 1.0)), 1.0)


def spread_directions(count: int) -> Array:
    """Return unit vectors on a golden spiral, shape (count, 3)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.arange(count) * (math.pi * (3.0 - math.sqrt(5.0)))
    sine = np.sqrt(1.0 - z * z)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), z], axis=-1)
