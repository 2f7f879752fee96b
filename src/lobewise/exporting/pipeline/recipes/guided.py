"""The layers of a recorded frame in two halves, which `lobewise.denoising.running` filters."""

from __future__ import annotations

from typing import Any, cast

from lobewise import engine
from lobewise.denoising.noisy import BoundedLayer, NoisyLayer, find_layer_level
from lobewise.exporting.pipeline.recipes.guides import PipelineGuides
from lobewise.features import Feature
from lobewise.filters.fireflies import BoundedHalves, bound_fireflies
from lobewise.filters.highlights import split_highlights
from lobewise.guides.halves import define_marked
from lobewise.settings import Similarity

SIMPLE: Similarity = "sg"
"""Similarity of the pilot, which compares single lobes."""


def prepare_halves(guides: PipelineGuides, layer: Any, pilot: tuple[Feature, ...]) -> NoisyLayer:
    """Return a layer in two halves, fireflies bounded and highlights split off; see `make_noisy_layers`."""
    marked: list[Any] = [
        engine.pixels(define_marked, {"image": half}, {}, names=[f"{layer.name}_{letter}"], text="mark bad pixels")[0]
        for letter, half in zip("ab", cast(Any, guides.give_halves(layer.name)), strict=True)
    ]
    bounded = bound_fireflies((marked[0], marked[1]), layer.albedo, layer.mask)
    bright = BoundedLayer(layer=layer, bounded=bounded, is_whole=True, noise_is_shared=False)
    level = find_layer_level(bright)
    a, b, kept = split_highlights(bright.halves, layer.albedo, layer.mask, paired=True)
    return NoisyLayer(
        layer=layer,
        bounded=BoundedHalves(a, b, bounded.sums),
        is_whole=True,
        noise_is_shared=False,
        pilot_features=pilot,
        seen=(),
        level=level,
        samples=(a, b),
        kept=cast(Any, kept),
    )
