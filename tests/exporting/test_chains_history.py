"""The passes of a history on a device, in three languages, against Python: step by step, and over whole sequences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.denoising.layers import Layer, split_lobes
from lobewise.exporting.shaders.chains import make_chain
from lobewise.filters.history.accumulation import SampleGrid
from lobewise.frame import FloatArray, Frame
from lobewise.guides.places import add_grid, compute_virtual_places, estimate_curvature
from lobewise.temporal.past import HistoryReprojection
from lobewise.temporal.recipe import compute_own_weight, make_named_layers
from lobewise.temporal.validation import Guides, compute_same_tau
from tests.exporting.chain_device import Player, fill, give_images, make_constants
from tests.exporting.chain_scene import make_clean_image, make_frame
from tests.exporting.test_chains import RTOL, WEIGHT_RTOL, compare

LAYERS = "diffuse", "specular"
FRAMES = 4
"""Frames before the one whose steps are compared."""
SETTINGS: dict[str, Any] = {"form": "separable", "radius": 6}


@dataclass(frozen=True)
class Steps:
    """What Python computes for a layer of a frame, step by step."""

    layer: Layer
    past: FloatArray
    history: FloatArray
    trust: FloatArray
    narrowing: FloatArray
    output: Any


@cache
def run_python(hits: bool) -> tuple[lobewise.TemporalFilter, dict[str, Steps]]:
    """Return a filter that has seen some frames, and the steps of the frame of `make_last`."""
    recipe = lobewise.TemporalFilter(**SETTINGS)
    for number in range(FRAMES):
        recipe.add(make_frame(number, hits=hits))
    frame = make_last(hits)
    past = recipe._past
    assert past is not None
    chosen = recipe._resolve(frame)
    guides = Guides(frame.gbuffer, frame.camera, ())
    lobes = split_lobes(frame, chosen.similarity, chosen.tau, compute_same_tau(guides, chosen))
    layers = make_named_layers(frame, chosen, (), lobes, compute_own_weight(frame))
    masks = {name: layer.mask for name, layer in layers.items()}
    reprojection = HistoryReprojection(guides, chosen, recipe.temporal, past, masks, lobes)
    steps = {}
    for name, layer in layers.items():
        history = reprojection.reproject(name)
        assert history is not None
        grid = SampleGrid(layer.mask, layer.features, scale=1, albedo=layer.albedo)
        own, growth = compute_own_weight(frame), recipe.temporal.strictness
        trust = grid.compute_trust(layer.radiance, history, own)
        narrowing = np.dstack(grid._narrow(history, trust, growth))
        more: dict[str, Any] = {"history": history, "trust": trust, "growth": growth, "own": own}
        output = grid.accumulate_filtered(layer.radiance, **SETTINGS, **more)
        steps[name] = Steps(layer, past.sums[name], history, trust, narrowing, output)
    return recipe, steps


def make_last(hits: bool) -> Frame:
    """Return the frame after the others. Half of it lies in a shadow that is new."""
    frame = make_frame(FRAMES, hits=hits)
    shadow = np.where(np.arange(frame.width)[:, None] < frame.width // 2, np.float32(0.2), np.float32(1.0))
    parts = {name: getattr(frame.radiance, name) * shadow for name in LAYERS}
    color = frame.radiance.color - frame.radiance.diffuse - frame.radiance.specular + sum(parts.values())
    return frame.with_changes(radiance=lobewise.Radiance(color, **parts))


def split(sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the two images of the sums of a history."""
    return fill(sums[..., :4]), fill(sums[..., 4:7])


@dataclass
class Bench:
    """A device with the chain, and everything that the passes of the last frame read, as Python computes it."""

    player: Player
    constants: dict[str, Any]
    given: dict[str, FloatArray]
    steps: Mapping[str, Steps]

    def run(self, layer: str, step: str, **images: FloatArray) -> dict[str, FloatArray]:
        return self.player.run_pass(f"{layer}_{step}", {**self.given, **images}, self.constants)


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "hits"])
def bench(request: pytest.FixtureRequest, graphics: Any, language: str, folder: Path) -> Bench:
    recipe, steps = run_python(request.param)
    frames = [
        *(make_frame(number, hits=request.param) for number in (FRAMES - 2, FRAMES - 1)),
        make_last(request.param),
    ]
    player = Player(graphics, make_chain("history", form="separable"), language, folder)
    made: list[dict[str, FloatArray]] = []
    for previous, frame in pairwise(frames):
        constants = make_constants(recipe, frame, previous)
        given = give_images(frame)
        made.append(
            {
                **player.run_pass("guides", given, constants),
                **player.run_pass("reflections", given, constants),
            }
        )
    given = {**give_images(frames[-1]), **made[1], **{f"{name}_before": image for name, image in made[0].items()}}
    for name, each in steps.items():
        given |= {
            f"{name}_kept_{part}_before": image for part, image in zip(("light", "more"), split(each.past), strict=True)
        }
        given |= {
            f"{name}_history_{part}": image for part, image in zip(("light", "more"), split(each.history), strict=True)
        }
        given |= {f"{name}_trust": fill(each.trust), f"{name}_narrowing": fill(each.narrowing)}
    return Bench(player, constants, given, steps)


@pytest.mark.sampled("plain-wgsl")
def test_footprints(bench: Bench) -> None:
    """Pixels are wider where a surface moved by itself, and nowhere else."""
    frame = make_last(False)
    angle = frame.require_camera("a history").get_pixel_angle(frame.height)
    depth = frame.gbuffer.depth
    assert depth is not None
    there = depth > 0.0
    wider = bench.given["points"][there][:, 3] / (depth[there] * angle)
    assert np.mean(np.abs(wider - 1.0) < 1e-3) > 0.5
    assert 0.05 < np.mean(wider > 1.2) < 0.5


