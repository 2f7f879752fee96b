"""The shape of the refining network: its layers, and where the weights of each layer lie in one array."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

PLANES = 21
"""Channels that the network reads of a pixel; see `lobewise.filters.refinement.planes`."""
LEVEL_COUNT = 5
"""Levels of the pyramid. Each has half the rows and columns of the level below, rounded up."""
UNITS = (24, 32, 48, 64, 80)
"""Channels of the features of each level, the finest first."""
SQUEEZED = 16
"""Channels that the finest level receives from the level above."""
NOISY_SIDE, FILTERED_SIDE, COARSE_SIDE = 5, 3, 3
"""Sides of the squares of taps, pixels."""
GROUPS = (4, 4)
"""Components of the vectors that taps compare: place and normal, lobe. Each group has one learned exponent."""
VECTORS = sum(GROUPS)
BLOCK_OUTPUTS = 8
"""Outputs of a layer whose weights lie together. Layers have a multiple of it; outputs that are added mean nothing."""
MULTIPLE = 2 ** (LEVEL_COUNT - 1)
"""Bands begin at a multiple of so many rows, so that all levels have the same pixels as in the whole image."""


class LogitPlaces(NamedTuple):
    """Indices of the first output of each kind in a head."""

    noisy: int
    filtered: int
    coarse: int
    exponents: int
    sources: int
    trust: int
    total: int


def place_logits(level: int) -> LogitPlaces:
    """Return where the outputs of a level's head are in the file. Only the finest one has source weights and trust."""
    filtered = NOISY_SIDE**2
    coarse = filtered + FILTERED_SIDE**2
    exponents = coarse + (COARSE_SIDE**2 if level < LEVEL_COUNT - 1 else 0)
    sources = exponents + len(GROUPS)
    trust = sources + (2 if level == 0 else 0)
    return LogitPlaces(0, filtered, coarse, exponents, sources, trust, trust + (1 if level == 0 else 0))


HEAD = place_logits(0)
"""Indices of the outputs in the heads that kernels read: all levels have those of the finest one."""
HEAD_OUTPUTS = -(-HEAD.total // BLOCK_OUTPUTS) * BLOCK_OUTPUTS
"""Outputs of the heads that kernels read."""


@dataclass(frozen=True)
class LayerShape:
    """A convolution.

    Parameters
    ----------
    name : str
        Name of the layer in the file of weights.
    inputs, outputs : int
        Channels.
    side : int
        Side of the square of taps.
    padded : int
        Outputs in the array that kernels read.
    start : int
        First row of the array that kernels read: for each `BLOCK_OUTPUTS` of outputs a row of biases, then a row for
        each (input, row, column).
    """

    name: str
    inputs: int
    outputs: int
    side: int
    padded: int
    start: int

    @property
    def stop(self) -> int:
        """Row after the last one."""
        return self.start + self.padded // BLOCK_OUTPUTS * (1 + self.inputs * self.side**2)


def list_network_layers() -> dict[str, LayerShape]:
    """Return all layers by name, in the order of the array that kernels read."""
    layers: dict[str, LayerShape] = {}
    start = 0
    for name, inputs, outputs, side in _list_sizes():
        padded = HEAD_OUTPUTS if name.startswith("heads") else outputs
        layers[name] = LayerShape(name, inputs, outputs, side, padded, start)
        start = layers[name].stop
    return layers


def _list_sizes() -> Iterator[tuple[str, int, int, int]]:
    """Yield name, inputs, outputs and side of each layer."""
    yield "stem", 4 * PLANES, UNITS[1], 1
    for level in range(1, LEVEL_COUNT):
        yield f"down.{level - 1}.0", UNITS[max(level - 1, 1)], UNITS[level], 3
        yield f"down.{level - 1}.1", UNITS[level], UNITS[level], 3
    for level in range(1, LEVEL_COUNT - 1):
        yield f"up.{level - 1}.0", UNITS[level + 1] + UNITS[level], UNITS[level], 3
        yield f"up.{level - 1}.1", UNITS[level], UNITS[level], 3
    yield "squeeze", UNITS[1], SQUEEZED, 1
    yield "fine.0", SQUEEZED + PLANES, UNITS[0], 3
    yield "fine.1", UNITS[0], UNITS[0], 3
    for level in range(LEVEL_COUNT):
        yield f"heads.{level}", UNITS[level], place_logits(level).total, 1


LAYERS = list_network_layers()
WEIGHT_ROWS = max(layer.stop for layer in LAYERS.values())
"""Rows of the array that kernels read, each of `BLOCK_OUTPUTS` numbers."""


def compute_reach() -> int:
    """Return the pixels from a pixel of the result to the furthest pixel on which it depends.

    A pixel of a level covers a block of pixels of the finest level. The reach of a level is counted from the edges of
    that block. A convolution and a square of taps add pixels of the level. A pixel's parent covers a larger block,
    which is up to one pixel of the level wider on one side.
    """
    down = [0] * LEVEL_COUNT
    for level in range(1, LEVEL_COUNT):
        down[level] = down[level - 1] + 2 * 2**level
    features = down[LEVEL_COUNT - 1]
    for level in reversed(range(LEVEL_COUNT - 1)):
        # Two convolutions, and what the level above is wider.
        features += 3 * 2**level
    reach = 0
    for level in reversed(range(LEVEL_COUNT)):
        own = NOISY_SIDE // 2 * 2**level + features
        above = reach + 2 ** (level + 1) + 2**level if level < LEVEL_COUNT - 1 else 0
        reach = max(own, above)
    return reach


REFINEMENT_REACH = compute_reach()
