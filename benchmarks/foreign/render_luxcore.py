"""Frames of LuxCoreRender with every film output on, from scenes made in code. Runs where `pyluxcore` is.

    python render_luxcore.py FOLDER [--scenes a,b] [--spp 8,32,128] [--seeds 1,2] [--reference 4096] [--size 256x192]
                                    [--without SHADING_NORMAL,...] [--threads 1]

Filter, sampler and light paths are LuxCore's defaults. A frame is a folder with a file for every output, as LuxCore
writes them: ``SCENE_SPP_SEED/RGB.exr``, ``.../DEPTH.exr`` and so on. The reference comes in two halves of different
seeds, ``SCENE_reference_1`` and ``SCENE_reference_2``, so that its own noise is known. LuxCore looks at the clock for
whether it has its samples, so a frame may have a few more than its name says: SAMPLECOUNT tells. The outputs
MATERIAL_ID and OBJECT_ID are left out: LuxCore refuses to write them as EXR. ``--without`` leaves out others, as a
person does who switches on only what a page names.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyluxcore

OUTPUTS = (
    "RGB", "ALPHA", "DEPTH", "POSITION", "GEOMETRY_NORMAL", "SHADING_NORMAL", "AVG_SHADING_NORMAL", "ALBEDO",
    "DIRECT_DIFFUSE", "INDIRECT_DIFFUSE", "DIRECT_GLOSSY", "INDIRECT_GLOSSY", "INDIRECT_SPECULAR", "EMISSION",
    "SAMPLECOUNT",
)  # fmt: skip
POLL = 0.002
"""Seconds between two looks at whether all samples are there."""
Point = tuple[float, float, float]


class Maker:
    """A scene under construction."""

    def __init__(self) -> None:
        self.scene = pyluxcore.Scene()

    def put(self, text: str) -> None:
        """Set properties, a line each, without the word that all begin with."""
        found = pyluxcore.Properties()
        found.SetFromString("".join(f"scene.{line.strip()}\n" for line in text.strip().splitlines()))
        self.scene.Parse(found)

    def add_mesh(
        self,
        name: str,
        material: str,
        points: list[Point],
        faces: list[tuple[int, int, int]],
        normals: list[Point] | None = None,
    ) -> None:
        """Add an object with a mesh of its own, flat without normals."""
        self.scene.DefineMesh(f"{name}_mesh", points, faces, normals, None, None, None)
        self.put(f"objects.{name}.shape = {name}_mesh\nobjects.{name}.material = {material}")

    def add_ball(self, name: str, material: str, radius: float, center: Point, steps: int = 48) -> None:
        """Add a sphere of smooth normals."""
        rows, wide = steps // 2, steps + 1
        angles = [(math.pi * i / rows, 2.0 * math.pi * j / steps) for i in range(rows + 1) for j in range(wide)]
        normals = [(math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a)) for a, b in angles]
        points = [tuple(c + radius * k for c, k in zip(center, normal, strict=True)) for normal in normals]
        faces = []
        for i in range(rows):
            for first in range(i * wide, i * wide + steps):
                below = first + wide
                # At a pole one of the two triangles has no area.
                faces += [(first, below, first + 1)] * (i > 0) + [(first + 1, below, below + 1)] * (i < rows - 1)
        self.add_mesh(name, material, points, faces, normals)

    def add_sheet(self, name: str, material: str, corner: Point, one: Point, other: Point) -> None:
        """Add a parallelogram; it faces where its first edge turns counter-clockwise into its second."""
        points = [tuple(c + a * u + b * v for c, u, v in zip(corner, one, other, strict=True)) for a, b in _CORNERS]
        self.add_mesh(name, material, points, [(0, 1, 2), (0, 2, 3)])

    def add_box(self, name: str, material: str, center: Point, size: Point, turn: float = 0.0) -> None:
        """Add a box, turned about the vertical."""
        cosine, sine = math.cos(turn), math.sin(turn)
        points, faces = [], []
        for axis in range(3):
            for side in (-0.5, 0.5):
                first = len(points)
                for a, b in _CORNERS if side > 0.0 else _CORNERS[::-1]:
                    local = [0.0, 0.0, 0.0]
                    local[axis], local[(axis + 1) % 3], local[(axis + 2) % 3] = side, a - 0.5, b - 0.5
                    x, y, z = (k * s for k, s in zip(local, size, strict=True))
                    points.append((center[0] + cosine * x - sine * y, center[1] + sine * x + cosine * y, center[2] + z))
                faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
        self.add_mesh(name, material, points, faces)

    def add_disney(self, name: str, color: str, roughness: str, more: str = "") -> str:
        """Add a material of Disney's model, ``color`` and ``roughness`` values or textures; return its name."""
        lines = ["type = disney", f"basecolor = {color}", f"roughness = {roughness}", *more.strip().splitlines()]
        self.put("\n".join(f"materials.{name}.{line.strip()}" for line in lines))
        return name

    def add_matte(self, name: str, color: str) -> None:
        """Add a material that is diffuse alone."""
        self.put(f"materials.{name}.type = matte\nmaterials.{name}.kd = {color}")

    def add_texture(self, name: str, kind: str, scale: float, more: str) -> None:
        """Add a solid texture in world space."""
        matrix = f"{scale} 0 0 0 0 {scale} 0 0 0 0 {scale} 0 0.013 0.017 0.5 1"
        lines = [f"type = {kind}", "mapping.type = globalmapping3d", f"mapping.transformation = {matrix}"]
        lines += more.strip().splitlines()
        self.put("\n".join(f"textures.{name}.{line.strip()}" for line in lines))

    def mix(self, name: str, amount: str, one: str, other: str) -> None:
        """Add a texture between two values by a third."""
        self.put(
            f"textures.{name}.type = mix\ntextures.{name}.amount = {amount}\n"
            f"textures.{name}.texture1 = {one}\ntextures.{name}.texture2 = {other}"
        )

    def add_lamp(self, name: str, corner: Point, one: Point, other: Point, light: str) -> None:
        """Add a rectangle that glows."""
        self.put(
            f"materials.{name}.type = matte\nmaterials.{name}.kd = 0 0 0\nmaterials.{name}.emission = {light}\n"
            f"materials.{name}.emission.gain = 1 1 1"
        )
        self.add_sheet(name, name, corner, one, other)

    def finish(self, sky: str, eye: Point, target: Point, angle: float) -> pyluxcore.Scene:
        """Add the sky and a camera, whose angle is the horizontal one, degrees; return the scene."""
        self.put(
            f"lights.sky.type = constantinfinite\nlights.sky.color = {sky}\n"
            "camera.type = perspective\ncamera.up = 0 0 1\n"
            f"camera.lookat.orig = {eye[0]} {eye[1]} {eye[2]}\n"
            f"camera.lookat.target = {target[0]} {target[1]} {target[2]}\n"
            f"camera.fieldofview = {angle}"
        )
        return self.scene


