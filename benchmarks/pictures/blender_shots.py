"""Draw docs/images/blender-shots.webp: where `high` is furthest from the reference on a random shot of each kind.

    python -m benchmarks.pictures.blender_shots FRAMES --foreign FOLDER

``FOLDER`` is the parent of the folder ``factory`` that `benchmarks/foreign/factory` renders into. Each row shows a
part: noisy, Open Image Denoise at its best, `high`, `auto`, the reference.
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.common import ROOT
from benchmarks.users.__main__ import make_shot
from benchmarks.users.methods import METHODS
from benchmarks.users.scenes import list_scenes
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.peers import require_oidn
from lobewise.records.frame import FloatArray

SHOTS = ("bokeh_0", "foliage_1", "hair_0", "jewels_0", "fog_0", "street_1")
SPP = 16
COLUMNS = ("noisy", "oidn", "high", "auto")
SIDE_PIXELS, STRIDE_PIXELS = 72, 8
"""Rows and columns of the part that is shown, and the distance of the parts that are compared."""
SCALE, GAP = 3, 6


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


def join(panels: list[NDArray[np.uint8]], axis: int) -> NDArray[np.uint8]:
    """Return pictures side by side or above each other, white between them."""
    shape = list(panels[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, 255, np.uint8)
    return np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=axis)


def main() -> None:
    """Draw."""
    require_oidn()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--foreign", type=Path, required=True, help="frames of other renderers")
    asked = parser.parse_args()
    scenes, rows = {scene.key: scene for scene in list_scenes(asked.frames, asked.foreign)}, []
    for name in SHOTS:
        scene = scenes[f"factory/{name}"]
        shot = make_shot(scene, scene.read(SPP), "all", SPP)
        images = {column: METHODS[column](shot, {}) for column in COLUMNS}
        reference = np.mean(scene.reference_images, axis=0, dtype=np.float32)
        part, exposure = choose_part(images["high"], reference), choose_exposure(reference)
        panels = [map_tones(image, exposure)[part] for image in (*images.values(), reference)]
        rows.append(join([panel.repeat(SCALE, axis=0).repeat(SCALE, axis=1) for panel in panels], 1))
    Image.fromarray(join(rows, 0)).save(ROOT / "docs" / "images" / "blender-shots.webp", quality=85)


if __name__ == "__main__":
    main()
