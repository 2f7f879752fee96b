"""Frames of Mitsuba's integrator `aov`, from scenes made in code. Runs where `mitsuba` is, without lobewise.

    python render_mitsuba.py FOLDER [--scenes a,b] [--spp 8,32,128] [--seeds 1,2] [--reference 4096] [--size 256x192]
                                    [--filter gaussian]

The frames are what ``film.bitmap().write(...)`` gives: R, G, B and the layers of ``aov``, 32-bit floats, one part.
Files are named ``SCENE_SPP_SEED.exr``; the reference comes in two halves of different seeds,
``SCENE_reference_1.exr`` and ``SCENE_reference_2.exr``. The pixel filter is Mitsuba's default, which spreads samples
over neighbours; docs/mitsuba.md advises ``--filter box``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

Item = dict[str, Any]
AOVS = "albedo:albedo,normals:sh_normal,position:position,depth:depth"
MAX_SAMPLES_AT_ONCE = 64
"""Per pixel: more of them take gigabytes of memory."""
place = mi.ScalarTransform4f


def make_stage(*things: Item, lens: float = 0.0) -> Item:
    """Return things on chequered tiles before a wall, under a small and a large lamp; a lens wider than 0 blurs."""
    tiles = {"type": "checkerboard", "to_uv": place().scale([10, 10, 1]), "color0": 0.15, "color1": 0.6}
    sensor = {
        "type": "thinlens" if lens else "perspective",
        "fov": 42,
        "to_world": place().look_at([0, -6, 2.2], [0, 0, 0.6], [0, 0, 1]),
    }
    if lens:
        sensor |= {"aperture_radius": lens, "focus_distance": 5.4}
    small = place().look_at([-2.5, -3, 4], [0, 0, 0.5], [0, 0, 1]).scale(0.15)
    large = place().look_at([3, -1, 4], [0, 0, 0.5], [0, 0, 1]).scale(0.9)
    return {
        "type": "scene",
        "sensor": sensor,
        "floor": {
            "type": "rectangle",
            "to_world": place().scale(8),
            "bsdf": {"type": "diffuse", "reflectance": tiles},
        },
        "wall": {
            "type": "rectangle",
            "to_world": place().translate([0, 4, 2]).rotate([1, 0, 0], 90).scale(8),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.55, 0.6]}},
        },
        "small": {"type": "rectangle", "to_world": small, "emitter": {"type": "area", "radiance": 250.0}},
        "large": {"type": "rectangle", "to_world": large, "emitter": {"type": "area", "radiance": 8.0}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.15, 0.18, 0.25]}},
        **{f"thing{number}": thing for number, thing in enumerate(things)},
    }


def make_ball(x: float, y: float, radius: float, bsdf: Item) -> Item:
    """Return a ball that stands on the floor."""
    return {"type": "sphere", "center": [x, y, radius], "radius": radius, "bsdf": bsdf}


def make_conductor() -> Item:
    """Return metals from mirror to rough."""
    metals = [{"type": "conductor", "material": "Ag"}]
    metals += [
        {"type": "roughconductor", "material": material, "distribution": "ggx", "alpha": alpha}
        for material, alpha in (("Au", 0.05), ("Cu", 0.15), ("Al", 0.35))
    ]
    return make_stage(*(make_ball(-2.1 + 1.4 * i, 0.3 * (i % 2), 0.65, metal) for i, metal in enumerate(metals)))


def make_principled() -> Item:
    """Return lacquers below clear coats, through a lens that is open."""
    paints = [
        {
            "type": "principled",
            "base_color": {"type": "rgb", "value": color},
            "roughness": roughness,
            "metallic": metallic,
            "clearcoat": 1.0,
            "clearcoat_gloss": 0.98,
        }
        for color, roughness, metallic in (
            ([0.65, 0.05, 0.04], 0.6, 0.0),
            ([0.1, 0.25, 0.6], 0.38, 0.8),
            ([0.8, 0.7, 0.5], 0.2, 0.0),
        )
    ]
    return make_stage(
        *(make_ball(-1.7 + 1.6 * i, 1.6 * i - 1.2, 0.65, paint) for i, paint in enumerate(paints)), lens=0.12
    )


def make_glass() -> Item:
    """Return smooth and rough glass, and a ball behind it."""
    things = [
        make_ball(-1.5, 0.0, 0.7, {"type": "dielectric", "int_ior": 1.5}),
        make_ball(0.1, -0.4, 0.7, {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.1, "int_ior": 1.5}),
        make_ball(1.7, 0.0, 0.7, {"type": "thindielectric"}),
        make_ball(-0.6, 1.8, 0.6, {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.3, 0.1]}}),
    ]
    return make_stage(*things)


SCENES: dict[str, Callable[[], Item]] = {
    "conductor": make_conductor,
    "principled": make_principled,
    "glass": make_glass,
}


def render(scene: Any, path: Path, spp: int, seed: int) -> None:
    """Render a scene into a file, unless it is there."""
    if path.exists():
        return
    start = time.process_time()
    integrator = mi.load_dict({"type": "aov", "aovs": AOVS, "nested": {"type": "path", "max_depth": 16}})
    film, sums = scene.sensors()[0].film(), 0.0
    turns = range(0, spp, MAX_SAMPLES_AT_ONCE)
    for first in turns:
        mi.render(scene, spp=min(MAX_SAMPLES_AT_ONCE, spp - first), seed=1000 * seed + first, integrator=integrator)
        sums = sums + np.array(film.bitmap()) * (min(MAX_SAMPLES_AT_ONCE, spp - first) / spp)
    bitmap = film.bitmap()
    if len(turns) > 1:
        names = [field.name for field in bitmap.struct_()]
        bitmap = mi.Bitmap(np.asarray(sums, dtype=np.float32), mi.Bitmap.PixelFormat.MultiChannel, names)
    temporary = path.with_name(f".{path.name}")
    bitmap.write(str(temporary))
    temporary.rename(path)
    print(f"wrote {path}, {time.process_time() - start:.1f} s of CPU", flush=True)


def main() -> None:
    """Render what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--spp", default="8,32,128")
    parser.add_argument("--seeds", default="1,2")
    parser.add_argument("--reference", type=int, default=4096)
    parser.add_argument("--size", default="256x192")
    parser.add_argument("--filter", default="gaussian", help="pixel filter, such as gaussian, box, mitchell")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    width, height = map(int, asked.size.split("x"))
    for name in asked.scenes.split(","):
        items = SCENES[name]()
        items["sensor"]["film"] = {
            "type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": asked.filter},
        }  # fmt: skip
        scene = mi.load_dict(items)
        for spp in filter(None, asked.spp.split(",")):
            for seed in asked.seeds.split(","):
                render(scene, asked.folder / f"{name}_{spp}_{seed}.exr", int(spp), int(seed))
        if asked.reference:
            for half in (1, 2):
                render(scene, asked.folder / f"{name}_reference_{half}.exr", asked.reference // 2, 7776 + half)


if __name__ == "__main__":
    main()
