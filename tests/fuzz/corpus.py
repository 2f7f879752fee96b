"""Seeds of the fuzzing, small files of every kind: ``python -m tests.fuzz.corpus`` writes them anew.

All are made here. No file of anybody else's is among them.
"""

from __future__ import annotations

import json
import shutil
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lobewise.camera import Camera
from lobewise.frame import Frame, GBuffer, Radiance
from lobewise.lobe_table import LobeTable

CORPUS = Path(__file__).parent / "corpus"
WIDTH, HEIGHT = 5, 4


def make_small_frame() -> Frame:
    """Return a frame of 5x4 pixels with what a history needs."""
    rng = np.random.default_rng(1)
    normal = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    normal[..., 2] = 1.0
    return Frame(
        Radiance(rng.random((HEIGHT, WIDTH, 3)).astype(np.float32)),
        GBuffer(normal=normal, depth=np.full((HEIGHT, WIDTH), 2.0, np.float32)),
        Camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 0.7),
        spp=4,
    )


def make_full_frame() -> Frame:
    """Return a frame of 5x4 pixels with every image."""
    from tests.conftest import _make_random_frame

    return _make_random_frame(np.random.default_rng(2), height=HEIGHT, width=WIDTH)


def make_table(kind: str, azimuths: int, lobes: int) -> LobeTable:
    """Return a lobe table of two views."""
    shape = (2, azimuths, lobes)
    return LobeTable(
        "é steel",
        kind,
        *([0.4, 1.0], [0.5 * k for k in range(azimuths)]),
        axis=np.broadcast_to([0.0, 0.0, 1.0], (*shape, 3)),
        sharpness=np.full((*shape, 2), 30.0),
        twist=np.zeros(shape),
        amplitude=np.full(shape, 0.1),
        alpha=np.full((2, azimuths, 2), 0.2),
        albedo=np.full((2, azimuths, 3), 0.7),
        cosine_l2=np.full((2, azimuths), 0.99),
    )


def write_exr(folder: Path) -> None:
    """Write EXR files: every compression, tiles, parts, views, lobewise's names and others'."""
    import OpenEXR

    from lobewise.io import write_frame, write_sparse_frame
    from lobewise.sparse_frame import make_sparse

    rng = np.random.default_rng(3)

    def planes(names: str, kind: type = np.float16, shape: tuple[int, int] = (HEIGHT, WIDTH)) -> dict[str, Any]:
        return {name: rng.random(shape).astype(kind) for name in names}

    def write(name: str, header: dict[str, Any], channels: dict[str, Any]) -> None:
        OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels).write(str(folder / f"{name}.exr"))

    def tiles(size: int, mode: Any = None) -> dict[str, Any]:
        told = OpenEXR.TileDescription()
        told.xSize = told.ySize = size
        if mode is not None:
            told.mode = mode
        return {"type": OpenEXR.tiledimage, "tiles": told}

    # Smooth, or else the library stores what it could not make smaller, and no codec is tried.
    ramp = np.add.outer(np.arange(20) // 4, np.arange(33) // 8).astype(np.float16)
    smooth = {name: ramp * np.float16(factor) for name, factor in zip("RGB", (0.5, 1.0, 2.0), strict=True)}
    for name in [
        "NO",
        "RLE",
        "ZIPS",
        "ZIP",
        "PIZ",
        "PXR24",
        "B44",
        "B44A",
        "DWAA",
        "DWAB",
        "HTJ2K32",
        "HTJ2K256",
        "ZSTD",
    ]:
        compression = getattr(OpenEXR, f"{name}_COMPRESSION", None)
        if compression is not None:
            write(f"scanline_{name.lower()}", {"compression": compression}, smooth)
    write("tiled_zip", {**tiles(4), "compression": OpenEXR.ZIP_COMPRESSION}, planes("ABGR", np.float32))
    write("tiled_piz", {**tiles(16), "compression": OpenEXR.PIZ_COMPRESSION}, smooth)
    ids = {"id": rng.integers(0, 9, (HEIGHT, WIDTH)).astype(np.uint32)}
    write("mixed", {"lineOrder": OpenEXR.DECREASING_Y}, planes("RGB") | planes("Z", np.float32) | ids)
    window = {"dataWindow": (np.array([-2, 1], np.int32), np.array([2, 4], np.int32))}
    write("window", {**window, "displayWindow": window["dataWindow"]}, planes("RGB"))
    parts = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage, "view": "left"}, planes("RGB"), "beauty"),
        OpenEXR.Part({"type": OpenEXR.scanlineimage}, planes("XYZ", np.float32), "normal"),
        OpenEXR.Part(tiles(8), planes("RGB"), "DiffCol"),
    ]
    OpenEXR.File(parts).write(str(folder / "multipart.exr"))
    write_frame(folder / "lobewise.exr", make_full_frame())
    write_frame(folder / "small.exr", make_small_frame(), compression="none")
    write_sparse_frame(folder / "sparse.exr", make_sparse(make_small_frame(), 2, (0, 1)))
    matrix = np.eye(4, dtype="f4")
    cycles = {f"V.Combined.{c}": p for c, p in planes("RGBA").items()} | {
        f"V.{name}.{c}": p for name in ("DiffCol", "DiffDir", "DiffInd", "GlossCol") for c, p in planes("RGB").items()
    }
    cycles |= {f"V.Normal.{c}": p for c, p in planes("XYZ", np.float32).items()} | planes("Z", np.float32)
    cycles |= {f"V.CryptoObject00.{c}": p for c, p in planes("rgba", np.float32).items()}
    samples = {"cycles.V.samples": "16", "cryptomatte/1234567/name": "V.CryptoObject", "worldToCamera": matrix}
    write("cycles", {**samples, "compression": OpenEXR.ZIP_COMPRESSION}, cycles)
    arnold = planes("RGB") | {f"N.{c}": p for c, p in planes("XYZ", np.float32).items()}
    arnold |= {f"P.{c}": p for c, p in planes("XYZ", np.float32).items()} | planes("Z", np.float32)
    lens = np.diag([2.0, 2.0, 1.0, 0.0]).astype("f4")
    lens[2, 3] = 1.0
    write("arnold", {"arnold/version": "7", "worldToCamera": matrix, "worldToNDC": matrix @ lens}, arnold)
    vray = {"cameraTransform": matrix, "cameraFov": 40.0}
    write("vray", vray, planes("RGB") | {f"normals.{c}": p for c, p in planes("XYZ", np.float32).items()})


