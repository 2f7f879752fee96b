"""What reading a file is, of every kind: all that lobewise does with it before it computes anything.

A reader returns the sentence of a `LobewiseError`, or an empty text. Any other exception is a finding.
"""

import importlib.util
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lobewise.errors import LobewiseError
from lobewise.records.camera import Camera
from tests.fuzz.exr_files import unpack

Answer = Callable[..., None]
CAMERA = Camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 0.7)


@dataclass(frozen=True)
class Reader:
    """How files of a kind are read.

    Parameters
    ----------
    ending : str
        Of their names.
    work : callable
        Takes the path and a function that answers; raises what lobewise raises.
    example : str
        A file of the corpus that is read first, so that everything is loaded before memory is measured.
    """

    ending: str
    work: Callable[[Path, Answer], None]
    example: str

    def read(self, path: Path, answer: Answer) -> str:
        """Return the sentence of a refusal, or an empty text."""
        try:
            self.work(path, answer)
        except LobewiseError as problem:
            told = str(problem)
            if not told.isprintable():
                raise AssertionError(f"no sentence: {told!r}") from problem
            return told
        return ""

    def prepare(self, folder: Path) -> None:
        """Read the example, which must open."""
        from tests.fuzz.corpus import CORPUS

        path = folder / f"case{self.ending}"
        path.write_bytes((CORPUS / self.example).read_bytes())
        told = self.read(path, lambda **_: None)
        assert not told, told


def read_exr(path: Path, answer: Answer) -> None:
    """Read an EXR file in every way, and compare all pixels with those that OpenEXR reads."""
    from lobewise.interchange import describe_file, import_file, read_image
    from lobewise.io import read_frame, read_sparse_frame
    from lobewise.io.exr.parsing import read_container
    from lobewise.io.exr.pixels import decode_part

    container = read_container(path)
    problems: list[LobewiseError] = []
    for read in (describe_file, read_image, read_frame, read_sparse_frame, import_file):
        try:
            read(path)
        except LobewiseError as problem:
            problems.append(problem)
            if not str(problem).isprintable():
                raise AssertionError(f"no sentence: {problem}") from problem
    size = sum(part.data_window.width * part.data_window.height for part in container.parts)
    if len(problems) < 3 and size < 4096 and path.read_bytes()[-1] % 8 == 0:
        _denoise(path)
    pixels = {}
    for part in container.parts:
        try:
            pixels[part.index] = decode_part(container, part)
        except LobewiseError as problem:
            problems.append(problem)
    if pixels:
        answer(stage="oracle")
        compare_pixels(path, pixels)
        answer(stage="ours")
    elif problems:
        raise problems[-1]


def _denoise(path: Path) -> None:
    from lobewise.recipes.streaming.recipe import denoise_file

    try:
        denoise_file(path, path.with_name("clean.exr"), quality="fast", similarity="auto")
    except LobewiseError:
        return


def compare_pixels(path: Path, pixels: dict[int, dict[str, np.ndarray]]) -> None:
    """Raise AssertionError unless OpenEXR itself reads the same bits in every channel.

    OpenEXR refuses a whole file for what decoding does not need: an attribute of a renderer's with a wrong size, parts
    without a name of their own or with several display windows, flags that contradict the types of parts. lobewise
    reads such a file; it is then compared with what OpenEXR reads of the same chunks behind a plain header.
    """
    try:
        _compare(path, pixels)
    except _Refused:
        plain = path.with_name("plain.exr")
        plain.write_bytes(make_plain(path.read_bytes()))
        _compare(plain, pixels)


class _Refused(AssertionError):
    """OpenEXR does not read a file or a channel of it."""


def _compare(path: Path, pixels: dict[int, dict[str, np.ndarray]]) -> None:
    import OpenEXR

    try:
        parts = OpenEXR.File(str(path), separate_channels=True).parts
    except UnicodeDecodeError:
        # OpenEXR's Python binding gives up at texts that are not UTF-8, whatever the file's pixels are.
        return
    except Exception as problem:
        raise _Refused(f"OpenEXR refuses what lobewise reads: {problem}") from problem
    # Parts that OpenEXR cannot decode are left out.
    found = {part.part_index: part.channels for part in parts}
    for index, channels in pixels.items():
        for name, plane in channels.items():
            other = found[index][name].pixels if name in found.get(index, {}) else None
            if other is None:
                raise _Refused(f"OpenEXR does not decode channel {name!r} of part {index}, lobewise does")
            if plane.dtype != other.dtype or plane.shape != other.shape or plane.tobytes() != other.tobytes():
                raise AssertionError(f"channel {name!r} of part {index} differs from what OpenEXR reads")


