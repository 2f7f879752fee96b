"""A recorded recipe, run at once in this process, has the bits of the library's own: one text is enough for both."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from lobewise.exporting.pipeline.frame import Features, no_features
from lobewise.exporting.pipeline.sample import FRAMES, make_sparse, prepare_frame, run_recipe
from lobewise.exporting.pipeline.scene import make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.features.base import DeclaredFeature
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.sparse_frame import AnyFrame
from tests.exporting.here import Recorded

SIMILARITIES = ("normal", "sg", "ggx")


def make_frames(settings: PipelineSettings, count: int) -> tuple[list[Frame], list[AnyFrame]]:
    """Return frames of the example, whole, and as the recipe reads them."""
    made = [make_frame(number, halves=settings.reads_halves) for number in range(count)]
    whole = [prepare_frame(settings, frame) for frame in made]
    return whole, [make_sparse(settings, frame, number) for number, frame in enumerate(whole)]


def check(settings: PipelineSettings, count: int = 1, features: Features = no_features) -> None:
    """Raise AssertionError unless the recorded recipe and the library's make the same of frames."""
    recorded = Recorded(settings, features)
    whole, frames = make_frames(settings, count)
    for full, frame, expected in zip(whole, frames, run_recipe(settings, frames, features), strict=True):
        np.testing.assert_array_equal(recorded.run(frame, full.gbuffer.mean_emission), expected)


@pytest.mark.sampled("full-ggx-apart", "separable-sg-color", "atrous-ggx-apart", "full-normal-color")
@pytest.mark.parametrize("layers", ["apart", "color"])
@pytest.mark.parametrize("similarity", [*SIMILARITIES, "sg_mixture"])
@pytest.mark.parametrize("form", ["full", "separable", "atrous"])
def test_fast(form: str, similarity: Any, layers: Any) -> None:
    check(PipelineSettings(form=form, similarity=similarity, layers=layers, radius=2))


@pytest.mark.sampled("atrous-diffuse", "full-sg_mixture", "separable-ggx")
@pytest.mark.parametrize("similarity", [*SIMILARITIES, "sg_mixture", "diffuse"])
@pytest.mark.parametrize("form", ["full", "separable", "atrous"])
def test_a_single_filter(form: Any, similarity: Any) -> None:
    check(PipelineSettings(plan="filter", form=form, similarity=similarity, radius=2, albedo=form != "full"))


@pytest.mark.parametrize("plan", ["filter", "fast"])
def test_guides_of_a_single_filter(plan: Any) -> None:
    check(PipelineSettings(plan=plan, radius=2, anisotropic=True, lobe_kind=True, position=True))


@pytest.mark.sampled("full-ggx", "separable-sg")
@pytest.mark.parametrize("similarity", ["sg", "ggx"])
@pytest.mark.parametrize("form", ["full", "separable"])
def test_layers_that_frames_name(form: Any, similarity: Any) -> None:
    check(PipelineSettings(form=form, similarity=similarity, layers="named", radius=2))


@pytest.mark.sampled("False")
@pytest.mark.parametrize("history", [False, True])
def test_areas_and_rays_of_sparse_samples(history: bool) -> None:
    settings = PipelineSettings(upsample=2, similarity="ggx", radius=2, history=history, coverage=True, rays=True)
    check(settings, 2 if history else 1)


@dataclass(frozen=True)
class NearDepth(DeclaredFeature):
    """A feature of somebody else: pixels are alike whose depths are."""

    depth: FloatArray
    sigma: float

    def log2_similarity(self, i: Any, j: Any, parameters: Any, offset: Any, stage: Any) -> Any:
        apart = (i[0] - j[0]) / parameters[0]
        return -1.0 * apart * apart


@pytest.mark.sampled("fast")
@pytest.mark.parametrize("settings", [{}, {"upsample": 2}, {"history": True}], ids=["fast", "upsample", "history"])
def test_features_of_ones_own(settings: dict[str, Any]) -> None:
    check(
        PipelineSettings(similarity="sg", radius=2, **settings),
        2 if settings else 1,
        lambda frame: [NearDepth(frame.gbuffer.depth, 0.3)],
    )


@pytest.mark.sampled("2-sg", "4-ggx")
@pytest.mark.parametrize("similarity", SIMILARITIES)
@pytest.mark.parametrize("scale", [2, 4])
def test_upsampling(scale: int, similarity: Any) -> None:
    check(PipelineSettings(upsample=scale, similarity=similarity, radius=2))


@pytest.mark.sampled("ggx-apart", "normal-color")
@pytest.mark.parametrize("layers", ["apart", "color"])
@pytest.mark.parametrize("similarity", SIMILARITIES)
def test_balanced(similarity: Any, layers: Any) -> None:
    check(PipelineSettings(plan="balanced", similarity=similarity, layers=layers, radius=2))


@pytest.mark.sampled("named-halves", "apart-whole", "color-whole")
@pytest.mark.parametrize("halves", [True, False], ids=["halves", "whole"])
@pytest.mark.parametrize("layers", ["apart", "color", "named"])
def test_balanced_with_other_light(layers: Any, halves: bool) -> None:
    check(PipelineSettings(plan="balanced", similarity="ggx", layers=layers, radius=2, halves=halves))


@pytest.mark.sampled("apart-halves", "color-whole")
@pytest.mark.parametrize("halves", [True, False], ids=["halves", "whole"])
@pytest.mark.parametrize("layers", ["apart", "color", "named"])
def test_high(layers: Any, halves: bool) -> None:
    check(PipelineSettings(plan="high", similarity="ggx", layers=layers, radius=2, halves=halves))


@pytest.mark.parametrize("halves", [True, False])
def test_balanced_with_coverage(halves: bool) -> None:
    check(PipelineSettings(plan="balanced", similarity="ggx", radius=2, coverage=True, halves=halves))


@pytest.mark.sampled("ggx-{'hit_distance': True}", "sg-{'upsample': 4}", "normal-{'motion': False}")
@pytest.mark.parametrize("changes", [{}, {"hit_distance": True}, {"motion": False}, {"upsample": 4}], ids=str)
@pytest.mark.parametrize("similarity", ["normal", "sg", "ggx"])
def test_history(similarity: Any, changes: dict[str, Any]) -> None:
    """Four frames; the last follows a cut."""
    check(PipelineSettings(history=True, similarity=similarity, radius=2, **changes), FRAMES)
