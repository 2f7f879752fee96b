"""The frames of the cases: parts of the bundled one, with guides and light that it lacks."""

from dataclasses import fields, replace
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import SHOWROOM
from lobewise import Frame, Radiance
from lobewise.records.radiance import RadianceLayer


def load_bundled() -> Frame:
    """Return the frame that comes with the repository, whole."""
    return lobewise.read_frame(SHOWROOM)


def crop(frame: Frame, rows: slice, columns: slice) -> Frame:
    """Return a part of a frame, with a camera that is only about right: bits do not mind."""

    def cut(part: Any) -> Any:
        values = {item.name: getattr(part, item.name) for item in fields(part)}
        return type(part)(**{name: None if v is None else v[rows, columns] for name, v in values.items()})

    scale = (rows.stop - rows.start) / frame.height
    camera = replace(frame.camera, fov_y=2.0 * float(np.arctan(scale * np.tan(0.5 * frame.camera.fov_y))))
    return Frame(cut(frame.radiance), cut(frame.gbuffer), camera, spp=frame.spp)


def enrich(frame: Frame) -> Frame:
    """Return the frame with every guide that a renderer of ours gives; what it lacks is made up, smooth and lasting."""
    rng = np.random.default_rng(20150915)
    height, width = frame.shape
    guides = frame.gbuffer
    x = np.mgrid[:height, :width][1] / 32.0
    helper = np.cross(guides.normal, np.array([0.3, 0.9, 0.1]))
    tangent = helper / np.maximum(np.linalg.norm(helper, axis=-1, keepdims=True), 1e-6)
    noise = rng.gamma(2.0, 0.5, (height, width, 1)).astype(np.float32)

    return frame.with_changes(
        gbuffer=replace(
            guides,
            tangent=tangent,
            alpha_v=np.clip(guides.alpha_u * (1.0 + 0.5 * np.sin(3.0 * x)), 0.0, 1.0),
            hit_distance=np.where(guides.depth > 0.0, 1.0 + np.sin(x) ** 2, 0.0),
            mean_normal=guides.normal,
            mean_diffuse_albedo=guides.diffuse_albedo,
            mean_specular_albedo=guides.specular_albedo,
            coverage=rng.multinomial(16, np.full(9, 1 / 9), (height, width)) / 16,
        ),
        half_a=scale(frame.radiance, noise),
        half_b=scale(frame.radiance, np.float32(2.0) - np.minimum(noise, np.float32(2.0))),
    )


def scale(light: Radiance, factor: Any) -> Radiance:
    """Return all light of a part times a factor."""
    images = {name: getattr(light, name) for name in ("color", "diffuse", "specular")}
    return Radiance(**{name: None if image is None else image * factor for name, image in images.items()})


def forget(frame: Frame, *names: str, **changes: Any) -> Frame:
    """Return a frame without some guides, and with other changes."""
    kept = changes.pop("gbuffer", frame.gbuffer)
    return frame.with_changes(gbuffer=replace(kept, **dict.fromkeys(names)), **changes)


def name_layers(frame: Frame) -> Frame:
    """Return a frame whose light is in named layers with parts, with light passes, emission and a blurring lens."""
    diffuse, specular = frame.radiance.parts or ()
    guides = frame.gbuffer
    height, width = frame.shape
    side = np.linspace(0.0, 1.0, width, dtype=np.float32)[None, :, None]
    glow = np.float32(0.2) * np.maximum(frame.radiance.color - diffuse - specular, np.float32(0.0))
    glow[height // 3 : height // 3 + 3, ::9] += 4.0
    lights = {"diffuse": 0.8 * diffuse, "glossy": specular, "transmission": 0.2 * diffuse}
    albedos = {"diffuse": guides.diffuse_albedo, "glossy": guides.specular_albedo}
    layers = tuple(
        RadianceLayer(name, name, light, albedos.get(name), parts={"left": light * side, "right": light * (1.0 - side)})
        for name, light in lights.items()
    )
    color = diffuse + specular + glow
    blur = np.broadcast_to(np.linspace(0.0, 6.0, height, dtype=np.float32)[:, None], frame.shape)
    return frame.with_changes(
        radiance=Radiance(color, diffuse=diffuse, specular=specular),
        gbuffer=replace(guides, blur_radius=blur),
        half_a=None,
        half_b=None,
        layers=layers,
        unscattered={"emission": glow},
        also={"key": 0.7 * color, "fill": 0.3 * color},
    )


def damage(frame: Frame) -> Frame:
    """Return a frame with NaN, infinite, negative and very bright pixels, a row of them, and negative light."""
    color = np.array(frame.radiance.color)
    color[3, 4], color[9, 20], color[30, 31, 0], color[50, 60] = np.nan, np.inf, -1.0, 1e6
    color[70, 10:40] = np.nan
    color[90:95, 50:80, 2] -= 0.05
    parts = frame.radiance.parts
    diffuse = np.array(parts[0])
    diffuse[3, 4], diffuse[11, 12] = np.nan, np.inf
    return frame.with_changes(radiance=Radiance(color, diffuse=diffuse, specular=parts[1]))


def roughen(frame: Frame) -> Frame:
    """Return a frame with normals of white noise, where "high" filters the color alone as well."""
    normal = np.random.default_rng(5).normal(size=(*frame.shape, 3)).astype(np.float32)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return frame.with_changes(gbuffer=replace(frame.gbuffer, normal=normal / length))


def move(frame: Frame, step: int) -> Frame:
    """Return a frame of a sequence: the light moves a pixel a frame, its noise changes, and motion tells so."""
    rng = np.random.default_rng(100 + step)
    noise = rng.gamma(4.0, 0.25, (*frame.shape, 1)).astype(np.float32)
    motion = np.zeros((*frame.shape, 2), np.float32)
    motion[..., 0] = -1.0
    hits = np.zeros((*frame.shape, 3), np.float32)
    hits[..., 1] = 0.01
    guides = {name: np.roll(image, step, axis=1) for name, image in list_images(frame.gbuffer)}
    light = {name: np.roll(image, step, axis=1) for name, image in list_images(frame.radiance)}
    guides |= {"motion": motion, "reflected_motion": hits}
    if "position" in guides:
        guides["hit_position"] = guides["position"] + np.float32(0.5)
    return frame.with_changes(
        radiance=scale(Radiance(**light), noise),
        gbuffer=replace(frame.gbuffer, **guides),
        half_a=None,
        half_b=None,
    )


def list_images(part: Any) -> list[tuple[str, np.ndarray]]:
    """Return the images of a part of a frame by their names."""
    found = [(item.name, getattr(part, item.name)) for item in fields(part)]
    return [(name, image) for name, image in found if image is not None]