def make_plain(data: bytes) -> bytes:
    """Return an EXR file with the prescribed attributes alone, its parts numbered and of one display window."""
    from lobewise.io.exr.container import DEEP, MULTIPART, TILED

    file = unpack(data)
    kind = next((value for name, _, value in file.headers[0].attributes if name == b"type"), b"")
    for number, header in enumerate(file.headers):
        kept = [item for item in header.attributes if item[0] in NEEDED]
        header.attributes = [(name, word, SHARED.get(name, value)) for name, word, value in kept]
        if file.version & MULTIPART:
            header.attributes.append((b"name", b"string", str(number).encode()))
    if file.version & MULTIPART:
        file.version &= ~(TILED | DEEP)
    elif not kind.startswith(b"deep"):
        file.version &= ~DEEP
    return file.pack()


SHARED = {b"displayWindow": bytes(16), b"pixelAspectRatio": struct.pack("<f", 1.0)}
"""Attributes that all parts of a file should have in common; decoding does not look at them."""
NEEDED = (
    *(b"channels", b"compression", b"dataWindow", b"displayWindow", b"lineOrder", b"pixelAspectRatio"),
    *(b"screenWindowCenter", b"screenWindowWidth", b"tiles", b"chunkCount", b"type"),
)
"""Attributes that the file format prescribes, beside names."""


def read_lobes(path: Path, _: Answer) -> None:
    from lobewise.io.materials import lobe_table_from_json, lobe_table_to_json, read_lobe_table

    table = read_lobe_table(path)
    # What was read can be written, and is then the same.
    text = lobe_table_to_json(table)
    assert lobe_table_to_json(lobe_table_from_json(text)) == text


def read_merl(path: Path, _: Answer) -> None:
    """Read a MERL file that is told as JSON: its bins, size, value, and bytes put somewhere; whole it has 35 MB."""
    from lobewise.io.materials import read_merl

    try:
        data = make_merl(path.read_bytes())
    except (ValueError, TypeError, KeyError, RecursionError, struct.error):
        # Fuzzing by coverage changes bytes of the JSON, which then often tells of no file.
        return
    target = path.with_suffix(".binary")
    target.write_bytes(data)
    brdf = read_merl(target)
    assert np.isfinite(brdf.samples).all()


