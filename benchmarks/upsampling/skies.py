"""Errors of upsampling on scenes with lamps and skies in view, on which nothing was tuned.

    python -m benchmarks.upsampling.skies --cache FOLDER

Five scenes are made in code: Mitsuba's Cornell box with glossy boxes, and balls of copper, plastic, brushed aluminium
and glass on tiles under a sky with clouds and a sun. One of 4x4 pixels has radiance of 4 samples, all have guides; the
camera moves by half a degree a frame. The last of eight frames is compared with its reference: pixels that show more
unscattered than scattered light, and all others. Frames and references are rendered on first use, in some minutes.
Pixels that are shaded again are rendered anew, with other random numbers than those of the frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lobewise
from benchmarks.common import RESULTS, ROOT, describe_machine, write_json
from benchmarks.pictures.detail import join
from lobewise.adaptive import Shade, choose_spp
from lobewise.camera import Camera
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.frame import FloatArray, Frame, Radiance, Result
from lobewise.io.exr import read_image, write_image
from lobewise.io.png import encode_png
from lobewise.sparse_frame import SparseFrame, list_places, make_sparse

Item = dict[str, Any]
SIZE_PIXELS, FRAMES, SPP, SCALE, DEGREES = 256, 8, 4, 4, 0.5
REFERENCE_SPP, REFERENCE_SEED, AGAIN_SEED = 2048, 999, 5000
BUDGET = 0.05
AGAIN_SPP, PARTS = choose_spp(BUDGET), 8
"""Samples of each pixel that is shaded again, and the parts of these samples."""
TRIED_SPP = (4, 16, 32, 64, 128, 256)
BRUSHED = (0.05, 0.25)
"""Alpha along and across the brush."""
PICTURE = ROOT / "docs" / "images" / "skies.png"
SHOWN = ("bilinear", "one frame", "over time", "over time, 5 % again")


def make_sky(rows: int = 128) -> FloatArray:
    """Return a sky with a few clouds and a sun above brown ground, (rows, 2 rows, 3)."""
    down, across = np.mgrid[0:rows, 0 : 2 * rows]
    v, u = (down + 0.5) / rows, (across + 0.5) / (2 * rows)
    blue = np.array([0.25, 0.4, 0.8]) * (0.4 + 1.6 * v[..., None]) + 0.05
    sky = np.where(v[..., None] < 0.5, blue, np.array([0.125, 0.1, 0.075]))
    clouds = np.clip(2.0 * np.sin(40.0 * u) * np.sin(57.0 * v + 13.0 * u) - 0.8, 0.0, 1.0) * (v < 0.5)
    sky = sky + 0.8 * clouds[..., None]
    sky[4.0 * (u - 0.3) ** 2 + (v - 0.25) ** 2 < 4e-4] = 300.0
    return np.asarray(sky, np.float32)


def make_film() -> Item:
    """Return a film with the box filter."""
    return {"type": "hdrfilm", "width": SIZE_PIXELS, "height": SIZE_PIXELS, "rfilter": {"type": "box"}}


def load_cornell(mi: Any) -> Any:
    """Return Mitsuba's Cornell box with a copper and a plastic box."""
    scene = mi.cornell_box()
    scene["sensor"]["film"] = make_film()
    scene["small-box"]["bsdf"] = make_copper(1)
    scene["large-box"]["bsdf"] = make_plastic(1)
    return mi.load_dict(scene)


def load_balls(mi: Any, make_material: Callable[[int], Item]) -> Any:
    """Return three balls on tiles under the sky."""
    place = mi.ScalarTransform4f
    tiles = {"type": "checkerboard", "to_uv": place().scale([8, 8, 1]), "color0": 0.2, "color1": 0.6}
    view = place().look_at([0, -6, 1.6], [0, 0, 0.8], [0, 0, 1])
    scene: Item = {
        "type": "scene",
        "integrator": {"type": "path"},
        "sensor": {"type": "perspective", "fov": 45, "to_world": view, "film": make_film()},
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(make_sky()), "to_world": place().rotate([1, 0, 0], 90)},
        "floor": {
            "type": "disk",
            "to_world": place().scale(5),
            "bsdf": {"type": "twosided", "tiles": {"type": "diffuse", "reflectance": tiles}},
        },
    }
    for number, (x, y, radius) in enumerate(((-1.6, 0.0, 0.8), (0.2, 0.6, 1.0), (1.9, -0.4, 0.6))):
        ball = {"type": "sphere", "center": [x, y, radius], "radius": radius, "bsdf": make_material(number)}
        scene[f"ball{number}"] = ball
    return mi.load_dict(scene)


