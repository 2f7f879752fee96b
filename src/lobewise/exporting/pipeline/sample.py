"""The frames of a pipeline's example, and what the recipe of this package makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lobewise.denoising.automatic import resolve_settings
from lobewise.denoising.recipe import check_frame, denoise_checked
from lobewise.engine.graph import Graph
from lobewise.exporting.pipeline.frame import Features, no_features
from lobewise.exporting.pipeline.recording import filter_alone
from lobewise.exporting.pipeline.scene import CUT, average, make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.recipes.temporal import TemporalFilter
from lobewise.recipes.upsampling import upsample
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.radiance import RadianceLayer
from lobewise.records.sparse_frame import AnyFrame, Rays, SparseFrame
from lobewise.settings import DenoiseSettings

FRAMES = CUT + 1
"""The last one follows a cut."""


def make_sample(settings: PipelineSettings, graph: Graph, features: Features = no_features) -> tuple[bytes, bytes]:
    """Return the frames of the example, as frames.raw holds them, and what the recipe of the plan makes of them."""
    made = [make_frame(number, halves=settings.reads_halves) for number in range(FRAMES)]
    frames = [make_sparse(settings, prepare_frame(settings, frame), number) for number, frame in enumerate(made)]
    given = [_pack(graph, frame, whole.gbuffer.mean_emission) for frame, whole in zip(frames, made, strict=True)]
    return b"".join(given), np.array(run_recipe(settings, frames, features), "<f4").tobytes()


def _pack(graph: Graph, frame: AnyFrame, emission: FloatArray | None) -> bytes:
    """Return camera, place of the shaded pixels, and inputs of a frame."""
    camera = frame.require_camera("a pipeline")
    view = [*camera.position, *camera.forward, *camera.up, camera.fov_y, camera.fov_x or 0.0, *camera.shift]
    images = collect_images(graph, frame, emission).values()
    return np.array([*view, *get_place(frame)], "<f8").tobytes() + b"".join(
        np.ascontiguousarray(each, "<f4").tobytes() for each in images
    )


def prepare_frame(settings: PipelineSettings, frame: Frame) -> Frame:
    """Return a frame with the images that the pipeline reads, and no others."""
    guides, changes = frame.gbuffer, dict.fromkeys(settings.left_out)
    lights = [frame.radiance, frame.half_a, frame.half_b]
    if settings.layers == "color":
        lights = [light and Radiance(light.color) for light in lights]
    if settings.is_filter:
        # The filter has one light and one albedo.
        kind = "specular" if settings.record.has_lobes else "diffuse"
        lights = [Radiance(getattr(frame.radiance, kind)), None, None]
        guides = replace(guides, diffuse_albedo=getattr(guides, f"{kind}_albedo"))
    light: dict[str, Any] = dict(zip(("radiance", "half_a", "half_b"), lights, strict=True))
    frame = replace(frame, **light, gbuffer=replace(guides, **changes))
    return replace(frame, layers=name_layers(frame)) if settings.layers == "named" else frame


def name_layers(frame: Frame) -> tuple[RadianceLayer, ...]:
    """Return the light of a frame in three layers: a part of its specular light counts as transmitted."""
    halves = [split_specular(half) for half in (frame.half_a, frame.half_b) if half is not None]
    # A pipeline is given halves, and computes their mean.
    first, second = halves or [split_specular(frame.radiance)] * 2
    albedos = {name: getattr(frame.gbuffer, f"{name}_albedo") for name in ("diffuse", "specular")}
    return tuple(
        RadianceLayer(
            name,
            name,
            average(first[name], second[name]),
            albedos.get(name, albedos["specular"]),
            half_a=first[name] if halves else None,
            half_b=second[name] if halves else None,
        )
        for name in first
    )


def split_specular(radiance: Radiance) -> dict[str, FloatArray]:
    """Return light in three layers, by name."""
    assert radiance.parts is not None
    diffuse, specular = radiance.parts
    glossy = np.float32(0.75) * specular
    return {"diffuse": diffuse, "glossy": glossy, "transmission": specular - glossy}


def make_sparse(settings: PipelineSettings, frame: Frame, number: int) -> AnyFrame:
    """Return a frame with one shaded pixel of each block, another one in each frame; the frame without blocks."""
    scale = settings.upsample
    if scale == 1:
        return frame
    row, column = number % scale, (2 * number + 1) % scale
    images = [frame.radiance.color, *(frame.radiance.parts or ())]
    color, diffuse, specular = (image[row::scale, column::scale] for image in images)
    radiance = Radiance(color, diffuse=diffuse, specular=specular)
    rays = None
    if settings.rays:
        rays = Rays(np.random.default_rng(number).uniform(0.5, 1.5, color.shape[:2]))
    return SparseFrame(radiance, frame.gbuffer, scale, (row, column), frame.camera, spp=frame.spp, rays=rays)


def get_place(frame: AnyFrame) -> tuple[int, int]:
    """Return row and column of the shaded pixel in each block."""
    return frame.place if isinstance(frame, SparseFrame) else (0, 0)


def make_settings(settings: PipelineSettings) -> DenoiseSettings:
    """Return the settings by which the recipe of this package does what a pipeline does."""
    return DenoiseSettings(**settings.choices)


def run_recipe(
    settings: PipelineSettings, frames: Sequence[AnyFrame], features: Features = no_features
) -> list[FloatArray]:
    """Return what Python makes of frames, one after the other."""
    chosen = make_settings(settings)
    over_time = TemporalFilter(chosen) if settings.history else None

    def run(frame: AnyFrame) -> FloatArray:
        if over_time is not None:
            return over_time.add(frame, features=features(frame)).image
        if isinstance(frame, SparseFrame):
            return upsample(frame, chosen, features=features(frame)).image
        if not settings.is_filter:
            return denoise_checked(check_frame(frame, chosen), chosen, features(frame)).image
        albedo = frame.gbuffer.diffuse_albedo if settings.albedo else None
        resolved = resolve_settings(frame, chosen)
        return filter_alone(frame, settings, resolved, features(frame), frame.radiance.color, albedo).image

    return [run(frame) for frame in frames]


def collect_images(graph: Graph, frame: AnyFrame, emission: FloatArray | None = None) -> dict[str, FloatArray]:
    """Return the images that a pipeline is given, by name; ``emission`` that of a frame that does not tell it."""
    guides, radiance = frame.gbuffer, frame.radiance
    named = {"color": radiance.color, "diffuse": radiance.diffuse, "specular": radiance.specular}
    for half in ("half_a", "half_b"):
        light = getattr(frame, half, None)
        named |= {f"{half}_{part}": getattr(light, part, None) for part in ("color", "diffuse", "specular")}
    named |= {"radiance": radiance.color, "albedo": guides.diffuse_albedo}
    named |= {"emission": guides.mean_emission if emission is None else emission}
    named |= {} if guides.alpha_v is not None else {"alpha": guides.alpha_u}
    named |= {"ray_weight": getattr(getattr(frame, "rays", None), "weight", None)}
    for layer in getattr(frame, "layers", ()):
        named |= {layer.name: layer.radiance, f"{layer.name}_albedo": layer.albedo}
        named |= {f"half_a_{layer.name}": layer.half_a, f"half_b_{layer.name}": layer.half_b}
    inputs = {}
    for name in graph.inputs:
        image = named.get(name) if name in named else getattr(guides, name)
        assert image is not None, f"the example has no image {name}"
        inputs[name] = image
    return inputs
