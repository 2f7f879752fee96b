"""Render the frame and the reference that `lobewise demo` shows, into the package.

Run as ``python -m benchmarks.pictures.demo_frame``; the reference takes minutes. The scene is a printed sheet in a
mirror: only its reflection is in the picture, so albedo and normal of the surface that a pixel sees do not show the
print. Channels that the demonstration does not read, or can make again, are left out, and light is rounded, so that the
files are small.
"""

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmarks.common import ROOT
from lobewise.cli.demo import FRAME, REFERENCE, REFERENCE_SEED
from lobewise.io import write_frame
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.render import render_frame, render_reference
from lobewise.render.loading import build_scene
from lobewise.scenes import parts

DATA = ROOT / "src" / "lobewise" / "data"
WIDTH, HEIGHT, SPP, REFERENCE_SPP = 256, 192, 32, 2048
LIMIT_BYTES = 400_000
LIGHT_BITS, REFERENCE_BITS, DEPTH_BITS = 3, 6, 10
"""Bits of the mantissa that are kept. Steps of the light are up to 12 %, less than the noise of a pixel; it is the
noise that makes files large. Steps of the depth are a tenth of a pixel's footprint."""
GUIDE_STEPS = 256
SHEET_PIXELS = (2048, 1536)
LINES = (
    ("LOBEWISE", 220),
    ("COMPARES WHAT", 168),
    ("EACH PIXEL REFLECTS", 134),
    ("SO A MIRROR KEEPS THE PRINT", 108),
    ("OF A SHEET BEHIND THE CAMERA", 94),
    ("AND LETTERS THAT SAMPLES SHOW", 82),
    ("ARE LETTERS IN THE CLEAN PICTURE", 70),
)
"""Lines of the sheet, each with the height of its letters in pixels of the sheet."""
PAPER, INK = (0.85, 0.80, 0.66), (0.06, 0.09, 0.20)


def print_sheet() -> NDArray[np.float64]:
    """Return the sheet as it must lie behind the camera to be read in a mirror, (rows, columns, 3)."""
    picture = Image.new("L", SHEET_PIXELS, 0)
    draw = ImageDraw.Draw(picture)
    top = 60.0
    for text, size in LINES:
        font = ImageFont.load_default(size)
        draw.text(((SHEET_PIXELS[0] - draw.textlength(text, font=font)) / 2, top), text, font=font, fill=255)
        top += 1.32 * size
    ink = (np.asarray(picture) / 255.0)[::-1, ::-1, None]
    return np.array(PAPER) * (1.0 - ink) + np.array(INK) * ink


def make_scene(width: int, height: int) -> dict[str, Any]:
    """Return the scene as a description for `lobewise.render.loading.build_scene`."""
    return {
        **parts.scene((0.5, 1.5, 2.6), (0.06, 1.42, 0), 33.0, width, height),
        "mirror": parts.rectangle((0, 1.45, -0.4), (0, 1.45, 4), (1.2, 0.95), parts.mirror((0.92, 0.92, 0.92))),
        "frame": parts.rectangle((0, 1.45, -0.42), (0, 1.45, 4), (1.32, 1.07), parts.plastic((0.45, 0.2, 0.08), 0.2)),
        "shelf": parts.box((0, 0.42, 0.2), (1.6, 0.03, 0.45), parts.plastic((0.5, 0.3, 0.15), 0.2)),
        "gold": parts.sphere((-0.72, 0.72, 0.2), 0.27, parts.metal("gold", 0.18)),
        "ball": parts.sphere((0.72, 0.68, 0.25), 0.23, parts.plastic((0.1, 0.42, 0.12), 0.1)),
        "sheet": parts.rectangle(
            (-0.85, 1.45, 3), (0, 1.45, 0), (1.7, 1.28), parts.diffuse(parts.texture(print_sheet()))
        ),
        "lamp": parts.light((0, 3.98, 1.2), (0, 0, 1.2), (1.6, 1.2), (3.2, 3.0, 2.8)),
        **parts.walls(
            floor=((0, 0, 0), (0, 1, 0), (5, 7), (0.30, 0.16, 0.08)),
            back=((0, 2.5, -0.5), (0, 2.5, 4), (5, 2.5), (0.20, 0.26, 0.36)),
            front=((0, 2.5, 5), (0, 2.5, 0), (5, 2.5), (0.5, 0.5, 0.45)),
            left=((-3, 2.5, 1), (0, 2.5, 1), (6, 2.5), (0.70, 0.14, 0.07)),
            right=((3, 2.5, 1), (0, 2.5, 1), (6, 2.5), (0.04, 0.36, 0.40)),
            ceiling=((0, 4, 2), (0, 0, 2), (5, 5), (0.7, 0.7, 0.7)),
        ),
    }


def round_relative(image: FloatArray, bits: int) -> FloatArray:
    """Return an image whose values have so many bits of mantissa, behind the first."""
    mantissa, exponent = np.frexp(image)
    steps = 2.0 ** (bits + 1)
    return np.ldexp(np.round(mantissa * steps) / steps, exponent).astype(np.float32)


def round_steps(image: FloatArray) -> FloatArray:
    """Return an image in [-1, 1] in steps of 1 / `GUIDE_STEPS`."""
    return (np.round(image * GUIDE_STEPS) / GUIDE_STEPS).astype(np.float32)


def make_small(frame: Frame) -> Frame:
    """Return what the filters of the demonstration read, rounded."""
    full = frame.gbuffer
    rounded = ("normal", "mean_normal", "mean_diffuse_albedo", "mean_specular_albedo")
    exact = ("alpha_u", "lobe_kind", "diffuse_albedo", "specular_albedo")
    images = {name: round_steps(full.require(name, "the demonstration")) for name in rounded}
    images |= {name: full.require(name, "the demonstration") for name in exact}
    images["depth"] = round_relative(full.require("depth", "the demonstration"), DEPTH_BITS)
    halves = [half for half in (frame.half_a, frame.half_b) if half is not None]
    mean, half_a, half_b = (Radiance(round_relative(one.color, LIGHT_BITS)) for one in (frame.radiance, *halves))
    return Frame(mean, GBuffer(**images), camera=frame.camera, spp=frame.spp, half_a=half_a, half_b=half_b)


def write(frame: Frame, reference: Frame) -> None:
    """Write both files into the package, and tell their sizes."""
    write_frame(DATA / FRAME, make_small(frame))
    small = Frame(Radiance(round_relative(reference.radiance.color, REFERENCE_BITS)), spp=reference.spp)
    write_frame(DATA / REFERENCE, small)
    for name in (FRAME, REFERENCE):
        size = (DATA / name).stat().st_size
        print(f"{name}: {size / 1e3:.0f} kB")
        if size > LIMIT_BYTES:
            raise SystemExit(f"{name} should stay below {LIMIT_BYTES / 1e3:.0f} kB")


def main() -> None:
    """Render and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--spp", type=int, default=SPP)
    parser.add_argument("--reference-spp", type=int, default=REFERENCE_SPP)
    options = parser.parse_args()
    scene = build_scene(make_scene(WIDTH, HEIGHT))
    reference = render_reference(scene, spp=options.reference_spp, seed=REFERENCE_SEED)
    write(render_frame(scene, spp=options.spp), reference)


if __name__ == "__main__":
    main()
