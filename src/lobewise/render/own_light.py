"""Light rendered by a scene's own integrator, and guides through a lens.

Both see the scene through a copy of its sensor whose film has a box filter, so that pixels are independent. Light
through a lens is a mean over the lens and the pixel's area. So the guides are means over both as well, instead of
coming from the ray through the pixel's centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError, require_choice, require_integer
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, LobeKind, Radiance
from lobewise.render.bridge import dr, mi, repeat, starts_as
from lobewise.render.camera import get_camera, get_image_size, get_sensor, has_lens, is_flat, make_matrix, use_sensor
from lobewise.render.images import to_image
from lobewise.render.integrators import LIGHTS, Light, name_integrator
from lobewise.render.materials.bsdfs import list_shapes, read_scene_materials
from lobewise.render.tracing.own_samples import OwnSamples, sample_own
from lobewise.render.tracing.points import Points, trace_first_opaque, trace_points
from lobewise.render.tracing.rays import draw_point, make_opaque, make_ray, make_rng

CHUNK_SAMPLES = 1 << 22
"""Samples per launch of the scene's integrator."""
MIN_HIT_SHARE = 0.5
"""Share of a pixel's rays. If fewer hit a surface, the pixel counts as background."""

_WITHOUT_LOBE = {"alpha_u": 1.0, "alpha_v": 1.0, "lobe_kind": float(LobeKind.NONE), "material": 0.0}
"""The guides of a lobe, at surfaces without one."""


def make_box_sensor(scene: Any) -> Any:
    """Return a sensor with the rays of a scene's sensor, but with a box filter and pixels in linear RGB."""
    original = get_sensor(scene)
    if is_flat(scene):
        kind = {"type": "orthographic", "film": _copy_film(original)}
    elif has_lens(scene):
        kind = _describe_lens(original)
    else:
        kind = _describe_pinhole(get_camera(scene), *get_image_size(scene))
    matrix = np.array(mi.traverse(original)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    return _make_copy(original, kind, matrix)


def make_pinhole_sensor(scene: Any, camera: Camera) -> Any:
    """Return a perspective sensor for a camera, with the other properties of a scene's sensor.

    Its whole film is the rendered part of the film of the scene's sensor, so that it can be resized.
    """
    return _make_copy(get_sensor(scene), _describe_pinhole(camera, *get_image_size(scene)), make_matrix(camera))


def _make_copy(original: Any, kind: dict[str, Any], matrix: NDArray[np.float64]) -> Any:
    sensor = mi.load_dict(
        {
            **kind,
            "near_clip": float(original.near_clip()),
            "far_clip": float(original.far_clip()),
            "to_world": mi.ScalarTransform4f(matrix),
            "sampler": {"type": "independent"},
        }
    )
    if original.get_medium() is not None:
        sensor.set_medium(original.get_medium())
    return sensor


def _describe_film(width: int, height: int, **crop: int) -> dict[str, Any]:
    size = {"width": width, "height": height, **crop}
    pixels = {"pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"}}
    return {"type": "hdrfilm", **size, **pixels}


def _describe_pinhole(camera: Camera, width: int, height: int) -> dict[str, Any]:
    """Return a pinhole sensor whose whole film is the rendered part of the camera's film."""
    half_width, half_height = camera.get_half_extent(width, height)
    return {
        "type": "perspective",
        "fov": float(np.rad2deg(2.0 * np.arctan(half_width))),
        "fov_axis": "x",
        "principal_point_offset_x": float(0.5 * camera.shift[0] / half_width),
        "principal_point_offset_y": float(-0.5 * camera.shift[1] / half_height),
        "film": _describe_film(width, height),
    }


def _describe_lens(sensor: Any) -> dict[str, Any]:
    """Return a lens sensor."""
    known = mi.traverse(sensor)
    numbers = {name: float(np.array(known[name]).item()) for name in ("aperture_radius", "focus_distance", "x_fov")}
    return {
        "type": "thinlens",
        "fov": numbers.pop("x_fov"),
        "fov_axis": "x",
        **numbers,
        "film": _copy_film(sensor),
    }


