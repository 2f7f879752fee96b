"""The history of a pipeline: where each pixel was a frame ago, and what it keeps; see `lobewise.temporal.past`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

from lobewise.engine.graph import Image
from lobewise.engine.numbers import round_single
from lobewise.engine.recorder import give_feature_images, give_feature_numbers
from lobewise.exporting.pipeline.recipes.guides import SIZE, PipelineGuides
from lobewise.features import Feature
from lobewise.filters.cross_pass import describe_structure
from lobewise.filters.history.reprojection import make_scheduled_preparation, make_scheduled_reprojection
from lobewise.filters.history.reprojection_pass import AGREEMENT
from lobewise.filters.history.sums import HISTORY_CHANNELS
from lobewise.guides.lobe_fields import SplitField
from lobewise.guides.surfaces import define_footprints
from lobewise.settings import TemporalSettings
from lobewise.temporal.past import MAX_SHARE_SAMPLES, MAX_STEP, MIN_AGREEMENT, MIN_DIFFUSE_SHARE, find_all_places
from lobewise.temporal.validation import make_validation_features

HAS_PAST, HAS_HISTORY = "p->has_past", "p->has_history"


@dataclass
class Compared:
    """What recognises the pixels of a layer a frame later; see `lobewise.temporal.validation.ValidationFeatures`.

    Parameters
    ----------
    name : str
    mask : Image
        Pixels that have this light.
    surface : tuple of Feature
        Compared at the earlier place of the surface.
    virtual : int
        How many of them, the last ones, are compared at the earlier place of the reflection; 0 where it is not tracked.
    """

    name: str
    mask: Image
    surface: tuple[Feature, ...]
    virtual: int = 0
    planes: tuple[Image, Image] | None = None
    masks: tuple[Image, Image] | None = None
    sums: tuple[Image, Image] | None = None


@dataclass
class PlannedHistory:
    """The history of the layers of a frame.

    Parameters
    ----------
    guides : PipelineGuides
    masks : mapping of str to Image
        Pixels that have the light of each layer, by name.
    compared : dict of str to Compared
    """

    guides: PipelineGuides
    masks: Mapping[str, Image]
    compared: dict[str, Compared]
    footprint: Image
    allowance: Image | None
    places: Image
    virtual_places: Image | None
    found: dict[str, Image] = field(default_factory=dict)

    def find_all(self) -> dict[str, Image]:
        """Add the search of the history of every layer; return their sums, (7, height, width) each, by name."""
        graph = self.guides.graph
        for each in self.compared.values():
            self._prepare(each)
        with graph.part("history: places of a frame ago"):
            self._judge_cut()
            self._forget()
        for name in self.masks:
            with graph.part(f"{name}: history"):
                if name not in self.found:
                    with graph.only_when(HAS_HISTORY):
                        self._find(name)
                with graph.only_when(f"!{HAS_HISTORY}"):
                    found = self.found[name]
                    graph.run("clear_image", [found], [], "no history", writes=[found])
        for each in self.compared.values():
            assert each.masks is not None
            with graph.part("history: memory"):
                graph.run("copy_image", [each.mask, each.masks[0]], [], "pixels of the layer", writes=[each.masks[0]])
        return {
            name: replace(found, name=f"{found.name}_sums", shape=(HISTORY_CHANNELS, *SIZE), whole=found)
            for name, found in self.found.items()
            if name in self.masks
        }

    def keep_sums(self, name: str) -> None:
        """Let the sums of a layer be what the next frame reads."""
        sums = self.compared[name].sums
        assert sums is not None
        self.guides.kernels.state[f"{name}_sums"] = sums[0]

    def _prepare(self, each: Compared) -> None:
        """Add the planes by which a layer is compared, in this frame and in the next."""
        graph, name = self.guides.graph, each.name
        with graph.part("history: what is compared"):
            each.masks = graph.keep(f"{name}_mask", *SIZE, type="uint8")
            each.planes = self._call_preparation(each)
        if name in self.masks:
            each.sums = graph.keep(f"{name}_sums", HISTORY_CHANNELS, *SIZE)

    def _call_preparation(self, each: Compared) -> tuple[Image, Image]:
        kernels = self.guides.kernels
        key = "preparation", *map(describe_structure, each.surface)
        kernel = kernels.get(key, partial(make_scheduled_preparation, each.surface))
        if each.planes is None:
            count = sum(parameter.role == "output" for parameter in kernel.parameters)
            each.planes = self.guides.graph.keep(f"{each.name}_planes", count, *SIZE)
        given = give_feature_images("own", each.surface) | give_feature_numbers(each.surface)
        text = f"planes that {each.name} light is recognised by"
        kernels.call_stacked(kernel, {"mask": each.mask, **given}, name="", stack=each.planes[0], text=text)
        return each.planes

    def _find(self, name: str) -> None:
        """Add the reprojection of a layer."""
        kernels, each = self.guides.kernels, self.compared[name]
        assert each.masks is not None and each.planes is not None
        tracked = self.virtual_places is not None and each.virtual > 0
        virtual_from = len(each.surface) - each.virtual if tracked else None
        key = "reprojection", virtual_from, *map(describe_structure, each.surface)
        kernel = kernels.get(key, partial(make_scheduled_reprojection, each.surface, virtual_from))
        past = each.sums[1] if each.sums is not None else self._make_nothing()
        images = {"places": self.places, "virtual_places": self.virtual_places, "past": past}
        images |= {"mask": self.masks.get(name, each.mask), "mask_before": each.masks[1]}
        images |= {"planes": each.planes[0], "planes_before": each.planes[1]}
        numbers = {"memory": self.guides.constants.get("memory"), "rows": "p->height", "columns": "p->width"}
        given = {**images, **numbers, **give_feature_numbers(each.surface)}
        text = f"history of {name} light"
        self.found[name] = kernels.call_stacked(kernel, given, name=f"{name}_history", text=text)

    def _make_nothing(self) -> Image:
        """Return sums of nothing: how much of the image continues is measured without light."""
        graph = self.guides.graph
        nothing = graph.make("no_sums", HISTORY_CHANNELS, *SIZE)
        graph.run("clear_image", [nothing], [], "sums of nothing", writes=[nothing])
        return nothing

    def _judge_cut(self) -> None:
        """Measure how much of the image continues, by diffuse light where there is enough of it."""
        graph = self.guides.graph
        graph.run("set_flag", [], [f"&{graph.add_flag('has_history')}", "0"], "no history is known yet")
        if "diffuse" not in self.masks:
            with graph.only_when(HAS_PAST):
                self._find("rest")
                self._judge("rest", self.compared["rest"].mask)
            return
        covered, mask = graph.add_flag("is_covered"), self.masks["diffuse"]
        graph.run("measure_cover", [mask], [str(MIN_DIFFUSE_SHARE), f"&{covered}"], "how much is diffuse")
        with graph.only_when(HAS_PAST):
            self._find("diffuse")
            with graph.only_when(covered):
                self._judge("diffuse", mask)
            with graph.only_when(f"!{covered}"):
                self._find("rest")
                self._judge("rest", self.compared["rest"].mask)

    def _judge(self, name: str, mask: Image) -> None:
        agreement = self.found[name].take_plane(AGREEMENT)
        numbers = [str(MIN_AGREEMENT), str(MAX_STEP), str(MAX_SHARE_SAMPLES), f"&{HAS_HISTORY}"]
        text = "whether the image continues the frame before"
        self.guides.graph.run("judge_cut", [agreement, self.places, mask], numbers, text)

    def _forget(self) -> None:
        """Where there is no history, nothing has moved by itself: the next frame compares plain footprints."""
        if self.allowance is None:
            return
        graph = self.guides.graph
        with graph.only_when(f"!{HAS_HISTORY}"):
            graph.run("clear_image", [self.allowance], [], "no motion is known", writes=[self.allowance])
            constants = self.guides.constants
            images = {"surface": self.guides.surface, "depth": self.guides.depth, "allowance": self.allowance}
            allowed = round_single(1.0 / constants.get("plane_sigma"))
            numbers = {"pixel_angle": round_single(constants.pixel_angle), "allowed": allowed}
            self.guides.kernels.map_pixels(
                define_footprints, images, numbers, into=[self.footprint], text="widths of pixels"
            )
            for each in self.compared.values():
                self._call_preparation(each)


def make_history(guides: PipelineGuides, lobes: SplitField | None, masks: Mapping[str, Image]) -> PlannedHistory:
    """Return the history of a frame's layers; see `lobewise.temporal.past.HistoryReprojection`.

    Parameters
    ----------
    guides : PipelineGuides
    lobes : SplitField, optional
        The frame's lobes for both band-limits.
    masks : mapping of str to Image
        Pixels that have the light of each layer.
    """
    constants, graph, whole = guides.constants, guides.graph, cast(Any, guides)
    temporal = replace(TemporalSettings(), beta=constants.get("history_beta"), plane_sigma=constants.get("plane_sigma"))
    with graph.part("history: places of a frame ago"):
        found, allowance = cast(Any, find_all_places(whole, guides.before))
        if allowance is not None:
            with graph.only_when(f"!{HAS_PAST}"):
                graph.run("clear_image", [allowance], [], "no motion is known", writes=[allowance])
        features = make_validation_features(whole, guides.resolved, temporal, allowance, masks, lobes)
    plane: Any = features["rest"].surface[0]
    compared = {
        name: Compared(name, cast(Any, each.mask), each.surface, len(each.virtual)) for name, each in features.items()
    }
    return PlannedHistory(guides, masks, compared, plane.footprint, allowance, found.surface, found.virtual)
