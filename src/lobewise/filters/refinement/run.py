"""Refine a filtered image: fill the planes, then run the network and its pyramid of filters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from lobewise import engine
from lobewise.backend.buffers import Image, device_scope, returns_host_images, take_image
from lobewise.errors import InputError
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.refinement.network import RefiningNetwork
from lobewise.filters.refinement.planes import OPTIONAL, PlanesKey, make_planes
from lobewise.filters.refinement.shape import BLOCK_OUTPUTS, HEAD, LAYERS, WEIGHT_ROWS, LayerShape, place_logits
from lobewise.records.frame import FloatArray


def pack_weights(arrays: Mapping[str, FloatArray]) -> FloatArray:
    """Return the array that the kernels read, shape (`WEIGHT_ROWS`, `BLOCK_OUTPUTS`).

    Parameters
    ----------
    arrays : mapping of str to array
        ``NAME.weight``, shape (outputs, inputs, rows, columns), and ``NAME.bias``, shape (outputs,), of every layer.
        The stem has taps 2 pixels apart and a square of 2x2.

    Raises
    ------
    InputError
        If a layer is missing or has another shape.
    """
    packed = np.zeros((WEIGHT_ROWS, BLOCK_OUTPUTS), dtype=np.float32)
    for name, layer in LAYERS.items():
        square = (2, 2) if name == "stem" else (layer.side, layer.side)
        inputs = layer.inputs // (4 if name == "stem" else 1)
        for part, shape in (("weight", (layer.outputs, inputs, *square)), ("bias", (layer.outputs,))):
            got = np.shape(arrays[f"{name}.{part}"]) if f"{name}.{part}" in arrays else None
            if got != shape:
                action = "export it again with benchmarks.training.refinement"
                raise InputError(f"{name}.{part}", expected=f"shape {shape}", got=str(got), action=action)
        # A block of 2x2 pixels is read as channels, so the stem has taps of one pixel.
        rows = np.zeros((layer.padded, 1 + layer.inputs * layer.side**2), np.float32)
        places = _place_outputs(layer)
        rows[places, 0] = arrays[f"{name}.bias"]
        rows[places, 1:] = arrays[f"{name}.weight"].reshape(layer.outputs, -1)
        blocks = rows.reshape(-1, BLOCK_OUTPUTS, rows.shape[1]).swapaxes(1, 2)
        packed[layer.start : layer.stop] = blocks.reshape(-1, BLOCK_OUTPUTS)
    return packed


def _place_outputs(layer: LayerShape) -> list[int]:
    """Return the places of a layer's outputs among those that kernels compute: all heads have one layout."""
    places = list(range(layer.outputs))
    kind, _, level = layer.name.partition(".")
    if kind == "heads":
        own = place_logits(int(level))
        places[own.exponents :] = range(HEAD.exponents, HEAD.exponents + layer.outputs - own.exponents)
    return places


@returns_host_images
@device_scope()
def refine_image(
    images: dict[str, Image | None],
    weights: FloatArray,
    *,
    brightness: float,
    mean_log_depth: float,
    shared: bool,
) -> Image:
    """Return the refined image, shape (height, width, 3), finite and >= 0.

    Parameters
    ----------
    images : dict of str to array or None
        "noisy" and "filtered", shape (height, width, 3), finite, >= 0; and those of `OPTIONAL` that are known, finite.
        The dictionary is emptied, so that no image of it takes memory while the network runs.
    weights : array
        Result of `pack_weights`.
    brightness : float
        Squared mean of the root of the light of the whole image, > 0.
    mean_log_depth : float
        Mean natural logarithm of the depth of all surfaces of the whole image.
    shared : bool
        Whether neighbouring pixels share samples.

    Raises
    ------
    InputError
        If an image has another shape.
    """
    there = {name: image for name, image in images.items() if image is not None}
    size, known = there["noisy"].shape[:2], tuple(name for name in OPTIONAL if name in there)
    lent: dict[str, Image] = {}
    for name in ("noisy", "filtered", *known):
        channels = OPTIONAL.get(name, COLORS)
        lent[name] = take_image(name, there[name], (*size, channels) if channels else size)
    key = PlanesKey(known)
    numbers = {"brightness": brightness, "mean_log_depth": mean_log_depth, "noise_is_shared": float(shared)}
    planes = engine.kernel(key, partial(make_planes, key), lent, numbers, text="planes of the network")
    for held in (images, there, lent):
        held.clear()
    return RefiningNetwork(weights, planes, brightness).run()
