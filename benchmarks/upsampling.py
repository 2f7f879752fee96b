"""Upsampling over space and time on ``showroom``: errors, ghosts, flicker and time, part by part.

Writes a JSON with everything and prints a table; parts that a run leaves out keep their rows, each of which names its
commit. Geometry-aware weights (``normal``) are tuned on the frame against its reference, coordinate by coordinate from
several starts; lobe-aware weights are both tuned likewise and left at their defaults.

Frames and references are rendered on first use. The references take an hour on two cores.

    python benchmarks/upsampling.py --cache ~/.cache/lobewise-quality -o benchmarks/results/upsampling.json
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lobewise
from common import describe_machine, fetch_frame, write_json
from lobewise import TemporalFilter
from lobewise.adaptive import find_unsupported, recompute
from lobewise.bench.timing import time_best
from lobewise.camera import Camera
from lobewise.denoising import denoise
from lobewise.frame import FloatArray, Frame, Radiance, Result
from lobewise.io.exr import read_frame, read_image, write_frame, write_image
from lobewise.io.sparse import read_sparse_frame, write_sparse_frame
from lobewise.metrics import Flicker, find_disoccluded, find_specular_pixels, make_error_map, rel_mse
from lobewise.render import (
    MovingScene,
    find_orbit_centre,
    get_camera,
    load_scene,
    make_orbit,
    render_frame,
    render_pixels,
    render_sequence,
    set_camera,
)
from lobewise.sparse_frame import AnyFrame, SparseFrame, list_places, make_sparse
from lobewise.upsampling import upsample

Mask = NDArray[np.bool_]

SCENE = "showroom"
SPP = 4
SCALE = 4
REFERENCE_SEED = 100_000

ALPHA_BINS = (0.0, 0.045, 0.1, 0.2, 0.35, 1.0)
"""Limits between which roughness is counted together; the floor's tiles have 0.03 to 0.6."""

PLACE_GRID: dict[str, tuple[Any, ...]] = {
    "radius": (2, 3, 5, 7, 9, 12, 16),
    "screen_sigma": (3.0, 6.0, 10.0, 20.0, 40.0, 100.0),
    "position_sigma": (4.0, 8.0, 16.0, 24.0, 40.0, 64.0, 96.0),
}
GEOMETRY_GRID = {**PLACE_GRID, "normal_exponent": (1.0, 4.0, 16.0, 32.0, 64.0, 128.0, 256.0, 1024.0)}
LOBE_GRID = {
    **PLACE_GRID,
    "beta": (0.5, 1.0, 2.0, 4.0, 8.0),
    "diffuse_beta": (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0),
    "tau": (0.03, 0.06, 0.09, 0.12, 0.16, 0.2),
}
STARTS: tuple[dict[str, Any], ...] = (
    {"radius": 5, "screen_sigma": 20.0, "position_sigma": 16.0, "tau": 0.12, "normal_exponent": 64.0},
    {"radius": 9, "screen_sigma": 40.0, "position_sigma": 24.0, "tau": 0.06, "normal_exponent": 16.0},
)


@dataclass(frozen=True)
class HurriedScene(MovingScene):
    """A scene whose objects are ``pace`` times as fast."""

    pace: float = 1.0

    def load(self, time: float = 0.0) -> Any:
        """Return the scene at a time."""
        return super().load(self.pace * time)

    def find_moves(self, time: float, before: float) -> dict[str, NDArray[np.float64]]:
        """Return where the moving shapes came from."""
        return super().find_moves(self.pace * time, self.pace * before)


@dataclass(frozen=True)
class Shot:
    """A sequence: an orbit of the camera, or at some pace moving objects before a camera that stands still.

    Parameters
    ----------
    size : int
        Pixels a side.
    frames : int
        How many.
    light : str
        As `render_frame` takes it.
    pace : float
        Of the objects; 0 is an orbit instead.
    """

    size: int
    frames: int
    light: str = "all"
    pace: float = 0.0

    @property
    def name(self) -> str:
        """Name of its files."""
        if self.pace:
            return f"moving-{self.size}-{self.pace:g}"
        return f"orbit-{self.size}-{self.light}"

    def open(self) -> tuple[Any, list[Camera]]:
        """Return scene and cameras."""
        scene = load_scene(SCENE, width=self.size, height=self.size)
        start = get_camera(scene)
        if self.pace:
            return HurriedScene(SCENE, self.size, self.size, self.pace), [start] * self.frames
        return scene, make_orbit(start, find_orbit_centre(scene), self.frames)