def make_copper(number: int) -> Item:
    """Return copper, from nearly a mirror to satin."""
    return {"type": "roughconductor", "material": "Cu", "alpha": (0.03, 0.12, 0.3)[number], "distribution": "ggx"}


def make_plastic(number: int) -> Item:
    """Return plastic of three colours."""
    colors = ([0.6, 0.2, 0.1], [0.1, 0.4, 0.6], [0.5, 0.5, 0.5])
    color = {"type": "rgb", "value": colors[number]}
    return {"type": "roughplastic", "alpha": (0.03, 0.1, 0.25)[number], "diffuse_reflectance": color}


def make_brushed(number: int) -> Item:
    """Return brushed aluminium, brushed around, along, and finely."""
    along, across = (BRUSHED, BRUSHED[::-1], (0.02, 0.1))[number]
    metal = {"type": "roughconductor", "material": "Al", "distribution": "ggx"}
    return metal | {"alpha_u": along, "alpha_v": across}


def make_glass(number: int) -> Item:
    """Return clear glass, rough glass and a mirror."""
    rough = {"type": "roughdielectric", "alpha": 0.1, "distribution": "ggx"}
    return ({"type": "dielectric"}, rough, {"type": "conductor", "material": "Ag"})[number]


SCENES: dict[str, Callable[[Any], Any]] = {
    "Cornell box": load_cornell,
    "copper": lambda mi: load_balls(mi, make_copper),
    "plastic": lambda mi: load_balls(mi, make_plastic),
    "brushed aluminium": lambda mi: load_balls(mi, make_brushed),
    "glass and mirror": lambda mi: load_balls(mi, make_glass),
}


