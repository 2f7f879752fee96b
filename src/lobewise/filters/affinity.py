"""The affinity filter: a dilated 5x5 mean whose weights compare features that a network predicts for every pixel.

``y_i = (c_i x_i + sum_j w_ij x_j) / (c_i + sum_j w_ij)`` over the 24 neighbours j of pixel i, with
``w_ij = exp(-|f_i - f_j|^2 - b_i |L_i - L_j|^2) m_j``. The features f, the centre weight c, the source weight m and the
exponent b come from the network; the lobe vectors L are fixed. All weights are >= 0: the mean is convex.

Source: Isik et al. 2021, "Interactive Monte Carlo Denoising using Affinity of Neural Features", equations 1 to 3.
Departs: the weight also compares lobes and has the source weight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import NamedTuple

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.buffers import Image, returns_host_images, take_dense
from lobewise.backend.jit import Scheduled, get_kernel, run_kernel
from lobewise.backend.signature import Signature
from lobewise.errors import InputError
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.planes import C, X, Y, clamp_likely
from lobewise.filters.schedules.affinity import AffinityFuncs, schedule_affinity

RADIUS = 2
"""Taps from the centre to the edge."""
MAX_STEP = 1024
"""Largest distance between neighbouring taps, pixels."""


@dataclass(frozen=True)
class AffinityKey:
    """Everything that changes the code of the filter."""

    features: int
    lobes: int
    """Components of a lobe vector; 0 if lobes are not compared."""


class Inputs(NamedTuple):
    """The images that the filter reads; Halide orders their axes as columns, rows, channels."""

    light: hl.ImageParam
    features: hl.ImageParam
    centre: hl.ImageParam
    source: hl.ImageParam
    lobes: hl.ImageParam | None
    exponent: hl.ImageParam | None


class Pixel(NamedTuple):
    """The values of a pixel that the filter reads."""

    light: Sequence[hl.Expr]
    features: Sequence[hl.Expr]
    centre: hl.Expr
    source: hl.Expr
    lobes: Sequence[hl.Expr]
    exponent: hl.Expr


class Distance(NamedTuple):
    """Squared distances of two pixels i and j."""

    features: hl.Expr
    """``|f_i - f_j|^2``"""
    lobes: hl.Expr
    """``|L_i - L_j|^2``"""


def measure_distance(here: Pixel, there: Pixel) -> Distance:
    """Return the squared distances of the features and of the lobes of two pixels."""

    def add_squares(first: Sequence[hl.Expr], second: Sequence[hl.Expr]) -> hl.Expr:
        return sum(((p - q) * (p - q) for p, q in zip(first, second, strict=True)), hl.f32(0.0))

    return Distance(add_squares(here.features, there.features), add_squares(here.lobes, there.lobes))


def compute_affinity(distance: Distance, exponent: hl.Expr) -> hl.Expr:
    """Return ``exp(-|f_i - f_j|^2 - b_i |L_i - L_j|^2)``, relative error 1e-5; ``exponent`` is b of the centre i."""
    return expressions.exp2(hl.f32(-expressions.LOG2_E) * (distance.features + exponent * distance.lobes))


def declare_inputs(signature: Signature, key: AffinityKey) -> Inputs:
    """Declare the images that the filter reads, channels first in memory."""
    size = "height", "width"

    def declare(name: str, *channels: int) -> hl.ImageParam:
        image = signature.image(name, *channels, *size)
        if channels:
            image.dim(2).set_bounds(0, channels[0])
        return image

    return Inputs(
        declare("light", COLORS),
        declare("features", key.features),
        declare("centre"),
        declare("source"),
        declare("lobes", key.lobes) if key.lobes else None,
        declare("exponent") if key.lobes else None,
    )


def read_pixel(inputs: Inputs, key: AffinityKey, x: hl.Expr) -> Pixel:
    """Return the values of the pixel of column ``x`` and row Y."""

    def read(image: hl.ImageParam | None, channels: int) -> list[hl.Expr]:
        return [] if image is None else [image[x, Y, k] for k in range(channels)]

    light, features, lobes = (
        read(inputs.light, COLORS),
        read(inputs.features, key.features),
        read(inputs.lobes, key.lobes),
    )
    exponent = inputs.exponent[x, Y] if inputs.exponent is not None else hl.f32(0.0)
    return Pixel(light, features, inputs.centre[x, Y], inputs.source[x, Y], lobes, exponent)


def flatten_pixel(pixel: Pixel) -> list[hl.Expr]:
    """Return all values of a pixel, one after the other."""
    return [*pixel.light, *pixel.features, pixel.centre, pixel.source, *pixel.lobes, pixel.exponent]


def rebuild_pixel(key: AffinityKey, values: Iterator[hl.Expr]) -> Pixel:
    """Return a pixel from its values in the order of `flatten_pixel`."""
    light, features = list(islice(values, COLORS)), list(islice(values, key.features))
    return Pixel(light, features, next(values), next(values), list(islice(values, key.lobes)), next(values))


def stack_pixels(width: hl.Expr, read: Callable[[hl.Expr], list[hl.Expr]]) -> tuple[hl.Func, int]:
    """Return a function of (x, c, y), all values of ``read(column)``, 0 beside the image; and the number of values."""
    values = read(clamp_likely(X, width))
    pixels = hl.Func("pixels")
    pixels[X, C, Y] = hl.select(hl.likely(X >= 0) & hl.likely(width > X), hl.mux(C, values), hl.f32(0.0))
    return pixels, len(values)


def make_window(height: hl.Expr, step: hl.Expr) -> tuple[hl.RDom, hl.Expr, hl.Expr]:
    """Return the window of the 24 neighbours in rows of the image, and the column and row of a neighbour."""
    window = hl.RDom([(-RADIUS, 2 * RADIUS + 1)] * 2, "window")
    row = Y + window.y * step
    window.where(((window.x != 0) | (window.y != 0)) & (row >= 0) & (height > row))
    return window, X + window.x * step, hl.clamp(row, 0, height - 1)


def _make_affinity(key: AffinityKey, target: hl.Target) -> Scheduled:
    """Return the filter's kernel."""
    signature = Signature("affinity")
    inputs = declare_inputs(signature, key)
    step = signature.count("step", 1, MAX_STEP)
    signature.output("filtered", COLORS + 1, "height", "width")

    pixels, pixel_channels = stack_pixels(
        inputs.centre.dim(0).extent(), lambda column: flatten_pixel(read_pixel(inputs, key, column))
    )
    window, *at = make_window(inputs.centre.dim(1).extent(), step)
    here, there = (rebuild_pixel(key, (pixels[x, k, y] for k in range(pixel_channels))) for x, y in ((X, Y), at))
    weight = compute_affinity(measure_distance(here, there), here.exponent) * there.source
    sums, out = hl.Func("sums"), hl.Func("filtered")
    sums[X, Y] = hl.Tuple([*(here.centre * value for value in here.light), here.centre])
    add_terms(sums, [*(weight * value for value in there.light), weight])
    total = sums[X, Y][COLORS]
    out[X, Y, C] = hl.mux(C, [*(sums[X, Y][k] / total for k in range(COLORS)), total])
    funcs = AffinityFuncs(
        pixels=pixels, pixel_channels=pixel_channels, sums=sums, window=window, out=out, out_channels=COLORS + 1
    )
    schedule_affinity(funcs, target)
    return Scheduled([out], signature)


