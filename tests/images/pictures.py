"""Pictures of a failure: noisy, result, committed result and reference side by side."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lobewise.display.tones import choose_exposure, map_tones
from lobewise.io.png import encode_png
from tests.images.frames import BASELINES
from tests.images.measuring import Measured

SCALE = 4
"""Width and height of a pixel in the pictures."""
GAP = 2
"""Columns between two images, before they are enlarged."""
JPEG_QUALITY = 90


def show(measured: Measured, name: str) -> NDArray[np.uint8]:
    """Return one of the pictures as sRGB; all have the exposure of the reference."""
    return map_tones(measured.pictures[name], choose_exposure(measured.pictures["reference"]))


def write_comparison(path: Path, measured: Measured, baseline: Path) -> None:
    """Write noisy, result, committed result and reference as a PNG."""
    images = [show(measured, "noisy"), show(measured, "result"), show(measured, "reference")]
    if baseline.exists():
        with Image.open(baseline) as committed:
            images.insert(2, np.asarray(committed.convert("RGB")))
    gap = np.full((images[0].shape[0], GAP, 3), 255, dtype=np.uint8)
    row = np.concatenate([part for image in images for part in (image, gap)][:-1], axis=1)
    path.write_bytes(encode_png(np.ascontiguousarray(row.repeat(SCALE, axis=0).repeat(SCALE, axis=1))))


def write_baseline(path: Path, measured: Measured) -> None:
    """Write the result as a small JPEG, for people alone."""
    out = io.BytesIO()
    Image.fromarray(show(measured, "result")).save(out, "JPEG", quality=JPEG_QUALITY, subsampling=0, optimize=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(out.getvalue())


def locate_baseline(name: str, quality: str) -> Path:
    """Return the file of a committed picture, which "balanced" and "high" have."""
    return BASELINES / f"{name}-{quality}.jpg"
