"""Error of every similarity on four built-in scenes at 1, 4, 16 and 64 samples per pixel.

Both of the paper's baselines are tuned by grid search on each frame against its reference (so they are at least as
good as a user could make them); ours runs with its defaults. Writes a JSON with everything and prints a table; scenes
and sample counts that a run leaves out keep their rows, each of which names its commit.

The four references take some twenty minutes on two cores.

    python -m benchmarks.quality.similarities --cache ~/.cache/lobewise-quality -o benchmarks/results/similarities.json
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lobewise
from benchmarks.common import RESULTS, describe_machine, fetch_frame, fetch_image, write_json
from lobewise.denoising import denoise
from lobewise.frame import FloatArray, Frame
from lobewise.metrics import rel_mse, smape
from lobewise.peers import denoise_oidn, has_oidn
from lobewise.render import load_scene, render_frame, render_reference
from lobewise.settings import DenoiseSettings

Mask = NDArray[np.bool_]

SCENES = ("showroom", "brushed", "parlour", "sparks")
SAMPLES = (1, 4, 16, 64)
SIZE = 512
REFERENCE_SPP = 2048

NORMAL_EXPONENTS = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0, 4096.0)
SCREEN_SIGMAS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.5, 8.0)
BAND_EXPONENTS = (16.0, 64.0, 256.0, 1024.0)
BAND_SIGMAS = (1.5, 3.0, 8.0)
BAND_LIMITS = (0.06, 0.25, 1.0, 2.0)
BETAS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)


def fetch(cache: Path, scene: str, spp: int) -> Frame:
    """Return the noisy frame, rendered once."""
    return fetch_frame(
        cache / f"{scene}-{spp}.exr",
        lambda: render_frame(load_scene(scene, width=SIZE, height=SIZE), spp=spp, seed=1),
    )


def fetch_reference(cache: Path, scene: str) -> FloatArray:
    """Return the reference radiance, rendered once."""
    return fetch_image(
        cache / f"{scene}-reference-{REFERENCE_SPP}.exr",
        lambda: render_reference(load_scene(scene, width=SIZE, height=SIZE), spp=REFERENCE_SPP, seed=1000),
    )


def list_baselines(band_limited: bool) -> Iterator[dict[str, float]]:
    """Yield the settings of the grid search."""
    if band_limited:
        for exponent, sigma, limit in itertools.product(BAND_EXPONENTS, BAND_SIGMAS, BAND_LIMITS):
            yield {"normal_exponent": exponent, "screen_sigma": sigma, "band_limit": limit}
    else:
        for exponent, sigma in itertools.product(NORMAL_EXPONENTS, SCREEN_SIGMAS):
            yield {"normal_exponent": exponent, "screen_sigma": sigma}


def measure(image: FloatArray, reference: FloatArray, specular: Mask, anisotropic: Mask) -> dict[str, float]:
    """Return the errors of one image."""
    errors = {
        "rel_mse": rel_mse(image, reference),
        "rel_mse_specular": rel_mse(image, reference, specular),
        "smape": smape(image, reference),
    }
    if anisotropic.any():
        errors["rel_mse_anisotropic"] = rel_mse(image, reference, anisotropic)
    return errors


def mark_anisotropic(frame: Frame) -> Mask:
    """Return the specular pixels whose two alphas differ by more than a third."""
    guides = frame.gbuffer
    assert guides.lobe_kind is not None
    assert guides.alpha_u is not None
    assert guides.alpha_v is not None
    large, small = np.maximum(guides.alpha_u, guides.alpha_v), np.minimum(guides.alpha_u, guides.alpha_v)
    return (guides.lobe_kind > 0) & (large > 4.0 / 3.0 * small)


def search(
    frame: Frame,
    reference: FloatArray,
    specular: Mask,
    anisotropic: Mask,
    grid: list[dict[str, Any]],
    **fixed: Any,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return errors and settings of the best grid point, once for the whole image and once for specular pixels."""
    tried = [
        {
            **measure(denoise(frame, quality="fast", **fixed, **point).image, reference, specular, anisotropic),
            "settings": point,
        }
        for point in grid
    ]
    return min(tried, key=lambda row: row["rel_mse"]), min(tried, key=lambda row: row["rel_mse_specular"])


