"""Measure what lobes at the place of a texture gain over lobes at its centre, on floors of two roughnesses.

python -m benchmarks.quality.textured_lobes -o benchmarks/results/textured_lobes.json

Each scene is a floor of squares of alpha 0.05 and 0.4 below coloured lamps and balls. ``plastic`` is Mitsuba's
``pplastic``, whose lobes are always fitted. ``metal`` is its ``roughconductor``. The formula of its lobes is taken
away, so that they are fitted, and is the third column. All columns have the same samples; only lobes and albedos
differ.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import describe_machine, write_json
from lobewise import denoise
from lobewise.display.tones import map_tones
from lobewise.frame import Frame
from lobewise.io.png import encode_png
from lobewise.metrics import rel_mse

ALPHAS = (0.05, 0.4)
SQUARES = 6
"""Number of squares along the floor."""
WAYS = ("one place", "places", "formula")
"""Whence the lobes come: fitted to the centre of the texture, fitted to places of the texture, or from a formula."""
FILTERS: dict[str, dict[str, Any]] = {
    "fast, ggx": {"quality": "fast", "similarity": "ggx"},
    "balanced, ggx": {"quality": "balanced", "similarity": "ggx"},
    "balanced, sg_mixture": {"quality": "balanced", "similarity": "sg_mixture"},
    "high, ggx": {"quality": "high", "similarity": "ggx"},
}
SEEDS = (1, 2, 3)


def make_scene(material: str, size: int) -> Any:
    """Return the scene of a floor of squares below lamps and balls."""
    import mitsuba as mi

    turn = mi.ScalarTransform4f
    count = SQUARES / 2
    alpha = {
        "type": "checkerboard",
        "color0": ALPHAS[0],
        "color1": ALPHAS[1],
        "to_uv": mi.ScalarTransform3f().scale([count, count]),
    }
    floors = {
        "metal": {"type": "roughconductor", "distribution": "ggx", "material": "Al", "alpha": alpha},
        "plastic": {"type": "pplastic", "distribution": "ggx", "diffuse_reflectance": 0.02, "alpha": alpha},
    }

    def make_ball(x: float, z: float, color: tuple[float, float, float]) -> dict[str, Any]:
        bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(color)}}
        return {"type": "sphere", "center": [x, 0.45, z], "radius": 0.45, "bsdf": bsdf}

    def make_lamp(x: float, color: tuple[float, float, float]) -> dict[str, Any]:
        shine = {"type": "area", "radiance": {"type": "rgb", "value": list(color)}}
        place = turn().translate([x, 1.3, -2.4]).scale([0.25, 0.9, 1.0])
        return {"type": "rectangle", "to_world": place, "emitter": shine}

    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    camera = turn().look_at(origin=[0.0, 2.2, 4.0], target=[0.0, 0.2, -0.4], up=[0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": 48.0, "to_world": camera, "film": film},
            "floor": {
                "type": "rectangle",
                "to_world": turn().rotate([1, 0, 0], -90).scale(2.4),
                "bsdf": floors[material],
            },
            "sky": {"type": "constant", "radiance": 0.15},
            "red": make_ball(-1.0, -0.6, (0.8, 0.1, 0.1)),
            "green": make_ball(0.1, -1.1, (0.1, 0.7, 0.2)),
            "blue": make_ball(1.1, -0.4, (0.1, 0.2, 0.8)),
            "left": make_lamp(-1.2, (6.0, 4.0, 2.0)),
            "middle": make_lamp(0.0, (5.0, 5.0, 5.0)),
            "right": make_lamp(1.2, (2.0, 4.0, 6.0)),
        }
    )


@contextmanager
def use_lobes(way: str) -> Iterator[None]:
    """Render with lobes of one of `WAYS`."""
    from lobewise.render.materials import bsdfs, fitted

    known, find = dict(bsdfs.PLUGIN_OF_CLASS), fitted.probe_places
    fitted._fits.clear()
    try:
        if way != "formula":
            del bsdfs.PLUGIN_OF_CLASS["RoughConductor"]
        if way == "one place":
            fitted.probe_places = lambda *_: None
        yield
    finally:
        bsdfs.PLUGIN_OF_CLASS.update(known)
        fitted.probe_places = find
        fitted._fits.clear()


def measure(material: str, size: int, spp: int, reference_spp: int, pictures: Path | None) -> dict[str, Any]:
    """Return errors (``rel_mse``) of the floor by way and filter, means over the seeds; and what a fit takes."""
    from lobewise.render import render_frame, render_reference
    from lobewise.render.materials.bsdfs import read_scene_materials

    scene = make_scene(material, size)
    reference = render_reference(scene, spp=reference_spp, seed=1000).radiance.color
    found: dict[str, Any] = {}
    for way in WAYS if material == "metal" else WAYS[:2]:
        with use_lobes(way):
            start = time.process_time()
            read_scene_materials(scene)
            seconds = time.process_time() - start
            frames = [render_frame(scene, spp=spp, seed=seed) for seed in SEEDS]
        floor = mark_floor(frames[0])
        images = {name: [denoise(frame, **choice).image for frame in frames] for name, choice in FILTERS.items()
                  if way != "formula" or "sg_mixture" not in name}  # fmt: skip
        found[way] = {
            "seconds of one core": seconds,
            "lobe tables": len(frames[0].lobe_tables),
            "alpha": [float(value) for value in np.quantile(frames[0].gbuffer.alpha_v[floor], [0.02, 0.98])],
            "errors": {name: float(np.mean([rel_mse(image, reference, floor) for image in each]))
                       for name, each in images.items()},
        }  # fmt: skip
        noisy = [rel_mse(frame.radiance.color, reference, floor) for frame in frames]
        found["noisy"] = float(np.mean(noisy))
        print(material, way, found[way], file=sys.stderr)
        if pictures is not None:
            for name, image in [("noisy", [frames[0].radiance.color]), ("reference", [reference]), *images.items()]:
                file = pictures / f"{material} {way} {name}.png".replace(" ", "_").replace(",", "")
                file.write_bytes(encode_png(map_tones(image[0], 1.0)))
    return found


def mark_floor(frame: Frame) -> Any:
    """Return which pixels show the floor, the only surface with a lobe."""
    return frame.gbuffer.lobe_kind != 0


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--size", type=int, default=192)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--reference-spp", type=int, default=2048)
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the first seed")
    choice = parser.parse_args()
    from lobewise.render import load_mitsuba

    load_mitsuba("cpu")
    shape = {"size": choice.size, "spp": choice.spp, "reference_spp": choice.reference_spp}
    scenes = {name: measure(name, **shape, pictures=choice.pictures) for name in ("metal", "plastic")}
    write_json(choice.output, {"machine": describe_machine(), **shape, "seeds": len(SEEDS), "scenes": scenes})


if __name__ == "__main__":
    main()
