"""Small frames with every combination of images that decides which kernels a recipe asks for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from lobewise import Camera, Frame, GBuffer, Radiance
from lobewise.filters.dual_buffer import MORE_AT_ONCE
from lobewise.records.radiance import LOBES, RadianceLayer

SIZE = 24, 40
NARROW = 8
"""Width below that of every vector."""
_HITS: tuple[tuple[str, ...], ...] = (
    (),
    ("hit_distance",),
)


def make_frame(size: tuple[int, int] = SIZE, seed: int = 1) -> Frame:
    """Return a noisy plane with all guides that `lobewise.GBuffer` has, halves and variance."""
    rng = np.random.default_rng(seed)
    height, width = size
    camera = Camera(position=(0.0, 2.0, 2.5), forward=(0.0, -0.75, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7)
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    position = np.asarray(camera.position) - (camera.position[1] / rays[..., 1])[..., None] * rays
    kind = np.ones(size, np.uint32)

    def image(low: float, high: float, *channels: int) -> Any:
        return rng.uniform(low, high, (*size, *channels)).astype(np.float32)

    def direction() -> Any:
        found = np.array([0.0, 1.0, 0.0]) + rng.normal(0.0, 0.05, (*size, 3))
        return (found / np.linalg.norm(found, axis=-1, keepdims=True)).astype(np.float32)

    def light() -> Radiance:
        diffuse, specular = image(0.1, 1.0, 3), image(0.1, 1.0, 3)
        return Radiance(diffuse + specular, diffuse, specular)

    coverage = rng.dirichlet(np.ones(9), size)
    guides = GBuffer(
        depth=np.linalg.norm(position - np.asarray(camera.position), axis=-1),
        position=position,
        normal=direction(),
        tangent=np.broadcast_to([1.0, 0.0, 0.0], (*size, 3)),
        alpha_u=image(0.1, 0.5),
        alpha_v=image(0.1, 0.5),
        lobe_kind=kind,
        diffuse_albedo=image(0.3, 0.7, 3),
        specular_albedo=image(0.3, 0.7, 3),
        hit_distance=image(1.0, 3.0),
        mean_normal=direction(),
        mean_diffuse_albedo=image(0.3, 0.7, 3),
        mean_specular_albedo=image(0.3, 0.7, 3),
        mean_emission=image(0.0, 0.1, 3),
        coverage=coverage,
        motion=np.zeros((*size, 2), np.float32),
    )
    a, b = light(), light()
    whole = Radiance(*(0.5 * (x + y) for x, y in zip(_parts(a), _parts(b), strict=True)))
    return Frame(
        whole, guides, camera, half_a=a, half_b=b, variance=Radiance(*(0.1 * part for part in _parts(whole))), spp=4
    )


def _parts(light: Radiance) -> tuple[Any, Any, Any]:
    return light.color, light.diffuse, light.specular


def drop(frame: Frame, *names: str) -> Frame:
    """Return a frame without some images of its G-buffer."""
    return frame.with_changes(gbuffer=replace(frame.gbuffer, **dict.fromkeys(names)))


def combine(frame: Frame) -> Frame:
    """Return a frame whose diffuse and specular light are not apart."""
    owners = ("radiance", "half_a", "half_b", "variance")
    lights = {name: getattr(frame, name) for name in owners}
    return frame.with_changes(**{name: light and Radiance(light.color) for name, light in lights.items()})


def vary_main_images(frame: Frame) -> Iterator[Frame]:
    """Yield the frame with every combination of the images that most kernels depend on."""
    for apart, halves, albedo, hits, round_lobes, places in product(
        (True, False), (True, False), (True, False), _HITS, (True, False), (True, False)
    ):
        absent = [name for name in _HITS[-1] if name not in hits]
        absent += [] if albedo else ["diffuse_albedo", "specular_albedo", "mean_diffuse_albedo", "mean_specular_albedo"]
        absent += ["tangent", "alpha_v"] if round_lobes else []
        absent += [] if places else ["position"]
        each = drop(frame, *absent)
        each = each if halves else each.with_changes(half_a=None, half_b=None)
        yield each if apart else combine(each)


def vary_rare_images(frame: Frame) -> Iterator[Frame]:
    """Yield the frame with one image or property changed at a time."""
    yield drop(frame, "coverage")
    yield drop(frame, "mean_emission")
    yield drop(frame, "mean_normal", "mean_diffuse_albedo", "mean_specular_albedo")
    yield drop(frame, "alpha_u", "alpha_v", "tangent", "lobe_kind")
    yield drop(frame, "lobe_kind")
    yield drop(frame, "depth", "position")
    yield drop(frame, "diffuse_albedo")
    yield drop(frame, "specular_albedo")
    yield drop(frame, "normal", "tangent", "alpha_v", "mean_normal")
    yield frame.with_changes(camera=None)
    yield drop(frame.with_changes(camera=None), "position")
    yield frame.with_changes(variance=None)
    yield frame.with_changes(variance=None, half_a=None, half_b=None)
    yield frame.with_changes(noise_is_shared=True)
    yield frame.with_changes(noise_is_shared=True, half_a=None, half_b=None)
    for spp in (None, 1, 2, 64):
        yield frame.with_changes(spp=spp)
        yield frame.with_changes(spp=spp, half_a=None, half_b=None)
    yield frame.with_changes(unscattered={"emission": np.asarray(frame.radiance.color) * 0.1})
    yield frame.with_changes(also={"lamp": np.asarray(frame.radiance.color) * 0.5})
    if frame.radiance.diffuse is not None and frame.radiance.specular is not None:
        yield from _split_layers(frame)


def draw_images(frame: Frame, count: int, seed: int = 1) -> Iterator[Frame]:
    """Yield the frame with random sets of images, as files of many renderers have them."""
    rng = np.random.default_rng(seed)
    layered = [frame, *_split_layers(frame)]
    for _ in range(count):
        each = layered[rng.integers(len(layered))] if rng.random() < 0.3 else frame
        absent = [name for names in _TOGETHER if rng.random() < 0.5 for name in names]
        each = drop(each, *absent)
        each = each if rng.random() < 0.5 else each.with_changes(half_a=None, half_b=None)
        each = each if rng.random() < 0.5 else each.with_changes(variance=None)
        each = each if rng.random() < 0.8 else each.with_changes(camera=None)
        yield combine(each) if rng.random() < 0.4 and not each.layers else each


_TOGETHER = (
    ("depth",),
    ("position",),
    ("alpha_v", "tangent"),
    ("alpha_u", "alpha_v", "tangent"),
    ("lobe_kind",),
    ("diffuse_albedo",),
    ("specular_albedo",),
    ("mean_normal", "mean_diffuse_albedo", "mean_specular_albedo"),
    ("hit_distance",),
    ("mean_emission",),
    ("coverage",),
    ("motion",),
)
"""Images of a G-buffer that are present or absent together."""


def _split_layers(frame: Frame) -> Iterator[Frame]:
    """Yield the frame with a layer for each kind of lobe, with and without albedo, halves and parts."""
    light, halves = frame.radiance, (frame.half_a, frame.half_b)
    for lobe in LOBES:
        part = "diffuse" if lobe in ("diffuse", "subsurface", "volume") else "specular"
        image = getattr(light, part)
        own = {name: half and getattr(half, part) for name, half in zip(("half_a", "half_b"), halves, strict=True)}
        for albedo, shares in product((None, getattr(frame.gbuffer, f"{part}_albedo")), ({}, own)):
            # With the layer itself, which the parts do not sum to, these are all counts of images.
            for count in range(1, MORE_AT_ONCE):
                parts = {f"lamp {number}": 0.2 * image for number in range(count)}
                layer = RadianceLayer(lobe, lobe, image, albedo, parts=parts, **shares)
                yield frame.with_changes(layers=(layer,), half_a=None, half_b=None)
                if shares:
                    yield frame.with_changes(layers=(layer,))