def write_lobes(folder: Path) -> None:
    from lobewise.io.materials import write_lobe_table

    write_lobe_table(folder / "sg.lobes", make_table("sg", 1, 1))
    write_lobe_table(folder / "asg.lobes", make_table("asg", 2, 3))


def write_merl(folder: Path) -> None:
    from lobewise.fitting.merl import BINS, FILE_BYTES

    half = struct.unpack("<Q", struct.pack("<d", 0.5))[0]
    told = {"bins": BINS, "bits": half, "size": FILE_BYTES, "patches": []}
    (folder / "whole.json").write_text(json.dumps(told))
    (folder / "short.json").write_text(json.dumps({**told, "size": 1000}))


def write_cameras(folder: Path) -> None:
    camera = {"position": [0, 1, 5], "forward": [0, -0.25, -1], "up": [0, 1, 0], "fov_y": 40, "shift": [0.5, 0]}
    _put(folder / "camera_json" / "camera.json", json.dumps(camera))
    _put(
        folder / "camera_json" / "target.json", '{"position": [1, 2, 3], "target": [0, 0, 0], "fov_x": 90, "fov_y": 60}'
    )
    frames = [{"position": [0, 1, 5], "target": [0, 0, 0], "fov_y": 40}, {"position": [0, 1, 4], "forward": [0, 0, -1]}]
    _put(folder / "camera_path" / "two.json", json.dumps(frames))
    keys = [{"frame": 1}, {"frame": 3, "translate": [0, 1, 0], "degrees": 90, "scale": [1, 2, 1]}]
    _put(
        folder / "object_paths" / "keys.json",
        json.dumps({"cube": {"axis": [0, 0, 1], "about": [1, 2, 3], "keys": keys}}),
    )
    still = [[1, 0, 0, 0], [0, 1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]]
    _put(folder / "object_paths" / "matrices.json", json.dumps({"ball": {"matrices": [still, still]}}))
    _put(
        folder / "camera_xml" / "scene.xml",
        """<?xml version="1.0"?>
<scene version="3.0.0"><default name="w" value="48"/><!-- a scene --><sensor type="perspective">
<float name="fov" value="50"/><string name="fov_axis" value="smaller"/>
<float name="principal_point_offset_x" value="0.1"/>
<transform name="to_world"><scale value="1, 1, 1"/><rotate x="1" angle="20"/><translate x="1" y="2" z="3"/>
<lookat origin="0.3, -5, 1.6" target="0.2, -1, 0.8" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="$w"/><integer name="height" value="36"/>
<integer name="crop_width" value="20"/></film></sensor></scene>
""",
    )
    _put(
        folder / "camera_xml" / "thin.xml",
        '<scene><sensor type="thinlens"><string name="focal_length" value="50mm"/><transform>'
        '<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></sensor></scene>',
    )
    lens = {"type": "perspective", "perspective": {"yfov": 0.7, "aspectRatio": 1.5, "znear": 0.1}}
    nodes = [
        {"children": [1], "translation": [0, 1, 0], "rotation": [0, 0, 0, 1], "scale": [1, 2, 1]},
        {"camera": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1]},
    ]
    text = json.dumps({"asset": {"version": "2.0"}, "scene": 0, "nodes": nodes, "cameras": [lens]})
    _put(folder / "camera_gltf" / "nodes.gltf", text)
    text += " " * (-len(text) % 4)
    binary = struct.pack("<5I", 0x46546C67, 2, 20 + len(text) + 12, len(text), 0x4E4F534A) + text.encode()
    path = folder / "camera_glb" / "nodes.glb"
    path.parent.mkdir()
    path.write_bytes(binary + struct.pack("<2I", 4, 0x004E4942) + b"abcd")
    _put(
        folder / "camera_usda" / "camera.usda",
        """#usda 1.0
(
    startTimeCode = 1
    endTimeCode = 2
)
def Xform "rig" {
    double3 xformOp:translate = (0, 1, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Camera "eye" {
        float focalLength = 35
        float horizontalAperture.timeSamples = { 1: 36, 2: 24 }
        float verticalAperture = 24
        float horizontalApertureOffset = 2
        token projection = "perspective"
    }
}
""",
    )
    try:
        from pxr import Usd
    except ImportError:
        return
    made = folder / "camera_usdc" / "camera.usdc"
    made.parent.mkdir()
    Usd.Stage.Open(str(folder / "camera_usda" / "camera.usda")).Export(str(made))