_CORNERS = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))


def add_floor(maker: Maker, material: str) -> None:
    """Add a wide floor."""
    maker.add_sheet("floor", material, (-10.0, -10.0, 0.0), (20.0, 0.0, 0.0), (0.0, 20.0, 0.0))


def make_gloss() -> pyluxcore.Scene:
    """Balls and a block of metals and plastics, from mirror to rough, on a chequered floor of varnish."""
    maker = Maker()
    maker.add_texture("checks", "checkerboard3d", 1.5, "texture1 = 0.6 0.55 0.5\ntexture2 = 0.12 0.1 0.1")
    maker.add_disney("tiles", "checks", "0.25")
    add_floor(maker, "tiles")
    for number, rough in enumerate((0.02, 0.15, 0.35, 0.6)):
        maker.add_disney(f"metal{number}", f"0.9 {0.75 - 0.1 * number} 0.45", f"{rough}", "metallic = 1")
        maker.add_ball(f"metal{number}", f"metal{number}", 0.7, (-2.4 + 1.6 * number, 1.2, 0.7))
        maker.add_disney(f"plastic{number}", f"{0.1 + 0.2 * number} 0.3 {0.7 - 0.2 * number}", f"{rough}")
        maker.add_ball(f"plastic{number}", f"plastic{number}", 0.45, (-2.0 + 1.35 * number, -0.7, 0.45))
    maker.add_disney("brushed", "0.8 0.8 0.85", "0.3", "metallic = 1")
    maker.add_box("block", "brushed", (0.4, 3.4, 0.8), (1.6, 1.6, 1.6), 0.5)
    maker.add_lamp("left", (-4.5, -3.5, 5.0), (0.0, 1.5, 0.0), (1.5, 0.0, -0.8), "22 22 22")
    maker.add_lamp("right", (3.7, 1.7, 4.0), (0.0, 0.6, 0.0), (0.6, 0.0, 0.4), "50 35 20")
    return maker.finish("0.15 0.18 0.24", (0.0, -7.5, 3.2), (0.0, 0.8, 0.5), 42.0)


