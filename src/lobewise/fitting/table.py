"""The lobes of points, interpolated from a lobe table over the view and turned into world space.

Lobes are interpolated in a frame about the mirror direction, because the mirror direction moves fast with the view. So
between the views of the table the lobes follow the mirror direction exactly."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError
from lobewise.fitting.arrays import Array, as_reals, dot, normalize
from lobewise.records.lobe_table import LobeTable

# Points evaluated at a time: their rows of the table fit into the L2 cache of a core.
_POINTS_PER_CHUNK = 8192


class TableLobes(NamedTuple):
    """The N lobes of each of some points, in world space; `LobeTable` defines a lobe."""

    axis: Array
    """Unit vectors, shape (..., N, 3)."""
    x: Array
    """Unit vectors across the axis, shape (..., N, 3): the directions of the first sharpness."""
    sharpness: Array
    """``(l, m)`` along x and along ``axis cross x``, shape (..., N, 2)."""
    amplitude: Array
    """Value along the axis, 1/sr, shape (..., N)."""


def evaluate_table(
    table: LobeTable, normal: ArrayLike, view: ArrayLike, tangent: ArrayLike | None = None
) -> TableLobes:
    """Return the lobes that a material has at points seen from ``view``.

    Between views of the table the logarithm of the sharpness, the amplitude, the twist, and the axis relative to the
    mirror direction are interpolated linearly in the angle of the view from the normal and in its azimuth. The axis is
    normalized afterwards; the twist takes the shorter way. Beyond the first and last n.v lobes are constant.

    Parameters
    ----------
    table : LobeTable
    normal, view : array_like, shape (..., 3)
        Unit vectors in world space; the view points away from the surface. Leading shapes broadcast.
    tangent : array_like, shape (..., 3), optional
        Direction of azimuth 0, in world space; it need not be perpendicular to the normal. Anisotropic tables need it.

    Returns
    -------
    TableLobes
        float32 if all given arrays are float32, otherwise float64.

    Raises
    ------
    InputError
        If the table is anisotropic and there is no tangent.
    """
    if tangent is None and not table.is_isotropic:
        expected = f"directions, because material {table.name!r} is anisotropic"
        raise InputError("tangent", expected=expected, got="none", action="pass tangent=")
    arguments = (normal, view) if tangent is None else (normal, view, tangent)
    vectors = np.broadcast_arrays(*as_reals(*arguments))
    shape, dtype, lobes = vectors[0].shape[:-1], vectors[0].dtype, table.lobe_count
    flat = [vector.reshape(-1, 3) for vector in vectors]
    count = flat[0].shape[0]
    axis, x = np.empty((count, lobes, 3), dtype), np.empty((count, lobes, 3), dtype)
    sharpness, amplitude = np.empty((count, lobes, 2), dtype), np.empty((count, lobes), dtype)
    rows = _pack(table, dtype)
    # Untwisted lobes in the plane of incidence all have the same x: the direction across the plane.
    in_plane = not rows[..., 0].any() and not rows[..., 7].any()
    for first in range(0, count, _POINTS_PER_CHUNK):
        part = slice(first, first + _POINTS_PER_CHUNK)
        across, along, mirror, cosine, azimuth = _make_mirror_frame(*(vector[part] for vector in flat))
        row = _interpolate(table, rows, cosine, azimuth)
        local = normalize(row[..., :3])
        axis[part] = _to_world(local, across, along, mirror)
        sharpness[part] = np.exp(row[..., 3:5])
        amplitude[part] = row[..., 5]
        if in_plane:
            x[part] = across[:, None]
        else:
            twist = 0.5 * np.arctan2(row[..., 7], row[..., 6])
            x[part] = _to_world(_make_x(local, twist), across, along, mirror)
    return TableLobes(
        axis.reshape(*shape, lobes, 3),
        x.reshape(*shape, lobes, 3),
        sharpness.reshape(*shape, lobes, 2),
        amplitude.reshape(*shape, lobes),
    )


def evaluate_lobes(lobes: TableLobes, direction: ArrayLike, kind: str) -> Array:
    """Return the sum of the lobes in ``direction``, which approximates luminance of BRDF times cosine, 1/sr.

    Parameters
    ----------
    lobes : TableLobes
        Lobes of any number of points.
    direction : array_like, shape (..., 3)
        Unit vectors; leading shapes broadcast against those of the lobes.
    kind : {"sg", "asg"}
        Kind of the table that the lobes come from.
    """
    direction = np.asarray(direction, dtype=lobes.axis.dtype)[..., None, :]
    z = dot(lobes.axis, direction)
    if kind == "sg":
        value = np.exp(2.0 * lobes.sharpness[..., 0] * (z - 1.0))
    else:
        x, y = dot(lobes.x, direction), dot(np.cross(lobes.axis, lobes.x), direction)
        value = np.exp(-lobes.sharpness[..., 0] * x * x - lobes.sharpness[..., 1] * y * y) * np.maximum(z, 0.0)
    return np.asarray((lobes.amplitude * value).sum(axis=-1))


def get_equivalent_alphas(table: LobeTable, cosine: ArrayLike, azimuth: ArrayLike = 0.0) -> Array:
    """Return the GGX-equivalent roughness, shape (..., 2): in the plane of incidence, and across it.

    Parameters
    ----------
    table : LobeTable
    cosine : array_like, shape (...)
        n.v.
    azimuth : array_like, shape (...)
        Azimuth of the view about the normal, from the tangent, radians; ignored for an isotropic table.
    """
    return _look_up(table, table.alpha, cosine, azimuth)


def get_albedo(table: LobeTable, cosine: ArrayLike, azimuth: ArrayLike = 0.0) -> Array:
    """Return the directional albedo, shape (..., 3), linear RGB; parameters as in `get_equivalent_alphas`."""
    return _look_up(table, table.albedo, cosine, azimuth)


def order_lobes(table: LobeTable) -> LobeTable:
    """Return a table whose lobes have the same order at all azimuths, so that they can be interpolated.

    The fit keeps the order over n.v already. The order over the azimuth is found at the highest view: seen from above,
    all azimuths show the same lobes, turned.
    """
    names = ("axis", "sharpness", "twist", "amplitude")
    arrays: dict[str, Any] = {name: np.array(getattr(table, name)) for name in names}
    top = arrays["axis"][-1].astype(np.float64)
    width = np.log(arrays["sharpness"][-1, ..., 0].astype(np.float64))
    for column in range(1, table.azimuth.size):
        turn = float(table.azimuth[column] - table.azimuth[column - 1])
        x, y, z = np.moveaxis(top[column - 1], -1, 0)
        ahead, side = math.cos(turn) * x + math.sin(turn) * y, math.cos(turn) * y - math.sin(turn) * x
        gap = ((np.stack([ahead, side, z], axis=-1)[:, None] - top[column]) ** 2).sum(axis=-1)
        before, here = width[column - 1][:, None], width[column]
        cost = gap * np.exp(0.5 * (before + here)) + (before - here) ** 2
        rows = np.arange(table.lobe_count)
        orders = np.array(list(permutations(rows)))
        best = orders[np.argmin(cost[rows, orders].sum(axis=1))]
        for values in arrays.values():
            values[:, column] = values[:, column, best]
        top[column], width[column] = top[column, best], width[column, best]
    return replace(table, **arrays)


def _look_up(table: LobeTable, values: Array, cosine: ArrayLike, azimuth: ArrayLike) -> Array:
    cosine, azimuth = np.broadcast_arrays(*as_reals(cosine, azimuth))
    flat = _interpolate(table, values.astype(cosine.dtype), cosine.ravel(), azimuth.ravel())
    return np.asarray(flat.reshape(*cosine.shape, values.shape[-1]))


def _pack(table: LobeTable, dtype: Any) -> Array:
    """Return the numbers to interpolate, (V, P, N, 8): axis (3), log sharpness (2), amplitude, doubled twist (2).

    The axis is in the frame (across the plane of incidence, along the plane, mirror direction). The twist is stored as
    cosine and sine of its double, because a lobe turned by pi is the same lobe.
    """
    cosine = table.cosine.astype(np.float64)[:, None, None]
    sine = np.sqrt(1.0 - cosine * cosine)
    x, y, z = np.moveaxis(table.axis.astype(np.float64), -1, 0)
    parts = [
        y,
        -cosine * x - sine * z,
        cosine * z - sine * x,
        *np.moveaxis(np.log(table.sharpness.astype(np.float64)), -1, 0),
        table.amplitude,
        np.cos(2.0 * table.twist),
        np.sin(2.0 * table.twist),
    ]
    return np.stack(parts, axis=-1).astype(dtype)


def _make_mirror_frame(
    normal: Array, view: Array, tangent: Array | None = None
) -> tuple[Array, Array, Array, Any, Any]:
    """Return (across, along, mirror, n.v, azimuth): a right-handed frame about the mirror direction."""
    cosine = dot(normal, view)
    leaning = view - cosine[:, None] * normal
    sine = np.sqrt(dot(leaning, leaning))
    # A view from straight above has no plane of incidence: use the tangent, or else any direction along the surface.
    spare = tangent
    if spare is None:
        spare = np.where(np.abs(normal[:, :1]) < 0.5, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]).astype(normal.dtype)
    spare = normalize(spare - dot(spare, normal)[:, None] * normal)
    away = np.where((sine > 1e-6)[:, None], normalize(leaning), spare)
    across = np.cross(normal, away)
    along = -cosine[:, None] * away - sine[:, None] * normal
    mirror = 2.0 * cosine[:, None] * normal - view
    azimuth = np.zeros_like(cosine)
    if tangent is not None:
        azimuth = np.arctan2(-dot(across, spare), dot(away, spare))
    return across, along, mirror, cosine, azimuth


def _interpolate(table: LobeTable, rows: NDArray[Any], cosine: Array, azimuth: Array) -> Array:
    """Return ``rows`` (V, P, ...) at points (n,), linear in the angle from the normal and in the azimuth."""
    # Lobes change sharply with n.v at normal incidence, but smoothly with the angle.
    low, share = _locate(np.arcsin(table.cosine.astype(np.float64)), np.arcsin(np.clip(cosine, -1.0, 1.0)))
    high = np.minimum(low + 1, table.cosine.size - 1)
    columns = rows.shape[1]
    flat = rows.reshape(-1, *rows.shape[2:])
    fill = (-1, *[1] * (rows.ndim - 2))
    share = share.astype(rows.dtype).reshape(fill)

    def at(column: NDArray[np.intp] | int) -> Array:
        below = flat[low * columns + column]
        return np.asarray(below + share * (flat[high * columns + column] - below))

    if columns == 1:
        return at(0)
    turn = 2.0 * math.pi
    grid = table.azimuth.astype(np.float64)
    left, part = _locate(np.append(grid, grid[0] + turn), grid[0] + np.mod(azimuth - grid[0], turn))
    weight = part.astype(rows.dtype).reshape(fill)
    return np.asarray((1.0 - weight) * at(left) + weight * at((left + 1) % columns))


def _locate(grid: Array, value: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the cell of an ascending grid that holds each value, and the place in the cell, clamped to the grid."""
    position = np.interp(value, grid, np.arange(grid.size))
    low = np.minimum(position.astype(np.intp), max(grid.size - 2, 0))
    return low, np.asarray(position - low)