ORBIT = {light: Shot(512, 16, light) for light in ("indirect", "all")}
SLOW, FAST = Shot(256, 17, pace=1.0), Shot(256, 17, pace=3.0)
FLICKERING = Shot(256, 32)
GHOST_SHOTS = (SLOW, FAST)
PIECE_SPP = {"indirect": 2048, "all": 512}
"""Samples of a piece of the orbit's references; indirect light alone has more noise."""
GHOST_SPP, FLICKER_SPP = 128, 64
"""Samples of each of the two halves of the other references, whose noise is measured and taken off."""


class Cache:
    """Frames and references by their files, rendered on first use.

    Parameters
    ----------
    folder : Path
        Where.
    pieces : int
        Of how many renders the references of `ORBIT` are the mean.
    """

    def __init__(self, folder: Path, pieces: int) -> None:
        self.folder = folder / "upsampling"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.pieces = pieces

    def fetch_shot(self, shot: Shot, scale: int) -> list[AnyFrame]:
        """Return the frames of a shot, whole ones (scale 1) or sparse ones."""
        paths = [self.folder / f"{shot.name}-x{scale}-{index:02d}.exr" for index in range(shot.frames)]
        missing = [index for index, path in enumerate(paths) if not path.exists()]
        if missing:
            scene, cameras = shot.open()
            options: dict[str, Any] = {"spp": SPP, "scale": scale, "light": shot.light, "seed": 100}
            for index, frame in enumerate(
                render_sequence(scene, cameras, first=missing[0], **options), start=missing[0]
            ):
                if isinstance(frame, SparseFrame):
                    write_sparse_frame(paths[index], frame, half=False)
                else:
                    write_frame(paths[index], replace(frame, half_a=None, half_b=None), half=False)
        return [read_frame(path) if scale == 1 else read_sparse_frame(path) for path in paths]

    def fetch_reference(self, shot: Shot, index: int, spp: int, piece: int) -> FloatArray:
        """Return one piece of the reference of a frame; pieces have random numbers of their own."""
        path = self.folder / f"{shot.name}-{index:02d}-{spp}-{piece}.exr"
        if not path.exists():
            print(f"rendering {path.name}", file=sys.stderr)
            scene, cameras = shot.open()
            options: dict[str, Any] = {"light": shot.light, "seed": REFERENCE_SEED + 1000 * piece}
            frame = next(iter(render_sequence(scene, cameras, spp=spp, first=index, reference=True, **options)))
            write_image(path, frame.radiance.color)
        return read_image(path)

    def fetch_pair(self, shot: Shot, index: int, spp: int) -> tuple[FloatArray, FloatArray]:
        """Return the reference of a frame, of twice as many samples, and an image that is as noisy before it.

        That image is as far from the reference as the reference is from the truth, by figures that are mean squares.
        """
        first, second = (self.fetch_reference(shot, index, spp, piece) for piece in (0, 1))
        return np.float32(0.5) * (first + second), first

    def fetch_mean(self, shot: Shot, index: int) -> tuple[FloatArray, dict[str, Any]]:
        """Return the reference of a frame from all pieces, and what to say of it."""
        spp = PIECE_SPP[shot.light]
        pieces = [self.fetch_reference(shot, index, spp, piece) for piece in range(self.pieces)]
        mean = np.mean(pieces, axis=0, dtype=np.float64).astype(np.float32)
        row: dict[str, Any] = {"reference_spp": spp * self.pieces}
        if self.pieces > 1:
            # A piece is off the mean of n by n - 1 times the variance of that mean.
            apart = [rel_mse(piece, mean) for piece in pieces]
            row["reference_error"] = float(np.mean(apart)) / (self.pieces - 1)
        return mean, row


def select_bins(frame: AnyFrame) -> dict[str, Mask]:
    """Return the masks of which errors are told: specular pixels, those of similar roughness, the others."""
    specular = find_specular_pixels(frame.gbuffer)
    alpha = frame.gbuffer.alpha_u
    assert alpha is not None
    masks = {"specular": specular, "others": ~specular}
    for low, high in itertools.pairwise(ALPHA_BINS):
        masks[f"alpha {low:g} to {high:g}"] = specular & (alpha >= low) & (alpha < high)
    return {name: mask for name, mask in masks.items() if mask.any()}


