"""What it brings that samples count by the weights of their rays, and that pixels weigh rays by their own lobes.

    python -m benchmarks.upsampling.rays --cache FOLDER

Nine scenes: those of `benchmarks.upsampling.skies`, and four built-in ones, 256x256 pixels. One of 4x4 pixels has one
ray; the camera moves by half a degree a frame, and the last of eight frames is compared with its reference. "indirect"
is the light of `lobewise.interactive`, which was scattered twice or more. "sky" is all light that comes along the ray,
in the four scenes with a sky, from which the sun was taken.

Errors are those of the specular light (`rel_mse`, epsilon 0.01) of pixels whose alphas are below 0.2, means over two
runs with other random numbers. The noise of the reference is taken off: it has two halves, and the error is the mean
product of the differences to both. A trial is a rule by which rays are weighed; see `TRIALS`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple
from unittest import mock

import halide as hl
import numpy as np
from numpy.typing import NDArray

import lobewise
from benchmarks.common import RESULTS, ROOT, describe_machine, write_json
from benchmarks.pictures.detail import join
from benchmarks.upsampling import skies
from benchmarks.upsampling.skies import SCENES as SKIES
from benchmarks.upsampling.skies import SIZE_PIXELS
from lobewise.camera import Camera
from lobewise.denoising import layers
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.features.base import Vector
from lobewise.features.ray import RayFeature, RayPlanes, evaluate_ray_lobe
from lobewise.frame import FloatArray, Radiance
from lobewise.guides.rays import make_ray_feature
from lobewise.io.png import encode_png
from lobewise.metrics import find_specular_pixels
from lobewise.render import find_orbit_centre, load_mitsuba, load_scene, make_orbit
from lobewise.render.bridge import dr, mi, repeat
from lobewise.render.materials.dispatch import dispatch_share
from lobewise.render.stages import Stages
from lobewise.render.tracing.paths import PathLight, PathSettings, trace_path
from lobewise.render.tracing.points import trace_points
from lobewise.render.tracing.rays import make_opaque, make_rng
from lobewise.sparse_frame import Rays, SparseFrame, list_places

NAMES = {
    "indirect": (*SKIES, "showroom", "brushed", "parlour", "kitchen"),
    "sky": ("copper", "plastic", "brushed aluminium", "glass and mirror"),
}
"""Scenes by kind of light."""
MAX_SKY_RADIANCE = 2.0
"""Radiance to which the sun is reduced: rays that are sampled by the BSDF alone seldom meet it."""
FRAMES, SCALE, DEGREES, RUNS = 8, 4, 0.5, 2
REFERENCE_SPP = 1024
MAX_ALPHA = 0.2
NEAREST_PIXELS = 8.0
"""Smallest distance of a hit in the trial that follows hits, pixel footprints."""
TRIALS: dict[str, dict[str, Any] | None] = {
    "no rays": None,
    "weights": {},
    "lobes": {"spread": 0.01},
    "lobes widened by 0.1": {"spread": 0.1},
    "widened by 0.1, hits followed": {"spread": 0.1, "hits": True},
    "lobes widened by 0.3": {"spread": 0.3},
}
"""Trials: frames without rays; rays without directions; and pixels that weigh rays by their own lobes, whose alphas are
widened, also with rays that lead from the pixel's own place to where the neighbour's ray arrived."""
BETAS: tuple[float | str, ...] = ("auto", 1.0)
"""Strictness of the lobes' similarity."""
PICTURE = ROOT / "docs" / "images" / "rays.png"
SHOWN = (("sky", "copper"), ("sky", "brushed aluminium"), ("indirect", "kitchen"))
Mask = NDArray[np.bool_]


class Shaded(NamedTuple):
    """Samples (count, ...) of some pixels: specular light, rays, and the distances of their hits."""

    specular: FloatArray
    weight: FloatArray
    direction: FloatArray
    distance: FloatArray


@dataclass(frozen=True)
class Shot:
    """The frames of a scene in every run, with the distances of rays, and both halves of the last frame's reference."""

    runs: list[list[SparseFrame]]
    distances: list[list[FloatArray]]
    halves: tuple[FloatArray, FloatArray]
    mask: Mask