def _to_world(local: Array, across: Array, along: Array, mirror: Array) -> Array:
    return np.asarray(
        local[..., 0:1] * across[:, None] + local[..., 1:2] * along[:, None] + local[..., 2:3] * mirror[:, None]
    )


def _make_x(axis: Array, twist: Array) -> Array:
    """Return the x of lobes, in the frame whose first direction is across the plane of incidence."""
    first = np.zeros_like(axis)
    first[..., 0] = 1.0
    x = normalize(first - axis[..., :1] * axis)
    return np.asarray(np.cos(twist)[..., None] * x + np.sin(twist)[..., None] * np.cross(axis, x))


def blend_tables(one: LobeTable, two: LobeTable, share: float) -> LobeTable:
    """Return the table between two tables of round lobes, by ``share`` of the second one, 0 to 1.

    Each lobe of the first table is paired with one of the second. The axis, the logarithm of the sharpness, the
    integral of the lobe and the logarithm of alpha are interpolated linearly. So a lobe between a sharp and a wide lobe
    has a width between theirs; a sum of both lobes would have two widths.

    Raises
    ------
    InputError
        If a table is not of kind ``sg``, or the tables differ in views, azimuths or number of lobes.
    """
    for table in (one, two):
        if table.kind != "sg":
            raise InputError(
                "kind of lobes", expected="'sg'", got=repr(table.kind), action="fit the table with kind='sg'"
            )
    if one.axis.shape != two.axis.shape or not all(
        np.array_equal(getattr(one, name), getattr(two, name)) for name in ("cosine", "azimuth")
    ):
        got = f"{one.axis.shape} and {two.axis.shape}"
        raise InputError(
            "lobe tables", expected="equal views, azimuths and numbers of lobes", got=got, action="fit them alike"
        )
    order = _pair_lobes(one, two)
    axis, sharpness, amplitude = (getattr(two, name)[:, :, order] for name in ("axis", "sharpness", "amplitude"))
    # A lobe of amplitude 0 has no shape of its own: give it that of its partner.
    empty, other_empty = one.amplitude == 0.0, amplitude == 0.0
    first_axis = np.where(empty[..., None], axis, one.axis)
    first_sharpness = np.where(empty[..., None], sharpness, one.sharpness)
    axis = np.where(other_empty[..., None], one.axis, axis)
    sharpness = np.where(other_empty[..., None], one.sharpness, sharpness)
    width = _mix_logs(first_sharpness, sharpness, share)
    energy = _mix(one.amplitude * _integrate(first_sharpness), amplitude * _integrate(sharpness), share)
    return LobeTable(
        name=one.name,
        kind="sg",
        cosine=one.cosine,
        azimuth=one.azimuth,
        axis=normalize(_mix(first_axis, axis, share)).astype(np.float32),
        sharpness=width.astype(np.float32),
        twist=one.twist,
        amplitude=(energy / _integrate(width)).astype(np.float32),
        alpha=_mix_logs(one.alpha, two.alpha, share).astype(np.float32),
        albedo=_mix(one.albedo, two.albedo, share).astype(np.float32),
        cosine_l2=np.minimum(one.cosine_l2, two.cosine_l2),
    )