def make_textured() -> pyluxcore.Scene:
    """Textured albedo, roughness and bumps."""
    maker = Maker()
    for name, kind, scale in (("grain", "fbm", 3.0), ("crumbs", "wrinkled", 2.0), ("spots", "fbm", 5.0)):
        maker.add_texture(name, kind, scale, "octaves = 4\nroughness = 0.5")
    maker.mix("earth", "grain", "0.7 0.5 0.3", "0.2 0.1 0.05")
    maker.add_texture("shine", "checkerboard3d", 1.5, "texture1 = 0.1\ntexture2 = 0.5")
    maker.add_disney("tiles", "earth", "shine")
    add_floor(maker, "tiles")
    maker.mix("paper", "crumbs", "0.1 0.3 0.4", "0.8 0.8 0.7")
    maker.add_matte("wall", "paper")
    maker.add_sheet("wall", "wall", (-6.0, 3.5, 0.0), (12.0, 0.0, 0.0), (0.0, 0.0, 6.0))
    maker.put("textures.bumps.type = scale\ntextures.bumps.texture1 = spots\ntextures.bumps.texture2 = 0.05")
    maker.add_disney("bumped", "0.7 0.2 0.15", "0.25", "bumptex = bumps")
    maker.add_ball("bumped", "bumped", 0.9, (-1.6, 0.3, 0.9), 64)
    maker.mix("wear", "spots", "0.05", "0.7")
    maker.add_ball("worn", maker.add_disney("worn", "0.85 0.8 0.7", "wear", "metallic = 1"), 0.9, (1.2, 0.2, 0.9), 64)
    maker.mix("stripes", "grain", "0.8 0.1 0.1", "0.9 0.9 0.9")
    maker.add_disney("paint", "stripes", "0.15", "clearcoat = 1\nclearcoatgloss = 0.95")
    maker.add_box("paint", "paint", (-0.1, -1.3, 0.45), (0.9, 0.9, 0.9), 0.2)
    maker.add_lamp("lamp", (-4.0, -5.0, 5.0), (0.0, 2.0, 0.7), (2.0, 0.0, -0.8), "16 16 16")
    return maker.finish("0.2 0.21 0.25", (0.0, -6.5, 2.6), (0.0, 0.5, 0.9), 45.0)


def make_glass() -> pyluxcore.Scene:
    """Smooth and rough glass before stripes."""
    maker = Maker()
    maker.add_texture("checks", "checkerboard3d", 2.0, "texture1 = 0.75 0.7 0.6\ntexture2 = 0.25 0.3 0.35")
    maker.add_matte("tiles", "checks")
    add_floor(maker, "tiles")
    for number, rough in enumerate((0.0, 0.05, 0.2)):
        name = f"glass{number}"
        kind = "glass" if rough == 0.0 else f"roughglass\nmaterials.{name}.uroughness = {rough}"
        rest = "" if rough == 0.0 else f"\nmaterials.{name}.vroughness = {rough}"
        tint = f"{1.0 - 0.1 * number} 0.98 0.9"
        maker.put(
            f"materials.{name}.type = {kind}{rest}\nmaterials.{name}.interiorior = 1.45\n"
            f"materials.{name}.kr = 1 1 1\nmaterials.{name}.kt = {tint}"
        )
        maker.add_ball(name, name, 0.7, (-1.8 + 1.8 * number, 0.0, 0.7), 64)
    maker.add_ball("gold", maker.add_disney("gold", "0.95 0.7 0.3", "0.2", "metallic = 1"), 0.4, (-1.0, -1.5, 0.4))
    maker.add_box("wax", maker.add_disney("wax", "0.9 0.6 0.4", "0.4"), (2.9, 1.5, 0.5), (1.0, 1.0, 1.0))
    maker.add_lamp("lamp", (2.5, 2.5, 5.0), (0.0, 1.0, -0.6), (1.0, 0.0, 0.6), "45 45 45")
    return maker.finish("0.35 0.4 0.5", (0.0, -6.5, 2.8), (0.2, 0.0, 0.5), 42.0)


