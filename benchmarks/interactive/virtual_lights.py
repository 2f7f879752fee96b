"""Measure what lobe-aware weights make of light that is not sampled by the BRDF, and how a band-limit helps.

Tokuyoshi 2015, slide "Limitations (2)": without importance sampling by the BRDF, as with instant radiosity, sharp lobes
show spikes instead of detail, and the narrow kernels of sharp lobes keep the spikes. This program renders indirect
light by virtual lights and denoises it with two band-limits of the lobes: the default, and the one that follows from
the number of lights. It compares both with paths and with the sum over all lights of the same set. It writes a JSON
file and the pictures of docs/virtual_lights.md.

    python -m benchmarks.interactive.virtual_lights --cache ~/.cache/lobewise-quality \\
        -o benchmarks/results/virtual_lights.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import ROOT, describe_machine, fetch_frame, write_json
from benchmarks.pictures.detail import join
from lobewise.denoising import denoise
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.frame import FloatArray, Frame, Radiance
from lobewise.io.png import encode_png
from lobewise.metrics import find_specular_pixels, rel_mse

SIZE = 512
PATHS = 1024
REFERENCE_SPP = 256
"""Samples of each of the two halves of a reference by paths. The halves tell the error of the reference."""

FILTER = {"form": "atrous"}
"""Spikes lie further apart than the usual radius, so that a window of this radius smears each to a block."""

GUIDE_SPP = 16
SHARP = 0.1
"""Alpha below which a specular lobe counts as sharp."""

TAUS = (0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)
CROPS = {"showroom": (slice(190, 446), slice(60, 316)), "brushed": (slice(150, 406), slice(120, 376))}

PANELS = ("one sample", "sg, default", "sg, limited", "all lights", "paths")
"""Images in the pictures, from left to right."""

BOX_COUNTS = (64, 256, 1024, 4096)
BOX_SIZE = 64
BOX_SPP = 2048


def open_scene(name: str, size: int) -> tuple[Any, Any]:
    """Return a scene and what its pixel centres see."""
    from lobewise.render import load_mitsuba, load_scene

    mi = load_mitsuba()
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.tracing.points import trace_points

    if name == "cornell box":
        items = mi.cornell_box()
        items["sensor"]["film"].update(width=size, height=size)
        scene = mi.load_dict(items)
    else:
        scene = load_scene(name, width=size, height=size)
    materials = read_scene_materials(scene)

    def look(pixels: FloatArray) -> Any:
        from lobewise.render.bridge import dr

        width = tuple(dr.opaque(mi.UInt32, size) for _ in range(2))
        return trace_points(scene, materials, mi.UInt32(pixels.astype(np.uint32)), width)

    return (scene, materials), look


def shade(look: Callable[[Any], Any], size: int, shading: Callable[[Any], Any]) -> Radiance:
    """Return the light at all pixel centres, some ten thousand of them at a time."""
    parts = []
    for pixels in np.array_split(np.arange(size**2), max(1, size**2 // 65536)):
        light = shading(look(pixels))
        parts.append([np.array(value).T for value in (light.diffuse, light.specular)])
    diffuse, specular = (np.concatenate(part).reshape(size, size, 3) for part in zip(*parts, strict=True))
    return Radiance(diffuse + specular, diffuse=diffuse, specular=specular)


def compute_errors(image: FloatArray, frame: Frame, references: Mapping[str, FloatArray]) -> dict[str, float]:
    """Return rel_mse against each reference, over all pixels, specular ones and sharp ones."""
    specular = find_specular_pixels(frame.gbuffer)
    assert frame.gbuffer.alpha_u is not None
    masks = {"all": None, "specular": specular, "sharp": specular & (frame.gbuffer.alpha_u < SHARP)}
    return {
        f"{name}, {where}": rel_mse(image, reference, mask)
        for name, reference in references.items()
        for where, mask in masks.items()
    }


def run_scene(name: str, cache: Path) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Return the figures of a scene, and its images."""
    from lobewise.render import render_frame
    from lobewise.render.tracing.paths import PathLight
    from lobewise.render.virtual_lights.instant_radiosity import VirtualLights, compute_sharpness_limit
    from lobewise.render.virtual_lights.point_walk import LIGHTS_PER_SAMPLE

    (scene, materials), look = open_scene(name, SIZE)
    method = VirtualLights(scene, materials, count=PATHS)
    guides = fetch_frame(
        cache / f"{name}-guides.exr", lambda: render_frame(scene, spp=GUIDE_SPP, seed=1, aov_only=True)
    )

    def fetch(which: str, shading: Callable[[Any], Any]) -> Frame:
        def render() -> Frame:
            return replace(guides, radiance=shade(look, SIZE, shading), half_a=None, half_b=None, variance=None, spp=1)

        return fetch_frame(cache / f"{name}-{which}.exr", render)

    paths = PathLight(scene, materials)

    def trace(seed: int) -> Callable[[Any], Any]:
        return lambda points: paths.shade(points, samples=REFERENCE_SPP, seed=seed)

    frame = fetch("one", lambda points: method.shade(points, samples=1, seed=0))
    whole = fetch("whole", lambda points: method.shade(points, samples=1, seed=0, all_lights=True)).radiance.color
    halves = [fetch(f"paths{suffix}", trace(seed)).radiance.color for suffix, seed in (("", 1000), ("-b", 2000))]
    truth = np.float32(0.5) * (halves[0] + halves[1])

    some = np.add.outer(np.arange(8, SIZE, 16) * SIZE, np.arange(8, SIZE, 16)).ravel()
    seen = method.count_lights_seen(look(some))
    tau = compute_sharpness_limit(seen)
    references = {"paths": truth, "all lights": whole}
    images = {"one sample": frame.radiance.color, "all lights": whole, "paths": truth}
    for similarity in ("sg", "ggx"):
        images[f"{similarity}, default"] = denoise(frame, quality="fast", similarity=similarity, **FILTER).image
        images[f"{similarity}, limited"] = denoise(
            frame, quality="fast", similarity=similarity, tau=tau, **FILTER
        ).image
    images["normal-aware"] = denoise(frame, quality="fast", similarity="normal", **FILTER).image
    images["sg, default, radius 8"] = denoise(frame, quality="fast", similarity="sg").image
    images["sg, limited, radius 8"] = denoise(frame, quality="fast", similarity="sg", tau=tau).image
    row: dict[str, Any] = {
        "lights": method.lights.number,
        "lights_per_pixel": LIGHTS_PER_SAMPLE,
        "lights_seen": seen,
        "tau": tau,
        "default_tau": denoise(frame, quality="fast", similarity="sg").settings["tau"],
        "reference_spp": 2 * REFERENCE_SPP,
        # The distance of a half from the mean of both estimates the distance of the mean from the truth.
        "reference_errors": compute_errors(halves[0], frame, {"paths": truth}),
        "errors": {key: compute_errors(image, frame, references) for key, image in images.items() if key != "paths"},
        "sweep": {
            similarity: {
                f"{value:g}": compute_errors(
                    denoise(frame, quality="fast", similarity=similarity, tau=value, **FILTER).image,
                    frame,
                    {"paths": references["paths"]},
                )
                for value in TAUS
            }
            for similarity in ("sg", "ggx")
        },
    }
    for key, errors in row["errors"].items():
        print(f"{name} {key:14}", "  ".join(f"{what} {value:.4f}" for what, value in errors.items()), flush=True)
    return row, images