def add_terms(sums: hl.Func, terms: Sequence[hl.Expr]) -> None:
    """Add a tap to every sum of a pixel."""
    sums[X, Y] = hl.Tuple([sums[X, Y][k] + term for k, term in enumerate(terms)])


class AffinityInputs(NamedTuple):
    """The arrays that the filter reads, channels first, all finite.

    Parameters
    ----------
    light : (3, height, width)
        Radiance to average.
    features : (count, height, width)
    centre : (height, width)
        Weight of the pixel itself, > 0.
    source : (height, width)
        Weight of the pixel in the means of its neighbours, >= 0.
    lobes : (count, height, width), optional
    exponent : (height, width), optional
        Factor of squared distances of lobes, >= 0.
    """

    light: Image
    features: Image
    centre: Image
    source: Image
    lobes: Image | None = None
    exponent: Image | None = None

    def find_key(self) -> AffinityKey:
        """Return the key of the kernel; raise InputError unless all shapes fit."""
        size = self.centre.shape
        planes = [("features", self.features)] + [("lobes", self.lobes)] * (self.lobes is not None)
        counts = [image.shape[0] if image is not None and image.ndim == 3 else 1 for _, image in planes]
        expected = {"light": (COLORS, *size), "centre": size, "source": size}
        expected |= {name: (count, *size) for (name, _), count in zip(planes, counts, strict=True)}
        if self.lobes is not None or self.exponent is not None:
            expected |= {"exponent": size, "lobes": expected.get("lobes", ("count", *size))}
        for name, shape in expected.items():
            image = getattr(self, name)
            got = "nothing" if image is None else f"shape {image.shape}"
            if image is None or image.shape != shape or len(size) != 2:
                raise InputError(
                    name,
                    expected=f"shape {shape}",
                    got=got,
                    action="give every pixel its numbers, channels first, and lobes together with their exponent",
                )
        return AffinityKey(counts[0], counts[1] if len(counts) > 1 else 0)

    def name_images(self) -> dict[str, Image]:
        """Return the arrays that are not None by name, dense and float32."""
        return {name: take_dense(image) for name, image in self._asdict().items() if image is not None}


@returns_host_images
def run_affinity(inputs: AffinityInputs, *, step: int = 1, device: str = "cpu") -> Image:
    """Return the mean of every pixel and its neighbours, and the sum of their weights, shape (4, height, width).

    Parameters
    ----------
    inputs : AffinityInputs
    step : int
        Distance between neighbouring taps, pixels, from 1 to `MAX_STEP`.
    device : str
        A name from `lobewise.backend.devices.list_devices`.

    Raises
    ------
    InputError
        If an array has another shape than `AffinityInputs` asks for.
    """
    key = inputs.find_key()
    kernel = get_kernel(device, key, partial(_make_affinity, key))
    return run_kernel(kernel, device, inputs.name_images(), step=step)["filtered"]
