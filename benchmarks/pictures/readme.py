"""Write the picture of the README from the frame inside the package.

python -m benchmarks.pictures.readme
"""

import numpy as np

from benchmarks.common import ROOT
from lobewise.cli.demo import load_bundled
from lobewise.denoising import denoise
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.io.png import encode_png
from lobewise.peers import denoise_oidn, require_oidn

CROP, ZOOM = (slice(8, 148), slice(20, 204)), 2
"""The sheet in the mirror: rows and columns, and how many pixels of the picture each of them becomes."""
GAP = 6


def main() -> None:
    """Write docs/images/demo.png: noisy, Open Image Denoise at its best, the default, reference."""
    require_oidn()
    frame, reference, _ = load_bundled()
    images = [frame.radiance.color, denoise_oidn(frame)[0], denoise(frame).image, reference]
    exposure = choose_exposure(reference)
    panels = [map_tones(image, exposure)[CROP].repeat(ZOOM, axis=0).repeat(ZOOM, axis=1) for image in images]
    gap = np.full((panels[0].shape[0], GAP, 3), 255, dtype=np.uint8)
    row = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    target = ROOT / "docs" / "images" / "demo.png"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(encode_png(np.ascontiguousarray(row)))
    print(f"{target}: {row.shape[1]}x{row.shape[0]}, {target.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
