"""The plan of a single filter: one light, compared by one similarity, in one pass."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise import engine
from lobewise.denoising.layers import (
    Compared,
    Layer,
    compare_specular,
    filter_layer,
    make_position_features,
    mark_surface,
)
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.features import DiffuseFeature, Feature
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.forms import describe_form
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import ResolvedSettings


def filter_alone(
    frame: Frame,
    settings: PipelineSettings,
    resolved: ResolvedSettings,
    features: Sequence[Feature],
    light: FloatArray,
    albedo: FloatArray | None,
) -> FilterOutput:
    """Return a light after one pass.

    Parameters
    ----------
    frame : Frame
        Its guides and its camera.
    settings, resolved
        What is fixed when the filter is compiled, and its numbers.
    features : sequence of Feature
        More features.
    light : (height, width, 3)
        Linear radiance.
    albedo : (height, width, 3), optional
        Divides the light before the filter and multiplies it after.
    """
    if settings.similarity == "diffuse":
        surface = mark_surface(frame)
        normal = frame.gbuffer.require("normal", "similarity 'diffuse'")
        compared = Compared((DiffuseFeature(normal, resolved.diffuse_beta),), surface, surface)
    else:
        compared = compare_specular(frame, resolved, True)
    every = *make_position_features(frame, resolved), *features, *compared.features
    with engine.part(describe_form(settings.form, settings.radius)):
        return filter_layer(Layer(light, albedo, compared.mask, every, "light"), resolved)
