"""The frame before, as a pipeline remembers it; stands where recipes read a `lobewise.recipes.temporal.past.Past`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lobewise.engine.graph import GraphImage
from lobewise.engine.numbers import Condition
from lobewise.exporting.pipeline.frame import SIZE, PipelineGuides
from lobewise.filters.history.reprojection import ComparedPixels
from lobewise.filters.history.sums import HISTORY_CHANNELS
from lobewise.recipes.temporal.validation import ValidationFeatures


@dataclass(frozen=True)
class GivenPast:
    """The frame before.

    Parameters
    ----------
    guides : PipelineGuides
        Of the frame before only the camera is known.
    similarity : str
    sums : mapping of str to GraphImage
        Sums of each layer, by its name.
    frame : PipelineGuides
        The frame itself.
    """

    guides: Any
    similarity: str
    sums: Mapping[str, GraphImage]
    frame: PipelineGuides
    validation = True
    exists = Condition("p->has_past")

    def get_pixels(self, name: str, features: ValidationFeatures) -> Any:
        """Return the pixels of a layer."""
        recorder = self.frame.kernels
        mask = recorder.declare(f"{name}_mask", *SIZE, type="uint8")
        planes = recorder.before.get(f"{name}_planes")
        size: Any = "p->height", "p->width"
        return ComparedPixels((), mask, planes, size)  # type: ignore[arg-type]  # recorded images stand for arrays


def make_past(guides: PipelineGuides) -> GivenPast:
    """Return the frame before of a pipeline's frame."""
    declare = guides.kernels.declare
    sums = {name: declare(f"{name}_sums", HISTORY_CHANNELS, *SIZE) for name in guides.settings.layer_names}
    return GivenPast(guides.before, guides.settings.similarity, sums, guides)
