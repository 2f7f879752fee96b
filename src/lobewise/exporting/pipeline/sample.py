"""The frames of a pipeline's example, and what the recipe of this package makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lobewise.camera import Camera
from lobewise.denoising.automatic import resolve_settings
from lobewise.denoising.recipe import check_frame, denoise_checked
from lobewise.engine.graph import Graph
from lobewise.exporting.pipeline.alone import filter_alone
from lobewise.exporting.pipeline.frame import Features, no_features
from lobewise.exporting.pipeline.scene import CUT, HEIGHT, SPP, WIDTH, make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.frame import FloatArray, Frame, GBuffer, LobeKind, Radiance
from lobewise.guides.surfaces import compute_points
from lobewise.radiance import RadianceLayer
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.sparse_frame import AnyFrame, Rays, SparseFrame
from lobewise.temporal import TemporalFilter
from lobewise.upsampling import upsample

FRAMES = CUT + 1
"""The last one follows a cut."""


@dataclass(frozen=True)
class SampleFrame:
    """A frame of the example.

    Parameters
    ----------
    camera : Camera
    place : (int, int)
        Row and column of the shaded pixel in each block.
    images : mapping of str to array
        Inputs by name.
    expected : (height, width, 3)
        What Python makes of it.
    """

    camera: Camera
    place: tuple[int, int]
    images: Mapping[str, FloatArray]
    expected: FloatArray

    def pack(self) -> bytes:
        """Return camera, place and inputs as they lie in frames.raw."""
        camera = self.camera
        view = [*camera.position, *camera.forward, *camera.up, camera.fov_y, camera.fov_x or 0.0, *camera.shift]
        numbers = np.array([*view, *self.place], np.float64)
        return numbers.tobytes() + b"".join(
            np.ascontiguousarray(each, np.float32).tobytes() for each in self.images.values()
        )


def make_sample(settings: PipelineSettings, graph: Graph, features: Features = no_features) -> list[SampleFrame]:
    """Return the frames of the example, filtered by the recipe whose plan is exported."""
    made = [make_frame(number, halves=settings.reads_halves) for number in range(FRAMES)]
    frames = [make_sparse(settings, prepare_frame(settings, frame), number) for number, frame in enumerate(made)]
    results = run_recipe(settings, frames, features)
    return [
        SampleFrame(
            frame.require_camera("a pipeline"),
            get_place(frame),
            collect_images(graph, frame, whole.gbuffer.mean_emission),
            expected,
        )
        for whole, frame, expected in zip(made, frames, results, strict=True)
    ]


def prepare_frame(settings: PipelineSettings, frame: Frame) -> Frame:
    """Return a frame with the images that the pipeline reads, and no others."""
    guides = frame.gbuffer
    changes: dict[str, Any] = {} if settings.history and settings.motion else {"motion": None}
    changes |= {} if settings.upsample > 1 else {"mean_emission": None}
    changes |= {} if settings.hit_distance else {"hit_distance": None}
    radiance = choose_light(settings, frame.radiance)
    if frame.half_a is not None and frame.half_b is not None:
        both = choose_light(settings, frame.half_a), choose_light(settings, frame.half_b)
        frame = replace(frame, half_a=both[0], half_b=both[1])
        radiance = average_light(*both)
    if settings.position:
        place, _ = compute_points(guides, frame.require_camera("positions"))
        changes["position"] = place
    if settings.anisotropic:
        alpha, normal = (guides.require(name, "brushed surfaces") for name in ("alpha_u", "normal"))
        changes |= {"alpha_v": np.float32(0.5) * alpha, "tangent": np.cross(normal, np.array([0.3, 0.9, 0.1]))}
    if settings.hit_guides:
        changes |= show_reflections(guides)
    if settings.coverage:
        changes |= cover_pixels(guides)
    if settings.lobe_kind:
        changes["lobe_kind"] = choose_kinds(guides)
    if settings.is_filter:
        # The filter has one light and one albedo.
        kind = "specular" if settings.record.has_lobes else "diffuse"
        radiance = Radiance(getattr(radiance, kind))
        changes |= {"diffuse_albedo": getattr(guides, f"{kind}_albedo"), "specular_albedo": None}
    frame = replace(frame, radiance=radiance, gbuffer=replace(guides, **changes))
    return replace(frame, layers=name_layers(frame)) if settings.layers == "named" else frame


def name_layers(frame: Frame) -> tuple[RadianceLayer, ...]:
    """Return the light of a frame in three layers: a part of its specular light counts as transmitted."""
    lights = [split_specular(frame.radiance)]
    if frame.half_a is not None and frame.half_b is not None:
        lights += [split_specular(frame.half_a), split_specular(frame.half_b)]
        # A pipeline is given halves, and computes their mean.
        lights[0] = {name: np.float32(0.5) * lights[1][name] + np.float32(0.5) * lights[2][name] for name in lights[0]}
    albedos = {name: getattr(frame.gbuffer, f"{name}_albedo") for name in ("diffuse", "specular")}
    return tuple(
        RadianceLayer(
            name,
            name,
            light,
            albedos["diffuse" if name == "diffuse" else "specular"],
            half_a=lights[1][name] if len(lights) > 1 else None,
            half_b=lights[2][name] if len(lights) > 1 else None,
        )
        for name, light in lights[0].items()
    )


def split_specular(radiance: Radiance) -> dict[str, FloatArray]:
    """Return light in three layers, by name."""
    assert radiance.parts is not None
    diffuse, specular = radiance.parts
    glossy = np.float32(0.75) * specular
    return {"diffuse": diffuse, "glossy": glossy, "transmission": specular - glossy}


def choose_light(settings: PipelineSettings, radiance: Radiance) -> Radiance:
    """Return diffuse and specular light apart, or all light in one image."""
    return Radiance(radiance.color) if settings.layers == "color" else radiance


def average_light(a: Radiance, b: Radiance) -> Radiance:
    """Return the mean of both halves of the samples, as the pipeline computes it."""

    def average(name: str) -> FloatArray | None:
        first, second = getattr(a, name), getattr(b, name)
        return None if first is None else np.float32(0.5) * first + np.float32(0.5) * second

    color = average("color")
    assert color is not None
    return Radiance(color, diffuse=average("diffuse"), specular=average("specular"))


def cover_pixels(guides: GBuffer) -> dict[str, FloatArray]:
    """Return shares of pixels that near surfaces cover, and the albedos over pixel areas that follow."""
    share = np.random.default_rng(9).uniform(0.0, 0.2, (*(guides.shape or (0, 0)), 9))
    share[..., 4] += 1.0 - share.sum(axis=-1)
    images = {"coverage": share.astype(np.float32)}
    for name in ("diffuse_albedo", "specular_albedo"):
        albedo = np.pad(guides.require(name, "coverage"), ((1, 1), (1, 1), (0, 0)), mode="edge")
        near = [albedo[k // 3 :, k % 3 :][: share.shape[0], : share.shape[1]] for k in range(9)]
        parts = [share[..., k : k + 1] * each for k, each in enumerate(near)]
        images[f"mean_{name}"] = np.sum(parts, axis=0).astype(np.float32)
    return images


def show_reflections(guides: GBuffer) -> dict[str, FloatArray]:
    """Return albedo and normal of the surfaces that reflections show: those of pixels some rows away."""
    albedo, normal = (guides.require(name, "reflections") for name in ("diffuse_albedo", "normal"))
    return {"hit_albedo": np.roll(albedo, 9, axis=0), "hit_normal": np.roll(normal, 9, axis=0)}


def choose_kinds(guides: GBuffer) -> FloatArray:
    """Return kinds of lobes: diffuse surfaces have none, the smoothest are mirrors."""
    alpha = guides.require("alpha_u", "kinds of lobes")
    diffuse = np.float32(LobeKind.NONE)
    kind = np.where(alpha < 0.04, np.float32(LobeKind.DELTA), np.float32(LobeKind.GGX))
    return np.where(alpha > 0.2, diffuse, kind).astype(np.float32)


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
    return DenoiseSettings(
        quality=settings.quality.name,
        similarity=settings.record.name,
        lobes=settings.lobes,
        form=settings.form,
        radius=settings.radius,
        device="cpu",
        hit_distance=settings.compares_hits,
        with_oidn=False,
    )


def run_recipe(
    settings: PipelineSettings, frames: Sequence[AnyFrame], features: Features = no_features
) -> list[FloatArray]:
    """Return what Python makes of frames, one after the other."""
    chosen = make_settings(settings)
    if settings.is_filter:
        return [run_filter(settings, frame, resolve_settings(frame, chosen), features) for frame in frames]
    if settings.history:
        over_time = TemporalFilter(chosen)
        return [over_time.add(frame, features=features(frame)).image for frame in frames]
    return [
        upsample(frame, chosen, features=features(frame)).image
        if isinstance(frame, SparseFrame)
        else denoise_checked(check_frame(frame, chosen), chosen, features(frame)).image
        for frame in frames
    ]


def run_filter(
    settings: PipelineSettings, frame: AnyFrame, resolved: ResolvedSettings, features: Features
) -> FloatArray:
    """Return what the single filter makes of a frame."""
    assert isinstance(frame, Frame)
    albedo = frame.gbuffer.diffuse_albedo if settings.albedo else None
    return filter_alone(frame, settings, resolved, features(frame), frame.radiance.color, albedo).image


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


__all__ = ["FRAMES", "HEIGHT", "SPP", "WIDTH", "SampleFrame", "make_sample"]
