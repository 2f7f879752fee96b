"""Errors of `lobewise.mitsuba` on what `mitsuba.render` gives, and of Open Image Denoise with the same guides.

python -m benchmarks.foreign.mitsuba_users
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import lobewise.mitsuba
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.foreign.judging import make_judge
from lobewise.frame import FloatArray
from lobewise.mitsuba import Denoiser
from lobewise.render import load_mitsuba, load_scene

SIZE = 192
SAMPLES = (4, 16, 64)
SEEDS = (11, 12)
REFERENCE_SAMPLES = 512
AOVS = "albedo:albedo,normals:sh_normal,position:position"


def make_fog(mi: Any) -> dict[str, Any]:
    """Return a ball of fog and a glass one filled with it, on a floor of coloured tiles under two lamps."""
    transform = mi.ScalarTransform4f
    tiles = np.random.default_rng(0).uniform(0.1, 0.9, (16, 16, 3)).astype(np.float32)
    paint = {"type": "bitmap", "bitmap": mi.Bitmap(tiles), "raw": True, "filter_type": "nearest"}
    fog = {"type": "homogeneous", "sigma_t": 3.0, "albedo": {"type": "rgb", "value": [0.8, 0.6, 0.4]}}
    above = transform().translate([0, 0, 4]).rotate([1, 0, 0], 180)
    behind = transform().translate([1, 1, 1]).rotate([1, 0, 0], 70).scale(0.15)
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 32},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": transform().look_at([0, -4, 1], [0, 0, 0.5], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": transform().scale(4),
            "bsdf": {"type": "diffuse", "reflectance": paint},
        },
        "ball": {
            "type": "sphere",
            "center": [0.3, 0, 0.7],
            "radius": 0.6,
            "bsdf": {"type": "null"},
            "interior": fog,
        },
        "glass": {
            "type": "sphere",
            "center": [-0.9, 0, 0.5],
            "radius": 0.4,
            "bsdf": {"type": "dielectric"},
            "interior": fog,
        },
        "lamp": {"type": "rectangle", "to_world": above, "emitter": {"type": "area", "radiance": 5.0}},
        "window": {"type": "rectangle", "to_world": behind, "emitter": {"type": "area", "radiance": 20.0}},
        "sky": {"type": "constant", "radiance": 0.1},
    }


def load(mi: Any, name: str) -> Any:
    """Return a scene by name."""
    if name == "fog":
        return mi.load_dict(make_fog(mi))
    if name == "cornell box":
        items = mi.cornell_box()
        items["sensor"]["film"] |= {"width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
        return mi.load_dict(items)
    return load_scene(name, width=SIZE, height=SIZE)


def run_peer(layers: dict[str, FloatArray]) -> FloatArray:
    """Return what Open Image Denoise makes of the image, albedo and normals as they come."""
    from pyoidn.denoise import denoise

    color, albedo, normals = (np.array(layers[name][..., :3]) for name in ("<root>", "albedo", "normals"))
    return np.asarray(denoise(color, np.clip(albedo, 0.0, 1.0), normals, hdr=True, clean_aux=False, quality="high"))


def list_methods(mi: Any, scene: Any, bitmap: Any, spp: int, seed: int) -> dict[str, Callable[[], Any]]:
    """Return what is compared, by name."""
    layers = {name: np.array(layer) for name, layer in bitmap.split()}
    noisy, albedo, normals = (mi.TensorXf(layers[name]) for name in ("<root>", "albedo", "normals"))
    to_sensor = scene.sensors()[0].world_transform().inverse()
    names = {"albedo_ch": "albedo", "normals_ch": "normals", "to_sensor": to_sensor}
    return {
        "noisy": lambda: noisy,
        "denoiser": lambda: Denoiser(bitmap.size())(noisy),
        "denoiser, albedo and normals": lambda: Denoiser(bitmap.size())(noisy, albedo, normals, to_sensor),
        "denoiser, positions too": lambda: Denoiser(bitmap.size())(bitmap, **names),
        "denoiser, high": lambda: Denoiser(bitmap.size(), quality="high")(bitmap, **names),
        "oidn, albedo and normals": lambda: run_peer(layers),
        "scene": lambda: lobewise.mitsuba.denoise(scene, spp=spp, seed=seed),
        "scene, high": lambda: lobewise.mitsuba.denoise(scene, spp=spp, seed=seed, quality="high"),
    }


def measure(mi: Any, name: str) -> dict[str, Any]:
    """Return the errors in a scene, by samples and method, one for each seed."""
    scene = load(mi, name)
    halves = [np.array(mi.render(scene, spp=REFERENCE_SAMPLES, seed=seed))[..., :3] for seed in (101, 102)]
    judge = make_judge(*halves)
    integrator = mi.load_dict({"type": "aov", "aovs": AOVS, "nested": scene.integrator()})
    found: dict[str, Any] = {}
    for spp in SAMPLES:
        errors: dict[str, list[float]] = {}
        for seed in SEEDS:
            mi.render(scene, spp=spp, seed=seed, integrator=integrator)
            bitmap = scene.sensors()[0].film().bitmap()
            for method, run in list_methods(mi, scene, bitmap, spp, seed).items():
                image = np.array(run(), dtype=np.float32)[..., :3]
                errors.setdefault(method, []).append(float(f"{judge.measure(image)[0]:.4g}"))
        found[str(spp)] = errors
        print(name, spp, errors, flush=True)
    return {"samples": found, "reference_error": float(f"{judge.measure_noise():.4g}")}


def main() -> None:
    """Measure, and write the results."""
    mi = load_mitsuba("cpu")
    scenes = {name: measure(mi, name) for name in ("cornell box", "showroom", "kitchen", "fog")}
    settings = {"size": SIZE, "reference_spp": 2 * REFERENCE_SAMPLES, "seeds": len(SEEDS)}
    write_json(RESULTS / "mitsuba.json", {"machine": describe_machine(), "settings": settings, "scenes": scenes})


if __name__ == "__main__":
    main()
