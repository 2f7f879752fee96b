"""Write pictures of the frames on which the quality "high" is furthest behind Open Image Denoise.

    python -m benchmarks.pictures.worst FRAMES --foreign FOLDER

For each set of guides it takes the three held-out frames of 4 or 16 samples per pixel with the largest error over that
of Open Image Denoise, as `benchmarks/results/users.json` has them, one for each scene. Of each frame it shows the part
in which the error is largest: noisy, `balanced`, `high`, Open Image Denoise at its best, reference.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import RESULTS, ROOT
from benchmarks.pictures.detail import ask_scenes, enlarge, join
from benchmarks.users.__main__ import make_shot
from benchmarks.users.guides import GUIDE_SETS
from benchmarks.users.methods import run_oidn
from benchmarks.users.scenes import Scene
from benchmarks.users.summary import is_known, list_rows
from lobewise.denoising import denoise
from lobewise.display.tones import choose_exposure
from lobewise.frame import FloatArray
from lobewise.io.png import encode_png

SPPS = 4, 16
FRAMES_SHOWN = 3
SIDE_PIXELS, STRIDE_PIXELS = 72, 8
"""Rows and columns of the part that is shown, and the distance of the parts that are compared."""
FOLDER = ROOT / "docs" / "images"


def list_worst(guides: str) -> Iterator[tuple[str, int, float]]:
    """Yield scene, samples per pixel, and error over that of Open Image Denoise, the worst frame first."""
    rows = list_rows(json.loads((RESULTS / "users.json").read_text())["scenes"])
    found, seen = [], set()
    for row in rows:
        high, peer = row.methods.get("high"), row.methods.get("oidn")
        if not (row.held_out and row.guides == guides and row.spp in SPPS and high and peer):
            continue
        if is_known(high) and is_known(peer):
            found.append((high["rel_mse"] / peer["rel_mse"], row.scene, row.spp))
    for ratio, scene, spp in sorted(found, reverse=True):
        if scene not in seen and len(seen) < FRAMES_SHOWN:
            seen.add(scene)
            yield scene, spp, ratio


def choose_part(image: FloatArray, reference: FloatArray) -> tuple[slice, slice]:
    """Return the rows and columns in which an image is furthest from its reference."""
    apart = ((image - reference) ** 2 / (reference**2 + 0.01)).mean(axis=-1)
    rows, columns = apart.shape
    places = [
        (np.s_[top : top + SIDE_PIXELS], np.s_[left : left + SIDE_PIXELS])
        for top in range(0, max(rows - SIDE_PIXELS, 0) + 1, STRIDE_PIXELS)
        for left in range(0, max(columns - SIDE_PIXELS, 0) + 1, STRIDE_PIXELS)
    ]
    # A few pixels of extreme error would choose the part alone.
    bound = np.quantile(apart, 0.999)
    return max(places, key=lambda place: float(np.minimum(apart[place], bound).mean()))


def draw_row(scene: Scene, guides: str, spp: int) -> NDArray[np.uint8]:
    """Return one frame's row of panels."""
    shot = make_shot(scene, scene.read(spp), guides, spp)
    assert shot is not None
    reference = np.mean(scene.reference_images, axis=0, dtype=np.float32)
    high = denoise(shot.frame, quality="high").image
    images = [shot.frame.radiance.color, denoise(shot.frame, quality="balanced").image, high, run_oidn(shot, {})]
    part, exposure = choose_part(high, reference), choose_exposure(reference)
    return join([enlarge(image, exposure, part) for image in (*images, reference)], 1)


def main() -> None:
    """Write docs/images/worst-GUIDES.png for every set of guides, and say which frames they show."""
    scenes = ask_scenes(__doc__)
    for guides in GUIDE_SETS:
        shown = list(list_worst(guides))
        picture = join([draw_row(scenes[key], guides, spp) for key, spp, _ in shown], 0)
        (FOLDER / f"worst-{guides}.png").write_bytes(encode_png(np.ascontiguousarray(picture)))
        print(guides, *(f"{key} at {spp} spp: {ratio:.2f}" for key, spp, ratio in shown), sep="\n  ")


if __name__ == "__main__":
    main()