def _copy_film(sensor: Any) -> dict[str, Any]:
    """Return a film with the original's crop window, for sensors that cannot shift their film."""
    film = sensor.film()
    crop = {
        f"crop_{name}": int(value)
        for names, values in (
            (("width", "height"), film.crop_size()),
            (("offset_x", "offset_y"), film.crop_offset()),
        )
        for name, value in zip(names, values, strict=True)
    }
    whole = film.size()
    return _describe_film(int(whole[0]), int(whole[1]), **crop)


def check_own(spp: int, seed: int, light: str) -> None:
    """Raise InputError if a number is out of range, or a scene's own integrator cannot render the kind of light."""
    if require_choice("light", light, LIGHTS) != "all":
        action = "leave it out, or ask for integrator 'paths'"
        raise InputError("light", expected="'all' with the scene's own integrator", got=repr(light), action=action)
    require_integer("spp", spp, 1, 1 << 24)
    require_integer("seed", seed, 0, (1 << 32) - 1)


def sample_pixels(
    scene: Any,
    plan: Light,
    pixels: NDArray[np.uint32],
    *,
    spp: int,
    seed: int,
    light: str,
    advance: Callable[[int], None] | None = None,
) -> OwnSamples:
    """Return the light of single pixels by the integrator of a plan of `plan_pixels`. Errors as in `check_own`.

    ``pixels`` holds row-major numbers. ``advance`` is called with the number of samples after each launch.
    """
    check_own(spp, seed, light)
    return sample_own(scene, plan.own, mi.UInt32(pixels), samples=spp, seed=seed, advance=advance)