class Shader:
    """Shades single pixels of a scene."""

    def __init__(self, name: str, light: str) -> None:
        sky = skies.make_sky() if light == "indirect" else np.minimum(skies.make_sky(), np.float32(MAX_SKY_RADIANCE))
        variant = load_mitsuba()
        with mock.patch.object(skies, "make_sky", return_value=sky):
            known = name in SKIES
            self.scene = SKIES[name](variant) if known else load_scene(name, width=SIZE_PIXELS, height=SIZE_PIXELS)
        self.stages = Stages(self.scene)
        self.method = PathLight(self.scene, self.stages.materials, max_depth=self.stages.max_depth, through=True)
        self._size = (dr.opaque(mi.UInt32, SIZE_PIXELS),) * 2

    def place(self, camera: Camera) -> None:
        """Move the camera."""
        self.stages.place_camera(camera, SIZE_PIXELS, SIZE_PIXELS)

    def trace_points(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Any:
        """Return the first surfaces of pixels."""
        pixel = mi.UInt32((rows * SIZE_PIXELS + columns).astype(np.uint32))
        return trace_points(self.scene, self.stages.materials, pixel, self._size)

    def shade(self, rows: NDArray[np.intp], columns: NDArray[np.intp], seed: int, light: str) -> Shaded:
        """Return one sample of each pixel."""
        if light == "sky":
            return self._shade_all(rows, columns, seed)
        found = self.stages.shade_indirect(self.method, rows, columns, 1, seed)
        assert found.ray_weight is not None
        assert found.direction is not None
        return Shaded(found.specular, found.ray_weight, found.direction, found.hit_distance)

    def _shade_all(self, rows: NDArray[np.intp], columns: NDArray[np.intp], seed: int) -> Shaded:
        """Sample the BSDF, and take all radiance along the ray from Mitsuba's path tracer."""
        points, flags = self.trace_points(rows, columns), mi.BSDFFlags
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(rows))
        context, si, active = mi.BSDFContext(), points.si, points.active
        chosen, factor = points.bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        ray = si.spawn_ray(si.to_world(chosen.wo))
        radiance = mi.load_dict({"type": "path"}).sample(self.scene, sampler, mi.RayDifferential3f(ray), None, active)[
            0
        ]
        is_delta = mi.has_flag(chosen.sampled_type, flags.Delta)
        share = dispatch_share(self.stages.materials, points.bsdf, si, chosen.wo, active & ~is_delta)
        specular = factor * dr.select(is_delta, 1.0, 1.0 - share)
        albedo = dr.sum(points.surface.specular_albedo)
        bends = mi.has_flag(points.bsdf.flags(), flags.GlossyTransmission)
        bends |= mi.has_flag(points.bsdf.flags(), flags.DeltaTransmission)
        weight = dr.select((albedo > 0) & ~bends, dr.sum(specular) / albedo, 1.0)
        direction, hit = dr.select(bends, 0.0, ray.d), self.scene.ray_intersect(ray, active)
        there = active & (albedo > 0)
        values = (dr.select(there, specular * radiance, 0.0), dr.select(there, weight, 1.0), direction, hit.t)
        return Shaded(*(np.moveaxis(np.array(each, np.float32), -1, 0) for each in values))

    def shade_reference(self, half: int, light: str) -> FloatArray:
        """Return half of the samples of specular light at all pixels."""
        rows, columns = (index.ravel() for index in np.indices((SIZE_PIXELS, SIZE_PIXELS)))
        depth = make_opaque(self.stages.max_depth)
        settings = PathSettings(self.stages.max_depth, min_bounces=2 * (light == "indirect"), surfaces=False)
        points, seed = self.trace_points(rows, columns), make_opaque(90_000 + half)

        def take(index: Any, total: Any) -> tuple[Any]:
            rng = make_rng(points.pixel, index, seed)
            path = trace_path(self.scene, self.stages.materials, points.ray, rng, settings, depth)
            return (total + path.lobes.specular,)

        count = REFERENCE_SPP // 2
        (total,) = repeat(take, mi.UInt32(0), make_opaque(count), dr.zeros(mi.Color3f, len(rows)), label="samples")
        image = np.array(total, np.float32).T.reshape(SIZE_PIXELS, SIZE_PIXELS, 3)
        return np.asarray(image / count, np.float32)


