"""Write the picture of what taking back detail does: crops of windows, of lamps in mirrors and of textures.

    python -m benchmarks.pictures.detail FRAMES --foreign FOLDER

The frames are those of `benchmarks.users`, with one albedo, normal and depth beside the color, and without halves.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import ROOT
from benchmarks.users.__main__ import make_shot
from benchmarks.users.scenes import Scene, list_scenes
from lobewise.denoising import denoise
from lobewise.denoising.automatic import resolve_all
from lobewise.denoising.bad_pixels import mark_bad_pixels
from lobewise.denoising.chain import filter_rows
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.frame import FloatArray, Frame
from lobewise.guides.usable import bound_guides
from lobewise.io.png import encode_png
from lobewise.peers import require_oidn
from lobewise.settings import DenoiseSettings

GUIDES = "plain"
CROPS = (
    ("own/street", 64, (slice(60, 124), slice(0, 64))),
    ("blender-5.2/gloss", 16, (slice(56, 120), slice(4, 68))),
    ("blender-5.2/textured", 1024, (slice(96, 160), slice(96, 160))),
    ("blender-5.2/interior", 128, (slice(36, 100), slice(192, 256))),
    ("blender-5.2/interior", 128, (slice(52, 116), slice(0, 64))),
)
"""Scene, samples per pixel, rows and columns."""
SCALE, GAP = 3, 6
TARGET = ROOT / "docs" / "images" / "detail.png"


def filter_alone(frame: Frame) -> NDArray[np.float32]:
    """Return what the quality "high" makes of a frame before detail is taken back."""
    frame = bound_guides(frame)
    settings = resolve_all(frame, DenoiseSettings(quality="high", with_oidn=False))
    before = filter_rows(frame, settings, (), mark_bad_pixels(frame)).taken_from
    assert before is not None
    return before.image


def join(panels: list[NDArray[np.uint8]], axis: int) -> NDArray[np.uint8]:
    """Return pictures side by side or above each other, white between them."""
    shape = list(panels[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, 255, np.uint8)
    return np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=axis)


def enlarge(image: FloatArray, exposure: float, part: tuple[slice, slice]) -> NDArray[np.uint8]:
    """Return a part of an image as it is shown, every pixel as a square of `SCALE` pixels."""
    return map_tones(image, exposure)[part].repeat(SCALE, axis=0).repeat(SCALE, axis=1)


def ask_scenes(description: str | None) -> dict[str, Scene]:
    """Return the scenes of the bench in the folders of the command line, by key."""
    require_oidn()
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--foreign", type=Path, required=True, help="frames of other renderers")
    asked = parser.parse_args()
    return {scene.key: scene for scene in list_scenes(asked.frames, asked.foreign)}


def main() -> None:
    """Write docs/images/detail.png: noisy, `high` before and after detail is taken back, the default, reference."""
    scenes, rows = ask_scenes(__doc__), []
    for key, spp, crop in CROPS:
        scene = scenes[key]
        shot = make_shot(scene, scene.read(spp), GUIDES, spp)
        assert shot is not None
        frame, reference = shot.frame, np.mean(scene.reference_images, axis=0, dtype=np.float32)
        images = [
            frame.radiance.color,
            filter_alone(frame),
            denoise(frame, quality="high").image,
            denoise(frame).image,
            reference,
        ]
        exposure = choose_exposure(reference)
        rows.append(join([enlarge(image, exposure, crop) for image in images], 1))
    picture = join(rows, 0)
    TARGET.write_bytes(encode_png(np.ascontiguousarray(picture)))
    print(f"{TARGET}: {picture.shape[1]}x{picture.shape[0]}, {TARGET.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