def make_merl(words: bytes) -> bytes:
    """Return the MERL file that is told as JSON."""
    told = json.loads(words)
    if told["size"] > MAX_MERL_BYTES:
        raise ValueError(told["size"])
    data = bytearray(struct.pack("<3i", *told["bins"]))
    data += struct.pack("<Q", told["bits"]) * ((told["size"] - len(data)) // 8 + 1)
    del data[max(told["size"], 0) :]
    for at, text in told["patches"]:
        part = bytes.fromhex(text)[: max(len(data) - at, 0)]
        data[at : at + len(part)] = part
    return bytes(data)


MAX_MERL_BYTES = 40_000_000


def read_camera_path(path: Path, _: Answer) -> None:
    from lobewise.render.camera_path import read_camera_path

    for camera in read_camera_path(path, CAMERA):
        _use(camera)


def read_object_paths(path: Path, _: Answer) -> None:
    from lobewise.render.moving.object_paths import read_object_paths

    paths = read_object_paths(path)
    for frame in (1.0, 2.0):
        if all(len(one.matrices) != 1 or frame == 1.0 for one in paths.paths.values()):
            for matrix in paths.compute_places(frame).values():
                assert matrix.shape == (4, 4)


def read_camera(path: Path, _: Answer) -> None:
    from lobewise.interchange.cameras.files import read_camera_file

    _use(read_camera_file(path))


def _use(camera: Camera) -> None:
    """Do what is done with every camera: its numbers are finite, and its rays and positions can be computed."""
    for name in ("position", "forward", "up", "right", "middle"):
        assert np.isfinite(getattr(camera, name)).all(), name
    assert np.isfinite(camera.make_ray_directions(4, 3)).all()


def read_preset(path: Path, _: Answer) -> None:
    """Read a preset, and then a file by it."""
    from lobewise.interchange.mapping import map_channels
    from lobewise.interchange.preset import look_up_preset

    look_up_preset(path)
    map_channels(_open_example(), preset=path)


def read_map(path: Path, _: Answer) -> None:
    """Read the words of ``--map``, one in each line, and map a file's channels by them."""
    from lobewise.cli.options.reading import parse_maps
    from lobewise.interchange.mapping import map_channels

    # As Python gets the words of a command line.
    words = path.read_bytes().decode("utf-8", "surrogateescape").split("\n")
    map_channels(_open_example(), mapping=parse_maps(words))


@cache
def _open_example() -> Any:
    from lobewise.io.exr.parsing import read_container
    from tests.fuzz.corpus import CORPUS

    return read_container(CORPUS / "exr" / "cycles.exr")


def read_definitions(path: Path, _: Answer) -> None:
    """Read the words of ``-D``, one in each line, and load a scene with them."""
    from lobewise.cli.rendering import parse_definitions
    from lobewise.render.loading import load_scene

    words = path.read_bytes().decode("utf-8", "surrogateescape").split("\n")
    scene = path.with_suffix(".xml")
    shape = '<shape type="sphere"><float name="radius" value="$r"/></shape>'
    scene.write_text(f'<scene version="3.0.0"><default name="r" value="1"/>{shape}</scene>')
    load_scene(scene, parameters=parse_definitions(words))


class Remembering:
    """A filter that remembers, with the settings of the seeds."""

    def __init__(self) -> None:
        from lobewise.recipes.temporal import TemporalFilter

        self._filter = TemporalFilter(similarity="normal", quality="fast")

    def add(self, frame: Any, *, cut: bool = False) -> Any:
        return self._filter.add(frame, cut=cut)

    def get_state(self) -> Any:
        return self._filter.get_state()

    def set_state(self, state: Any) -> None:
        self._filter.set_state(state)


def read_state(path: Path, _: Answer) -> None:
    """Go on with what a filter remembers; a state that is not used is refused."""
    from lobewise.recipes.states import load_state
    from tests.fuzz.corpus import PROOF, make_small_frame

    kept = load_state(path, [PROOF])
    if kept is None:
        raise LobewiseError("not used")
    active = Remembering()
    try:
        active.set_state(kept[1])
    except Exception as problem:
        raise LobewiseError("refused by the filter") from problem
    active.add(make_small_frame())


def read_viewer(path: Path, _: Answer) -> None:
    """Read a message of a browser, and look through the camera that it sets."""
    import msgspec

    from lobewise.interactive.settings import InteractiveSettings
    from lobewise.viewer.cameras import CameraMap, read_pose
    from lobewise.viewer.http.browser_messages import Control, read_message
    from lobewise.viewer.messages import Description

    controls = {"a": Control(("one", "two")), "b": Control((), 0.0, 8.0), "c": Control()}
    found, remark = read_message(path.read_bytes(), controls)
    if found is None:
        raise LobewiseError(f"{remark or 'a control that is gone'}.")
    message = msgspec.msgpack.decode(found)
    if message["type"] != "ViewerCameraMessage":
        return
    handle = type("Handle", (), message)
    pose = read_pose(handle)
    camera = CameraMap(Description(InteractiveSettings(), 64, 64, CAMERA, (0.0, 0.0, -2.0))).to_camera(pose)
    if camera is not None:
        _use(camera)


READERS = {
    "exr": Reader(".exr", read_exr, "exr/lobewise.exr"),
    "lobes": Reader(".lobes", read_lobes, "lobes/sg.lobes"),
    "merl": Reader(".json", read_merl, "merl/whole.json"),
    "camera_path": Reader(".json", read_camera_path, "camera_path/two.json"),
    "object_paths": Reader(".json", read_object_paths, "object_paths/keys.json"),
    "camera_json": Reader(".json", read_camera, "camera_json/camera.json"),
    "camera_xml": Reader(".xml", read_camera, "camera_xml/scene.xml"),
    "camera_gltf": Reader(".gltf", read_camera, "camera_gltf/nodes.gltf"),
    "camera_glb": Reader(".glb", read_camera, "camera_glb/nodes.glb"),
    "camera_usda": Reader(".usda", read_camera, "camera_usda/camera.usda"),
    "camera_usdc": Reader(".usdc", read_camera, "camera_usdc/camera.usdc"),
    "preset": Reader(".toml", read_preset, "preset/house.toml"),
    "map": Reader(".txt", read_map, "map/words.txt"),
    "definitions": Reader(".txt", read_definitions, "definitions/words.txt"),
    "checkpoint": Reader(".npz", read_state, "checkpoint/state.npz"),
    "viewer": Reader(".msgpack", read_viewer, "viewer/camera.msgpack"),
}
NEEDS = {
    "camera_path": "mitsuba",
    "object_paths": "mitsuba",
    "definitions": "mitsuba",
    "camera_usda": "pxr",
    "camera_usdc": "pxr",
    "viewer": "lobewise.viewer.http",
}
"""What some kinds need that is optional."""


def can_read(kind: str) -> bool:
    """Return whether what a kind needs is installed."""
    if kind not in NEEDS:
        return True
    try:
        return importlib.util.find_spec(NEEDS[kind]) is not None
    except ModuleNotFoundError:
        return False
