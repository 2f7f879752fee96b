"""Share out the light of specks, single bright pixels at blurred lights, among their neighbours.

Light that no surface scatters (emission, background) has no noise where a pixel shows one object. Where depth of field
or motion mixes several objects in a pixel, few samples choose among them: the disc of a lamp out of focus gets a rim of
dots. No guide distinguishes such a pixel from its neighbours, so filters do not help. Only excess light is moved: light
above the fourth brightest of the eight neighbours goes to the 5x5 pixels around, in proportion to their own light. No
light is lost, and none reaches dark pixels.
"""

from __future__ import annotations

import numpy as np

from lobewise.backend.buffers import Image, device_scope, download, take_image
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled, get_kernel, run_kernel
from lobewise.backend.pointwise import LARGEST_FLOAT, is_finite
from lobewise.backend.signature import Signature
from lobewise.filters.cross_pass import find_luminance
from lobewise.filters.planes import X, Y
from lobewise.filters.schedules.specks import SpeckFuncs, schedule_specks
from lobewise.frame import FloatArray

MAX_MIXED_SHARE = 0.97
"""Largest share of its area that one object covers in a pixel that counts as mixed."""
WINDOW_RADIUS, MIN_MIXED = 3, 0.6
"""Radius of a window, pixels, and the share of mixed pixels above which its centre is blurred. Edges in focus have
less, because they are at most two pixels wide. Pixels within the same radius of a blurred pixel may be specks."""
RANK = 4
"""Rank, from the brightest, of the neighbour that bounds a pixel's luminance."""
SPREAD_RADIUS = 2
"""Radius of the square that excess light is shared out over, pixels."""
REACH = max(2 * SPREAD_RADIUS + 1, 2 * SPREAD_RADIUS + 2 * WINDOW_RADIUS)
"""Distance of the farthest pixel that affects a pixel, rows or columns."""


def share_out_specks(light: FloatArray, object_share: FloatArray, *, device: str = "cpu") -> FloatArray:
    """Return the gain of every pixel's light, (height, width), >= 0, that removes specks.

    Parameters
    ----------
    light : array, shape (height, width, 3)
        Linear radiance, >= 0. NaN, infinite and negative pixels count as 0.
    object_share : array, shape (height, width)
        As in `lobewise.GBuffer`.
    device : str
        A name from `lobewise.backend.devices.list_devices`.

    Raises
    ------
    InputError
        If the images differ in size.

    Notes
    -----
    The gain moves light and keeps the sum of luminances, up to rounding. Without mixed pixels it is 1 everywhere.
    """
    images: dict[str, Image] = {
        "light": take_image("light", light, (*object_share.shape, 3)),
        "share": take_image("object share", object_share, object_share.shape),
    }
    if not (object_share < MAX_MIXED_SHARE).any():
        return np.ones(object_share.shape, np.float32)
    with device_scope():
        kernel = get_kernel(device, ("specks",), _make_specks)
        return download(run_kernel(kernel, device, images)["gain"])


def _make_specks(target: hl.Target) -> Scheduled:
    """Return the kernel of `share_out_specks`."""
    signature, size = Signature("specks"), ("height", "width")
    light, share = signature.image("light", *size, 3), signature.image("share", *size)
    light.dim(0).set_bounds(0, 3)
    signature.output("gain", *size)
    width, height = share.width(), share.height()
    inside = (X >= 0) & (width > X) & (Y >= 0) & (height > Y)
    at = hl.clamp(X, 0, width - 1), hl.clamp(Y, 0, height - 1)
    zero, one = hl.f32(0.0), hl.f32(1.0)
    bright, mixed, rows, blurred, near, low, quotient, out = (
        hl.Func(name) for name in ("bright", "mixed", "mixed_rows", "blurred", "near", "low", "quotient", "gain")
    )
    luminance = find_luminance([light[k, at[0], at[1]] for k in range(3)])
    good = inside & is_finite(luminance) & (luminance > zero) & (luminance < hl.f32(LARGEST_FLOAT))
    bright[X, Y] = hl.select(good, luminance, zero)
    known = share[at]
    is_mixed = inside & (known < hl.f32(MAX_MIXED_SHARE))
    mixed[X, Y] = hl.Tuple([hl.select(is_mixed, one, zero), hl.select(inside, one, zero)])
    window = range(-WINDOW_RADIUS, WINDOW_RADIUS + 1)
    rows[X, Y] = hl.Tuple([sum((mixed[X + k, Y][n] for k in window), zero) for n in range(2)])
    count, area = (sum((rows[X, Y + k][n] for k in window), zero) for n in range(2))
    blurred[X, Y] = hl.select(count > hl.f32(MIN_MIXED) * area, one, zero)
    near[X, Y] = _find_largest([blurred[X + k, Y] for k in window])
    around = [bright[X + i, Y + j] for j in (-1, 0, 1) for i in (-1, 0, 1) if (i, j) != (0, 0)]
    bound = _find_rank(around, RANK)
    here, takes = bright[X, Y], _find_largest([near[X, Y + k] for k in window]) > zero
    kept = hl.select(takes, hl.min(here, bound), here)
    low[X, Y] = hl.Tuple([kept, here - kept, hl.select(takes, kept, zero)])
    steps = range(-SPREAD_RADIUS, SPREAD_RADIUS + 1)
    spread = [(i, j) for j in steps for i in steps]
    taken = sum((low[X + i, Y + j][2] for i, j in spread), zero)
    # Where no pixel around takes light, the excess stays.
    quotient[X, Y] = hl.Tuple(
        [
            hl.select(taken > zero, low[X, Y][1] / hl.max(taken, hl.f32(1e-30)), zero),
            hl.select(taken > zero, zero, low[X, Y][1]),
        ]
    )
    given = low[X, Y][2] * sum((quotient[X + i, Y + j][0] for i, j in spread), zero)
    total = low[X, Y][0] + quotient[X, Y][1] + given
    out[X, Y] = hl.select(here > zero, total / hl.max(here, hl.f32(1e-30)), one)
    funcs = SpeckFuncs(
        bright=bright, mixed=mixed, rows=rows, blurred=blurred, near=near, low=low, quotient=quotient, out=out
    )
    schedule_specks(funcs, target)
    return Scheduled([out], signature)


def _find_largest(values: list[hl.Expr]) -> hl.Expr:
    largest = values[0]
    for value in values[1:]:
        largest = hl.max(largest, value)
    return largest


def _find_rank(values: list[hl.Expr], rank: int) -> hl.Expr:
    """Return the value of a rank, 1 for the largest, by insertion into a sorted list of ``rank`` values."""
    best = [hl.f32(-LARGEST_FLOAT)] * rank
    for value in values:
        for place in range(rank):
            best[place], value = hl.max(best[place], value), hl.min(best[place], value)
    return best[-1]