def measure(image: FloatArray, reference: FloatArray, masks: Mapping[str, Mask]) -> dict[str, Any]:
    """Return the errors of an image."""
    return {
        "rel_mse": rel_mse(image, reference),
        **{f"rel_mse, {name}": rel_mse(image, reference, mask) for name, mask in masks.items()},
    }


def tune(
    evaluate: Callable[[dict[str, Any]], float],
    grid: Mapping[str, Sequence[Any]],
    starts: Sequence[Mapping[str, Any]] = STARTS,
) -> tuple[dict[str, Any], int]:
    """Return the best settings that a search along one coordinate after the other finds, and how many it tried."""
    known: dict[tuple[Any, ...], float] = {}

    def look_up(point: dict[str, Any]) -> float:
        key = tuple(point[name] for name in grid)
        if key not in known:
            known[key] = evaluate(point)
        return known[key]

    best: dict[str, Any] = {}
    for start in starts:
        # A parameter that the start leaves open begins in the middle of its values.
        point = {name: start.get(name, values[len(values) // 2]) for name, values in grid.items()}
        before = float("inf")
        while look_up(point) < before:
            before = look_up(point)
            for name, values in grid.items():
                point = min(({**point, name: value} for value in values), key=look_up)
        if not best or look_up(point) < look_up(best):
            best = point
    return best, len(known)


def run_spatial(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """One sparse frame alone: bilinear, geometry-aware, lobe-aware."""
    row: dict[str, Any] = {}
    for light, shot in ORBIT.items():
        frame = cache.fetch_shot(shot, SCALE)[-1]
        assert isinstance(frame, SparseFrame)
        reference, cells = cache.fetch_mean(shot, shot.frames - 1)
        masks = select_bins(frame)
        share = {name: float(mask.mean()) for name, mask in masks.items()}

        def search(
            grid: Mapping[str, Sequence[Any]], starts: Sequence[Mapping[str, Any]] = STARTS, **fixed: Any
        ) -> dict[str, Any]:
            def evaluate(point: dict[str, Any]) -> float:
                return rel_mse(upsample(frame, **fixed, **point).image, reference)  # noqa: B023 - called at once

            point, tried = tune(evaluate, grid, starts)
            image = upsample(frame, **fixed, **point).image  # noqa: B023 - called at once
            return {**measure(image, reference, masks), "settings": point, "tried": tried}  # noqa: B023

        cells |= {"share": share, "bilinear": measure(upsample(frame, bilinear=True).image, reference, masks)}
        cells["normal (tuned)"] = search(GEOMETRY_GRID, similarity="normal")
        for similarity in ("ggx", "asg", "sg", "sg_mixture"):
            cells[similarity] = measure(upsample(frame, similarity=similarity).image, reference, masks)
            # The others begin where the first one ended.
            starts = [cells["ggx (tuned)"]["settings"]] if "ggx (tuned)" in cells else STARTS
            cells[f"{similarity} (tuned)"] = search(LOBE_GRID, starts, similarity=similarity)
        best = cells["ggx (tuned)"]["settings"]
        hits = upsample(frame, similarity="ggx", hit_distance=True, **best).image
        cells["ggx (tuned) with hits"] = measure(hits, reference, masks)
        default = upsample(frame)
        cells["default"] = {**measure(default.image, reference, masks), "settings": default.settings}
        geometry = cells["normal (tuned)"]
        cells["tuned_over_normal"] = cells["ggx (tuned)"]["rel_mse"] / geometry["rel_mse"]
        cells["tuned_over_normal_specular"] = cells["ggx (tuned)"]["rel_mse, specular"] / geometry["rel_mse, specular"]
        cells["default_over_normal"] = cells["default"]["rel_mse"] / geometry["rel_mse"]
        for name, value in cells.items():
            if isinstance(value, dict) and "rel_mse" in value:
                print(f"spatial {light:8} {name:22} {value['rel_mse']:.5f}  specular {value['rel_mse, specular']:.5f}")
        print(
            f"spatial {light:8} tuned ggx / tuned normal {cells['tuned_over_normal']:.3f}, specular "
            f"{cells['tuned_over_normal_specular']:.3f}; default / tuned normal {cells['default_over_normal']:.3f}",
            flush=True,
        )
        row[light] = cells
    return row


def list_spatial_settings(rows: Mapping[str, Any], light: str) -> dict[str, dict[str, Any]]:
    """Return the settings to run: the defaults, and those that `run_spatial` found if it ran."""
    settings: dict[str, dict[str, Any]] = {"default": {}}
    if "spatial" in rows:
        settings["tuned"] = rows["spatial"][light]["ggx (tuned)"]["settings"]
    return settings


def run_through(frames: Sequence[AnyFrame], **changes: Any) -> Iterator[Result]:
    """Yield the result of every frame of a sequence."""
    temporal = TemporalFilter(**changes)
    for frame in frames:
        yield temporal.add(frame)


def run_orbit(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """The same frame with the fifteen before it."""
    row: dict[str, Any] = {}
    for light, shot in ORBIT.items():
        frames = cache.fetch_shot(shot, SCALE)
        last = frames[-1]
        assert isinstance(last, SparseFrame)
        reference, cells = cache.fetch_mean(shot, shot.frames - 1)
        masks = select_bins(last)
        for name, changes in list_spatial_settings(rows, light).items():
            alone = measure(upsample(last, **changes).image, reference, masks)
            together = list(run_through(frames, **changes))[-1]
            over_time = measure(together.image, reference, masks)
            cells[name] = {
                "spatial": alone,
                "temporal": over_time,
                "history_share": together.settings["history_share"],
                "ratio": {key: over_time[key] / alone[key] for key in alone},
            }
            print(
                f"orbit {light:8} {name:8} spatial {alone['rel_mse']:.5f}  temporal {over_time['rel_mse']:.5f}  "
                f"ratio {cells[name]['ratio']['rel_mse']:.3f}",
                flush=True,
            )
        row[light] = cells
    return row


def run_adaptive(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """The least supported twentieth of the pixels shaded again with 64 samples."""
    light, spp = "indirect", 64
    shot = ORBIT[light]
    frames = cache.fetch_shot(shot, SCALE)
    last = frames[-1]
    assert isinstance(last, SparseFrame)
    reference, row = cache.fetch_mean(shot, shot.frames - 1)
    scene, cameras = shot.open()
    set_camera(scene, cameras[-1])
    results = {"spatial": upsample(last), "temporal": list(run_through(frames))[-1]}
    for name, result in results.items():
        mask = find_unsupported(result)
        begin = time.perf_counter()
        better = recompute(
            result,
            lambda y, x: render_pixels(scene, y, x, spp=spp, seed=9, light=light),
            samples=spp / SPP,
            frame=last,
        )
        seconds = time.perf_counter() - begin
        cells = {
            "share": float(mask.mean()),
            "masked_before": rel_mse(result.image, reference, mask),
            "masked_after": rel_mse(better.image, reference, mask),
            "all_before": rel_mse(result.image, reference),
            "all_after": rel_mse(better.image, reference),
            "samples_over_frame": float(mask.sum()) * spp / (last.radiance.color[..., 0].size * SPP),
            "seconds": round(seconds, 2),
        }
        cells["gain"] = cells["masked_before"] / cells["masked_after"]
        row[name] = cells
        print(
            f"adaptive {name:8} {100.0 * cells['share']:.1f} % of the pixels: {cells['masked_before']:.4f} -> "
            f"{cells['masked_after']:.4f} ({cells['gain']:.1f}x), all {cells['all_before']:.4f} -> "
            f"{cells['all_after']:.4f}; {cells['samples_over_frame']:.1f} times the frame's samples",
            flush=True,
        )
    return row


def run_still(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """Nothing moves and shading has no noise: after a turn through all places every pixel is its own sample."""
    path = cache.folder / "still-256.exr"
    if not path.exists():
        write_frame(path, render_frame(load_scene(SCENE, width=256, height=256), spp=64), half=False)
    frame = read_frame(path)
    black = np.zeros_like(frame.radiance.color)
    frame = replace(frame, variance=Radiance(black, diffuse=black, specular=black), half_a=None, half_b=None)
    truth = frame.radiance.color
    row: dict[str, Any] = {}
    for scale in (4, 3, 2):
        frames = [make_sparse(frame, scale, place) for place in list_places(scale)]
        cells = {}
        for name, turns in (("one turn", 1), ("four turns", 4)):
            image = list(run_through(frames * turns))[-1].image
            error = (np.abs(image - truth) / (truth + 0.01)).max(axis=-1)
            cells[name] = {"largest": float(error.max()), "share_above_0.001": float((error > 1e-3).mean())}
        row[f"{scale}x{scale}"] = cells
        print(f"still {scale}x{scale}: largest relative error {cells['one turn']['largest']:.2e}", flush=True)
    return row


def find_new(frames: Sequence[AnyFrame], index: int) -> Mask:
    """Return which pixels of a frame came into view in it."""
    now, before = frames[index], frames[index - 1]
    assert now.camera is not None
    assert before.camera is not None
    return find_disoccluded(now.gbuffer, now.camera, before.gbuffer, before.camera)


def find_changed_reflections(frames: Sequence[AnyFrame], index: int) -> Mask:
    """Return which mirrors that stand still see something else than in the frame before, at another distance."""
    guides, before = frames[index].gbuffer, frames[index - 1].gbuffer
    assert guides.alpha_u is not None
    assert guides.hit_distance is not None
    assert before.hit_distance is not None
    mirrors = find_specular_pixels(guides) & (guides.alpha_u < 0.1)
    near = np.minimum(guides.hit_distance, before.hit_distance)
    far = np.maximum(guides.hit_distance, before.hit_distance)
    return mirrors & (far > 1.2 * near) & find_still(frames, index)


def find_still(frames: Sequence[AnyFrame], index: int) -> Mask:
    """Return which pixels show a surface that did not move on the screen since the frame before."""
    motion = frames[index].gbuffer.motion
    assert motion is not None
    return np.asarray(np.hypot(motion[..., 0], motion[..., 1]) < 0.01)


def make_ghost_masks(frames: Sequence[AnyFrame], index: int) -> dict[str, Mask]:
    """Return the pixels where ghosts would be: what came into view some frames ago and was in view since."""
    masks = {}
    for name, find in (("surfaces", find_new), ("reflections", find_changed_reflections)):
        for age in (0, 1, 2):
            mask = find(frames, index - age) & find_still(frames, index - age)
            for later in range(index - age + 1, index + 1):
                mask &= find_still(frames, later) & ~find(frames, later)
            masks[f"{name}, {age} ago"] = mask
    return masks


def run_alone(frame: AnyFrame, **changes: Any) -> Result:
    """Return the result of a frame without history."""
    return upsample(frame, **changes) if isinstance(frame, SparseFrame) else denoise(frame, quality="fast", **changes)


def run_ghosting(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """Objects move before a still camera: errors where something came into view, over those without history.

    What the noise of the references adds is taken off.
    """
    row: dict[str, Any] = {"reference_spp": 2 * GHOST_SPP}
    for shot in GHOST_SHOTS:
        for scale in (SCALE, 1):
            frames = cache.fetch_shot(shot, scale)
            errors: dict[str, list[NDArray[np.float64]]] = {}
            for index, result in enumerate(run_through(frames)):
                if index < 9:
                    continue
                reference, half = cache.fetch_pair(shot, index, GHOST_SPP)
                images = (result.image, run_alone(frames[index]).image, half)
                maps = [make_error_map(image, reference) for image in images]
                everywhere = np.ones(frames[index].shape, dtype=bool)
                for name, mask in {**make_ghost_masks(frames, index), "all": everywhere}.items():
                    errors.setdefault(name, []).append(np.stack([each[mask] for each in maps]))
            cells = {}
            for name, found in errors.items():
                together = np.concatenate(found, axis=1)
                if together.shape[1]:
                    over_time, alone, noise = together.mean(axis=1, dtype=np.float64)
                    cells[name] = {
                        "pixels": together.shape[1],
                        "temporal": float(over_time - noise),
                        "alone": float(alone - noise),
                        "noise_of_reference": float(noise),
                        "ratio": float((over_time - noise) / (alone - noise)),
                    }
            name = f"pace {shot.pace:g}, " + (f"{scale}x{scale}" if scale > 1 else "whole frames")
            row[name] = cells
            for key, cell in cells.items():
                print(
                    f"ghosting {name:22} {key:20} {cell['pixels']:6} pixels  alone {cell['alone']:.4f}  temporal "
                    f"{cell['temporal']:.4f}  ratio {cell['ratio']:.2f}",
                    flush=True,
                )
    return row


def is_same(first: Result, second: Result) -> bool:
    """Return whether two results have the same bits."""
    names = ("image", "diffuse", "specular", "weight_sum", "effective_samples", "variance")
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)


def run_cut(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """A cut, told or not: the frames after it are those of a filter that never saw what was before."""
    scene = load_scene(SCENE, width=256, height=256)
    start = get_camera(scene)
    turned = Camera(position=(0.0, 2.0, 2.0), forward=(0.1, -0.1, 1.0), up=(0.0, 1.0, 0.0), fov_y=start.fov_y)
    aside = Camera(position=(-3.2, 1.6, 2.5), forward=(0.9, -0.25, -0.6), up=(0.0, 1.0, 0.0), fov_y=start.fov_y)
    other = load_scene("parlour", width=256, height=256)
    row: dict[str, Any] = {}
    for scale in (SCALE, 1):
        options: dict[str, Any] = {"spp": SPP, "scale": scale, "seed": 100}
        for place, scene_after, begin in (
            ("the wall behind", scene, turned),
            ("the same things from another side", scene, aside),
            ("another scene", other, get_camera(other)),
        ):
            before = list(render_sequence(scene, make_orbit(start, find_orbit_centre(scene), 8), **options))
            path = [start] * 8 + make_orbit(begin, begin.position + 3.0 * begin.forward, 4)
            after = list(render_sequence(scene_after, path, first=8, **options))
            expected = list(run_through(after))
            cells: dict[str, Any] = {}
            for name, cut in (("announced", True), ("unannounced", False)):
                temporal = TemporalFilter()
                for frame in before:
                    temporal.add(frame)
                results = [temporal.add(frame, cut=cut and not index) for index, frame in enumerate(after)]
                cells[name] = {
                    "same_bits": all(is_same(one, two) for one, two in zip(results, expected, strict=True)),
                    "history_share": results[0].settings["history_share"],
                }
            name = f"{place}, " + (f"{scale}x{scale}" if scale > 1 else "whole frames")
            row[name] = cells
            print(f"cut {name}: {cells}", flush=True)
    return row


def run_flicker(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """A slow orbit: how unlike the changes from frame to frame are to those of the references.

    The noise of the references flickers too, independently of the images: what it adds is taken off.
    """
    row: dict[str, Any] = {"reference_spp": 2 * FLICKER_SPP, "frames": FLICKERING.frames}
    for scale in (1, SCALE):
        frames = cache.fetch_shot(FLICKERING, scale)
        meters = {name: Flicker() for name in ("temporal", "alone", "reference")}
        errors: dict[str, list[float]] = {name: [] for name in meters}
        for index, result in enumerate(run_through(frames)):
            reference, half = cache.fetch_pair(FLICKERING, index, FLICKER_SPP)
            images = {"temporal": result.image, "alone": run_alone(frames[index]).image, "reference": half}
            for name, image in images.items():
                meters[name].add(image, reference)
                errors[name].append(rel_mse(image, reference))
        raw = {name: meter.get_mean() for name, meter in meters.items()}
        mean = {name: float(np.mean(each[8:])) for name, each in errors.items()}
        cells: dict[str, Any] = {"with_noise_of_reference": raw}
        for name in ("temporal", "alone"):
            cells[name] = raw[name] - raw["reference"]
            cells[f"rel_mse, {name}"] = mean[name] - mean["reference"]
        cells["ratio"] = cells["temporal"] / cells["alone"]
        name = f"{scale}x{scale}" if scale > 1 else "whole frames"
        row[name] = cells
        print(
            f"flicker {name:12} alone {cells['alone']:.5f}  temporal {cells['temporal']:.5f}  ratio "
            f"{cells['ratio']:.3f} (of the references {raw['reference']:.5f}); error {cells['rel_mse, alone']:.5f} -> "
            f"{cells['rel_mse, temporal']:.5f}",
            flush=True,
        )
    return row


@contextmanager
def watch(places: Mapping[str, tuple[Any, str]], spent: dict[str, float]) -> Iterator[None]:
    """Add up in ``spent`` the seconds within functions, given as module and name."""
    originals = {stage: getattr(*place) for stage, place in places.items()}

    def wrap(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            try:
                return function(*arguments, **options)
            finally:
                spent[stage] = spent.get(stage, 0.0) + time.perf_counter() - begin

        return timed

    for stage, (module, name) in places.items():
        setattr(module, name, wrap(stage, originals[stage]))
    try:
        yield
    finally:
        for stage, (module, name) in places.items():
            setattr(module, name, originals[stage])


def run_speed(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """1920x1080 from 480x270: time of a frame with history, by stage, beside upsampling without."""
    from lobewise.filters.runs import SampleGrid
    from lobewise.temporal import past, recipe

    places = {
        "layers": (recipe, "make_layers"),
        "marks": (past, "make_marks"),
        "places": (past, "_find_all_places"),
        "reprojection": (past, "run_reprojection"),
        "samples and trust": (SampleGrid, "join"),
    }

    def render() -> Frame:
        scene = load_scene(SCENE, width=1920, height=1080)
        return render_frame(scene, spp=SPP, aov_only=True, previous_camera=get_camera(scene))

    guides = fetch_frame(cache.folder / "guides-1080.exr", render)
    rng = np.random.default_rng(0)
    light = rng.exponential(1.0, (*guides.shape, 3)).astype(np.float32)
    assert guides.gbuffer.diffuse_albedo is not None
    assert guides.gbuffer.specular_albedo is not None
    parts = light * guides.gbuffer.diffuse_albedo, light * guides.gbuffer.specular_albedo
    whole = replace(guides, radiance=Radiance(parts[0] + parts[1], diffuse=parts[0], specular=parts[1]), spp=SPP)
    frames = [make_sparse(whole, SCALE, place) for place in list_places(SCALE)]
    row: dict[str, Any] = {}
    for similarity in ("normal", "sg", "ggx"):
        for radius in (2, 5):
            options: dict[str, Any] = {"similarity": similarity, "radius": radius}
            temporal = TemporalFilter(**options)
            for frame in frames[:3]:
                temporal.add(frame)
            best, best_spent = float("inf"), dict[str, float]()

            def add() -> None:
                nonlocal best, best_spent
                spent: dict[str, float] = {}
                with watch(places, spent):
                    begin = time.perf_counter()
                    temporal.add(frames[3])  # noqa: B023 - called at once
                    seconds = time.perf_counter() - begin
                if seconds < best:
                    best, best_spent = seconds, {**spent, "rest": seconds - sum(spent.values())}

            calls = {"alone": lambda: upsample(frames[3], **options), "temporal": add}  # noqa: B023 - called at once
            times = time_best(calls, 2.0)
            row[f"{similarity}, radius {radius}"] = {
                "alone_milliseconds": round(1e3 * times["alone"], 1),
                "temporal_milliseconds": round(1e3 * best, 1),
                "temporal_over_alone": round(best / times["alone"], 2),
                "stages_milliseconds": {stage: round(1e3 * value, 1) for stage, value in best_spent.items()},
            }
            print(f"speed {similarity}, radius {radius}: {row[f'{similarity}, radius {radius}']}", flush=True)
    return row


PARTS: dict[str, Callable[[Cache, dict[str, Any]], dict[str, Any]]] = {
    "spatial": run_spatial,
    "orbit": run_orbit,
    "adaptive": run_adaptive,
    "still": run_still,
    "ghosting": run_ghosting,
    "cut": run_cut,
    "flicker": run_flicker,
    "speed": run_speed,
}


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for frames and references")
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results" / "upsampling.json")
    parser.add_argument("--only", choices=tuple(PARTS), nargs="+", help="only these parts")
    parser.add_argument("--pieces", type=int, default=2, help="renders that make a reference of the orbit")
    arguments = parser.parse_args()
    cache = Cache(arguments.cache, arguments.pieces)
    rows: dict[str, Any] = {}
    if arguments.output.exists():
        rows = json.loads(arguments.output.read_text())["parts"]
    for name in arguments.only or PARTS:
        rows[name] = {**PARTS[name](cache, rows), "commit": describe_machine()["commit"]}
        write_json(
            arguments.output,
            {
                "what": "rel_mse (epsilon 0.01) of showroom at 4 spp per shaded pixel, one of 4x4 pixels shaded",
                "version": lobewise.__version__,
                "machine": describe_machine(),
                "grid": {"normal": GEOMETRY_GRID, "lobes": LOBE_GRID},
                "parts": {part: rows[part] for part in PARTS if part in rows},
            },
        )


if __name__ == "__main__":
    main()
