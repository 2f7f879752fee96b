"""Write the two pictures of the site's front page: a built-in scene, noisy and denoised.

python -m benchmarks.pictures.front
"""

from PIL import Image

import lobewise
from benchmarks.common import ROOT
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.render import load_scene, render_frame

SCENE, WIDTH, HEIGHT, SPP = "stilllife", 1200, 675, 8
WEBP_QUALITY = 85


def main() -> None:
    """Write docs/_static/front-noisy.webp and docs/_static/front-clean.webp."""
    frame = render_frame(load_scene(SCENE, width=WIDTH, height=HEIGHT), spp=SPP)
    clean = lobewise.denoise(frame).image
    exposure = choose_exposure(clean)
    for name, image in (("noisy", frame.radiance.color), ("clean", clean)):
        target = ROOT / "docs" / "_static" / f"front-{name}.webp"
        Image.fromarray(map_tones(image, exposure)).save(target, quality=WEBP_QUALITY, method=6)
        print(f"{target}: {target.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
