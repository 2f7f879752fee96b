"""Draw docs/images/blender-shots.webp: where `high` is furthest from the reference on a random shot of each kind.

    python -m benchmarks.pictures.blender_shots FRAMES --foreign FOLDER

``FOLDER`` is the parent of the folder ``factory`` that `benchmarks/foreign/factory` renders into. Each row shows a
part: noisy, Open Image Denoise at its best, `high`, `auto`, the reference.
"""

from __future__ import annotations

import numpy as np
from PIL import Image

from benchmarks.pictures.detail import ask_scenes, enlarge, join
from benchmarks.pictures.worst import FOLDER, choose_part
from benchmarks.users.__main__ import make_shot
from benchmarks.users.methods import METHODS
from lobewise.display.tones import choose_exposure

SHOTS = ("bokeh_0", "foliage_1", "hair_0", "jewels_0", "fog_0", "street_1")
SPP = 16
COLUMNS = ("noisy", "oidn", "high", "auto")


def main() -> None:
    """Draw."""
    scenes, rows = ask_scenes(__doc__), []
    for name in SHOTS:
        scene = scenes[f"factory/{name}"]
        shot = make_shot(scene, scene.read(SPP), "all", SPP)
        assert shot is not None
        images = {column: METHODS[column](shot, {}) for column in COLUMNS}
        reference = np.mean(scene.reference_images, axis=0, dtype=np.float32)
        part, exposure = choose_part(images["high"], reference), choose_exposure(reference)
        rows.append(join([enlarge(image, exposure, part) for image in (*images.values(), reference)], 1))
    Image.fromarray(join(rows, 0)).save(FOLDER / "blender-shots.webp", quality=85)


if __name__ == "__main__":
    main()