def render_own(
    scene: Any, integrator: Any, *, spp: int, seed: int, advance: Callable[[int], None]
) -> dict[str, Radiance]:
    """Return the images that an integrator renders, by their names in `Frame`.

    With an odd ``spp`` the first half has one sample more; with one sample there are no halves. ``advance`` is called
    with the number of samples after each launch. InputError if the integrator makes no image of three colours.
    """
    sensor = make_box_sensor(scene)
    width, height = get_image_size(scene)
    most = max(1, CHUNK_SAMPLES // (width * height))
    halves = []
    for half, count in enumerate(((spp + 1) // 2, spp // 2)):
        total = np.zeros((height, width, 3))
        for number, start in enumerate(range(0, count, most)):
            samples = min(most, count - start)
            own_seed = int(np.random.SeedSequence([seed, half, number]).generate_state(1)[0])
            with dr.suspend_grad():
                image = np.array(integrator.render(scene, sensor, seed=own_seed, spp=samples), dtype=np.float32)
            if image.ndim != 3 or image.shape[2] < 3:
                got = f"{name_integrator(integrator)}, which gives an image of shape {image.shape}"
                action = "put another into the scene, or ask for integrator 'paths'"
                raise InputError("integrator", expected="one that makes an image of light", got=got, action=action)
            total += image[..., :3].astype(np.float64) * samples
            advance(width * height * samples)
        halves.append((total / max(count, 1)).astype(np.float32))
    if spp == 1:
        return {"radiance": Radiance(halves[0])}
    share = np.float32(((spp + 1) // 2) / spp)
    color = share * halves[0] + (np.float32(1.0) - share) * halves[1]
    return {"radiance": Radiance(color), "half_a": Radiance(halves[0]), "half_b": Radiance(halves[1])}


def forget_lobes_of_media(scene: Any, frame: Frame) -> Frame:
    """Return a frame without the lobes of surfaces around media: light from inside does not follow these lobes.

    With its mirror lobe a glass ball filled with fog would not be filtered at all: a scene with such a ball had four
    times the error at 4 samples, and more than twice at 64.
    """
    guides = frame.gbuffer
    if guides.alpha_u is None or not any(shape.is_medium_transition() for shape in list_shapes(scene)):
        return frame
    width, height = get_image_size(scene)
    pixel = dr.arange(mi.UInt32, width * height)
    size = dr.opaque(mi.UInt32, width), dr.opaque(mi.UInt32, height)
    names = [name for name in _WITHOUT_LOBE if getattr(guides, name) is not None]
    with dr.suspend_grad():
        points = trace_points(scene, read_scene_materials(scene), pixel, size)
        lobe_guides = {name: mi.Float(np.ravel(getattr(guides, name))) for name in names}
        changed = {
            name: to_image(value).reshape(height, width) for name, value in forget_lobes(lobe_guides, points).items()
        }
    return frame.with_changes(gbuffer=replace(guides, **changed))


def forget_lobes(guides: dict[str, Any], points: Points) -> dict[str, Any]:
    """Return guides of points, Dr.Jit arrays by name, without the lobes of surfaces around media."""
    inside = points.active & points.si.shape.is_medium_transition()
    return {name: dr.select(inside, value, guides[name]) for name, value in _WITHOUT_LOBE.items() if name in guides}


@dataclass
class _Sums:
    """Sums over the rays of a pixel (Dr.Jit arrays; a PyTree).

    ``hit_count`` counts the rays that hit a surface. ``shine`` sums their mean specular albedo, which weights alphas.
    """

    hit_count: Any = starts_as("Float")
    depth: Any = starts_as("Float")
    position: Any = starts_as("Vector3f")
    normal: Any = starts_as("Vector3f")
    shine: Any = starts_as("Float")
    alpha_u: Any = starts_as("Float")
    alpha_v: Any = starts_as("Float")
    diffuse_albedo: Any = starts_as("Color3f")
    specular_albedo: Any = starts_as("Color3f")


def render_lens_guides(scene: Any, *, samples: int, seed: int, moved: bool = False) -> Frame:
    """Return a black frame with the mean guides through a lens, and the pinhole camera in the lens's middle.

    ``samples`` is the number of rays per pixel. Alphas are weighted by the specular albedo. With ``moved``, motion is
    asked for: InputError, because through a lens a pixel has no single motion.
    """
    if moved:
        action = "leave it out, or use a perspective sensor"
        raise InputError("previous_camera", expected="none, as a lens shows no single motion", got="one", action=action)
    camera = get_camera(scene, lens=True)
    width, height = get_image_size(scene)
    sensor, materials = make_box_sensor(scene), read_scene_materials(scene)
    pixel = dr.arange(mi.UInt32, width * height)
    size = dr.opaque(mi.UInt32, width), dr.opaque(mi.UInt32, height)
    eye = mi.Point3f(*(float(value) for value in camera.position))
    seed_value = make_opaque(seed)

    def take(index: Any, sums: _Sums) -> tuple[_Sums]:
        rng = make_rng(pixel, index, seed_value)
        ray = make_ray(scene, pixel, size, draw_point(rng), draw_point(rng), hides=False)
        si, surface = trace_first_opaque(scene, materials, ray)
        is_hit = si.is_valid()
        shine = dr.select(is_hit, dr.mean(surface.specular_albedo), 0.0)
        sums.hit_count += dr.select(is_hit, 1.0, 0.0)
        sums.depth += dr.select(is_hit, dr.norm(si.p - eye), 0.0)
        sums.position += dr.select(is_hit, mi.Vector3f(si.p), 0.0)
        sums.normal += dr.select(is_hit, surface.normal, 0.0)
        sums.shine += shine
        sums.alpha_u += shine * surface.alpha_u
        sums.alpha_v += shine * surface.alpha_v
        sums.diffuse_albedo += dr.select(is_hit, surface.diffuse_albedo, 0.0)
        sums.specular_albedo += dr.select(is_hit, surface.specular_albedo, 0.0)
        return (sums,)

    with use_sensor(sensor), dr.suspend_grad():
        (sums,) = repeat(take, mi.UInt32(0), dr.opaque(mi.UInt32, samples), _Sums(), label="lens")
        dr.eval(sums)
    hit_count, shine = to_image(sums.hit_count), to_image(sums.shine)
    there = hit_count > MIN_HIT_SHARE * samples

    def divide(value: Any, by: FloatArray, default: float) -> FloatArray:
        image = to_image(value)
        by, valid = (by[:, None], there[:, None]) if image.ndim == 2 else (by, there)
        return np.where(valid & (by > 0.0), image / np.maximum(by, np.float32(1e-9)), np.float32(default))

    images = {name: divide(getattr(sums, name), hit_count, 0.0) for name in ("depth", "position", "normal")}
    images |= {name: divide(getattr(sums, name), shine, 1.0) for name in ("alpha_u", "alpha_v")}
    for name in ("diffuse_albedo", "specular_albedo"):
        images[name] = np.clip(to_image(getattr(sums, name)) / np.float32(samples), 0.0, 1.0)
    whole = {name: image.reshape(height, width, *image.shape[1:]) for name, image in images.items()}
    black = np.zeros((height, width, 3), np.float32)
    return Frame(Radiance(black), GBuffer(**whole), camera, spp=samples)