def test_reflections(bench: Bench) -> None:
    """The virtual images are where Python finds them, and moved otherwise than the surfaces."""
    frame, previous = make_last(True), make_frame(FRAMES - 1)
    guides, camera = frame.gbuffer, frame.require_camera("a history")
    given = {**give_images(frame)}
    found = bench.player.run_pass("reflections", given, bench.constants)["reflections"]
    position, normal, distance = (guides.require(name, "it") for name in ("position", "normal", "hit_distance"))
    curvature = estimate_curvature(position, normal)
    expected = compute_virtual_places(position, curvature, distance, camera, previous.require_camera("it"))
    known = np.isfinite(expected).all(axis=-1)
    np.testing.assert_array_equal(np.abs(found[..., 2]) < 1e8, known)
    near = known & (np.abs(expected) < 200.0).all(axis=-1)
    np.testing.assert_allclose(found[near][:, 2:], expected[near], rtol=0.0, atol=2e-3)
    assert guides.motion is not None
    apart = expected - add_grid(guides.motion)
    assert np.mean(np.abs(apart[near]).max(axis=-1) > 0.3) > 0.2
    hit = np.isfinite(distance) & (distance > 0.0)
    np.testing.assert_allclose(found[hit][:, 0], 1.0 / distance[hit], rtol=1e-5)


@pytest.mark.parametrize("name", LAYERS)
def test_reproject(bench: Bench, name: str) -> None:
    expected = bench.steps[name].history
    found = bench.run(name, "reproject")
    sums = np.dstack([found[f"{name}_history_light"], found[f"{name}_history_more"][..., :3]])
    for k in range(7):
        compare(sums[..., k], expected[..., k])
    # Some pixels are seen for the first time, some have nearly all of their history.
    usable = bench.steps[name].layer.mask
    assert 0.01 < np.mean(expected[usable][:, 6] < 0.1) < 0.5
    assert np.mean(expected[usable][:, 6] > 1.5) > 0.3


@pytest.mark.parametrize("name", LAYERS)
def test_trust(bench: Bench, name: str) -> None:
    step = bench.steps[name]
    found = bench.run(name, "trust")[f"{name}_trust"][..., 0]
    np.testing.assert_allclose(found, step.trust, rtol=0.0, atol=RTOL)
    usable = step.layer.mask
    assert 0.02 < np.mean(step.trust[usable] < 0.1) < 0.9
    assert 0.02 < np.mean(step.trust[usable] > 0.9) < 0.9


@pytest.mark.parametrize("name", LAYERS)
def test_narrow(bench: Bench, name: str) -> None:
    step = bench.steps[name]
    found = bench.run(name, "narrow")[f"{name}_narrowing"]
    for k in range(2):
        compare(found[step.layer.mask][:, k], step.narrowing[step.layer.mask][:, k])
    assert np.ptp(step.narrowing[..., 0]) > 0.9


@pytest.mark.parametrize("name", LAYERS)
def test_filter_and_accumulate(bench: Bench, name: str) -> None:
    step = bench.steps[name]
    added = bench.run(name, "row")
    added = bench.run(name, "column", **added)
    found = bench.run(name, "accumulate", **added)
    sums = np.dstack([found[f"{name}_kept_light"], found[f"{name}_kept_more"][..., :3]])
    for k in range(7):
        compare(sums[..., k], step.output.sums[..., k], WEIGHT_RTOL)
    lit = sums[..., 3] > 0.0
    np.testing.assert_array_equal(lit, step.output.weight_sum > 0.0)
    assert step.layer.albedo is not None
    compare((sums[..., :3] / np.maximum(sums[..., 3:4], 1e-30) * step.layer.albedo)[lit], step.output.image[lit])


@pytest.mark.sampled("wgsl-separable-True-ggx")
@pytest.mark.parametrize(
    ("form", "hits", "similarity"), [("separable", True, "ggx"), ("atrous", False, "ggx"), ("separable", True, "sg")]
)
def test_sequence(graphics: Any, language: str, folder: Path, form: Any, hits: bool, similarity: Any) -> None:
    """A moving camera, a moving object, a light that changes: every frame is as Python's."""
    recipe = lobewise.TemporalFilter(form=form, radius=6, similarity=similarity)
    player = Player(graphics, make_chain("history", form=form, similarity=similarity), language, folder)
    previous = None
    images = []
    for number in range(FRAMES + 2):
        frame = make_last(hits) if number == FRAMES else make_frame(number, hits=hits)
        constants = make_constants(recipe, frame, previous)
        image = player.run(give_images(frame), constants)
        result = recipe.add(frame)
        compare(image[..., :3], result.image)
        images.append(image[..., :3])
        previous = frame
    # The history pays: the fourth frame has less noise than the first.
    noise = [np.mean((images[number] - make_clean_image(number)) ** 2) for number in (0, FRAMES - 1)]
    assert noise[1] < 0.8 * noise[0]


def test_a_cut_forgets(graphics: Any, folder: Path) -> None:
    """With ``memory`` 0 a frame is as the first one of a sequence."""
    recipe = lobewise.TemporalFilter(**SETTINGS)
    player = Player(graphics, make_chain("history", form="separable"), "wgsl", folder)
    player.run(give_images(make_frame(0)), make_constants(recipe, make_frame(0), None))
    frame = make_frame(1)
    image = player.run(give_images(frame), {**make_constants(recipe, frame, make_frame(0)), "memory": 0.0})
    compare(image[..., :3], lobewise.TemporalFilter(**SETTINGS).add(frame).image)