def load_shot(folder: Path, name: str, light: str) -> Shot:
    """Return a shot; its reference is rendered if the folder lacks it."""
    shader = Shader(name, light)
    path = make_orbit(
        shader.stages.start_camera, find_orbit_centre(shader.scene), frames=FRAMES, degrees_per_frame=DEGREES
    )
    runs: list[list[SparseFrame]] = [[] for _ in range(RUNS)]
    distances: list[list[FloatArray]] = [[] for _ in range(RUNS)]
    for k, (camera, place) in enumerate(zip(path, list_places(SCALE), strict=False)):
        shader.place(camera)
        hits, _ = shader.stages.trace_first(camera, k)
        guides = (shader.stages.add_motion(hits, path[k - 1], {}) if k else hits).gbuffer
        rows, columns = (np.arange(start, SIZE_PIXELS, SCALE) for start in place)
        shape = rows.size, columns.size
        pixels = np.repeat(rows, columns.size), np.tile(columns, rows.size)
        for run in range(RUNS):
            found = shader.shade(*pixels, 1000 * run + k, light)
            specular = found.specular.reshape(*shape, 3)
            radiance = Radiance(specular, diffuse=np.zeros_like(specular), specular=specular)
            rays = Rays(found.weight.reshape(shape), found.direction.reshape(*shape, 3))
            runs[run].append(SparseFrame(radiance, guides, SCALE, place, camera, spp=1, rays=rays))
            distances[run].append(found.distance.reshape(shape))
    assert guides.alpha_u is not None
    assert guides.specular_albedo is not None
    widest = np.maximum(guides.alpha_u, guides.alpha_u if guides.alpha_v is None else guides.alpha_v)
    mask = find_specular_pixels(guides) & (widest < MAX_ALPHA) & (guides.specular_albedo.max(axis=-1) > 0.0)
    return Shot(runs, distances, load_reference(folder, name, light, shader), mask)


def load_reference(folder: Path, name: str, light: str, shader: Shader) -> tuple[FloatArray, FloatArray]:
    """Return both halves of the specular light of the camera in place."""
    file = folder / f"{name.replace(' ', '-')}-{light}.npz"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(file, *(shader.shade_reference(half, light) for half in range(2)))
    with np.load(file) as stored:
        return stored["arr_0"], stored["arr_1"]


def measure_error(image: FloatArray, shot: Shot) -> float:
    """Return the error of specular light, without the noise of the reference."""
    first, second = (half[shot.mask].astype(np.float64) for half in shot.halves)
    mean, found = 0.5 * (first + second), image[shot.mask]
    return float(((found - first) * (found - second) / (mean**2 + 0.01)).mean())


def filter_one(frames: list[SparseFrame], beta: float | str) -> FloatArray:
    """Return the specular light of the last frame by itself."""
    found = lobewise.upsample(frames[-1], beta=beta).specular  # type: ignore[arg-type]
    assert found is not None
    return found


def filter_all(frames: list[SparseFrame], beta: float | str) -> FloatArray:
    """Return the specular light of the last frame with the history of the others."""
    temporal = lobewise.TemporalFilter(beta=beta)  # type: ignore[arg-type]
    found = [temporal.add(frame) for frame in frames][-1].specular
    assert found is not None
    return found


class HitPlanes(NamedTuple):
    """Planes of `HitRayFeature`."""

    lobe: RayPlanes
    place: Vector
    inverse_distance: hl.Expr


@dataclass(frozen=True, eq=False, repr=False)
class HitRayFeature(RayFeature):
    """A ray leads from the pixel's own place to where the neighbour's ray arrived."""

    name: ClassVar[str] = "ray and hit"
    place: FloatArray | None = None
    inverse_distance: FloatArray | None = None

    @property
    def neutral(self) -> tuple[float, ...]:
        return (*super().neutral, 0.0, 0.0, 0.0, 0.0)

    def prepare(self, inputs: Vector, parameters: Vector) -> HitPlanes:  # type: ignore[override]
        *_, place, inverse = self.split(inputs)
        alone = RayFeature(*(getattr(self, each.name) for each in fields(RayFeature)))
        return HitPlanes(alone.prepare(inputs[:-4], parameters), place, inverse)

    def make_factor(self, i: HitPlanes, j: HitPlanes, parameters: Vector) -> hl.Expr:  # type: ignore[override]
        shifts = [(p - q) * j.inverse_distance for p, q in zip(j.place, i.place, strict=True)]
        ray = [w + shift for w, shift in zip(j.lobe.direction, shifts, strict=True)]
        length = hl.sqrt(hl.max(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2], hl.f32(1e-12)))
        ratio = hl.min(evaluate_ray_lobe(i.lobe, [c / length for c in ray]) * j.lobe.inverse, parameters[1])
        return hl.select(j.lobe.inverse > hl.f32(0.0), ratio, hl.f32(1.0))


