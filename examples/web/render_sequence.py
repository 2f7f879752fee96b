"""Render the sequence of the page in the browser: ``showroom``, an orbit of the camera past moving objects.

    python examples/web/render_sequence.py

It writes ``showroom-sequence.bin.gz`` beside this file. Rendering takes half a minute on two cores.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import lobewise
from lobewise.exporting.shaders.bundle import pack_frames
from lobewise.exporting.shaders.web import SEQUENCE
from lobewise.render import MovingScene, find_orbit_centre, get_camera, load_scene, make_orbit, render_sequence

WIDTH, HEIGHT, FRAMES, SPP = 224, 128, 10, 1
DEGREES_PER_FRAME = 0.6


def render(width: int, height: int, frames: int, spp: int) -> list[lobewise.Frame]:
    """Return the frames of the sequence."""
    scene = load_scene("showroom", width=width, height=height)
    cameras = make_orbit(get_camera(scene), find_orbit_centre(scene), frames, DEGREES_PER_FRAME)
    del scene
    moving = MovingScene("showroom", width, height)
    return [frame for frame in render_sequence(moving, cameras, spp=spp, seed=7) if isinstance(frame, lobewise.Frame)]


def main() -> None:
    """Write the file and tell its size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=SEQUENCE)
    parser.add_argument("--width", type=int, default=WIDTH)
    parser.add_argument("--height", type=int, default=HEIGHT)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--spp", type=int, default=SPP)
    asked = parser.parse_args()
    packed = pack_frames(render(asked.width, asked.height, asked.frames, asked.spp))
    asked.output.write_bytes(packed)
    print(f"{asked.output}: {len(packed) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
