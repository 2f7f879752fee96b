"""Measure clusters of virtual lights against point lights and paths, at equal time, before and after the filter.

Cornell boxes with copper and aluminium, and built-in scenes, under a camera that moves by half a degree a frame. Each
other method takes as many samples as fill the time of one sample of clusters, rounded up. Errors are of indirect light
alone, against paths.

    python -m benchmarks.interactive.clusters --cache ~/.cache/lobewise-quality \\
        -o benchmarks/results/virtual_light_clusters.json
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import RESULTS, ROOT, describe_machine, write_json
from benchmarks.pictures.detail import join
from lobewise.camera import Camera
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.frame import FloatArray
from lobewise.interactive import InteractiveSettings, Session
from lobewise.io.exr import read_image, write_image
from lobewise.io.png import encode_png
from lobewise.metrics import find_specular_pixels, rel_mse
from lobewise.render import find_orbit_centre, load_mitsuba, load_scene, make_orbit

SIZE = 256
SPACING = 2
"""Distance of the pixels whose shading is timed: 128x128 of them."""
FRAMES = 8
DEGREES_PER_FRAME = 0.5
REFERENCE_SPP = 512
"""Samples of each of the two halves of a reference. The halves tell the error of the reference."""
SEEDS = 3
TIMINGS = 24

METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "paths": ("paths", {}),
    "points": ("virtual_lights", {"kind": "points"}),
    "clusters": ("virtual_lights", {"kind": "gaussians"}),
}
"""Method of the session and its options, by name."""
BOXES = {"copper, alpha 0.12": 0.12, "aluminium, alpha 0.03": 0.03, "aluminium, alpha 0.12": 0.12}
"""Cornell boxes, and the alpha of the metal in them."""
SCENES = (*BOXES, "showroom", "brushed", "parlour", "corridor", "kitchen")
STAGES = ("not filtered", "one frame", "eighth frame")
PARTS = ("all", "glossy")
"""Pixels whose errors are measured."""


def open_scene(name: str) -> Any:
    """Return a scene with an image of `SIZE` squared."""
    mi = load_mitsuba()
    if name not in BOXES:
        return load_scene(name, width=SIZE, height=SIZE)
    items = mi.cornell_box()
    items["sensor"]["film"].update(width=SIZE, height=SIZE)
    metal = {"type": "roughconductor", "alpha": BOXES[name], "distribution": "ggx"}
    metal["material"] = "Cu" if "copper" in name else "Al"
    items["large-box"]["bsdf"] = metal
    if "copper" in name:
        items["small-box"] = {"type": "sphere", "center": [0.33, -0.65, 0.38], "radius": 0.35, "bsdf": metal}
    else:
        items["small-box"]["bsdf"] = metal
    return mi.load_dict(items)


def open_session(scene: Any, name: str, seed: int = 0) -> Session:
    """Return a session for one of the `METHODS`, ready to render."""
    method, options = METHODS[name]
    session = Session(scene, width=SIZE, height=SIZE, options={method: options}, seed=seed)
    session.prepare(method)
    return session


def fetch_reference(scene: Any, camera: Camera, cache: Path, name: str) -> tuple[FloatArray, float]:
    """Return indirect light of every pixel by paths, and the error that its noise adds to others."""
    settings = InteractiveSettings(method="paths", scale=1, similarity="none", spp=REFERENCE_SPP, adaptive=0.0)
    halves = []
    for seed in (1000, 2000):
        path = cache / f"{name.replace(', alpha', '').replace(' ', '-')}-{seed}.exr"
        if not path.exists():
            session = Session(scene, width=SIZE, height=SIZE, seed=seed)
            write_image(path, session.render(camera, settings).get_view("indirect"))
        halves.append(read_image(path))
    truth = np.float32(0.5) * (halves[0] + halves[1])
    # The distance of a half from the mean of both estimates the distance of the mean from the truth.
    return truth, rel_mse(halves[0], truth)


def time_samples(sessions: Mapping[str, Session]) -> dict[str, float]:
    """Return the time that one sample of `METHODS` takes at 128x128 pixels, milliseconds of all threads together.

    Methods take turns, and the shortest of `TIMINGS` counts, because the machine may have other work.
    """
    rows, columns = (part.ravel() for part in np.indices((SIZE // SPACING, SIZE // SPACING)) * SPACING)
    spent: dict[str, list[float]] = {name: [] for name in sessions}
    for seed in range(TIMINGS + 2):
        for name, session in sessions.items():
            stages, method = session._stages, session._methods.get(METHODS[name][0])
            stages.place_camera(session.camera, SIZE, SIZE)
            begin = time.process_time()
            stages.shade_indirect(method, rows, columns, 1, seed)
            spent[name].append(time.process_time() - begin)
    return {name: round(1e3 * min(values[2:]), 2) for name, values in spent.items()}


def time_update(session: Session) -> float:
    """Return the time of tracing the lights and joining them to clusters, milliseconds of all threads together."""
    method: Any = session._methods.get("virtual_lights")
    spent = []
    for _ in range(3):
        begin = time.process_time()
        method.update()
        spent.append(time.process_time() - begin)
    return round(1e3 * min(spent), 1)


def compute_errors(image: FloatArray, truth: FloatArray, glossy: Any) -> dict[str, float]:
    """Return rel_mse over all pixels and over glossy ones."""
    return {"all": rel_mse(image, truth), "glossy": rel_mse(image, truth, glossy)}


def render_stages(session: Session, method: str, cameras: list[Camera], samples: int) -> tuple[dict[str, Any], Any]:
    """Return indirect light of the last camera by `STAGES`, and the guides."""
    usual = InteractiveSettings(method=METHODS[method][0], spp=samples)  # type: ignore[arg-type]
    plain = {"scale": 1, "similarity": "none", "adaptive": 0.0}
    images: dict[str, Any] = {}
    for stage, changes, path in (
        ("not filtered", plain, cameras[-1:]),
        ("one frame", {"temporal": False}, cameras[-1:]),
        ("eighth frame", {}, cameras),
    ):
        settings = InteractiveSettings(**{**usual.__dict__, **changes})
        frame = list(session.make_sibling().frames(path, settings))[-1]
        images[stage] = frame.get_view("indirect")
    return images, frame.parts.hits.gbuffer


def run_scene(name: str, cache: Path) -> tuple[dict[str, Any], dict[str, dict[str, FloatArray]]]:
    """Return the figures of a scene, and its images by method and stage."""
    scene = open_scene(name)
    sessions = {method: open_session(scene, method) for method in METHODS}
    camera = sessions["paths"].camera
    cameras = make_orbit(camera, find_orbit_centre(scene), FRAMES, DEGREES_PER_FRAME)
    truth, noise = fetch_reference(scene, cameras[-1], cache, name)
    times = time_samples(sessions)
    samples = {method: math.ceil(times["clusters"] / spent) for method, spent in times.items()}
    row: dict[str, Any] = {"milliseconds": times, "samples": samples, "reference_error": noise, "errors": {}}
    row["update_milliseconds"] = {method: time_update(sessions[method]) for method in ("points", "clusters")}
    pictures: dict[str, dict[str, FloatArray]] = {"reference": dict.fromkeys(STAGES, truth)}
    for method in METHODS:
        found: dict[str, dict[str, list[float]]] = {stage: {part: [] for part in PARTS} for stage in STAGES}
        means = []
        for seed in range(SEEDS):
            session = open_session(scene, method, seed) if seed else sessions[method]
            images, guides = render_stages(session, method, cameras, samples[method])
            for stage, image in images.items():
                for part, error in compute_errors(image, truth, find_specular_pixels(guides)).items():
                    found[stage][part].append(error)
            pictures.setdefault(method, images)
            means.append(images["not filtered"].mean() / truth.mean())
        errors = {
            stage: {part: float(np.mean(values)) for part, values in parts.items()} for stage, parts in found.items()
        }
        row["errors"][method] = {**errors, "brightness": float(np.mean(means))}
        told = "  ".join(f"{stage} {parts['all']:.4f} {parts['glossy']:.4f}" for stage, parts in errors.items())
        print(f"{name:22} {method:9} {times[method]:6.1f} ms x {samples[method]}  {told}", flush=True)
    return row, pictures


def write_picture(name: str, pictures: Mapping[str, Mapping[str, FloatArray]]) -> None:
    """Write point lights, clusters, paths and the reference, side by side: not filtered, and below the eighth frame."""
    exposure = choose_exposure(pictures["reference"]["one frame"])
    shown = ("points", "clusters", "paths", "reference")
    stages = ("not filtered", "eighth frame")
    picture = join([join([map_tones(pictures[key][each], exposure) for key in shown], 1) for each in stages], 0)
    target = ROOT / "docs" / "images" / f"virtual-light-clusters-{name.replace(', alpha ', '-').replace('.', '')}.png"
    target.write_bytes(encode_png(np.ascontiguousarray(picture)))
    print(f"{target}: {picture.shape[1]}x{picture.shape[0]}, {target.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for references")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "virtual_light_clusters.json")
    parser.add_argument("scenes", nargs="*", help="only these scenes")
    arguments = parser.parse_args()
    cache = arguments.cache / "virtual_light_clusters"
    cache.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = json.loads(arguments.output.read_text()) if arguments.output.exists() else {}
    results |= {
        "what": "rel_mse (epsilon 0.01) of indirect light, 256x256, each method at the time of clusters",
        "version": lobewise.__version__,
        "machine": describe_machine(),
        "reference_spp": 2 * REFERENCE_SPP,
        "seeds": SEEDS,
    }
    results.setdefault("scenes", {})
    for name in arguments.scenes or SCENES:
        results["scenes"][name], pictures = run_scene(name, cache)
        if name in (*BOXES, "brushed"):
            write_picture(name, pictures)
        write_json(arguments.output, results)


if __name__ == "__main__":
    main()
