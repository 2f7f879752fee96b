"""The convolutions of the refining network, as Halide functions of (x, c, y).

The network is a U-Net: it halves the image four times, and enlarges the features again. Outside the image every input
of a convolution is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from lobewise.backend.compiler import hl
from lobewise.filters.planes import C, X, Y
from lobewise.filters.refinement.shape import LAYERS, LEVELS, PLANES, SQUEEZED, UNITS

LEAK = 0.1
"""Slope of the activation below 0 (leaky ReLU)."""


class Size(NamedTuple):
    """Columns and rows of a level."""

    width: hl.Expr
    height: hl.Expr


class Input(NamedTuple):
    """A function that taps read, and its channels.

    It is a copy of another function that is 0 outside the image, or the function itself if taps stay in the image.
    """

    func: hl.Func
    channels: int
    is_copy: bool = True


class Convolution(NamedTuple):
    """A convolution: its inputs, its sums with one domain for each input, and its result."""

    inputs: tuple[Input, ...]
    sums: hl.Func
    domains: tuple[hl.RDom, ...]
    out: hl.Func
    channels: int
    level: int
    is_square: bool
    """Whether it reads 3x3 pixels, not one."""


@dataclass
class Network:
    """The functions of the network.

    Parameters
    ----------
    weights : halide.ImageParam
        The flat array of all weights.
    sizes : list of Size
        Of each level.
    convolutions : list of Convolution
        All but the heads, in order.
    features : dict of int to halide.Func
        Features of each level.
    """

    weights: hl.ImageParam
    sizes: list[Size]
    convolutions: list[Convolution] = field(default_factory=list)
    features: dict[int, hl.Func] = field(default_factory=dict)

    def convolve(self, name: str, level: int, *inputs: Input, active: bool = True) -> hl.Func:
        """Add the layer of this name on a level and return its result."""
        made = define_convolution(self.weights, name, level, inputs, active=active)
        self.convolutions.append(made)
        return made.out

    def convolve_near(self, name: str, level: int, source: hl.Func, channels: int) -> hl.Func:
        """Add a layer that reads a function of its own level."""
        return self.convolve(name, level, Input(surround(source, self.sizes[level], name), channels))


def measure_levels(width: hl.Expr, height: hl.Expr) -> list[Size]:
    """Return the size of each level."""
    sizes = [Size(width, height)]
    for _ in range(LEVELS - 1):
        sizes.append(Size((sizes[-1].width + 1) // 2, (sizes[-1].height + 1) // 2))
    return sizes


def define_network(planes: hl.ImageParam, weights: hl.ImageParam, sizes: list[Size]) -> Network:
    """Return the network up to the features of each level; ``planes`` is a function of (x, c, y)."""
    found = Network(weights, sizes)
    space = Input(gather_blocks(planes, sizes[0], sizes[1]), 4 * PLANES)
    last, channels = found.convolve("stem", 1, space), UNITS[1]
    skipped: dict[int, hl.Func] = {}
    for level in range(1, LEVELS):
        name = f"down.{level - 1}.0"
        if level == 1:
            first = found.convolve_near(name, level, last, channels)
        else:
            smaller = halve(last, sizes[level - 1], sizes[level], name)
            first = found.convolve(name, level, Input(smaller, channels))
        last, channels = found.convolve_near(f"down.{level - 1}.1", level, first, UNITS[level]), UNITS[level]
        skipped[level] = last
    found.features[LEVELS - 1] = last
    for level in reversed(range(1, LEVELS - 1)):
        name, size = f"up.{level - 1}.0", sizes[level]
        larger = Input(enlarge(found.features[level + 1], size, name), UNITS[level + 1])
        same = Input(surround(skipped[level], size, name), UNITS[level])
        joined = found.convolve(name, level, larger, same)
        found.features[level] = found.convolve_near(f"up.{level - 1}.1", level, joined, UNITS[level])
    squeezed = found.convolve("squeeze", 1, Input(found.features[1], UNITS[1], is_copy=False))
    larger = Input(enlarge(squeezed, sizes[0], "fine"), SQUEEZED)
    same = Input(surround(planes, sizes[0], "fine"), PLANES)
    joined = found.convolve("fine.0", 0, larger, same)
    found.features[0] = found.convolve_near("fine.1", 0, joined, UNITS[0])
    return found


def define_convolution(
    weights: hl.ImageParam, name: str, level: int, inputs: Sequence[Input], *, active: bool
) -> Convolution:
    """Return a convolution, with a leaky ReLU if ``active``."""
    layer, short = LAYERS[name], name.replace(".", "_")
    sums, out = hl.Func(f"sums_{short}"), hl.Func(short)
    sums[X, C, Y] = weights[layer.bias + C]
    radius, first, domains = layer.side // 2, 0, []
    for number, source in enumerate(inputs):
        taps = hl.RDom([(0, layer.side), (0, layer.side), (0, source.channels)], f"taps_{short}_{number}")
        place = (taps.y * layer.side + taps.x) * layer.inputs + first + taps.z
        weight = weights[layer.start + place * layer.padded + C]
        sums[X, C, Y] = sums[X, C, Y] + weight * source.func[X + taps.x - radius, taps.z, Y + taps.y - radius]
        first += source.channels
        domains.append(taps)
    value = sums[X, C, Y]
    out[X, C, Y] = hl.max(value, hl.f32(LEAK) * value) if active else value
    return Convolution(tuple(inputs), sums, tuple(domains), out, layer.padded, level, layer.side > 1)


def surround(source: hl.Func | hl.ImageParam, size: Size, name: str) -> hl.Func:
    """Return a function that is 0 outside the image."""
    found = hl.Func(f"near_{name.replace('.', '_')}")
    found[X, C, Y] = _keep_inside(source[hl.clamp(X, 0, size.width - 1), C, hl.clamp(Y, 0, size.height - 1)], size)
    return found


def enlarge(source: hl.Func, size: Size, name: str) -> hl.Func:
    """Return every pixel of a function of the level above four times."""
    found = hl.Func(f"larger_{name.replace('.', '_')}")
    x, y = hl.clamp(X, 0, size.width - 1) // 2, hl.clamp(Y, 0, size.height - 1) // 2
    found[X, C, Y] = _keep_inside(source[x, C, y], size)
    return found


def halve(source: hl.Func, before: Size, size: Size, name: str) -> hl.Func:
    """Return the largest of four pixels of a function of the level below."""
    found = hl.Func(f"smaller_{name.replace('.', '_')}")
    x, y = 2 * hl.clamp(X, 0, size.width - 1), 2 * hl.clamp(Y, 0, size.height - 1)
    right, below = hl.min(x + 1, before.width - 1), hl.min(y + 1, before.height - 1)
    top = hl.max(source[x, C, y], source[right, C, y])
    found[X, C, Y] = _keep_inside(hl.max(top, hl.max(source[x, C, below], source[right, C, below])), size)
    return found


def gather_blocks(source: hl.ImageParam, before: Size, size: Size) -> hl.Func:
    """Return the four pixels of each block of 2x2 as channels: channel, then row, then column."""
    found = hl.Func("blocks")
    x = 2 * hl.clamp(X, 0, size.width - 1) + C % 2
    y = 2 * hl.clamp(Y, 0, size.height - 1) + (C // 2) % 2
    value = source[hl.min(x, before.width - 1), C // 4, hl.min(y, before.height - 1)]
    found[X, C, Y] = _keep_inside(hl.select((x < before.width) & (y < before.height), value, hl.f32(0.0)), size)
    return found


def _keep_inside(value: hl.Expr, size: Size) -> hl.Expr:
    inside = (X >= 0) & (size.width > X) & (Y >= 0) & (size.height > Y)
    return hl.select(inside, value, hl.f32(0.0))
