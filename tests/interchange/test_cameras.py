"""Cameras of other renderers' frames: off the centre, orthographic, from headers and from files of their own."""

import json
import math
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from renderers import CAMERA, HEIGHT, WIDTH, WRITERS, make_scene, to_camera, write

from lobewise.errors import FileError, InputError
from lobewise.interchange.cameras import fitting, usd
from lobewise.interchange.cameras.files import read_camera_file
from lobewise.interchange.cameras.fitting import fit_any_camera, fit_camera, fit_orthographic
from lobewise.interchange.importing import surfaces
from lobewise.interchange.reading import import_file
from lobewise.io.exr.frames import write_frame
from lobewise.records.camera import Camera, project_points
from lobewise.records.frame import Frame, GBuffer, Radiance
from tests.mistakes import refuses

SHIFTED = Camera(CAMERA.position, CAMERA.forward, CAMERA.up, CAMERA.fov_y, shift=(0.1, -0.05))


def show(camera: Camera, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Return points 3 to 5 away along the rays of a camera."""
    distance = 4.0 + np.sin(np.arange(height * width)).reshape(height, width)
    return camera.position + distance[..., None] * camera.make_ray_directions(width, height)


def require_same_view(found: Camera, expected: Camera, size: tuple[int, int] = (WIDTH, HEIGHT)) -> None:
    """Compare cameras by where they show points, to a thousandth of a pixel."""
    seen = project_points(found, show(expected, *size), *size)
    columns, rows = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    np.testing.assert_allclose(seen, np.stack([columns, rows], axis=-1), atol=1e-3)


def test_a_shifted_camera_shows_points_where_its_rays_go() -> None:
    require_same_view(SHIFTED, SHIFTED)
    middle = SHIFTED.make_ray_directions(3, 3)[1, 1]
    np.testing.assert_allclose(middle, SHIFTED.middle / np.linalg.norm(SHIFTED.middle), atol=1e-6)


def test_a_shifted_camera_is_that_of_a_part_of_a_larger_image() -> None:
    whole = CAMERA.make_ray_directions(40, 30)
    half_width, half_height = CAMERA.get_half_extent(40, 30)
    part = Camera(
        CAMERA.position,
        CAMERA.forward,
        CAMERA.up,
        2.0 * math.atan(half_height * 10 / 30),
        shift=(half_width * (2 * 18 / 40 - 1), -half_height * (2 * 7 / 30 - 1)),
    )
    np.testing.assert_allclose(part.make_ray_directions(20, 10), whole[2:12, 8:28], atol=1e-6)


def test_a_shifted_camera_survives_its_file(make_frame: Any, tmp_path: Path) -> None:
    frame = make_frame(height=6, width=8).with_changes(camera=SHIFTED)
    write_frame(tmp_path / "frame.exr", frame)
    camera = import_file(tmp_path / "frame.exr").frame.camera
    np.testing.assert_allclose(camera.shift, SHIFTED.shift, atol=1e-6)


def test_a_data_window_off_the_display_window(tmp_path: Path) -> None:
    """The camera of the header is that of the whole image; pixels are those of a part of it."""
    written = WRITERS["arnold"](make_scene()).leave_out("P.")
    rows, columns = slice(4, 30), slice(10, 41)
    channels = {name: np.ascontiguousarray(plane[rows, columns]) for name, plane in written.channels.items()}
    window = {
        "dataWindow": (np.array([10, 4], np.int32), np.array([40, 29], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([WIDTH - 1, HEIGHT - 1], np.int32)),
    }
    header = {**written.attributes, **window, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(tmp_path / "part.exr"))
    camera = import_file(tmp_path / "part.exr").frame.camera
    expected = CAMERA.make_ray_directions(WIDTH, HEIGHT)[rows, columns]
    np.testing.assert_allclose(camera.make_ray_directions(31, 26), expected, atol=1e-5)


@pytest.mark.parametrize("left", [0, 9, 17])
def test_the_camera_of_a_part_of_an_image_is_off_its_axis(left: int, tmp_path: Path) -> None:
    """A render region, or a window that follows an object: the camera is that of the display window."""
    written = WRITERS["mitsuba"](make_scene())
    rows, columns = slice(4, 34), slice(left, left + 31)
    channels = {name: np.ascontiguousarray(plane[rows, columns]) for name, plane in written.channels.items()}
    window = {
        "dataWindow": (np.array([left, 4], np.int32), np.array([left + 30, 33], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([WIDTH - 1, HEIGHT - 1], np.int32)),
    }
    header = {**written.attributes, **window, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(tmp_path / "part.exr"))
    imported = import_file(tmp_path / "part.exr")
    expected = CAMERA.make_ray_directions(WIDTH, HEIGHT)[rows, columns]
    np.testing.assert_allclose(imported.frame.camera.make_ray_directions(31, 30), expected, atol=2e-3)
    assert not any("unit" in note or "no distance" in note for note in imported.notes), imported.notes


def test_one_fit_tells_the_blur_and_the_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fits = []

    def count(*arguments: Any, **options: Any) -> fitting.CameraFit | None:
        fits.append(fit_camera(*arguments, **options))
        return fits[-1]

    for module in (fitting, surfaces):
        monkeypatch.setattr(module, "fit_camera", count)
    write(tmp_path / "a.exr", WRITERS["cycles"](make_scene()))
    camera = import_file(tmp_path / "a.exr").frame.camera
    assert [fit.camera for fit in fits] == [camera]


@pytest.mark.parametrize("aspect", [1.0, 2.0])
@pytest.mark.parametrize("left_handed", [False, True])
def test_an_orthographic_camera_is_found_from_the_positions(left_handed: bool, aspect: float) -> None:
    rng = np.random.default_rng(3)
    depth = rng.uniform(2.0, 4.0, (HEIGHT, WIDTH)).astype(np.float32)
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    unit = 2.6 / HEIGHT
    aside, above = (columns - WIDTH / 2) * unit * aspect, (HEIGHT / 2 - rows) * unit
    position = CAMERA.position + aside[..., None] * CAMERA.right + above[..., None] * CAMERA.up
    position = position + depth[..., None] * CAMERA.forward
    turn = np.array([-1.0, 1.0, 1.0]) if left_handed else np.ones(3)
    world, mask = (turn * position).astype(np.float32), np.ones(depth.shape, np.bool_)
    found = fit_any_camera(world, mask, depth, aspect)
    assert found.orthographic
    assert found.mirrored is left_handed
    assert found.error < 0.1
    np.testing.assert_allclose(found.camera.forward, CAMERA.forward, atol=1e-4)
    np.testing.assert_allclose(found.camera.up, CAMERA.up, atol=1e-4)
    seen = project_points(found.camera, position, WIDTH, HEIGHT)
    np.testing.assert_allclose(seen, np.stack([columns, rows], axis=-1), atol=0.1)


def test_an_orthographic_frame_is_told_and_its_planar_depth_not_used(tmp_path: Path) -> None:
    written = WRITERS["mitsuba"](make_scene())
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    aside, above = (columns - WIDTH / 2) * 0.05, (HEIGHT / 2 - rows) * 0.05
    position = aside[..., None] * CAMERA.right + above[..., None] * CAMERA.up
    position = position + (2.0 + 0.2 * np.sin(aside * 3) * above)[..., None] * CAMERA.forward
    for name in written.channels:
        head, _, letter = name.rpartition(".")
        if "position" in head.lower() or head in ("P", "pp"):
            written.channels[name] = position[..., "XYZ".index(letter.upper())].astype(np.float32)
    write(tmp_path / "a.exr", written)
    found = import_file(tmp_path / "a.exr")
    assert any("orthographic" in note for note in found.notes), found.notes
    camera, depth = found.frame.camera, found.frame.gbuffer.depth
    lit = depth > 0
    placed = camera.position + depth[..., None].astype(np.float64) * camera.make_ray_directions(WIDTH, HEIGHT)
    assert lit.any()
    assert np.abs(placed - position)[lit].max() < 0.05


def test_points_of_one_plane_tell_no_camera() -> None:
    flat = show(CAMERA).astype(np.float32)
    flat[..., 2] = 0.0
    assert fit_orthographic(flat, np.ones(flat.shape[:2], np.bool_)) is None


def write_json(folder: Path) -> Path:
    path = folder / "camera.json"
    told = {
        "position": CAMERA.position.tolist(),
        "target": (CAMERA.position + 3.0 * CAMERA.forward).tolist(),
        "up": CAMERA.up.tolist(),
        "fov_y": math.degrees(CAMERA.fov_y),
        "shift": [0.1, -0.05],
    }
    path.write_text(json.dumps(told))
    return path


def write_gltf(folder: Path, *, binary: bool) -> Path:
    """Write a camera that is the child of a node that moves it."""
    matrix = np.eye(4)
    matrix[:3] = np.stack([CAMERA.right, CAMERA.up, -CAMERA.forward, CAMERA.position - [1.0, 2.0, 3.0]], axis=1)
    scene = {
        "nodes": [{"translation": [1, 2, 3], "children": [1]}, {"camera": 0, "matrix": matrix.T.ravel().tolist()}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": CAMERA.fov_y, "aspectRatio": WIDTH / HEIGHT}}],
    }
    text = json.dumps(scene).encode()
    path = folder / ("camera.glb" if binary else "camera.gltf")
    head = struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text), len(text), 0x4E4F534A)
    path.write_bytes(head + text if binary else text)
    return path


def write_usd(folder: Path) -> Path:
    """Write a stage whose camera's aperture is that of the image, moved aside."""
    focal, high = 50.0, 2.0 * 50.0 * math.tan(0.5 * CAMERA.fov_y)
    rows = np.eye(4)
    rows[:3, :3] = np.stack([CAMERA.right, CAMERA.up, -CAMERA.forward])
    rows[3, :3] = CAMERA.position
    matrix = ", ".join("(" + ", ".join(f"{value:.12g}" for value in row) + ")" for row in rows)
    path = folder / "camera.usda"
    path.write_text(
        f"""#usda 1.0
def Xform "set" {{
    def Camera "main" {{
        float focalLength = {focal}
        float horizontalAperture = {high * WIDTH / HEIGHT:.9g}
        float verticalAperture = {high:.9g}
        float horizontalApertureOffset = {0.1 * focal}
        float verticalApertureOffset = {-0.05 * focal}
        matrix4d xformOp:transform = ({matrix})
        uniform token[] xformOpOrder = ["xformOp:transform"]
    }}
}}
"""
    )
    return path


def test_camera_of_json(tmp_path: Path) -> None:
    require_same_view(read_camera_file(write_json(tmp_path)), SHIFTED)


@pytest.mark.parametrize("binary", [False, True])
def test_camera_of_gltf(binary: bool, tmp_path: Path) -> None:
    require_same_view(read_camera_file(write_gltf(tmp_path, binary=binary)), CAMERA)


@pytest.fixture
def needs_usd() -> None:
    """Skip where no stage can be read."""
    pytest.importorskip("pxr", reason="usd-core is not installed")


@pytest.mark.usefixtures("needs_usd")
def test_camera_of_usd(tmp_path: Path) -> None:
    require_same_view(read_camera_file(write_usd(tmp_path)), SHIFTED)
    (tmp_path / "empty.usda").write_text("#usda 1.0\n")
    with refuses(InputError, "camera 'empty.usda'"):
        read_camera_file(tmp_path / "empty.usda")
    (tmp_path / "broken.usda").write_text("#usda 1.0\ndef {")
    with refuses(FileError, "camera 'broken.usda'"):
        read_camera_file(tmp_path / "broken.usda")


def write_stage(path: Path, *layers: str) -> Path:
    """Write a root layer that has other layers below it."""
    path.write_text(f"#usda 1.0\n(subLayers = [{', '.join(f'@{layer}@' for layer in layers)}])\n")
    return path


@pytest.mark.usefixtures("needs_usd")
def test_camera_in_a_layer_below_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "layers"
    folder.mkdir()
    write_usd(folder)
    (folder / "broken.usda").write_text("#usda 1.0\ndef {")
    write_stage(tmp_path / "shot.usda", "layers/broken.usda", "layers/camera.usda", "missing.usda")
    monkeypatch.chdir(tmp_path)
    require_same_view(read_camera_file("shot.usda"), SHIFTED)


@pytest.mark.sampled("sublayer", "expression")
@pytest.mark.usefixtures("needs_usd")
@pytest.mark.parametrize("arc", ["sublayer", "reference", "expression", "link", "layer of a layer"])
def test_a_layer_of_usd_outside_the_folder_is_refused(arc: str, tmp_path: Path) -> None:
    write_usd(tmp_path)
    folder = tmp_path / "shot"
    folder.mkdir()
    path = write_stage(folder / "shot.usda", "../camera.usda")
    if arc == "reference":
        path.write_text('#usda 1.0\ndef "cam" (references = @../camera.usda@</set>) {}\n')
    elif arc == "expression":
        path.write_text("""#usda 1.0\n(subLayers = [@`'../camera.usda'`@])\n""")
    elif arc == "link":
        (folder / "camera.usda").symlink_to(tmp_path / "camera.usda")
        write_stage(path, "camera.usda")
    elif arc == "layer of a layer":
        path.rename(folder / "lower.usda")
        write_stage(path, "lower.usda")
    with refuses(InputError, "camera 'shot.usda'", "the layer 'camera.usda' outside of it"):
        read_camera_file(path)


needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")


@pytest.mark.usefixtures("needs_usd")
@needs_pipes
def test_a_pipe_as_layer_of_usd_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.usda")
    with refuses(InputError, "camera 'shot.usda'", "the device, pipe or folder 'pipe.usda'"):
        read_camera_file(write_stage(tmp_path / "shot.usda", "pipe.usda"))


@pytest.mark.nightly
@pytest.mark.usefixtures("needs_usd")
@needs_pipes
def test_a_pipe_as_layer_of_usd_that_no_check_sees_ends_in_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenUSD alone evaluates expressions in paths, and waits for the pipe."""
    monkeypatch.setattr(usd, "MAX_WALL_SECONDS", 3)
    os.mkfifo(tmp_path / "pipe.usda")
    (tmp_path / "shot.usda").write_text("""#usda 1.0\n(subLayers = [@`'pipe.usda'`@])\n""")
    with refuses(InputError, "camera 'shot.usda'", "none", "an answer of OpenUSD within 3 s"):
        read_camera_file(tmp_path / "shot.usda")


@pytest.mark.nightly
@pytest.mark.usefixtures("needs_usd")
def test_a_stage_of_a_thousand_million_prims_is_refused(tmp_path: Path) -> None:
    levels = [
        f'def "L{level}" {{\n'
        + "".join(f'def "c{child}" (references = </L{level - 1}>) {{}}\n' for child in range(10) if level)
        + "}\n"
        for level in range(10)
    ]
    path = tmp_path / "huge.usda"
    path.write_text("#usda 1.0\n" + "".join(levels))
    assert path.stat().st_size < 5600
    with refuses(InputError, "camera 'huge.usda'"):
        read_camera_file(path)


@pytest.mark.skipif(sys.platform != "linux", reason="limits memory where Linux runs")
@pytest.mark.parametrize(("gibibytes", "has_room"), [(1, True), (2, False)])
def test_the_process_that_reads_usd_gets_no_more_memory(gibibytes: int, has_room: bool) -> None:
    program = (
        "import sys\nfrom lobewise.interchange.cameras import usd_stage\n"
        "usd_stage.read_first_camera = lambda path: len(bytearray(int(path) << 30))\n"
        "usd_stage._main('.', sys.argv[1])\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(gibibytes)], capture_output=True, text=True)
    assert ("MemoryError" not in done.stderr) is (done.returncode == 0) is has_room


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not limit processor time")
@pytest.mark.parametrize(
    ("reading", "seconds", "is_ended"),
    # On a busy machine the start alone takes a second.
    [("while time.process_time() < 4: pass", 1, True), ("time.sleep(3)", 2, False)],
    ids=["computes", "waits"],
)
@pytest.mark.sampled("computes")
def test_the_process_that_reads_usd_is_ended_by_processor_time_alone(
    reading: str, seconds: int, is_ended: bool
) -> None:
    program = (
        f"import time\nfrom lobewise.interchange.cameras import usd_stage\nusd_stage.MAX_SECONDS = {seconds}\n"
        f"def read(path):\n    {reading}\n"
        "usd_stage.read_first_camera = read\nusd_stage._main('.', '')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True)
    assert (done.returncode < 0) is is_ended


MITSUBA = """<scene version="3.0.0"><default name="w" value="48"/><sensor type="perspective">
<float name="fov" value="50"/><string name="fov_axis" value="{axis}"/>{more}
<transform name="to_world"><lookat origin="0.3, -5, 1.6" target="0.2, -1, 0.8" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="$w"/><integer name="height" value="36"/>{film}</film>
</sensor></scene>"""
MOVED = '<float name="principal_point_offset_x" value="0.1"/><float name="principal_point_offset_y" value="-0.2"/>'
CROP = "".join(
    f'<integer name="crop_{name}" value="{value}"/>'
    for name, value in {"offset_x": 5, "offset_y": 8, "width": 30, "height": 20}.items()
)


@pytest.mark.mitsuba
@pytest.mark.parametrize(
    ("axis", "more", "film"),
    [("x", "", ""), ("y", "", ""), ("smaller", "", ""), ("diagonal", "", ""), ("x", MOVED, ""), ("y", "", CROP)],
    ids=["x", "y", "smaller", "diagonal", "principal point", "crop"],
)
def test_camera_of_a_mitsuba_scene_is_that_of_mitsuba(axis: str, more: str, film: str, mi: Any, tmp_path: Path) -> None:
    from lobewise.render.camera import get_camera, get_image_size

    path = tmp_path / "scene.xml"
    path.write_text(MITSUBA.format(axis=axis, more=more, film=film))
    scene = mi.load_file(str(path))
    require_same_view(read_camera_file(path), get_camera(scene), get_image_size(scene))


SENSOR = (
    "<scene>"
    # Each parameter is ten of the next: in all a text of 10^10 letters.
    + "".join(f'<default name="p{number}" value="{10 * f"$p{number - 1}"}"/>' for number in range(9, 0, -1))
    + '<default name="p0" value="x"/><sensor type="perspective">{}</sensor></scene>'
)


@pytest.mark.parametrize(
    ("name", "text", "refused"),
    [
        ("camera.txt", "", ("camera 'camera.txt'",)),
        ("camera.json", "{", ("camera 'camera.json'", "text that is no JSON: it ends too soon, in line 1")),
        ("camera.json", "[]", ("camera 'camera.json'", "a list")),
        ("camera.json", '{VIEW, "target": [1, 1, 1]}', ("camera 'camera.json'", "position, forward, target")),
        ("camera.json", '{"position": ["0", 0, 0], "forward": [0, 0, 1]}', ("camera 'camera.json', position",)),
        ("camera.json", '{VIEW, "fov_y": true}', ("camera 'camera.json', fov_y", "true")),
        ("camera.json", '{VIEW, "fov_y": 1%s}' % (400 * "0"), ("camera 'camera.json'", "a whole number of 401 digits")),
        ("camera.json", "[" * 200_000, ("camera 'camera.json'", "lists or objects more than 64 deep")),
        ("camera.json", "{VIEW}", ("camera 'camera.json'", "neither fov_y nor fov_x")),
        ("camera.json", '{VIEW, "fov_x": 40}', ("camera 'camera.json'", "fov_x alone")),
        ("camera.json", '{VIEW, "fov_y": 400}', ("camera 'camera.json', fov_y", "400")),
        (
            "camera.json",
            '{"position": [0, 5, 0], "target": [0, 5, 0], "fov_y": 40}',
            ("camera 'camera.json', target",),
        ),
        (
            "camera.json",
            '{"position": [0, 1 2]}',
            ("camera 'camera.json'", "text that is no JSON from line 1, column 20 on"),
        ),
        (
            "camera.json",
            '{"position": [0, ',
            ("camera 'camera.json'", "text that is no JSON: it ends too soon, in line 1"),
        ),
        ("camera.json", '{VIEW, "look": [0, 0, 1]}', ("camera 'camera.json', key",)),
        ("camera.gltf", '{"nodes": []}', ("camera 'camera.gltf'", "none")),
        ("camera.gltf", "[]", ("camera 'camera.gltf'", "a list")),
        (
            "camera.gltf",
            '{"nodes": [{"camera": 0, "children": [0]}], "cameras": [LENS]}',
            ("camera 'camera.gltf'", "node 0 inside itself"),
        ),
        (
            "camera.gltf",
            '{"nodes": [{"camera": 0}, {"children": [9]}], "cameras": [LENS]}',
            ("camera 'camera.gltf', child of node 1",),
        ),
        ("camera.gltf", '{"nodes": [{"camera": -1}], "cameras": [LENS]}', ("camera 'camera.gltf', camera of node 0",)),
        (
            "camera.gltf",
            '{"nodes": [{"camera": 0, "rotation": [1e300, 1e300, 0, 0]}], "cameras": [LENS]}',
            ("camera position",),
        ),
        ("camera.gltf", '{"nodes": [{"camera": 3}], "cameras": []}', ("camera 'camera.gltf'", "no cameras at all")),
        ("camera.gltf", '{"nodes": [1, ', ("camera 'camera.gltf'",)),
        ("camera.glb", "glTF" + 16 * "x", ("camera 'camera.glb'",)),
        ("camera.xml", "<scene/>", ("camera 'camera.xml'", "none")),
        ("camera.xml", "<scene>", ("camera 'camera.xml'", "text that is no XML: it ends too soon, in line 1")),
        ("camera.xml", "<scene><a></scene>", ("camera 'camera.xml'", "text that is no XML from line 1, column 13 on")),
        ("camera.xml", "<!DOCTYPE a [<!ENTITY b 'c'>]><scene/>", ("camera 'camera.xml'", "a document type")),
        ("camera.xml", "<a>" * 1000, ("camera 'camera.xml'", "more than 524288 elements, or any more than 64 deep")),
        (
            "camera.xml",
            f"<scene>{'<a/>' * 2**19}</scene>",
            ("camera 'camera.xml'", "more than 524288 elements, or any more than 64 deep"),
        ),
        ("camera.xml", SENSOR.format("<a/>" * 1024), ("camera 'camera.xml'", "1025")),
        (
            "camera.xml",
            '<?xml version="1.0" encoding="foo"?><scene/>',
            ("camera 'camera.xml'", "unknown encoding: foo"),
        ),
        ("camera.xml", SENSOR.format('<float name="fov" value="180"/>'), ("camera 'camera.xml', fov",)),
        (
            "camera.xml",
            SENSOR.format('<float name="focal_length" value="0mm"/>'),
            ("camera 'camera.xml', focal_length",),
        ),
        (
            "camera.xml",
            SENSOR.format('<film><integer name="width" value="0"/></film>'),
            ("camera 'camera.xml', width",),
        ),
        ("camera.xml", SENSOR.format("<transform><rotate x='0' angle='5'/></transform>"), ("camera position",)),
        (
            "camera.xml",
            SENSOR.format("<transform><lookat origin='1, 2, 3' target='1, 2, 3'/></transform>"),
            ("camera 'camera.xml', <lookat>, target",),
        ),
        ("camera.xml", SENSOR.format('<float name="fov" value="$p9"/>'), ("camera 'camera.xml'", "a longer one")),
        ("camera.xml", '<scene><sensor type="orthographic"/></scene>', ("camera 'camera.xml'", "'orthographic'")),
    ],
)
def test_what_is_no_camera_is_refused_in_a_sentence(
    name: str, text: str, refused: tuple[str, ...], tmp_path: Path
) -> None:
    lens = '{"type": "perspective", "perspective": {"yfov": 0.7}}'
    view = '"position": [0, 0, 0], "forward": [0, 0, 1]'
    (tmp_path / name).write_text(text.replace("LENS", lens).replace("VIEW", view))
    with refuses((FileError, InputError), *refused) as caught:
        read_camera_file(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


def test_a_given_camera_turns_normals_of_camera_space(tmp_path: Path) -> None:
    """V-Ray's normals are in camera space; without positions or a header, the camera has to be given."""
    scene, written = make_scene(), WRITERS["vray"](make_scene()).leave_out("worldPositions")
    written.attributes.clear()
    write(tmp_path / "a.exr", written)
    found = import_file(tmp_path / "a.exr", preset="vray", camera=CAMERA)
    normal = found.frame.gbuffer.normal
    np.testing.assert_allclose(normal[scene.surface], scene.normal[scene.surface], atol=2e-3)
    without = import_file(tmp_path / "a.exr", preset="vray").frame.gbuffer.normal
    axes = to_camera(scene.normal, back=True)
    np.testing.assert_allclose(without[scene.surface], axes[scene.surface], atol=2e-3)


def test_a_given_camera_of_another_frame_is_refused(tmp_path: Path) -> None:
    """The positions of a file in lobewise's own names tell where its camera is. Depth alone does not."""
    position = show(CAMERA).astype(np.float32)
    depth = np.linalg.norm(position - CAMERA.position, axis=-1)
    light = Radiance(np.ones((HEIGHT, WIDTH, 3)))
    write_frame(tmp_path / "placed.exr", Frame(light, GBuffer(position=position), CAMERA), half=False)
    write_frame(tmp_path / "depth.exr", Frame(light, GBuffer(depth=depth), CAMERA), half=False)
    with pytest.raises(InputError, match=r"--camera: expected the camera that sees the positions .* pixels away"):
        import_file(tmp_path / "placed.exr", camera=SHIFTED)
    assert import_file(tmp_path / "placed.exr", camera=CAMERA).frame.camera is CAMERA
    assert import_file(tmp_path / "depth.exr", camera=SHIFTED).frame.camera is SHIFTED