@contextmanager
def change_rays(shot: Shot, run: int, *, hits: bool = False, **numbers: float) -> Iterator[None]:
    """Let the features of rays have other numbers, or follow hits, in a ``with`` block."""
    known = {frame.place: k for k, frame in enumerate(shot.runs[run])}

    def make(frame: SparseFrame, direction: FloatArray) -> RayFeature:
        feature = replace(make_ray_feature(frame, direction), **numbers)
        if not hits:
            return feature
        guides, camera = frame.gbuffer, frame.require_camera("rays")
        assert guides.position is not None
        assert guides.depth is not None
        nearest = NEAREST_PIXELS * camera.get_pixel_angle(frame.height) * guides.depth
        whole = np.zeros(frame.shape, np.float32)
        with np.errstate(divide="ignore"):
            distance = np.maximum(shot.distances[run][known[frame.place]], nearest[frame.shaded])
            whole[frame.shaded] = np.where(distance > 0.0, 1.0 / distance, 0.0)
        parts = {each.name: getattr(feature, each.name) for each in fields(RayFeature)}
        return HitRayFeature(**parts, place=guides.position, inverse_distance=whole)

    with mock.patch.object(layers, "make_ray_feature", make):
        yield


def take_rays(frames: list[SparseFrame], numbers: dict[str, Any] | None) -> list[SparseFrame]:
    """Return frames with the rays that a trial reads."""
    if numbers:
        return frames
    weights = [None if numbers is None else frame.rays and Rays(frame.rays.weight) for frame in frames]
    return [replace(frame, rays=rays) for frame, rays in zip(frames, weights, strict=True)]


def measure_scene(shot: Shot) -> tuple[dict[str, dict[str, dict[str, float]]], list[FloatArray]]:
    """Return the errors of every trial, by the strictness of lobes, and the images of the first run over time."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    images = []
    for name, numbers in TRIALS.items():
        for beta in BETAS:
            errors: dict[str, list[float]] = {"one frame": [], "over time": []}
            for run, whole in enumerate(shot.runs):
                frames = take_rays(whole, numbers)
                with change_rays(shot, run, **(numbers or {})):
                    image = filter_all(frames, beta)
                    errors["one frame"].append(measure_error(filter_one(frames, beta), shot))
                    errors["over time"].append(measure_error(image, shot))
                if run == 0 and beta == "auto":
                    images.append(image)
            found.setdefault(name, {})[str(beta)] = {key: _round(np.mean(each)) for key, each in errors.items()}
    return found, images


def _round(value: Any) -> float:
    return float(f"{float(value):.4g}")


def compute_mean_ratios(scenes: dict[str, Any]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the geometric means over the scenes of the errors over those without rays."""

    def find(trial: str, beta: str, kind: str) -> float:
        pairs = [(each[trial][beta][kind], each["no rays"]["auto"][kind]) for each in scenes.values()]
        return _round(np.exp(np.mean([np.log(error / base) for error, base in pairs])))

    return {
        trial: {
            str(beta): {kind: find(trial, str(beta), kind) for kind in ("one frame", "over time")} for beta in BETAS
        }
        for trial in TRIALS
    }


def main() -> None:
    """Measure every scene; write the JSON, and docs/images/rays.png."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for references")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "rays.json")
    asked = parser.parse_args()
    lights: dict[str, dict[str, Any]] = {light: {} for light in NAMES}
    rows = []
    for light, names in NAMES.items():
        for name in names:
            shot = load_shot(asked.cache, name, light)
            lights[light][name], images = measure_scene(shot)
            print(name, light, lights[light][name], flush=True)
            if (light, name) in SHOWN:
                reference = 0.5 * (shot.halves[0] + shot.halves[1])
                exposure = choose_exposure(reference)
                shown = [images[0], images[1], images[3], reference]
                rows.append(join([map_tones(image, exposure) for image in shown], 1))
    if rows:
        PICTURE.write_bytes(encode_png(np.ascontiguousarray(join(rows, 0))))
    means = {light: compute_mean_ratios(scenes) for light, scenes in lights.items()}
    write_json(asked.output, {"lights": lights, "mean ratios": means, "machine": describe_machine()})


if __name__ == "__main__":
    main()