def make_room() -> pyluxcore.Scene:
    """A closed room with a lamp that glows, a window to the sky, a varnished table and a mirror."""
    maker = Maker()
    maker.add_matte("plaster", "0.75 0.72 0.68")
    maker.add_texture("boards", "blender_wood", 1.0, "woodtype = bands\nnoisesize = 0.25")
    maker.mix("timber", "boards", "0.45 0.25 0.12", "0.2 0.1 0.05")
    maker.add_disney("wood", "timber", "0.25")
    maker.add_matte("red", "0.6 0.15 0.1")
    sheets = (
        ("ground", "wood", (-3.0, -3.0, 0.0), (6.0, 0.0, 0.0), (0.0, 6.0, 0.0)),
        ("ceiling", "plaster", (-3.0, -3.0, 3.0), (0.0, 6.0, 0.0), (6.0, 0.0, 0.0)),
        ("back", "plaster", (-3.0, 3.0, 0.0), (6.0, 0.0, 0.0), (0.0, 0.0, 3.0)),
        ("front", "plaster", (-3.0, -3.0, 0.0), (0.0, 0.0, 3.0), (6.0, 0.0, 0.0)),
        ("right", "red", (3.0, -3.0, 0.0), (0.0, 0.0, 3.0), (0.0, 6.0, 0.0)),
        # The left wall leaves a window of 2.0 x 1.4.
        ("sill", "plaster", (-3.0, -3.0, 0.0), (0.0, 6.0, 0.0), (0.0, 0.0, 0.9)),
        ("lintel", "plaster", (-3.0, -3.0, 2.3), (0.0, 6.0, 0.0), (0.0, 0.0, 0.7)),
        ("near", "plaster", (-3.0, -3.0, 0.9), (0.0, 2.6, 0.0), (0.0, 0.0, 1.4)),
        ("far", "plaster", (-3.0, 1.6, 0.9), (0.0, 1.4, 0.0), (0.0, 0.0, 1.4)),
    )
    for name, material, corner, one, other in sheets:
        maker.add_sheet(name, material, corner, one, other)
    maker.add_box("table", maker.add_disney("table", "0.5 0.5 0.55", "0.12"), (0.2, 0.9, 0.75), (1.8, 1.0, 0.06))
    for number, x in enumerate((-0.6, 1.0)):
        maker.add_box(f"leg{number}", "wood", (x, 0.9, 0.36), (0.08, 0.8, 0.72))
    maker.add_ball("pot", maker.add_disney("pot", "0.9 0.85 0.8", "0.1", "metallic = 1"), 0.28, (-0.2, 0.8, 1.06))
    maker.add_box("vase", maker.add_disney("vase", "0.2 0.4 0.6", "0.3"), (0.7, 1.0, 1.03), (0.26, 0.26, 0.5), 0.4)
    maker.put("materials.mirror.type = mirror\nmaterials.mirror.kr = 0.95 0.95 0.95")
    maker.add_sheet("mirror", "mirror", (0.5, 2.98, 1.15), (1.4, 0.0, 0.0), (0.0, 0.0, 1.1))
    maker.add_lamp("lamp", (0.05, 0.25, 2.98), (0.0, 0.5, 0.0), (0.9, 0.0, 0.0), "12 10 7")
    return maker.finish("1.8 2.25 3.0", (0.2, -2.8, 1.5), (-0.1, 1.4, 1.5), 80.0)


