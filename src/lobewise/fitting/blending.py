"""Lobe tables between two tables, for materials that change from place to place."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np

from lobewise.errors import InputError
from lobewise.fitting.arrays import Array, normalize
from lobewise.records.lobe_table import LobeTable


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
