"""What the samples tell about a filtered frame, as steps of a pipeline: lost detail, and lost light.

See `lobewise.denoising.evidence` and `lobewise.denoising.light_loss`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lobewise.denoising.evidence import MAX_CONCENTRATION, MAX_RADIANCE
from lobewise.denoising.light_loss import MAX_TAKER
from lobewise.denoising.networks import load_networks
from lobewise.engine.graph import Image
from lobewise.engine.numbers import Number, choose_larger, choose_smaller, round_single
from lobewise.exporting.pipeline.recipes.guides import SIZE, PipelineGuides
from lobewise.filters import glue
from lobewise.filters.fireflies import define_cut
from lobewise.filters.noise.detail import COUNT, LEVELS, define_difference, define_features, define_products
from lobewise.filters.noise.evidence import (
    BLUR_COUNT,
    define_excess,
    define_share,
    find_margins,
)
from lobewise.filters.noise.pooling import DARK_SHARE, count_weights, define_blur
from lobewise.filters.noise.shares import make_shares


@dataclass(frozen=True)
class FoundFrame:
    """The filtered layers of a frame: noisy light, filtered light, and the light that is in none of them."""

    layers: Sequence[Any]
    noisy: Sequence[Image]
    parts: Sequence[Image]
    rest: Image | None


def compose(guides: PipelineGuides, parts: Sequence[Image], rest: Image | None) -> Image:
    """Return the sum of all light."""
    images: dict[str, Image | None] = {f"part{k}": part for k, part in enumerate(parts)}
    if len(parts) == 1 and rest is None:
        return parts[0]
    (total,) = guides.kernels.map_pixels(
        glue.define_composed, {**images, "rest": rest}, {}, names=["total"], text="the sum of all light"
    )
    return total


def _single(value: float) -> Number:
    return Number(float(np.float32(value)), repr(float(np.float32(value))), is_single=True)


def _blur(guides: PipelineGuides, image: Image, step: int) -> Image:
    for along_rows in (True, False):
        (image,) = guides.kernels.map_pixels(
            define_blur,
            {"image": image},
            {"step": _single(step)},
            along_rows,
            names=["blurred"],
            text=f"blur, taps {step} pixels apart",
        )
    return image


def take_back(guides: PipelineGuides, found: FoundFrame, color: Image) -> list[Image]:
    """Return the parts of a frame, and the rest where there is one, mixed with their noisy light."""
    kernels, levels = guides.kernels, [layer.level for layer in found.layers if layer.level is not None]
    level: float = levels[0]
    for other in levels[1:]:
        level = choose_larger(level, other)
    total, bounded = (compose(guides, light, found.rest) for light in (found.parts, found.noisy))
    images: dict[str, Image | None] = {"color": color, "bounded": bounded}
    (color,) = kernels.map_pixels(define_cut, images, {}, names=["cut"], text="samples that are not too bright")
    images = {"image": total}
    (filtered,) = kernels.map_pixels(glue.define_good, images, {}, names=["good"], text="the filtered image, finite")
    halves = dict(zip(("half_a", "half_b"), guides.give_halves("color"), strict=True))
    told = {"filtered": filtered, "noisy": color, **halves}
    shares = find_shares(guides, told, level)
    certain = find_certain(guides, told, level)
    images = {"color": color, "shares": shares, "certain": certain}
    (share,) = kernels.map_pixels(
        glue.define_share_taken, images, {}, MAX_RADIANCE, names=["share"], text="share of the noisy image"
    )
    pairs = [*zip(found.parts, found.noisy, strict=True)]
    # The light that no surface scattered is not filtered: nothing of it is lost.
    pairs += [(found.rest, found.rest)] if found.rest is not None else []
    mixed: list[Image] = []
    for part, noisy in pairs:
        images = {"part": part, "noisy": noisy, "share": share}
        mixed += kernels.map_pixels(glue.define_mixed, images, {}, names=["mixed"], text="take the noisy light back")
    return mixed


def find_shares(guides: PipelineGuides, told: dict[str, Image], level: float) -> Image:
    """Return the shares that the network predicts; see `find_share_taken_back`."""
    kernels = guides.kernels
    level = choose_smaller(choose_larger(level, 1e-12), 1e12)
    dark = DARK_SHARE * level
    floor = {"floor": round_single(choose_larger(dark * dark, 1e-24))}
    names = ["apart", "noise", "light"]
    apart, noise, light = kernels.map_pixels(
        define_difference, told, floor, names=names, text="difference to the noisy image"
    )
    images = {"apart": apart, "noise": noise, "light": light, "filtered": told["filtered"]}
    (sums,) = kernels.map_pixels(define_products, images, floor, names=["products"], text="products with neighbours")
    (own,) = kernels.map_pixels(glue.define_channel, {"image": sums}, {}, 0, names=["own"], text="squared difference")
    pooled = {"own": own, "light": light}
    for number in range(max(LEVELS) + 1):
        sums = _blur(guides, sums, 2**number)
        if number in LEVELS:
            pooled[f"sums{number}"] = sums
    numbers = {
        "counts": [_single(count_weights(number)) for number in LEVELS],
        "factor": _single(1.0),
        "level": round_single(level),
        "flags": [_single(1.0), _single(0.0)],
    }
    network = load_networks()["noisy"]
    network.require_fit(COUNT, 2)
    sizes = COUNT, *(len(bias) for bias in network.biases)
    arrays = {name: guides.graph.hold(f"network_{name}", array) for name, array in network.name_arrays().items()}
    kernel = kernels.get(("shares", sizes), partial(make_shares, sizes))
    # The features of a whole image would take more memory than all other images.
    seen, shares = guides.graph.make("seen", "band", "width", COUNT), guides.graph.make("shares", *SIZE, 2)
    with guides.graph.only_in_bands():
        text = "features of the difference"
        kernels.map_pixels(define_features, pooled, numbers, into=[seen], text=text)
        text = "a small network says how much to take back"
        kernels.call(kernel, {"seen": seen, **arrays}, into={"shares": shares}, text=text)
    return shares


def find_certain(guides: PipelineGuides, told: dict[str, Image], level: float) -> Image:
    """Return the share of the noisy image that the halves prove; see `find_noisy_share`."""
    kernels = guides.kernels
    dark = DARK_SHARE * level
    floor = round_single(choose_smaller(choose_larger(dark * dark, 1e-24), 1e30))
    text = "excess of the difference over the noise"
    (sums,) = kernels.map_pixels(define_excess, told, {"floor": floor}, False, names=["excess"], text=text)
    images = {"noisy": told["noisy"]}
    for number in range(BLUR_COUNT):
        images[f"sums{number}"] = sums = _blur(guides, sums, 2**number)
    numbers = {"error": find_margins(), "most": _single(MAX_CONCENTRATION)}
    (share,) = kernels.map_pixels(define_share, images, numbers, names=["certain"], text="share that is certain")
    return share


def keep_light(
    guides: PipelineGuides, layers: Sequence[Any], parts: Sequence[Image], image: Image
) -> tuple[Image, list[Image]]:
    """Return a frame and its parts, with the light that bounding took shared out; see `keep_light`."""
    kernels, graph, found = guides.kernels, guides.graph, []
    for layer, part in zip(layers, parts, strict=True):
        assert layer.level is not None
        images = {"part": part, "albedo": layer.albedo, "mask": layer.mask}
        (taker,) = kernels.map_pixels(
            glue.define_takers,
            images,
            {"level": layer.level},
            MAX_TAKER,
            names=[f"{layer.name}_taker"],
            text="light that takes part in sharing",
        )
        gains = [graph.add_real(f"{name}_gain_{layer.name}") for name in ("takers", "all")]
        graph.run(
            "find_gain", [layer.radiance, part, taker], [f"&{gain}" for gain in gains], f"gain of {layer.name} light"
        )
        found.append((taker, gains))
    bright = []
    for (taker, gains), layer, part in zip(found, layers, parts, strict=True):
        names = zip(("takers", "all"), gains, strict=True)
        numbers = {name: Number(0.0, f"(double)(float){gain}", is_single=True) for name, gain in names}
        for name, source in (("total", image), (f"{layer.name}_part", part)):
            images = {"image": source, "part": part, "taker": taker}
            (result,) = kernels.map_pixels(
                glue.define_brightened, images, numbers, names=[name], text=f"share {layer.name} light out"
            )
            if name == "total":
                image = result
            else:
                bright.append(result)
    return image, bright
