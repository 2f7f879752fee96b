"""The layers of a recorded frame in two halves, which `lobewise.denoising.running` filters."""

from __future__ import annotations

from functools import partial
from typing import Any, cast

from lobewise import engine
from lobewise.denoising.noisy import NoisyLayer
from lobewise.engine.numbers import Number
from lobewise.exporting.pipeline.recipes.guides import PipelineGuides
from lobewise.features import Feature
from lobewise.filters.fireflies import BoundedHalves, make_fireflies
from lobewise.filters.highlights import Kinds, make_highlights
from lobewise.filters.noise_guides import make_light_sums
from lobewise.guides.halves import define_marked
from lobewise.settings import Similarity

KINDS = Kinds(shared=False, single=False, paired=True)
"""Halves of the samples are samples of every pixel, at least two, and independent of those of its neighbours."""
SIMPLE: Similarity = "sg"
"""Similarity of the pilot, which compares single lobes."""


def prepare_halves(guides: PipelineGuides, layer: Any, pilot: tuple[Feature, ...]) -> NoisyLayer:
    """Return a layer in two halves, fireflies bounded and highlights split off; see `make_noisy_layers`."""
    graph, name = guides.graph, layer.name
    marked: list[Any] = [
        engine.pixels(define_marked, {"image": half}, {}, names=[f"{name}_{letter}"], text="mark bad pixels")[0]
        for letter, half in zip("ab", cast(Any, guides.give_halves(name)), strict=True)
    ]
    tinted = layer.albedo is not None
    beside = {"albedo": layer.albedo, "mask": layer.mask}
    images = {"a": marked[0], "b": marked[1], **beside}
    bright = engine.kernel(("fireflies", tinted), partial(make_fireflies, tinted), images, text="bound fireflies")
    images = {"a": bright["bounded_a"], "b": bright["bounded_b"], **beside}
    light = partial(make_light_sums, tinted)
    sums = engine.kernel(("light sums", tinted), light, images, text="light of every row")["sums"]
    level = graph.add_real(f"level_{name}")
    graph.run("find_level", [sums, layer.mask], [f"&{level}"], "mean light of the layer")
    highlights = partial(make_highlights, tinted, KINDS)
    split = engine.kernel(("highlights", tinted, KINDS), highlights, images, text="split off highlights")
    halves = split["rest_a"], split["rest_b"]
    return NoisyLayer(
        layer=layer,
        bounded=BoundedHalves(*halves, tally=cast(Any, None)),
        is_whole=True,
        noise_is_shared=False,
        pilot_features=pilot,
        seen=(),
        level=Number(1.0, level),
        samples=halves,
        kept=split["kept"],
    )