def run_box() -> dict[str, Any]:
    """Return how the diffuse Cornell box comes near paths as the lights grow in number, all of them used."""
    from lobewise.render.tracing.paths import PathLight
    from lobewise.render.virtual_lights.instant_radiosity import VirtualLights

    (scene, materials), look = open_scene("cornell box", BOX_SIZE)
    paths = PathLight(scene, materials)
    truth = shade(look, BOX_SIZE, lambda points: paths.shade(points, samples=BOX_SPP, seed=1000)).color
    rows: dict[str, Any] = {}
    for count in BOX_COUNTS:
        row = {}
        for key, options in {
            "clamp 0.05": {"clamp": 0.05},
            "clamp 0.01": {"clamp": 0.01},
            "clamp 0.05, compensated": {"clamp": 0.05, "compensate": True},
            "spheres of 0.05": {"radius": 0.05},
        }.items():
            method = VirtualLights(scene, materials, count=count, **options)
            samples = 64 if "compensate" in options else 1

            def light(points: Any, method: Any = method, samples: int = samples) -> Any:
                return method.shade(points, samples=samples, seed=0, all_lights=samples == 1)

            image = shade(look, BOX_SIZE, light).color
            row[key] = {"mean": float(image.mean() / truth.mean()), "rel_mse": rel_mse(image, truth)}
        rows[str(count)] = row
        print("cornell box", count, row, flush=True)
    return {"reference_spp": BOX_SPP, "counts": rows}


