"""Write the pictures of docs/gallery.md, each a row of panels, and the errors that stand under them.

python -m benchmarks.pictures.gallery --cache ~/.cache/lobewise-quality brushed plastic measured \\
    upsampling chain animation
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import ROOT, describe_machine, fetch_frame, fetch_image, write_json
from benchmarks.pictures import merl_bsdf
from benchmarks.quality.similarities import fetch, fetch_reference, mark_anisotropic
from benchmarks.upsampling.over_time import run_alone, run_through
from benchmarks.upsampling.shots import FLICKER_SPP, FLICKERING, ORBIT, SCALE, Cache
from lobewise.adaptive import recompute
from lobewise.denoising import denoise
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.frame import FloatArray, Frame, Radiance
from lobewise.io.materials import read_merl
from lobewise.io.png import encode_png
from lobewise.metrics import Flicker, rel_mse
from lobewise.render import render_frame, render_pixels, render_reference, set_camera
from lobewise.sparse_frame import SparseFrame, make_sparse
from lobewise.upsampling import upsample

RESULT = ROOT / "benchmarks" / "results" / "gallery.json"
GAP = 6
SPP = 4
MEASURED_SIZE = 384
MEASURED_SPP = 16
UPSAMPLING_SPP = 16
CHAIN_ADAPTIVE_SPP = 64
MEASURED_REFERENCE_SPP = 2048


def write_row(name: str, images: list[FloatArray], crop: tuple[slice, slice], zoom: int = 1) -> None:
    """Write docs/images/NAME.png: crops side by side, the last one is the reference."""
    exposure = choose_exposure(images[-1])
    panels = [map_tones(image, exposure)[crop] for image in images]
    panels = [panel.repeat(zoom, axis=0).repeat(zoom, axis=1) for panel in panels]
    gap = np.full((panels[0].shape[0], GAP, 3), 255, dtype=np.uint8)
    row = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    target = ROOT / "docs" / "images" / f"{name}.png"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(encode_png(np.ascontiguousarray(row)))
    print(f"{target}: {row.shape[1]}x{row.shape[0]}, {target.stat().st_size / 1e3:.0f} kB")


def make_brushed(arguments: argparse.Namespace) -> dict[str, Any]:
    """Brushed metal: noisy, `sg`, `asg`, `ggx`, reference."""
    frame, reference = fetch(arguments.cache, "brushed", SPP), fetch_reference(arguments.cache, "brushed")
    brushed = mark_anisotropic(frame)
    images = {name: denoise(frame, quality="fast", similarity=name).image for name in ("sg", "asg", "ggx")}
    write_row("brushed", [frame.radiance.color, *images.values(), reference], (slice(210, 450), slice(40, 280)))
    return {name: {"rel_mse": rel_mse(image, reference, brushed)} for name, image in images.items()}


def make_plastic(arguments: argparse.Namespace) -> dict[str, Any]:
    """Plastic in one radiance: noisy, one lobe, mixture of specular and diffuse lobes, reference."""
    apart, reference = fetch(arguments.cache, "parlour", SPP), fetch_reference(arguments.cache, "parlour")
    frame = apart.with_changes(radiance=Radiance(color=apart.radiance.color), variance=None)
    images = {name: denoise(frame, quality="fast", similarity=name).image for name in ("normal", "sg", "sg_mixture")}
    write_row(
        "plastic",
        [frame.radiance.color, images["sg"], images["sg_mixture"], reference],
        (slice(175, 295), slice(180, 340)),
        zoom=2,
    )
    return {name: {"rel_mse": rel_mse(image, reference)} for name, image in images.items()}


def fetch_measured(arguments: argparse.Namespace) -> tuple[Frame, FloatArray]:
    """Return frame and reference of the measured materials, rendered once."""
    noisy, clean = arguments.cache / f"measured-{MEASURED_SPP}.exr", arguments.cache / "measured-reference.exr"
    materials = merl_bsdf.make_materials()
    if arguments.material:
        materials = tuple(read_merl(path) for path in arguments.material)
        noisy, clean = (path.with_stem(path.stem + "-own") for path in (noisy, clean))
    frame = fetch_frame(
        noisy, lambda: render_frame(merl_bsdf.make_scene(materials, MEASURED_SIZE), spp=MEASURED_SPP, seed=1)
    )
    reference = fetch_image(
        clean,
        lambda: render_reference(merl_bsdf.make_scene(materials, MEASURED_SIZE), spp=MEASURED_REFERENCE_SPP, seed=1000),
    )
    return frame, reference


def make_measured(arguments: argparse.Namespace) -> dict[str, Any]:
    """Tabulated materials: noisy, `normal`, `sg_mixture` by their tables, `ggx` by equivalent alphas, reference."""
    frame, reference = fetch_measured(arguments)
    assert frame.gbuffer.material is not None
    measured = frame.gbuffer.material > 0
    images = {
        name: denoise(frame, quality="fast", similarity=name).image
        for name in ("normal", "sg", "sg_mixture", "asg", "ggx")
    }
    write_row(
        "measured",
        [frame.radiance.color, images["normal"], images["sg_mixture"], images["ggx"], reference],
        (slice(60, 315), slice(40, 340)),
    )
    return {name: {"rel_mse": rel_mse(image, reference, measured)} for name, image in images.items()}


def make_upsampling(arguments: argparse.Namespace) -> dict[str, Any]:
    """One of 4x4 pixels shaded: bilinear, `normal`, default, reference."""
    frame, reference = fetch(arguments.cache, "showroom", UPSAMPLING_SPP), fetch_reference(arguments.cache, "showroom")
    sparse = make_sparse(frame, 4, (1, 2))
    images = {
        "bilinear": upsample(sparse, bilinear=True).image,
        "normal": upsample(sparse, similarity="normal").image,
        "ggx": upsample(sparse).image,
    }
    write_row("upsampling", [*images.values(), reference], (slice(140, 440), slice(190, 490)))
    return {name: {"rel_mse": rel_mse(image, reference)} for name, image in images.items()}


def make_chain(arguments: argparse.Namespace) -> dict[str, Any]:
    """The chain of the paper: shaded, geometry-aware, lobe-aware, over time, with pixels shaded again; reference."""
    cache = Cache(arguments.cache, arguments.pieces)
    shot = ORBIT["indirect"]
    frames = cache.fetch_shot(shot, SCALE)
    last = frames[-1]
    assert isinstance(last, SparseFrame)
    reference, _ = cache.fetch_mean(shot, shot.frames - 1)
    over_time = list(run_through(frames))[-1]
    scene, cameras = shot.open()
    set_camera(scene, cameras[-1])
    better = recompute(
        over_time,
        lambda rows, columns: render_pixels(scene, rows, columns, spp=CHAIN_ADAPTIVE_SPP, seed=9, light="indirect"),
        samples=CHAIN_ADAPTIVE_SPP / SPP,
        frame=last,
    )
    shaded = last.radiance.color.repeat(SCALE, axis=0).repeat(SCALE, axis=1)[: last.height, : last.width]
    images = {
        "shaded": shaded,
        "normal": upsample(last, similarity="normal").image,
        "ggx": upsample(last).image,
        "with time": over_time.image,
        "with adaptive pixels": better.image,
    }
    write_row("chain", [*images.values(), reference], (slice(150, 400), slice(180, 430)))
    return {name: {"rel_mse": rel_mse(image, reference)} for name, image in images.items()}


def make_animation(arguments: argparse.Namespace) -> dict[str, Any]:
    """A sequence: every frame upsampled by itself, and with the frames before it."""
    from PIL import Image

    frames = Cache(arguments.cache, 1).fetch_shot(FLICKERING, SCALE)
    alone = [run_alone(frame).image for frame in frames]
    together = [result.image for result in run_through(frames)]
    exposure = choose_exposure(together[-1])
    pictures = []
    for pair in zip(alone, together, strict=True):
        panels = [map_tones(image, exposure) for image in pair]
        gap = np.full((panels[0].shape[0], GAP, 3), 255, dtype=np.uint8)
        pictures.append(Image.fromarray(np.concatenate([panels[0], gap, panels[1]], axis=1)))
    target = ROOT / "docs" / "images" / "sequence.webp"
    forth_and_back = [*pictures[1:], *pictures[-2:0:-1]]  # so that it goes round without a jump
    pictures[0].save(target, save_all=True, append_images=forth_and_back, duration=80, loop=0, quality=75, method=6)
    print(f"{target}: {target.stat().st_size / 1e3:.0f} kB")
    flicker = {}
    for name, images in (("alone", alone), ("with time", together)):
        measured = Flicker()
        for index, image in enumerate(images):
            measured.add(image, Cache(arguments.cache, 1).fetch_pair(FLICKERING, index, FLICKER_SPP)[0])
        flicker[name] = {"flicker": measured.get_mean()}
    return flicker


MAKERS: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {
    "brushed": make_brushed,
    "plastic": make_plastic,
    "measured": make_measured,
    "upsampling": make_upsampling,
    "chain": make_chain,
    "animation": make_animation,
}
SAMPLES = {"measured": MEASURED_SPP, "upsampling": UPSAMPLING_SPP}


def main() -> None:
    """Write the pictures that were asked for, and their errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="+", choices=MAKERS, help="which picture to make")
    parser.add_argument("--cache", type=Path, required=True, help="folder for frames and references")
    parser.add_argument("--pieces", type=int, default=8, help="renders that make the reference of `chain`")
    parser.add_argument("--material", type=Path, action="append", help="a MERL file of your own for `measured`")
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    result = json.loads(RESULT.read_text()) if RESULT.exists() else {}
    for name in arguments.picture:
        errors = MAKERS[name](arguments)
        print(name, {key: {k: round(v, 5) for k, v in value.items()} for key, value in errors.items()})
        result[name] = {
            "spp": SAMPLES.get(name, SPP),
            "errors": errors,
            "commit": describe_machine()["commit"],
        }
    result["version"] = lobewise.__version__
    if not arguments.material:
        write_json(RESULT, result)


if __name__ == "__main__":
    main()
