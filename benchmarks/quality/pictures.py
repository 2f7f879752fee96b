"""Crops of the held-out scenes for docs/quality_results.md: what each method makes of the same noise, side by side."""

from __future__ import annotations

import io
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from benchmarks.common import ROOT, describe_machine
from benchmarks.quality.frames import SAMPLES, SEEDS, Bench, Mask, classify_pixels
from benchmarks.quality.methods import METHODS, Tuning
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.frame import FloatArray

IMAGES = ROOT / "docs" / "images"
SHOWN = ("noisy", "single SG", "balanced", "high", "oidn", "high + oidn")
"""Panels from left to right; the reference follows."""
TELLING = ("anisotropic", "near-mirror", "glossy", "rough", "silhouette")
"""What a crop is to show, in this order, until there are enough."""
CROPS = 2
SIDE = 128
GAP = 4
LABEL_ROWS = 18
SPP = 4
COLORS = 255


def make_pictures(bench: Bench, scenes: tuple[str, ...], names: list[str], tuning: Tuning) -> dict[str, Any]:
    """Write docs/images/quality-SCENE.png for the scenes; return what each shows."""
    return {scene: make_picture(bench, scene, [name for name in SHOWN if name in names], tuning) for scene in scenes}


def make_picture(bench: Bench, scene: str, names: list[str], tuning: Tuning) -> dict[str, Any]:
    """Write the picture of one scene: a row for each crop, a column for each method, labels on top."""
    frame, (reference, _) = bench.fetch(scene, SPP, SEEDS[0]), bench.fetch_reference(scene)
    images = {name: METHODS[name].run(frame, tuning) for name in names}
    crops = choose_crops(classify_pixels(bench.fetch(scene, max(SAMPLES), SEEDS[0])), min(SIDE, bench.size))
    side = min(SIDE, bench.size)
    strips = [_join([_draw_label(name, side) for name in (*names, "reference")])]
    panels: list[FloatArray] = [*images.values(), reference]
    for row, column in crops.values():
        part = np.s_[row : row + side, column : column + side]
        # Each crop has an exposure of its own, or what lies in the shade were black.
        exposure = choose_exposure(reference[part])
        strips.append(_join([map_tones(image[part], exposure) for image in panels]))
    picture = np.concatenate([each for strip in strips for each in (strip, _make_gap(GAP, strip.shape[1]))][:-1])
    target = IMAGES / f"quality-{scene}.png"
    target.write_bytes(encode_small(picture))
    print(f"{target}: {picture.shape[1]}x{picture.shape[0]}, {target.stat().st_size / 1e3:.0f} kB", flush=True)
    return {
        "spp": SPP,
        "panels": [*names, "reference"],
        "crops": {kind: list(place) for kind, place in crops.items()},
        "commit": describe_machine()["commit"],
    }


def choose_crops(masks: dict[str, Mask], side: int) -> dict[str, tuple[int, int]]:
    """Return by class the top left corners (row, column) of the squares that show most of it and do not overlap."""
    crops: dict[str, tuple[int, int]] = {}
    for kind in TELLING:
        mask = masks[kind]
        if len(crops) == CROPS or not mask.any():
            continue
        rows, columns = mask.shape[0] - side + 1, mask.shape[1] - side + 1
        # The filter's value at the centre of a window is the mean over it.
        share = uniform_filter(mask.astype(np.float64), side, mode="constant")
        share = share[side // 2 : side // 2 + rows, side // 2 : side // 2 + columns].copy()
        for row, column in crops.values():
            share[max(0, row - side + 1) : row + side, max(0, column - side + 1) : column + side] = 0.0
        if share.max() > 0.0:
            place = np.unravel_index(int(share.argmax()), share.shape)
            crops[kind] = (int(place[0]), int(place[1]))
    return crops


def encode_small(picture: NDArray[np.uint8]) -> bytes:
    """Return a PNG with a palette of its own: a third of the size, and noise hides the difference."""
    from PIL import Image

    buffer = io.BytesIO()
    reduced = Image.fromarray(picture).quantize(COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    reduced.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _join(panels: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    gap = _make_gap(panels[0].shape[0], GAP)
    return np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)


def _make_gap(rows: int, columns: int) -> NDArray[np.uint8]:
    return np.full((rows, columns, 3), 255, dtype=np.uint8)


@lru_cache(maxsize=16)
def _draw_label(text: str, width: int) -> NDArray[np.uint8]:
    """Return dark text on white, in the middle of a strip."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGB", (width, LABEL_ROWS), (255, 255, 255))
    ImageDraw.Draw(image).text(
        (width // 2, LABEL_ROWS // 2), text, fill=(40, 40, 40), font=ImageFont.load_default(13), anchor="mm"
    )
    return np.asarray(image)