def run_speed() -> dict[str, Any]:
    """Return the milliseconds of the indirect light of 128x128 pixels of 512x512, and of tracing the lights."""
    from lobewise.render import load_scene
    from lobewise.render.stages import Stages
    from lobewise.render.virtual_lights.instant_radiosity import VirtualLights

    row: dict[str, Any] = {}
    rows, columns = (part.ravel() for part in np.indices((SIZE // 4, SIZE // 4)) * 4)
    for name in CROPS:
        stages = Stages(load_scene(name, width=SIZE, height=SIZE))
        method = VirtualLights(stages.scene, stages.materials, count=PATHS)
        spent: dict[str, list[float]] = {"update": [], "shade": [], "shade_cpu": []}
        for seed in range(32):
            begin = time.perf_counter()
            method.update()
            spent["update"].append(time.perf_counter() - begin)
            begin, cpu = time.perf_counter(), time.process_time()
            stages.shade_indirect(method, rows, columns, 1, seed)
            spent["shade"].append(time.perf_counter() - begin)
            spent["shade_cpu"].append(time.process_time() - cpu)
        row[name] = {key: round(1e3 * min(values[2:]), 1) for key, values in spent.items()}
        print("speed", name, row[name], flush=True)
    return row


def write_picture(name: str, images: Mapping[str, FloatArray]) -> None:
    """Write a row of crops: see `PANELS`."""
    exposure = choose_exposure(images["paths"])
    row = join([map_tones(images[key], exposure)[CROPS[name]] for key in PANELS], 1)
    target = ROOT / "docs" / "images" / f"virtual-lights-{name}.png"
    target.write_bytes(encode_png(np.ascontiguousarray(row)))
    print(f"{target}: {row.shape[1]}x{row.shape[0]}, {target.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for frames and references")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "benchmarks" / "results" / "virtual_lights.json")
    parser.add_argument("--only", choices=("scenes", "box", "speed"), nargs="+", help="only these parts")
    arguments = parser.parse_args()
    cache = arguments.cache / "virtual_lights"
    cache.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = json.loads(arguments.output.read_text()) if arguments.output.exists() else {}
    results |= {
        "what": "rel_mse (epsilon 0.01) of indirect light by virtual lights, 512x512, one sample per pixel",
        "version": lobewise.__version__,
        "machine": describe_machine(),
    }
    chosen = arguments.only or ("scenes", "box", "speed")
    if "scenes" in chosen:
        results["scenes"] = {}
        for name in CROPS:
            results["scenes"][name], images = run_scene(name, cache)
            write_picture(name, images)
            write_json(arguments.output, results)
    if "box" in chosen:
        results["box"] = run_box()
    if "speed" in chosen:
        results["speed"] = run_speed()
    write_json(arguments.output, results)


if __name__ == "__main__":
    main()
