"""Guides, direct light and indirect light for the interactive chain, frame after frame.

All rays go through the centres of pixels, so that guides, albedos and radiance belong to one surface. Functions are
frozen by Dr.Jit: the first call records the kernels, later calls launch them without running any Python.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, GBuffer
from lobewise.records.images import make_read_only
from lobewise.records.lobe_table import LobeTable
from lobewise.render.bridge import Frozen, dr, mi, take_numbers
from lobewise.render.camera import LENS, get_camera, get_image_size, get_sensor, is_flat, set_camera, use_sensor
from lobewise.render.gbuffer import Moves, add_motion, compute_guides
from lobewise.render.integrators import check_scene, choose_lens_light, choose_own_light, read_path_depth
from lobewise.render.materials.bsdfs import list_lobe_tables, read_scene_materials
from lobewise.render.own_light import forget_lobes, make_pinhole_sensor
from lobewise.render.tracing.direct import Boxes, draw_shifts, list_lamp_boxes, list_lamps, shade_direct
from lobewise.render.tracing.own_samples import OwnLight, sample_own
from lobewise.render.tracing.points import (
    Indirect,
    IndirectMethod,
    assign_to_lobes,
    can_be_transparent,
    trace_points,
)
from lobewise.render.tracing.rays import make_opaque


@dataclass(frozen=True)
class FirstHits:
    """The guides at all pixel centres, albedos included, and the camera in the sensor's precision.

    ``shape`` and ``seen_shape``, (height, width) each, hold the numbers of the shapes that rays through pixels and
    their mirror rays hit, for `lobewise.render.gbuffer.add_motion`.
    """

    gbuffer: GBuffer
    camera: Camera
    lobe_tables: tuple[LobeTable, ...]
    shape: FloatArray
    seen_shape: FloatArray


@dataclass(frozen=True)
class DirectLight:
    """Light that was scattered at most once; each (height, width, 3), linear, >= 0, albedo included."""

    emitted: FloatArray
    diffuse: FloatArray
    specular: FloatArray

    @property
    def total(self) -> FloatArray:
        """The sum of the three."""
        total = self.emitted + self.diffuse
        total += self.specular
        return total

    def make_black(self) -> DirectLight:
        """Return no light at as many pixels."""
        black = np.zeros_like(self.emitted)
        return DirectLight(black, black, black)


class IndirectLight(NamedTuple):
    """Indirect light of some pixels: by lobe, (count, 3) each, linear, >= 0, albedo included; hit distances, (count,).

    ``ray_weight``, (count,), is the mean over the samples of the weight of `lobewise.records.sparse_frame.Rays`; None
    where the method tells none.
    """

    diffuse: FloatArray
    specular: FloatArray
    hit_distance: FloatArray
    ray_weight: FloatArray | None = None


NO_PIXEL = (1 << 32) - 1
"""Number that no pixel has."""

LIMIT_PIXELS = 32
"""Columns and rows of the pixels at which `Stages.get_band_limit` measures."""

_GUIDES = {
    "depth": 1,
    "position": 3,
    "normal": 3,
    "tangent": 3,
    "alpha_u": 1,
    "alpha_v": 1,
    "lobe_kind": 1,
    "material": 1,
    "diffuse_albedo": 3,
    "specular_albedo": 3,
    "hit_distance": 1,
    "shape": 1,
    "seen_shape": 1,
}
"""Guides that the filters read, with their number of channels, and the numbers of shapes."""


def _make_opaque_size(width: int, height: int) -> tuple[Any, Any]:
    """Return width and height as opaque values, so that kernels are not compiled for each size."""
    return dr.opaque(mi.UInt32, width), dr.opaque(mi.UInt32, height)


def choose_sensor(scene: Any, camera: Camera) -> Any:
    """Return the sensor that moves through a scene: the scene's own, or a pinhole in its place.

    Dr.Jit records no lens, and a film with a crop window cannot be resized.
    """
    sensor = get_sensor(scene)
    whole = tuple(sensor.film().size()) == get_image_size(scene)
    return make_pinhole_sensor(scene, camera) if sensor.class_name() == LENS or not whole else sensor


def _place_sensor(scene: Any, camera: Camera, size: tuple[int, int]) -> None:
    """Move the sensor in use to a camera, and set the size of its film in pixels."""
    if get_image_size(scene) != size:
        parameters = mi.traverse(get_sensor(scene))
        parameters["film.size"] = list(size)
        parameters.update()
    set_camera(scene, camera)


def _number_pixels(rows: NDArray[np.intp], columns: NDArray[np.intp], width: int) -> Any:
    return take_numbers(mi.UInt32, rows * width + columns)


def _interleave(target: Any, pixel: Any, image: Any) -> Any:
    """Write the channels of pixels beside each other, as NumPy takes them. `Frozen` would copy the image for that."""
    for channel in range(3):
        at = 3 * pixel + channel
        dr.scatter(target, dr.detach(image[channel]), at, mode=dr.ReduceMode.NoConflicts)
    return target


class Stages:
    """The renderer of one scene, for many frames and sizes. It moves the scene's sensor.

    Through a lens it sees the scene from the lens's middle. It raises InputError if the sensor has no single viewpoint,
    and the errors of `lobewise.render.materials.bsdfs.read_material`.
    """

    def __init__(self, scene: Any) -> None:
        check_scene(scene)
        self.scene = scene
        self.start_camera = get_camera(scene, lens=True)
        self.max_depth = read_path_depth(scene)
        """Longest path, vertices after the camera."""
        self.own_light = choose_own_light(scene)
        """The scene's integrator if only it renders all light of the scene, otherwise None."""
        self._lens_light = choose_lens_light(scene)
        self._lens = get_sensor(scene)
        self._sensor = choose_sensor(scene, self.start_camera)
        self.start_size = get_image_size(scene)
        self.materials = read_scene_materials(scene)
        self.lobe_tables = list_lobe_tables(self.materials)
        self._lamps = list_lamps(scene)
        self._looks_through = can_be_transparent(self.materials)
        # Dr.Jit does not find all arrays of an orthographic sensor.
        self._records = not is_flat(scene)
        self._first = Frozen(self._trace_first, lambda: (scene, self._sensor), records=self._records)
        self._surfaces = Frozen(self._trace_surfaces, lambda: (scene, self._sensor), records=self._records)
        self._indirect: dict[str, tuple[IndirectMethod, Frozen]] = {}

    def forget_recordings(self) -> None:
        """Record all functions again: Dr.Jit 1.5 replays them with the addresses of a mesh's former arrays."""
        self._first.forget()
        self._surfaces.forget()
        self._indirect.clear()

    def place_camera(self, camera: Camera, width: int, height: int) -> None:
        """Move the sensor to the camera of the next frame, and set the size of its film in pixels."""
        with use_sensor(self._sensor):
            _place_sensor(self.scene, camera, (width, height))

    def trace_first(self, camera: Camera, seed: int) -> tuple[FirstHits, DirectLight]:
        """Return the guides and the direct light of all pixels, with one sample of the lights per pixel.

        ``camera`` is the camera of the last `place_camera`. Use another ``seed`` for every frame.
        """
        width, height = self._get_size()
        pixel = dr.arange(mi.UInt32, width * height)
        dr.eval(pixel)
        eye = [dr.opaque(mi.Float, float(value)) for value in camera.position]
        shifts = [dr.opaque(mi.Float, value) for value in draw_shifts(seed)]
        boxes = list_lamp_boxes(self.scene, self._lamps)
        counts = (*_GUIDES.values(), 3, 3, 3)
        targets = [dr.empty(mi.Float, 3 * width * height) for count in counts if count == 3]
        with use_sensor(self._sensor):
            flat = self._first(targets, pixel, *_make_opaque_size(width, height), *eye, boxes, *shifts)
        images = [
            values.reshape((height, width) if count == 1 else (height, width, count))
            for count, values in zip(counts, flat, strict=True)
        ]
        guides = dict(zip(_GUIDES, images, strict=False))
        shape, seen_shape = guides.pop("shape"), guides.pop("seen_shape")
        if not self.lobe_tables:
            del guides["material"]
        hits = FirstHits(GBuffer(**make_read_only(**guides)), camera, self.lobe_tables, shape, seen_shape)
        return hits, DirectLight(*images[len(_GUIDES) :])

    def add_motion(self, hits: FirstHits, previous: Camera, moves: Moves) -> FirstHits:
        """Return first hits whose guides hold ``motion`` and ``reflected_motion`` since a frame.

        ``previous`` is the camera of that frame. ``moves`` are those of `lobewise.render.gbuffer.move_back`, which says
        what it raises.
        """
        guides = hits.gbuffer
        seen = hits.seen_shape, guides.require("hit_distance", "motion")
        return replace(hits, gbuffer=add_motion(self.scene, guides, hits.shape, seen, (hits.camera, previous), moves))

    def shade_indirect(
        self, method: IndirectMethod, rows: NDArray[np.intp], columns: NDArray[np.intp], samples: int, *seeds: int
    ) -> IndirectLight:
        """Return the indirect light of some pixels, each shaded once with each seed: pixel by pixel, seeds in turn."""
        width, height = self._get_size()
        if isinstance(method, OwnLight):
            pixel = _number_pixels(rows, columns, width)
            with use_sensor(self._sensor):
                parts = [method.sample(pixel, samples, seed) for seed in seeds]
            color = np.stack(parts, axis=1).reshape(-1, 3)
            return IndirectLight(color, np.zeros_like(color), np.zeros(len(color), np.float32))
        known = self._indirect.get(method.name)
        if known is None or known[0] is not method:

            def shade(pixel: Any, width: Any, height: Any, samples: Any, seed: Any) -> list[Any]:
                points = trace_points(self.scene, self.materials, pixel, (width, height))
                light = method.shade(points, samples=samples, seed=seed)
                if self._looks_through:
                    parts = assign_to_lobes(points.surface, light.diffuse, light.specular)
                    # The first ray may leave a pane or a mask instead of the surface that the guides describe.
                    light = Indirect(*parts, light.hit_distance)
                # Light that is the same at all points, such as that of a lobe that no surface has, would keep the width
                # of the first call.
                there = pixel != NO_PIXEL
                light_parts = [getattr(light, each.name) for each in fields(Indirect)]
                return [dr.select(there, each, dr.nan) for each in light_parts if each is not None]

            frozen = Frozen(shade, lambda: (self.scene, self._sensor, method.state), records=self._records)
            known = self._indirect[method.name] = method, frozen
        # A seed for each lane: one recording serves any number of seeds.
        pixel = _number_pixels(rows.repeat(len(seeds)), columns.repeat(len(seeds)), width)
        seed = take_numbers(mi.UInt32, np.tile(np.array(seeds, np.uint32), rows.size))
        size = _make_opaque_size(width, height)
        with use_sensor(self._sensor):
            light_parts = known[1](pixel, *size, make_opaque(samples), seed)
        shapes = (-1, 3), (-1, 3), (-1,), (-1,)
        return IndirectLight(*(values.reshape(shape) for values, shape in zip(light_parts, shapes, strict=False)))

    def trace_surfaces(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], camera: Camera
    ) -> tuple[FloatArray, FloatArray]:
        """Return the depths of some pixels, (count,), and the numbers of shapes, (2, count), as in `FirstHits`.

        The shapes are those that the rays through the pixels and their mirror rays hit. ``camera`` is that of
        `place_camera`.
        """
        width, height = self._get_size()
        eye = [dr.opaque(mi.Float, float(value)) for value in camera.position]
        with use_sensor(self._sensor):
            depth, *shapes = self._surfaces(
                _number_pixels(rows, columns, width), *_make_opaque_size(width, height), *eye
            )
        return depth, np.stack(shapes)

    @property
    def has_lens(self) -> bool:
        """Whether the scene is seen through a lens wider than a pinhole."""
        return self._lens_light is not None

    def shade_through_lens(
        self, camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp], samples: int, seed: int
    ) -> FloatArray:
        """Return all light of some pixels through the lens, (count, 3), by the scene's integrator.

        ``camera`` is the camera of the last `place_camera`.
        """
        size = self._get_size()
        pixel = _number_pixels(rows, columns, size[0])
        with use_sensor(self._lens):
            _place_sensor(self.scene, camera, size)
            return sample_own(self.scene, self._lens_light, pixel, samples=samples, seed=seed, centred=True).color

    def _get_size(self) -> tuple[int, int]:
        with use_sensor(self._sensor):
            return get_image_size(self.scene)

    def get_band_limit(self, method: IndirectMethod, samples: int) -> float:
        """Return a method's band-limit, radians, measured at a grid of pixels."""
        width, height = self._get_size()
        columns, rows = min(width, LIMIT_PIXELS), min(height, LIMIT_PIXELS)
        grid = np.arange(rows)[:, None] * height // rows * width + np.arange(columns) * width // columns
        pixel = mi.UInt32(grid.ravel().astype(np.uint32))
        with use_sensor(self._sensor):
            points = trace_points(self.scene, self.materials, pixel, _make_opaque_size(width, height))
        return method.get_band_limit(points, samples)

    def _trace_surfaces(self, pixel: Any, width: Any, height: Any, x: Any, y: Any, z: Any) -> list[Any]:
        points = trace_points(self.scene, self.materials, pixel, (width, height))
        guides = compute_guides(self.scene, points, mi.Point3f(x, y, z))
        return [guides[name] for name in ("depth", "shape", "seen_shape")]

    def _trace_first(
        self,
        targets: list[Any],
        pixel: Any,
        width: Any,
        height: Any,
        x: Any,
        y: Any,
        z: Any,
        boxes: Boxes | None,
        *shifts: Any,
    ) -> list[Any]:
        points = trace_points(self.scene, self.materials, pixel, (width, height))
        guides = compute_guides(self.scene, points, mi.Point3f(x, y, z))
        inverse = guides["mirror_inverse"]
        missed = dr.select(guides["mirror_count"] > 0, dr.inf, 0.0)
        guides["hit_distance"] = dr.select(inverse > 0, dr.rcp(inverse), missed)
        if self.own_light is not None:
            guides |= forget_lobes(guides, points)
        light = shade_direct(self.scene, self.materials, points, width, shifts, boxes)
        scattered = (light.diffuse, light.specular)
        if self.max_depth < 2:
            scattered = (dr.zeros(mi.Color3f, dr.width(pixel)),) * 2
        images = [*(guides[name] for name in _GUIDES), light.emitted, *scattered]
        vectors = iter(targets)
        return [_interleave(next(vectors), pixel, image) if dr.depth_v(image) > 1 else image for image in images]
