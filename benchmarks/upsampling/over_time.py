"""Sequences: an orbit, shading again, still frames, ghosts, cuts and flicker."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.upsampling.errors import (
    make_ghost_masks,
    measure,
    select_bins,
)
from benchmarks.upsampling.shots import (
    FLICKER_SPP,
    FLICKERING,
    GHOST_SHOTS,
    GHOST_SPP,
    ORBIT,
    SCALE,
    SCENE,
    SPP,
    Cache,
)
from benchmarks.upsampling.spatial import (
    list_spatial_settings,
)
from lobewise import TemporalFilter
from lobewise.adaptive import find_unsupported, recompute
from lobewise.camera import Camera
from lobewise.denoising import denoise
from lobewise.frame import Radiance, Result
from lobewise.io.exr import read_frame, write_frame
from lobewise.metrics import Flicker, make_error_map, rel_mse
from lobewise.render import (
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
