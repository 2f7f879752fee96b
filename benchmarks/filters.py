"""Time of the filter kernels: sizes, radii, forms and similarities, as ratios to ``normal`` within the run.

Every group (one size, radius and form) runs its candidates in turn, again and again, and takes the best of each, so
that a disturbance of the machine meets all of them. One image is filtered, as Open Image Denoise does beside it.

    python benchmarks/filters.py -o benchmarks/results/filters.json
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from common import describe_machine, write_json
from lobewise.denoising import denoise
from lobewise.frame import Camera, FloatArray, Frame, GBuffer, LobeKind, Radiance
from lobewise.kernels.engine import ATROUS_LEVELS, FORMS, run_filter
from lobewise.kernels.features import Feature, NormalFeature, PositionFeature, ScreenFeature
from lobewise.kernels.lobe_features import AsgFeature, GgxFeature, SgFeature
from lobewise.kernels.mixture_features import SgMixtureFeature
from lobewise.lobes.field import build_lobe_field, default_tau
from lobewise.lobes.mixture_field import build_mixture_field
from lobewise.peers import denoise_oidn, has_oidn

SIZES = ((512, 512), (1024, 1024), (1920, 1080))
RADII = (8, 16)
BETA = 8.0


def make_frame(width: int, height: int) -> Frame:
    """Return a plane of patches whose roughness and normal vary, seen in perspective, with noise on it."""
    rng = np.random.default_rng(0)
    camera = Camera(position=(0.0, 2.0, 6.0), forward=(0.0, -0.4, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7)
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    depth = 2.0 / np.maximum(-rays[..., 1], 0.05)
    position = camera.position + rays * depth[..., None]
    normal = np.stack(
        [0.1 * np.sin(5.0 * position[..., 0]), np.ones_like(depth), 0.1 * np.sin(4.0 * position[..., 2])], axis=-1
    )
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    patch = (np.floor(2.0 * position[..., 0]) + np.floor(2.0 * position[..., 2])) % 5.0
    alpha = 0.03 + 0.12 * patch
    albedo = np.full((height, width, 3), 0.8)
    color = rng.exponential(1.0, (height, width, 3)).astype(np.float32)
    return Frame(
        radiance=Radiance(color=color, diffuse=0.5 * color, specular=0.5 * color),
        gbuffer=GBuffer(
            depth=depth,
            position=position,
            normal=normal,
            alpha_u=alpha,
            alpha_v=alpha,
            lobe_kind=np.full(depth.shape, int(LobeKind.GGX)),
            diffuse_albedo=0.5 * albedo,
            specular_albedo=0.5 * albedo,
        ),
        camera=camera,
        spp=4,
    )


def make_features(frame: Frame) -> dict[str, list[Feature]]:
    """Return the features of each similarity; position and screen distance are the same in all."""
    guides, camera = frame.gbuffer, frame.camera
    assert camera is not None
    assert guides.position is not None
    assert guides.depth is not None
    assert guides.normal is not None
    pixel_angle = camera.get_pixel_angle(frame.height)
    place = [
        ScreenFeature(5.0),
        PositionFeature(guides.position, guides.depth, pixel_angle=pixel_angle, sigma=16.0),
    ]
    lobes = build_lobe_field(guides, camera)
    assert lobes.axis is not None
    assert lobes.sharpness is not None
    assert lobes.tangent_axis is not None
    assert lobes.covariance is not None
    assert lobes.determinant is not None
    gaussian = build_lobe_field(guides, camera, representation="asg")
    assert gaussian.tangent_axis is not None
    assert gaussian.covariance is not None
    assert gaussian.determinant is not None
    mixture = build_mixture_field(guides, camera, tau=default_tau(camera, frame.height), lobes=3)
    # The same lobes without the knowledge that they share an axis: what lobes fitted to measured materials cost.
    apart = np.tile(mixture.axis, (1, 1, 3))
    return {
        "normal": [*place, NormalFeature(guides.normal, 64.0)],
        "sg": [*place, SgFeature(lobes.axis, lobes.sharpness, BETA)],
        "sg_mixture, 3 lobes": [*place, SgMixtureFeature(apart, mixture.sharpness, mixture.amplitude, BETA)],
        "sg_mixture, 3 coaxial": [*place, SgMixtureFeature(mixture.axis, mixture.sharpness, mixture.amplitude, BETA)],
        "asg": [*place, AsgFeature(gaussian.tangent_axis, gaussian.covariance, gaussian.determinant, BETA)],
        "ggx": [*place, GgxFeature(lobes.tangent_axis, lobes.covariance, lobes.determinant, BETA)],
    }


def time_best(candidates: dict[str, Callable[[], Any]], seconds: float) -> dict[str, float]:
    """Return the best wall time of each candidate, run in turn for at least ``seconds`` and five rounds."""
    for call in candidates.values():
        call()
    best = dict.fromkeys(candidates, float("inf"))
    start, rounds = time.perf_counter(), 0
    while rounds < 5 or time.perf_counter() - start < seconds:
        for name, call in candidates.items():
            begin = time.perf_counter()
            call()
            best[name] = min(best[name], time.perf_counter() - begin)
        rounds += 1
    return best


def count_taps(form: str, radius: int) -> int:
    """Return the taps of one pixel over all passes."""
    side = 2 * radius + 1
    return {"full": side * side, "separable": 2 * side, "atrous": 25 * ATROUS_LEVELS}[form]


def bench_kernels(frame: Frame, radius: int, form: str, seconds: float) -> dict[str, Any]:
    """Return times and ratios of the similarities for one size, radius and form."""
    features = make_features(frame)
    mask = np.ones(frame.shape, dtype=bool)

    def make_call(similarity: str) -> Callable[[], Any]:
        image: FloatArray = frame.radiance.color
        return lambda: run_filter(image, mask, features[similarity], form=form, radius=radius)

    best = time_best({name: make_call(name) for name in features}, seconds)
    taps = count_taps(form, radius) * frame.width * frame.height
    return {
        name: {
            "milliseconds": round(1e3 * value, 3),
            "ns_per_tap_and_pixel": round(1e9 * value / taps, 4),
            "ratio_to_normal": round(value / best["normal"], 3),
        }
        for name, value in best.items()
    }


def bench_against_oidn(frame: Frame, seconds: float) -> dict[str, Any]:
    """Return times of one separable filter run, of the whole recipe and of Open Image Denoise on the same frame."""
    features = make_features(frame)["sg"]
    mask = np.ones(frame.shape, dtype=bool)
    image = frame.radiance.color
    candidates: dict[str, Callable[[], Any]] = {
        "sg kernel, separable, radius 8": lambda: run_filter(image, mask, features, form="separable", radius=8),
        "denoise(sg, separable, radius 8): diffuse and specular": lambda: denoise(
            frame, similarity="sg", form="separable", radius=8
        ),
        "denoise(ggx, separable, radius 8): diffuse and specular": lambda: denoise(
            frame, similarity="ggx", form="separable", radius=8
        ),
        "oidn, default quality": lambda: denoise_oidn(frame, guides="centre"),
    }
    best = time_best(candidates, seconds)
    oidn = best["oidn, default quality"]
    return {
        name: {"milliseconds": round(1e3 * value, 2), "times_faster_than_oidn": round(oidn / value, 2)}
        for name, value in best.items()
    }


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results" / "filters.json")
    parser.add_argument("--seconds", type=float, default=3.0, help="least time per group")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    peers: dict[str, Any] = {}
    for width, height in SIZES:
        frame = make_frame(width, height)
        for form in FORMS:
            for radius in RADII if form != "atrous" else RADII[:1]:
                result = bench_kernels(frame, radius, form, arguments.seconds)
                rows.append({"width": width, "height": height, "form": form, "radius": radius, **result})
                cells = "  ".join(
                    f"{name} {cell['milliseconds']:8.2f} ms ({cell['ratio_to_normal']:.2f})"
                    for name, cell in result.items()
                )
                print(f"{width}x{height} {form:9} radius {radius:2}  {cells}", flush=True)
        if has_oidn():
            peers[f"{width}x{height}"] = bench_against_oidn(frame, arguments.seconds)
            for name, cell in peers[f"{width}x{height}"].items():
                print(f"{width}x{height} {name}: {cell['milliseconds']} ms, {cell['times_faster_than_oidn']}x")
    write_json(
        arguments.output,
        {
            "what": "best wall time of one run; atrous: five 5x5 levels, whatever the radius",
            "version": lobewise.__version__,
            "machine": describe_machine(),
            "kernels": rows,
            "oidn": peers,
        },
    )


if __name__ == "__main__":
    main()
