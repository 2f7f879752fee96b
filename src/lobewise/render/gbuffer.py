"""The guides of every pixel.

- Position, normal, tangent, roughness and kind of lobe come from the ray through the pixel's centre. A mean over
  samples would blend both sides of a silhouette into a surface that does not exist, whose lobe fits neither side.
- Albedos are means over the samples. Radiance is divided by them, and the mean of a product is closest to the product
  of means over the same samples.
- Hits are means over the samples whose first bounce was specular, and the mirror ray of the pixel's centre. The hit
  distance is the harmonic mean, because filters use its inverse, in which a miss is 0. The hit position is the mean
  weighted by 1/t, which along one ray lies at the hit distance. Hit normal and hit albedo are plain means with 0 for a
  miss. They follow perfect mirrors and smooth glass to the first surface that is neither.
- Means over the areas of pixels, for smooth silhouettes, are in `lobewise.render.coverage`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError, require_choice
from lobewise.records.camera import Camera, compute_motion
from lobewise.records.frame import FloatArray, GBuffer, LobeKind
from lobewise.render.bridge import dr, hold_garbage, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_surface
from lobewise.render.materials.surface import is_mirror
from lobewise.render.tracing.points import MIN_SURFACE_OPACITY, Points, trace_points
from lobewise.render.tracing.rays import invert_distance

Moves = Mapping[str, ArrayLike]
"""For each moved shape, by its id: the matrix (4, 4) that maps its world points to their previous positions."""


@hold_garbage()
def trace_guides(
    scene: Any, materials: dict[int, Material], camera: Camera, *, pixels: tuple[int, int], size: tuple[int, int]
) -> dict[str, Any]:
    """Return the guides of a run of pixels, from the ray through each pixel's centre, as Dr.Jit arrays by name.

    Beside the fields of `GBuffer` these are ``shape`` (a number for `move_back`) and the results of the mirror ray:
    ``mirror_count`` (1 if it was traced), ``mirror_inverse`` (1/t), ``mirror_position`` (position over t), and
    ``seen_shape`` (the number of the shape that it hits; 0 for none, and where a path would go on, through a mask or by
    a mirror).
    """
    width, height = (dr.opaque(mi.UInt32, length) for length in size)
    pixel = dr.arange(mi.UInt32, pixels[1]) + dr.opaque(mi.UInt32, pixels[0])
    points = trace_points(scene, materials, pixel, (width, height))
    eye = mi.Point3f(*(float(value) for value in camera.position))
    shiny, mirrored = trace_mirror_rays(scene, points)
    guides = _collect_guides(points, eye, shiny, mirrored)
    # `render_frame` takes the means of albedos over the samples instead.
    guides = {name: value for name, value in guides.items() if not name.endswith("albedo")}
    seen = shiny & mirrored.is_valid()
    surface = dispatch_surface(materials, mirrored.bsdf(), mirrored, seen)
    passes = seen & (is_mirror(surface) | (surface.opacity < MIN_SURFACE_OPACITY))
    guides["seen_shape"] = dr.select(passes, 0.0, guides["seen_shape"])
    dr.eval(guides)
    return guides


def compute_guides(scene: Any, points: Points, eye: Any) -> dict[str, Any]:
    """Return the guides of points, as in `trace_guides` but with albedos, not evaluated yet.

    Depths are distances from ``eye``, the camera's position. Mitsuba's rays begin at the near plane instead.
    """
    return _collect_guides(points, eye, *trace_mirror_rays(scene, points))


def trace_mirror_rays(scene: Any, points: Points) -> tuple[Any, Any]:
    """Return at which points a mirror ray was traced (those with a specular lobe), and its hits."""
    si, surface, is_hit = points.si, points.surface, points.active
    shiny = is_hit & (surface.lobe_kind != float(LobeKind.NONE))
    view = -points.ray.d
    out = 2.0 * dr.dot(view, surface.normal) * surface.normal - view
    shiny &= dr.dot(out, si.n) * dr.dot(view, si.n) > 0  # a strong normal map can mirror the ray into the surface
    return shiny, scene.ray_intersect(si.spawn_ray(out), shiny)


def _collect_guides(points: Points, eye: Any, shiny: Any, mirrored: Any) -> dict[str, Any]:
    si, surface, is_hit = points.si, points.surface, points.active
    inverse = invert_distance(mirrored, shiny & mirrored.is_valid())
    names = (field.name for field in fields(surface) if field.name != "opacity")
    return {
        **{name: dr.select(is_hit, getattr(surface, name), 0.0) for name in names},
        "depth": dr.select(is_hit, dr.norm(si.p - eye), 0.0),
        "position": dr.select(is_hit, si.p, 0.0),
        # An instance moves, the shapes of its group do not.
        "shape": _number_shapes_of(si),
        "seen_shape": dr.select(shiny & mirrored.is_valid(), _number_shapes_of(mirrored), 0.0),
        "mirror_count": dr.select(shiny, mi.Float(1), 0.0),
        "mirror_inverse": inverse,
        "mirror_position": mi.Vector3f(mirrored.p) * inverse,
    }


def _number_shapes_of(si: Any) -> Any:
    """Return the number of the shape at each intersection as a float."""
    return mi.Float(_number_shapes(dr.select(si.instance != None, si.instance, si.shape)))  # noqa: E711


def _number_shapes(shape: Any) -> Any:
    return dr.reinterpret_array(mi.UInt32, shape)


def move_back(scene: Any, shape: FloatArray, position: FloatArray, moves: Moves) -> FloatArray:
    """Return where each pixel's surface point was in the previous frame, (height, width, 3).

    ``shape`` (height, width) holds the numbers of `trace_guides`. Shapes and instances move as rigid bodies or by
    another affine map. InputError if the scene has no shape with an id of ``moves``, or a matrix is not finite or not
    (4, 4).
    """
    before = position
    for number, matrix in number_moves(scene, moves):
        there = position @ matrix[:3, :3].T + matrix[:3, 3]
        before = np.where((shape == number)[..., None], there, before)
    return np.asarray(before)


def compute_reflected_motion(
    scene: Any, guides: GBuffer, seen: tuple[FloatArray, FloatArray], eye: NDArray[np.float64], moves: Moves
) -> FloatArray:
    """Return the previous minus the present position of what each pixel's mirror ray hits, (height, width, 3).

    Parameters
    ----------
    guides : GBuffer
        Its positions and normals are those of the mirrors.
    seen : pair of arrays, shape (height, width)
        What the mirror rays hit: ``seen_shape`` of `trace_guides`, and the distance.
    eye : array, shape (3,)
        Position of the camera.
    moves : Moves
        As for `move_back`, which tells the errors.
    """
    shape, distance = seen
    motion = np.zeros((*shape.shape, 3), np.float32)
    for number, matrix in number_moves(scene, moves):
        pixels = (shape == number) & np.isfinite(distance)
        position, normal = (
            guides.require(name, "motion")[pixels].astype(np.float64) for name in ("position", "normal")
        )
        ray = position - eye
        ray /= np.maximum(np.linalg.norm(ray, axis=-1, keepdims=True), 1e-30)
        out = ray - 2.0 * np.sum(ray * normal, axis=-1, keepdims=True) * normal
        hit = position + distance[pixels, None].astype(np.float64) * out
        motion[pixels] = hit @ (matrix[:3, :3] - np.eye(3)).T + matrix[:3, 3]
    return motion


def add_motion(
    scene: Any,
    guides: GBuffer,
    shapes: FloatArray,
    seen: tuple[FloatArray, FloatArray],
    cameras: tuple[Camera, Camera],
    moves: Moves,
) -> GBuffer:
    """Return guides with ``motion`` since a previous frame, and with ``reflected_motion`` if shapes have moved.

    Parameters
    ----------
    shapes : array, shape (height, width)
        As ``shape`` of `trace_guides`.
    seen : pair of arrays, shape (height, width)
        As for `compute_reflected_motion`.
    cameras : pair of Camera
        The cameras of this frame and of the previous one.
    moves : Moves
        As for `move_back`, which tells the errors.
    """
    camera, previous = cameras
    before = move_back(scene, shapes, guides.require("position", "motion"), moves)
    motion = compute_motion(camera, previous, before, guides.require("depth", "motion"))
    if not moves:
        return replace(guides, motion=motion)
    reflected = compute_reflected_motion(scene, guides, seen, camera.position, moves)
    return replace(guides, motion=motion, reflected_motion=reflected)


def number_moves(scene: Any, moves: Moves) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield the number of each moved shape, as ``shape`` of `trace_guides` holds it, and its matrix.

    InputError as `move_back`.
    """
    numbers = {shape.id(): int(_number_shapes(mi.ShapePtr(shape))[0]) for shape in scene.shapes()}
    for name, move in moves.items():
        require_choice("moves", name, numbers)
        matrix = np.asarray(move, dtype=np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            got = f"an array of shape {matrix.shape}"
            action = "pass the matrix that maps points to their previous positions"
            raise InputError(f"moves[{name!r}]", expected="a finite matrix of shape (4, 4)", got=got, action=action)
        yield numbers[name], matrix
