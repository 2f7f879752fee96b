"""Cameras from files of their own: JSON, Mitsuba scenes, glTF, USD."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lobewise.errors import FileError, InputError
from lobewise.interchange.cameras.gltf import read_gltf_camera
from lobewise.interchange.cameras.mitsuba import read_mitsuba_camera
from lobewise.interchange.cameras.usd import read_usd_camera
from lobewise.io.cameras import make_camera
from lobewise.io.documents import parse_json, read_document
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera

MAX_JSON_BYTES = 1 << 20
_KEYS = ("position", "forward", "target", "up", "fov_y", "fov_x", "shift")


def read_camera_file(path: PathLike) -> Camera:
    """Return the camera of a file.

    The end of the name tells the format. A ``.json`` file holds ``position``, ``forward`` or ``target``, ``up`` (by
    default y) and ``fov_y``; it may hold ``fov_x`` and ``shift``. Angles are in degrees. A Mitsuba scene (``.xml``)
    gives its first sensor, a glTF file (``.gltf``, ``.glb``) the first node with a camera, and a USD file (``.usd``,
    ``.usda``, ``.usdc``, ``.usdz``; needs ``usd-core``) its first camera at the first time of the stage.

    Raises
    ------
    FileError
        If the file cannot be read, or its name has another end.
    InputError
        If the file has no camera, or the camera is no pinhole.
    MissingDependencyError
        If it is a USD file and ``usd-core`` is not installed.
    """
    file = Path(path)
    read = _READERS.get(file.suffix.lower())
    what = f"camera {str(path)!r}"
    if read is None:
        raise FileError(
            what,
            expected=f"a name that ends in {', '.join(_READERS)}",
            got=repr(file.suffix),
            action="write position, forward, up and fov_y into a .json",
        )
    try:
        return read(file)
    except InputError as problem:
        if repr(str(path)) in str(problem):
            raise
        raise problem.place_in(what, InputError) from None


def _read_json(path: Path) -> Camera:
    what = f"camera {str(path)!r}"
    document = parse_json(read_document(path, MAX_JSON_BYTES, what="camera", holds="a camera"), what=what)
    return make_camera(what, document, _KEYS)


_READERS: dict[str, Callable[[Path], Camera]] = {
    ".json": _read_json,
    ".xml": read_mitsuba_camera,
    **dict.fromkeys((".gltf", ".glb"), read_gltf_camera),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), read_usd_camera),
}
