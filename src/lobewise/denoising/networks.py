"""The trained networks of this package: small perceptrons, stored as arrays by name."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.resources import files

import numpy as np

from lobewise.filters.mixing import Network
from lobewise.frame import FloatArray

WEIGHTS = "weights.npz"
"""File of the arrays, beside this module."""
NAMES = ("noisy", "refined", "peer")
""""noisy" says how much of the noisy image a filtered image takes back, "refined" how much an image takes back that the
refining network made. "peer" mixes a result with the image of Open Image Denoise."""


@cache
def load_networks() -> Mapping[str, Network]:
    """Return the networks by name, see `NAMES`."""
    with files("lobewise.denoising").joinpath(WEIGHTS).open("rb") as file:
        arrays = dict(np.load(file, allow_pickle=False))
    return {kind: unpack_network(arrays, kind) for kind in NAMES}


def unpack_network(arrays: Mapping[str, FloatArray], kind: str) -> Network:
    """Return a network from the arrays that `pack_network` makes."""
    weights = tuple(arrays[f"{kind}_weights_{number}"] for number in range(3))
    biases = tuple(arrays[f"{kind}_biases_{number}"] for number in range(3))
    return Network(arrays[f"{kind}_mean"], arrays[f"{kind}_scale"], weights, biases)  # type: ignore[arg-type]


def pack_network(network: Network, kind: str) -> dict[str, FloatArray]:
    """Return a network as arrays by name."""
    arrays = {f"{kind}_mean": network.mean, f"{kind}_scale": network.scale}
    arrays |= {f"{kind}_weights_{number}": each for number, each in enumerate(network.weights)}
    arrays |= {f"{kind}_biases_{number}": each for number, each in enumerate(network.biases)}
    return arrays
