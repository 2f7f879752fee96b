"""What the hit-distance term does, on a scene made for it: thin posts that stand on satin metal.

Where a post meets the floor its reflection is sharp, and further up it is blurred; lobes that are compared by direction
alone blur both alike, which the paper names as its limitation. Each similarity runs without and with the term, both at
the best of a grid of beta and screen sigma against the reference, and by default. Besides the whole image, the error is
told for the contacts: specular pixels whose hit is nearer than a tenth of their depth.

    python -m benchmarks.quality.hit_distance --cache ~/.cache/lobewise-quality -o benchmarks/results/hit_distance.json
"""

from __future__ import annotations

import argparse
import itertools
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import RESULTS, describe_machine, fetch_frame, fetch_image, write_json
from lobewise.denoising import denoise, resolve_settings
from lobewise.frame import FloatArray, Frame
from lobewise.metrics import rel_mse
from lobewise.render import render_frame, render_reference
from lobewise.render.loading import build_scene
from lobewise.scenes import parts
from lobewise.settings import DenoiseSettings

SIZE = 384
REFERENCE_SPP = 4096
SAMPLES = (4, 16, 64, 256)
SIMILARITIES = ("sg", "asg", "ggx")
FACTORS = (0.25, 0.5, 1.0, 2.0)
NEAR = 0.1


def make_scene() -> Any:
    """Return the scene: a satin floor in three strips of roughness, striped posts on it, a wide lamp."""
    alpha = np.repeat(np.array([0.05, 0.12, 0.25]), 64)[None].repeat(4, axis=0)
    colors = ((0.85, 0.10, 0.06), (0.10, 0.30, 0.80), (0.90, 0.70, 0.10), (0.12, 0.55, 0.20), (0.85, 0.85, 0.82))
    posts = {}
    for number, x in enumerate(np.linspace(-2.2, 2.2, 12)):
        stripes = parts.checkerboard(colors[number % 5], (0.05, 0.05, 0.06), (1, 6))
        where = (float(x), 0.6, -0.5 + 0.9 * (number % 3 - 1))
        posts[f"post{number}"] = parts.box(where, (0.06, 0.6, 0.06), parts.diffuse(stripes), 20.0 * number)
    return build_scene(
        {
            "type": "scene",
            "sensor": parts.camera((0.0, 1.7, 5.2), (0.0, 0.35, 0.0), 40.0, SIZE, SIZE),
            "integrator": {"type": "path", "max_depth": 6},
            "floor": parts.rectangle(
                (0, 0, 0), (0, 1, 0), (3, 3), parts.metal("aluminium", parts.texture(alpha, filter_type="nearest"))
            ),
            "wall": parts.rectangle((0, 1.5, -3), (0, 1.5, 0), (3, 1.5), parts.diffuse((0.5, 0.5, 0.52))),
            "lamp": parts.light((0, 4.5, 2.0), (0, 0, 0), (2.0, 1.0), (7.0, 6.8, 6.4)),
            **posts,
        }
    )


def measure(frame: Frame, reference: FloatArray, **settings: Any) -> dict[str, float]:
    """Return the errors over the whole image and at the contacts."""
    guides = frame.gbuffer
    assert guides.hit_distance is not None
    assert guides.depth is not None
    assert guides.lobe_kind is not None
    near = (guides.lobe_kind > 0) & (guides.hit_distance > 0.0) & (guides.hit_distance < NEAR * guides.depth)
    image = denoise(frame, quality="fast", **settings).image
    return {"rel_mse": rel_mse(image, reference), "rel_mse_contacts": rel_mse(image, reference, near)}


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for frames and reference")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "hit_distance.json")
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    reference = fetch_image(
        arguments.cache / f"contacts-reference-{REFERENCE_SPP}.exr",
        lambda: render_reference(make_scene(), spp=REFERENCE_SPP, seed=1000),
    )
    rows: dict[str, Any] = {}
    for spp in SAMPLES:
        frame = fetch_frame(
            arguments.cache / f"contacts-{spp}.exr", partial(render_frame, make_scene(), spp=spp, seed=1)
        )
        usual = resolve_settings(frame, DenoiseSettings())
        assert not isinstance(usual.beta, str)
        assert not isinstance(usual.screen_sigma, str)
        grid = [
            {"beta": usual.beta * a, "screen_sigma": usual.screen_sigma * b}
            for a, b in itertools.product(FACTORS, FACTORS)
        ]
        rows[str(spp)] = {}
        for similarity, hits in itertools.product(SIMILARITIES, (False, True)):
            fixed = {"similarity": similarity, "hit_distance": hits}
            tried = [{**measure(frame, reference, **fixed, **point), "settings": point} for point in grid]
            row = {
                "default": measure(frame, reference, **fixed),
                "tuned": min(tried, key=lambda each: each["rel_mse"]),
                "tuned for contacts": min(tried, key=lambda each: each["rel_mse_contacts"]),
            }
            name = similarity + (" with hits" if hits else "")
            rows[str(spp)][name] = row
            print(
                f"{spp:4} spp  {name:14} default {row['default']['rel_mse']:.5f}, contacts "
                f"{row['default']['rel_mse_contacts']:.5f}; tuned {row['tuned']['rel_mse']:.5f}, contacts "
                f"{row['tuned for contacts']['rel_mse_contacts']:.5f}",
                flush=True,
            )
    write_json(
        arguments.output,
        {
            "what": "rel_mse (epsilon 0.01) without and with the hit-distance term; contacts: hits nearer than "
            f"{NEAR} of the depth",
            "version": lobewise.__version__,
            "size": SIZE,
            "reference_spp": REFERENCE_SPP,
            "machine": describe_machine(),
            "factors": FACTORS,
            "samples": rows,
        },
    )


if __name__ == "__main__":
    main()
