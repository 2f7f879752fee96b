"""Write the pictures of the README from the frames that ``quality/similarities.py`` has rendered.

python -m benchmarks.pictures.readme --cache ~/.cache/lobewise-quality
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT
from benchmarks.quality.similarities import fetch, fetch_reference
from lobewise.denoising import denoise
from lobewise.io.png import encode_png
from lobewise.reporting.display import choose_exposure, map_tones

# Two spheres, the patchwork floor and their reflections: rows, columns.
CROP = (slice(140, 440), slice(190, 490))
GAP = 6


def main() -> None:
    """Write docs/images/showroom.png: noisy, normal-aware (tuned), lobe-aware (default), reference."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder that quality/similarities.py has filled")
    arguments = parser.parse_args()
    frame, reference = fetch(arguments.cache, "showroom", 4), fetch_reference(arguments.cache, "showroom")
    similarities = json.loads((ROOT / "benchmarks" / "results" / "similarities.json").read_text())
    tuned = similarities["scenes"]["showroom"]["4"]["normal"]["settings"]
    images = [
        frame.radiance.color,
        denoise(frame, quality="fast", similarity="normal", **tuned).image,
        denoise(frame, quality="fast").image,
        reference,
    ]
    exposure = choose_exposure(reference)
    panels = [map_tones(image, exposure)[CROP] for image in images]
    gap = np.full((panels[0].shape[0], GAP, 3), 255, dtype=np.uint8)
    row = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    target = ROOT / "docs" / "images" / "showroom.png"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(encode_png(np.ascontiguousarray(row)))
    print(f"{target}: {row.shape[1]}x{row.shape[0]}, {target.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
