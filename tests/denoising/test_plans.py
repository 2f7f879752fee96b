"""Plans: data that say what is done, from which the executor, the reach and the printed plan follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lobewise.denoising import denoise
from lobewise.denoising.automatic import ask, resolve_all
from lobewise.denoising.noisy import find_layer_level, make_bounded_layers, make_noisy_layers, measure_layer
from lobewise.denoising.planning import frame_plans
from lobewise.denoising.planning.foretelling import count_bytes, estimate_seconds_per_megapixel, foretell
from lobewise.denoising.planning.frame_plans import FramePlan, describe_frame, find_reach, plan_frame
from lobewise.denoising.planning.layer_plans import LayerTraits, plan_balanced, plan_layers
from lobewise.denoising.planning.steps import SAMPLES, GuideStep, LayerPlan, PassStep
from lobewise.denoising.running import LayerRun
from lobewise.filters.noise_guides import find_level
from lobewise.frame import Frame
from lobewise.settings import QUALITIES, DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import QUALITIES as LIBRARY
from tests.denoising.test_denoising import make_frame


def resolve(frame: Frame, **changes: object) -> ResolvedSettings:
    """Return settings of a quality of ours with every "auto" replaced."""
    return resolve_all(frame, ask(None, {"with_oidn": False, "quality": "balanced", **changes}))


def make_plan(frame: Frame, **changes: object) -> FramePlan:
    """Return the plan of a frame."""
    return plan_frame(describe_frame(frame), resolve(frame, **changes))


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("apart", [True, False])
def test_every_step_reads_what_an_earlier_one_wrote(quality: str, apart: bool) -> None:
    for plan in make_plan(make_frame(apart=apart), quality=quality).layers.values():
        known = {SAMPLES}
        for step in plan.steps:
            assert known.issuperset(step.reads), step
            assert known.isdisjoint(step.writes), step
            known.update(step.writes)
        assert plan.steps[-1].writes == ("image",)


@pytest.mark.parametrize("quality", QUALITIES)
def test_every_image_is_let_go_once(quality: str) -> None:
    for plan in make_plan(make_frame(), quality=quality).layers.values():
        unused = [name for number in range(len(plan.steps)) for name in plan.list_unused(number)]
        written = {name for step in plan.steps[:-1] for name in step.writes}
        assert sorted(unused) == sorted(written)


@pytest.mark.parametrize("quality", ["balanced", "high"])
def test_the_executor_keeps_nothing_but_the_result(quality: str) -> None:
    frame = make_frame()
    settings = resolve(frame, quality=quality, similarity="normal")
    for noisy in make_noisy_layers(frame, settings, ()):
        state = LayerRun(frame, noisy.layer, settings, noisy)
        state.run(plan_layers({"": noisy.traits}, settings)[""])
        assert set(state.images) == {"image"}


def test_the_level_of_a_layer_is_that_of_its_rows() -> None:
    for layer in make_bounded_layers(make_frame(), resolve(make_frame())):
        level = find_layer_level(layer)
        assert level == find_level(measure_layer(layer)) > 0.0


def test_a_frame_is_described_as_its_layers_are(full_frame: Frame) -> None:
    shape = (*full_frame.shape, 3)
    hits = {name: np.full(shape, 0.5, np.float32) for name in ("hit_albedo", "hit_normal")}
    told = full_frame.with_changes(gbuffer=replace(full_frame.gbuffer, **hits))
    for frame in (full_frame, told, make_frame(apart=False)):
        layers = make_noisy_layers(frame, resolve(frame), ())
        assert describe_frame(frame).layers == {each.name: each.traits for each in layers}
    assert describe_frame(told).layers["specular"].has_seen
    assert not describe_frame(told).layers["diffuse"].has_seen


def test_the_reach_is_that_of_the_longest_way() -> None:
    frame = make_frame()
    settings = resolve(frame, quality="high")
    plan = plan_balanced(LayerTraits(is_diffuse=True), settings)
    shorter = LayerPlan(plan.steps[:2])
    first, second = shorter.steps
    assert isinstance(first, GuideStep)
    assert isinstance(second, PassStep)
    assert shorter.reach == 16 + first.reach + second.radius
    assert plan.reach > shorter.reach
    assert find_reach(settings) == make_plan(frame, quality="high").reach


def test_stages_that_see_the_whole_image_come_last() -> None:
    for quality in QUALITIES:
        plan = make_plan(make_frame(), quality=quality)
        local = plan.local_stages
        assert local[0] is frame_plans.FILTER_LAYERS
        assert all(stage.reach is None for stage in plan.stages[len(local) :])


def test_passes_of_other_images_follow_the_guides_of_the_layer() -> None:
    settings = resolve(make_frame())
    plan = plan_balanced(LayerTraits(is_diffuse=False), settings)
    until_guides, passes = plan.split_guides()
    assert until_guides.guides == plan.guides == ("guide 1", "guide 2", "guide 3")
    assert isinstance(until_guides.steps[-1], GuideStep)
    steps = [step for step in passes.steps if isinstance(step, PassStep)]
    assert len(steps) == len(passes.steps) == 2
    assert steps[0].source == SAMPLES


def test_a_printed_plan_names_every_stage_and_step() -> None:
    plan = make_plan(make_frame(), quality="high")
    lines = list(plan.describe())
    assert sum(line[0].isdigit() for line in lines) == len(plan.stages)
    assert sum("->" in line for line in lines) == sum(len(each.steps) for each in plan.layers.values())
    assert any("refine the image" in line for line in lines)


def test_time_and_memory_follow_the_plan() -> None:
    frame = make_frame()
    settings = resolve(frame, quality="high")
    plan = make_plan(frame, quality="high")
    usual = estimate_seconds_per_megapixel(plan, settings)
    assert usual == pytest.approx(LIBRARY["high"].seconds_per_megapixel)
    wide = resolve(frame, quality="high", radius=16)
    assert estimate_seconds_per_megapixel(make_plan(frame, quality="high", radius=16), wide) > 2.0 * usual
    assert count_bytes(frame) >= sum(getattr(frame.gbuffer, name).nbytes for name in frame.gbuffer.names)


def test_what_is_foretold_is_what_denoise_says() -> None:
    frame = make_frame()
    lines = foretell(frame, DenoiseSettings(quality="balanced"))
    assert denoise(frame, quality="balanced").method in lines[0]
    assert lines[-2].startswith("Memory: ")
    assert lines[-1].startswith("Time: ")