def run_frame(frame: Frame, reference: FloatArray) -> dict[str, Any]:
    """Return the errors of every method on one frame."""
    assert frame.gbuffer.lobe_kind is not None
    specular = frame.gbuffer.lobe_kind > 0
    masks = specular, mark_anisotropic(frame)
    row: dict[str, Any] = {"specular_fraction": float(specular.mean()), "anisotropic_fraction": float(masks[1].mean())}
    row["noisy"] = measure(frame.radiance.color, reference, *masks)
    common = (frame, reference, *masks)
    for name, grid in (("normal", list(list_baselines(False))), ("band-limited", list(list_baselines(True)))):
        row[name], row[f"{name} (for specular)"] = search(*common, grid, similarity="normal")
    for similarity in ("sg", "sg_mixture", "asg", "ggx"):
        row[similarity] = measure(denoise(frame, quality="fast", similarity=similarity).image, reference, *masks)
        betas: list[dict[str, Any]] = [{"beta": beta} for beta in BETAS]
        row[f"{similarity} (tuned beta)"], _ = search(*common, betas, similarity=similarity)
    for similarity in ("sg", "asg", "ggx"):
        near = denoise(frame, quality="fast", similarity=similarity, hit_distance=True).image
        row[f"{similarity} with hits"] = measure(near, reference, *masks)
    default = denoise(frame, quality="fast")
    row["default"] = {**measure(default.image, reference, *masks), "settings": default.settings}
    for form in ("separable", "atrous"):
        row[f"default ({form})"] = measure(denoise(frame, quality="fast", form=form).image, reference, *masks)
    if has_oidn():
        row["oidn"] = measure(denoise_oidn(frame, guides="centre")[0], reference, *masks)
    row["default_over_normal"] = row["default"]["rel_mse"] / row["normal"]["rel_mse"]
    row["default_over_normal_specular"] = (
        row["default"]["rel_mse_specular"] / row["normal (for specular)"]["rel_mse_specular"]
    )
    return row


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for frames and references")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "similarities.json")
    parser.add_argument("--scene", choices=SCENES, action="append", help="only this scene (may be repeated)")
    parser.add_argument("--spp", type=int, choices=SAMPLES, action="append", help="only this sample count")
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    rows: dict[str, dict[str, Any]] = {}
    if arguments.output.exists():
        rows = json.loads(arguments.output.read_text())["scenes"]
    for scene in arguments.scene or SCENES:
        reference = fetch_reference(arguments.cache, scene)
        for spp in arguments.spp or SAMPLES:
            row = run_frame(fetch(arguments.cache, scene, spp), reference)
            row["commit"] = describe_machine()["commit"]
            rows.setdefault(scene, {})[str(spp)] = row
            shown = ("noisy", "normal", "band-limited", "sg", "sg_mixture", "asg", "ggx", "ggx with hits", "oidn")
            cells = "  ".join(f"{name} {row[name]['rel_mse']:.4f}" for name in shown if name in row)
            ratio = f"{row['default_over_normal']:.2f}, specular {row['default_over_normal_specular']:.2f}"
            print(f"{scene:9} {spp:3} spp  {cells}  default/normal {ratio}", flush=True)
    write_json(
        arguments.output,
        {
            "what": "rel_mse (epsilon 0.01) and smape; baselines tuned per frame by grid search, ours by default",
            "version": lobewise.__version__,
            "size": SIZE,
            "reference_spp": REFERENCE_SPP,
            "machine": describe_machine(),
            "grid": {
                "normal_exponent": NORMAL_EXPONENTS,
                "screen_sigma": SCREEN_SIGMAS,
                "band_limit": BAND_LIMITS,
                "band_limited_normal_exponent": BAND_EXPONENTS,
                "band_limited_screen_sigma": BAND_SIGMAS,
                "beta": BETAS,
                "fixed": {"radius": DenoiseSettings().radius, "form": "full"},
            },
            "scenes": {
                scene: {str(spp): rows[scene][str(spp)] for spp in SAMPLES if str(spp) in rows[scene]}
                for scene in SCENES
                if scene in rows
            },
        },
    )


if __name__ == "__main__":
    main()