def write_words(folder: Path) -> None:
    _put(
        folder / "preset" / "house.toml",
        """name = "house"
title = "The house's"
attributes = ["house/*=1"]
passes = ["beauty"]
color = ["Combined", { pass = "beauty" }]
normal = [{ pass = "Normal", convert = ["camera_space", "negate"] }]
roughness = [{ pass = "rough", component = "X", convert = ["square"] }]
cryptomatte = ["CryptoObject"]
samples = ["cycles.*.samples"]
notes = ["A note."]

[[layer]]
name = "diffuse"
lobe = "diffuse"
light = ["DiffDir", "DiffInd"]
albedo = "DiffCol"
times_albedo = true

[advice]
normal = "Switch it on."
""",
    )
    _put(folder / "map" / "words.txt", "normal=V.Normal.X,V.Normal.Y,V.Normal.Z:camera_space\ndepth=Z\nalbedo=DiffCol")
    _put(folder / "map" / "one.txt", "color=*Combined")
    _put(folder / "definitions" / "words.txt", "r=2.5")


def write_checkpoint(folder: Path) -> None:
    """Write what a sequence that was interrupted after its first frame leaves."""
    from tests.fuzz.readers import go_on

    with tempfile.TemporaryDirectory() as work:
        try:
            go_on(Path(work) / "state.npz", stop=True)
        except KeyboardInterrupt:
            shutil.copy(Path(work) / "state.npz", folder / "state.npz")


def write_viewer(folder: Path) -> None:
    import msgspec

    camera = {
        "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.5, 1.0, 4.0],
        "look_at": [0.25, 0.5, 0.125], "up_direction": [0.5, 1.0, 0.25], "fov": 0.75, "near": 0.01, "far": 1000.0,
        "image_height": 720, "image_width": 1280,
    }  # fmt: skip
    (folder / "camera.msgpack").write_bytes(msgspec.msgpack.encode(camera))
    for name, control, value in (("choice", "a", "one"), ("slider", "b", 4.0), ("tick", "c", True)):
        update = {"type": "GuiUpdateMessage", "uuid": control, "updates": {"value": value}}
        (folder / f"{name}.msgpack").write_bytes(msgspec.msgpack.encode(update))


def _put(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(text.encode())


def main() -> None:
    """Write every seed, in place of those that there are."""
    shutil.rmtree(CORPUS, ignore_errors=True)
    CORPUS.mkdir()
    one_kind: dict[str, Callable[[Path], None]] = {
        "exr": write_exr, "lobes": write_lobes, "merl": write_merl, "checkpoint": write_checkpoint,
        "viewer": write_viewer,
    }  # fmt: skip
    for kind, write in one_kind.items():
        (CORPUS / kind).mkdir()
        write(CORPUS / kind)
    write_cameras(CORPUS)
    write_words(CORPUS)


if __name__ == "__main__":
    main()