@dataclass(frozen=True)
class Shot:
    """The frames of a scene with their cameras, and the reference of the last."""

    frames: list[Frame]
    reference: FloatArray
    scene: Any
    cameras: list[Camera]

    @property
    def sparse(self) -> list[SparseFrame]:
        """The frames, each shaded at another pixel of every block."""
        places = list_places(SCALE)
        return [make_sparse(frame, SCALE, places[k % len(places)]) for k, frame in enumerate(self.frames)]

    def make_shade(self, number: int, spp: int) -> Shade:
        """Return what renders pixels of a frame, by its number."""
        from lobewise.render import render_pixels, set_camera

        def shade(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Radiance:
            set_camera(self.scene, self.cameras[number])
            seed = AGAIN_SEED + number % FRAMES
            return render_pixels(self.scene, rows, columns, spp=spp, seed=seed, parts=min(PARTS, spp))

        return shade


def load_shot(folder: Path, name: str) -> Shot:
    """Return the frames and the reference of a scene; render what the folder lacks."""
    from lobewise.render import (
        find_orbit_centre,
        get_camera,
        load_mitsuba,
        make_orbit,
        render_reference,
        render_sequence,
        set_camera,
    )

    stem = folder / name.replace(" ", "-")
    paths = [stem.with_name(f"{stem.name}-{k}.exr") for k in range(FRAMES)]
    reference = stem.with_name(f"{stem.name}-reference.exr")
    scene = SCENES[name](load_mitsuba())
    path = make_orbit(get_camera(scene), find_orbit_centre(scene), frames=FRAMES, degrees_per_frame=DEGREES)
    if not (reference.exists() and all(path.exists() for path in paths)):
        folder.mkdir(parents=True, exist_ok=True)
        for target, frame in zip(paths, render_sequence(scene, path, spp=SPP, seed=1), strict=True):
            assert isinstance(frame, Frame)
            lobewise.write_frame(target, frame)
        set_camera(scene, path[-1])
        write_image(reference, render_reference(scene, spp=REFERENCE_SPP, seed=REFERENCE_SEED).radiance.color)
    frames = [lobewise.read_frame(path, light_passes=False) for path in paths]
    return Shot(frames, read_image(reference), scene, path)


def run_over_time(shot: Shot, **settings: Any) -> Result:
    """Return the last frame with the history of the others."""
    temporal = lobewise.TemporalFilter(**settings)
    return [temporal.add(frame) for frame in shot.sparse][-1]


def shade_again(
    shot: Shot, result: Result, number: int = -1, history: lobewise.TemporalFilter | None = None, spp: int = AGAIN_SPP
) -> tuple[Result, NDArray[np.bool_]]:
    """Return a result whose most uncertain pixels were rendered again, and these pixels; ``number`` is its frame's."""
    frame, shade = shot.sparse[number], shot.make_shade(number, spp)
    chosen = lobewise.find_unsupported(result, frame=frame, budget=BUDGET)
    again = lobewise.recompute(result, shade, samples=spp / SPP, frame=frame, budget=BUDGET, history=history)
    return again, chosen


def run_with_memory(shot: Shot, *, keeps: bool) -> tuple[FloatArray, float]:
    """Return the last frame after 5 % were shaded again in every frame, and the share that the frame before had chosen.

    ``keeps`` says whether what is shaded again enters the history.
    """
    temporal, before, repeats = lobewise.TemporalFilter(), None, []
    for number, frame in enumerate(shot.sparse):
        again, chosen = shade_again(shot, temporal.add(frame), number, temporal if keeps else None)
        if before is not None:
            repeats.append(np.count_nonzero(chosen & before) / max(np.count_nonzero(chosen), 1))
        before = chosen
    return again.image, float(np.mean(repeats))


def measure_shot(shot: Shot) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Return the errors of every method, and the images."""
    last, reference = shot.sparse[-1], shot.reference
    emission = shot.frames[-1].gbuffer.mean_emission
    assert emission is not None
    shining = emission.sum(axis=-1) > 0.5 * reference.sum(axis=-1)
    over_time = run_over_time(shot)
    again, chosen = shade_again(shot, over_time)
    (_, repeats), (kept, fewer) = (run_with_memory(shot, keeps=each) for each in (False, True))
    images = {
        "bilinear": lobewise.upsample(last, bilinear=True).image,
        "normals, one frame": lobewise.upsample(last, similarity="normal").image,
        "one frame": lobewise.upsample(last).image,
        "normals, over time": run_over_time(shot, similarity="normal").image,
        "over time": over_time.image,
        "over time, 5 % again": again.image,
        "5 % again, kept": kept,
    }
    cells = {}
    for name, image in images.items():
        apart = measure_error(image, reference)
        cells[name] = {
            "all": _round(apart.mean()),
            "lamps and sky": _round(apart[shining].mean()),
            "surfaces": _round(apart[~shining].mean()),
        }
    apart = measure_error(over_time.image, reference)
    held = {
        "share of the error": _round(apart[chosen].sum() / apart.sum()),
        "error before": _round(apart[chosen].mean()),
        "error after": _round(measure_error(again.image, reference)[chosen].mean()),
        "error after, by spp": {str(spp): measure_after(shot, over_time, chosen, spp) for spp in TRIED_SPP},
        "repeats": _round(repeats),
        "repeats, kept": _round(fewer),
    }
    return {"errors": cells, "shaded again": held, "share of lamps and sky": _round(shining.mean())}, images


def measure_after(shot: Shot, result: Result, chosen: NDArray[np.bool_], spp: int) -> float:
    """Return the error of the chosen pixels of the last frame after they are shaded again."""
    again, _ = shade_again(shot, result, spp=spp)
    return _round(measure_error(again.image, shot.reference)[chosen].mean())


def measure_error(image: FloatArray, reference: FloatArray) -> FloatArray:
    """Return the squared relative error of every pixel, (height, width)."""
    return np.asarray(((image - reference) ** 2 / (reference**2 + 0.01)).mean(axis=-1))


def _round(value: Any) -> float:
    return float(f"{float(value):.4g}")


def main() -> None:
    """Measure every scene, write the JSON and docs/images/skies.png."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for frames and references")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "skies.json")
    asked = parser.parse_args()
    scenes, rows = {}, []
    for name in SCENES:
        shot = load_shot(asked.cache, name)
        scenes[name], images = measure_shot(shot)
        print(name, {method: cells["all"] for method, cells in scenes[name]["errors"].items()}, flush=True)
        exposure = choose_exposure(shot.reference)
        shown = [*(images[each] for each in SHOWN), shot.reference]
        rows.append(join([map_tones(image, exposure) for image in shown], 1))
    PICTURE.write_bytes(encode_png(np.ascontiguousarray(join(rows, 0))))
    again = {"share": BUDGET, "spp": AGAIN_SPP, "parts": PARTS}
    write_json(asked.output, {"scenes": scenes, "shaded again": again, "machine": describe_machine()})


if __name__ == "__main__":
    main()
