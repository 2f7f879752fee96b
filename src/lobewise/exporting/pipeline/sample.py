"""The frames of a pipeline's example, and what the recipe of this package makes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from lobewise.camera import Camera
from lobewise.denoising.recipe import denoise
from lobewise.exporting.pipeline.program.graph import Graph
from lobewise.exporting.pipeline.scene import HEIGHT, SPP, WIDTH, make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.frame import FloatArray, Frame, Radiance
from lobewise.settings import DenoiseSettings
from lobewise.settings.choices import get_quality

FRAMES = 4


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


def make_sample(settings: PipelineSettings, graph: Graph) -> list[SampleFrame]:
    """Return the frames of the example, filtered by the recipe whose plan is exported."""
    frames = [prepare_frame(settings, make_frame(number)) for number in range(FRAMES)]
    results = run_recipe(settings, frames)
    return [
        SampleFrame(frame.require_camera("a pipeline"), (0, 0), collect_images(graph, frame), expected)
        for frame, expected in zip(frames, results, strict=True)
    ]


def prepare_frame(settings: PipelineSettings, frame: Frame) -> Frame:
    """Return a frame with the images that the pipeline reads, and no others."""
    guides = frame.gbuffer
    changes = {} if settings.history else {"motion": None}
    changes |= {} if settings.hit_distance else {"hit_distance": None}
    radiance = frame.radiance if settings.layers == "apart" else Radiance(frame.radiance.color)
    return replace(frame, radiance=radiance, gbuffer=replace(guides, **changes))


def make_settings(settings: PipelineSettings) -> DenoiseSettings:
    """Return the settings by which the recipe of this package does what a pipeline does."""
    return DenoiseSettings(
        quality=get_quality(settings.plan).name,
        similarity=settings.similarity,
        form=settings.form,
        radius=settings.radius,
        device="cpu",
        with_oidn=False,
    )


def run_recipe(settings: PipelineSettings, frames: list[Frame]) -> list[FloatArray]:
    """Return what Python makes of frames, one after the other."""
    return [denoise(frame, make_settings(settings)).image for frame in frames]


def collect_images(graph: Graph, frame: Frame) -> dict[str, FloatArray]:
    """Return the images that a pipeline is given, by name."""
    guides, radiance = frame.gbuffer, frame.radiance
    named = {"color": radiance.color, "diffuse": radiance.diffuse, "specular": radiance.specular}
    named |= {"alpha": guides.alpha_u}
    found = {}
    for name in graph.given:
        image = named.get(name) if name in named else getattr(guides, name)
        assert image is not None, f"the example has no image {name}"
        found[name] = image
    return found


__all__ = ["FRAMES", "HEIGHT", "SPP", "WIDTH", "SampleFrame", "make_sample"]