def _pair_lobes(one: LobeTable, two: LobeTable) -> list[int]:
    """Return for each lobe of the first table the lobe of the second one: the same at all views, so that lobes stay."""
    gap = ((one.axis[:, :, :, None].astype(np.float64) - two.axis[:, :, None]) ** 2).sum(axis=-1)
    width = [np.log(table.sharpness[..., 0].astype(np.float64)) for table in (one, two)]
    # The narrower of two lobes tells how much a turn of the axis matters. Wider lobes pair with wider ones.
    scale = np.exp(np.minimum(width[0][:, :, :, None], width[1][:, :, None]))
    middle = [log_width - log_width.mean(axis=2, keepdims=True) for log_width in width]
    cost = (gap * scale + (middle[0][:, :, :, None] - middle[1][:, :, None]) ** 2).mean(axis=(0, 1))
    orders = list(permutations(range(one.lobe_count)))
    return list(min(orders, key=lambda order: math.fsum(cost[row, column] for row, column in enumerate(order))))


def _integrate(sharpness: Array) -> Array:
    """Return the integrals over the sphere, over 2 pi, of round lobes of amplitude 1: of ``exp(2 l (z - 1))``."""
    twice = 2.0 * sharpness[..., 0].astype(np.float64)
    return np.asarray(-np.expm1(-2.0 * twice) / twice)


def _mix(one: Array, two: Array, share: float) -> Array:
    return (1.0 - share) * one.astype(np.float64) + share * two.astype(np.float64)


def _mix_logs(one: Array, two: Array, share: float) -> Array:
    return np.asarray(np.exp(_mix(np.log(one.astype(np.float64)), np.log(two.astype(np.float64)), share)))
