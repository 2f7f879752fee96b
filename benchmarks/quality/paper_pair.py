"""Measure the pair of errors that the paper's slides give: a geometry-aware filter against lobes, by plain MSE.

    python -m benchmarks.quality.paper_pair

The slides (Tokuyoshi 2015) give the MSE of one path-traced picture of 512x512 pixels, filtered by geometry (0.1380) and
by lobes (0.0157). Their scene is not public. Here the frame inside the package stands for it: 512x512 pixels of
`showroom`, 4 samples per pixel. The geometry-aware filter has the package's defaults, and is also tuned against the
reference.
"""

from __future__ import annotations

import itertools
from typing import Any

import lobewise
from benchmarks.common import RESULTS, SHOWROOM, SHOWROOM_REFERENCE, describe_machine, write_json
from lobewise.io import read_image
from lobewise.metrics import mse

PAPER = {"geometry": 0.1380, "lobes": 0.0157}
NORMAL_EXPONENTS = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0)
SCREEN_SIGMAS_PIXELS = (1.5, 3.0, 8.0)
COMMON: dict[str, Any] = {"quality": "fast", "form": "separable", "radius": 8}


def main() -> None:
    """Write benchmarks/results/paper_pair.json."""
    frame, reference = lobewise.read_frame(SHOWROOM), read_image(SHOWROOM_REFERENCE)

    def measure(**settings: Any) -> float:
        return mse(lobewise.denoise(frame, **COMMON, **settings).image, reference)

    tuned = min(
        measure(similarity="normal", normal_exponent=exponent, screen_sigma=sigma)
        for exponent, sigma in itertools.product(NORMAL_EXPONENTS, SCREEN_SIGMAS_PIXELS)
    )
    found = {
        "noisy": mse(frame.radiance.color, reference),
        "geometry": measure(similarity="normal"),
        "geometry, tuned": tuned,
        "lobes: sg": measure(similarity="sg"),
        "lobes: ggx": measure(similarity="ggx"),
    }
    for name, value in found.items():
        print(f"{name:16} {value:.4f}")
    write_json(
        RESULTS / "paper_pair.json",
        {"what": "mse of showroom, 512x512, 4 spp", "mse": found, "paper": PAPER, "machine": describe_machine()},
    )


if __name__ == "__main__":
    main()