def make_sparks() -> pyluxcore.Scene:
    """Small lamps inside glass: only paths that hit one by chance find its light, so that few pixels outshine all."""
    maker = Maker()
    maker.add_texture("checks", "checkerboard3d", 1.5, "texture1 = 0.6 0.55 0.5\ntexture2 = 0.2 0.22 0.25")
    maker.add_matte("tiles", "checks")
    add_floor(maker, "tiles")
    maker.add_matte("wall", "0.7 0.68 0.65")
    maker.add_sheet("wall", "wall", (-6.0, 3.0, 0.0), (12.0, 0.0, 0.0), (0.0, 0.0, 6.0))
    maker.put(
        "materials.glass.type = glass\nmaterials.glass.interiorior = 1.5\n"
        "materials.glass.kr = 1 1 1\nmaterials.glass.kt = 1 1 1\n"
        "materials.spark.type = matte\nmaterials.spark.kd = 0 0 0\n"
        "materials.spark.emission = 1600 1200 720\nmaterials.spark.emission.gain = 1 1 1"
    )
    for number, x in enumerate((-1.7, 1.5)):
        maker.add_ball(f"globe{number}", "glass", 0.55, (x, 0.6, 0.55), 64)
        maker.add_ball(f"spark{number}", "spark", 0.04, (x + 0.1, 0.5, 0.6), 16)
    maker.add_ball("plastic", maker.add_disney("plastic", "0.2 0.4 0.7", "0.3"), 0.6, (0.0, 1.4, 0.6))
    maker.add_disney("gold", "0.95 0.7 0.3", "0.25", "metallic = 1")
    maker.add_box("gold", "gold", (0.1, -0.9, 0.35), (0.7, 0.7, 0.7), 0.6)
    maker.add_lamp("lamp", (-4.0, -4.0, 5.0), (0.0, 1.5, 0.5), (1.5, 0.0, -0.6), "14 14 14")
    return maker.finish("0.05 0.06 0.08", (0.0, -6.0, 2.4), (0.0, 0.3, 0.6), 44.0)


SCENES: dict[str, Callable[[], pyluxcore.Scene]] = {
    "gloss": make_gloss,
    "textured": make_textured,
    "glass": make_glass,
    "room": make_room,
    "sparks": make_sparks,
}
DEFAULT = "gloss,textured,glass,room"


@dataclass(frozen=True)
class Settings:
    """What all frames have in common: (width, height), the film outputs, threads or 0 for all."""

    size: tuple[int, int]
    outputs: tuple[str, ...]
    threads: int


def render(scene: pyluxcore.Scene, folder: Path, settings: Settings, spp: int, seed: int) -> None:
    """Render a scene into a folder, unless it is there."""
    if folder.exists():
        return
    start = time.process_time()
    temporary = folder.with_name(f".{folder.name}")
    temporary.mkdir(exist_ok=True)
    lines = [
        "renderengine.type = PATHCPU",
        f"renderengine.seed = {seed}",
        f"film.width = {settings.size[0]}",
        f"film.height = {settings.size[1]}",
        f"batch.haltspp = {spp}",
    ]
    if settings.threads:
        lines.append(f"native.threads.count = {settings.threads}")
    for number, name in enumerate(settings.outputs):
        lines += [f"film.outputs.{number}.type = {name}", f"film.outputs.{number}.filename = {temporary}/{name}.exr"]
    properties = pyluxcore.Properties()
    properties.SetFromString("\n".join(lines) + "\n")
    session = pyluxcore.RenderSession(pyluxcore.RenderConfig(properties, scene))
    session.Start()
    session.UpdateStats()
    while not session.HasDone():
        time.sleep(POLL)
        session.UpdateStats()
    session.Stop()
    session.GetFilm().SaveOutputs()
    temporary.rename(folder)
    print(f"wrote {folder}, {time.process_time() - start:.1f} s of CPU", flush=True)


def main() -> None:
    """Render what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", default=DEFAULT, help=f"of {', '.join(SCENES)}")
    parser.add_argument("--spp", default="8,32,128")
    parser.add_argument("--seeds", default="1,2")
    parser.add_argument("--reference", type=int, default=4096)
    parser.add_argument("--size", default="256x192")
    parser.add_argument("--without", default="", help="film outputs that are not written, such as SHADING_NORMAL")
    parser.add_argument("--threads", type=int, default=0, help="0 for all")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    width, height = map(int, asked.size.split("x"))
    without = set(filter(None, asked.without.split(",")))
    if not without <= set(OUTPUTS):
        parser.error(f"--without: expected names of {', '.join(OUTPUTS)}, got {', '.join(sorted(without))}")
    outputs = tuple(name for name in OUTPUTS if name not in without)
    settings = Settings((width, height), outputs, asked.threads)
    pyluxcore.Init()
    for name in asked.scenes.split(","):
        scene = SCENES[name]()
        for spp in filter(None, asked.spp.split(",")):
            for seed in asked.seeds.split(","):
                render(scene, asked.folder / f"{name}_{spp}_{seed}", settings, int(spp), int(seed))
        if asked.reference:
            for half in (1, 2):
                folder = asked.folder / f"{name}_reference_{half}"
                render(scene, folder, settings, asked.reference // 2, 7776 + half)


if __name__ == "__main__":
    main()
