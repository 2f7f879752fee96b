"""Render the sequence of the page in the browser: ``showroom``, an orbit of the camera past moving objects.

    python -m examples.web.render_sequence

It writes ``showroom-sequence.bin.gz`` beside this file. Rendering takes half a minute on two cores.
"""

from __future__ import annotations

from examples.web.make_page import SEQUENCE
from examples.web.packing import pack_frames

from lobewise.render import MovingScene, find_orbit_centre, get_camera, load_scene, make_orbit, render_sequence

WIDTH, HEIGHT, FRAMES = 224, 128, 10
DEGREES_PER_FRAME = 0.6


def main() -> None:
    """Write the file and tell its size."""
    scene = load_scene("showroom", width=WIDTH, height=HEIGHT)
    cameras = make_orbit(get_camera(scene), find_orbit_centre(scene), FRAMES, DEGREES_PER_FRAME)
    del scene
    frames = render_sequence(MovingScene("showroom", WIDTH, HEIGHT), cameras, spp=1, seed=7)
    SEQUENCE.write_bytes(pack_frames(list(frames)))
    print(f"{SEQUENCE}: {SEQUENCE.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
