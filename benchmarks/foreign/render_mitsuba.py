"""A frame of Mitsuba's own integrators with the guides that they know, from a scene made in code.

    python -m benchmarks.foreign.render_mitsuba FOLDER [--spp 4] [--reference 2048] [--size 192x144]

Files are those that Mitsuba writes for the integrator ``aov`` around ``path``: ``metals_SPP_1.exr``, and the reference
in two halves of different seeds, ``metals_reference_1.exr`` and ``metals_reference_2.exr``.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from lobewise.render.loading import build_scene, load_mitsuba
from lobewise.scenes import parts

AOVS = "albedo:albedo,normals:sh_normal,position:position"
SPP_OF_A_PASS = 64
"""Samples that are rendered at once, so that memory suffices."""


def make_metals(width: int, height: int) -> Any:
    """Return balls, rods and a block of rough metals with a mirror and small lamps in a room."""
    tiles = parts.plastic(parts.checkerboard((0.5, 0.46, 0.42), (0.09, 0.1, 0.12), (14.0, 14.0)), 0.12)
    items: dict[str, Any] = {
        **parts.scene((0.3, 2.1, 6.4), (0.0, 0.95, 0.0), 36.0, width, height),
        **parts.walls(
            back=((0, 3, -2.6), (0, 3, 0), (7, 3), (0.55, 0.5, 0.45)),
            left=((-4.2, 3, 0), (0, 3, 0), (8, 3), (0.2, 0.35, 0.6)),
            right=((4.2, 3, 0), (0, 3, 0), (8, 3), (0.65, 0.25, 0.15)),
            front=((0, 3, 7.5), (0, 3, 0), (7, 3), (0.7, 0.65, 0.5)),
        ),
        "floor": parts.rectangle((0, 0, 0), (0, 1, 0), (7, 7), tiles),
        "mirror": parts.rectangle((1.9, 1.5, -2.55), (1.9, 1.5, 0), (0.85, 1.0), parts.mirror((0.9, 0.9, 0.9))),
        "block": parts.box((-2.5, 0.7, -1.3), (0.6, 0.7, 0.6), parts.metal("aluminium", 0.35, 0.08), 25.0),
        "window": parts.light((-1.5, 5.5, 3.5), (0, 0, 0), (1.1, 0.8), (17.0, 18.0, 20.0)),
    }
    # Roughness doubles from ball to ball: from a mirror image of the lamps to a sheen.
    for number, (name, alpha) in enumerate((("gold", 0.03), ("copper", 0.1), ("silver", 0.2), ("gold", 0.4))):
        items[f"ball{number}"] = parts.sphere((-1.8 + 1.2 * number, 0.55, 0.2), 0.55, parts.metal(name, alpha))
    for number in range(6):
        rod = {"type": "cylinder", "p0": [-1.5 + 0.45 * number, 0, -1.6], "p1": [-1.5 + 0.45 * number, 2.2, -1.6]}
        items[f"rod{number}"] = {**rod, "radius": 0.07, "bsdf": parts.metal("aluminium", 0.05 + 0.06 * number)}
        hue = (30.0, 22.0, 9.0) if number % 2 else (8.0, 16.0, 30.0)
        items[f"lamp{number}"] = parts.bulb((-2.4 + 0.95 * number, 0.12, 1.6 + 0.25 * (number % 2)), 0.09, hue)
    return build_scene(items)


def render(scene: Any, path: Path, spp: int, seed: int) -> None:
    """Render a scene into a file, unless it is there."""
    if path.exists():
        return
    mitsuba = load_mitsuba()
    integrator = mitsuba.load_dict({"type": "aov", "aovs": AOVS, "img": {"type": "path", "max_depth": 8}})
    total: Any = 0.0
    passes = max(1, spp // SPP_OF_A_PASS)
    for number in range(passes):
        film = scene.sensors()[0].film()
        mitsuba.render(scene, spp=spp // passes, integrator=integrator, seed=1000 * seed + number)
        bitmap = film.bitmap()
        total = total + mitsuba.TensorXf(bitmap) / passes
    names = [channel.name for channel in bitmap.struct_()]
    mean = mitsuba.Bitmap(total, channel_names=names)
    mean.metadata()["generatedBy"] = f"Mitsuba version {mitsuba.__version__}"
    mean.write(str(path))
    print(f"wrote {path}", flush=True)


def main() -> None:
    """Render what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--spp", type=int, default=4)
    parser.add_argument("--reference", type=int, default=2048)
    parser.add_argument("--size", default="192x144")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    scene = make_metals(*map(int, asked.size.split("x")))
    render(scene, asked.folder / f"metals_{asked.spp}_1.exr", asked.spp, 1)
    for half in (1, 2):
        render(scene, asked.folder / f"metals_reference_{half}.exr", asked.reference // 2, 7776 + half)


if __name__ == "__main__":
    main()
