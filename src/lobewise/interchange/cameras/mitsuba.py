"""Cameras of Mitsuba scenes, from their XML alone: neither Mitsuba nor what the scene includes is asked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import FileError, InputError
from lobewise.io.documents import MAX_DEPTH, read_document
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera

MAX_BYTES = 16 << 20
MAX_ELEMENTS = 1 << 19
MAX_SENSOR_ELEMENTS, MAX_DEFAULTS = 1024, 4096
MAX_TEXT = 4096
"""Letters of a value after its parameters were put in: parameters may hold each other."""

Matrix = NDArray[np.float64]
_Defaults = Mapping[str, str]


def read_mitsuba_camera(path: PathLike) -> Camera:
    """Return the camera of the first sensor of a scene.

    Raises
    ------
    FileError
        If the file cannot be read, or is no XML.
    InputError
        If there is no sensor in it, or one that is no pinhole.
    """
    what = f"camera {str(path)!r}"
    scene = _parse(read_document(path, MAX_BYTES, what="camera", holds="a camera"), what)
    sensor = next(scene.iter("sensor"), None)
    if sensor is None:
        raise InputError(what, expected="a sensor", got="none", action="give the file of the scene itself")
    if sensor.get("type") not in ("perspective", "thinlens"):
        got = repr(sensor.get("type"))
        raise InputError(what, expected="a perspective sensor", got=got, action="write the camera as JSON")
    defaults = {item.get("name", ""): item.get("value", "") for item in scene.iter("default") if item.get("name")}
    for expected, count, limit in (
        ("elements in its sensor", sum(1 for _ in sensor.iter()), MAX_SENSOR_ELEMENTS),
        ("parameters", len(defaults), MAX_DEFAULTS),
    ):
        if count > limit:
            raise InputError(
                what, expected=f"at most {limit} {expected}", got=str(count), action="write the camera as JSON"
            )
    with np.errstate(all="ignore"):  # the camera refuses what is not finite
        return _read_sensor(_Values(sensor, defaults, what), sensor, defaults, what)


def _parse(data: bytes, what: str) -> Element:
    """Return the tree of a document without its texts. A document type is refused: it can make any text a long one."""
    builder, depth, count = TreeBuilder(), 0, 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise ValueError(f"more than {MAX_ELEMENTS} elements, or any more than {MAX_DEPTH} deep")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse_type(*_: object) -> None:
        raise ValueError("a document type")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = refuse_type
    try:
        parser.Parse(data, True)
        return builder.close()
    except expat.ExpatError as problem:
        # In the words of one's own: the parser's are terse.
        ended = problem.code == expat.errors.codes[expat.errors.XML_ERROR_NO_ELEMENTS]
        place = f": it ends too soon, in line {problem.lineno}" if ended else ""
        got = f"text that is no XML{place or f' from line {problem.lineno}, column {problem.offset + 1} on'}"
        raise FileError(what, expected="a Mitsuba scene in XML", got=got, action="mend the file") from None
    except (LookupError, ValueError) as problem:
        got = " ".join(str(problem).split())[:200]
        raise FileError(what, expected="a Mitsuba scene in XML", got=got, action="mend the file") from None


class _Values:
    """The named values of a sensor or of its film, with their parameters put in."""

    def __init__(self, element: Element | None, defaults: _Defaults, what: str) -> None:
        items = () if element is None else element
        self._texts = {item.get("name", ""): item.get("value", "") for item in items if item.get("value")}
        self._defaults, self._what = defaults, what

    def __contains__(self, name: str) -> bool:
        return name in self._texts

    def get_text(self, name: str, default: str) -> str:
        return _fill(self._texts.get(name, default), self._defaults, self._what)

    def get_number(self, name: str, default: float, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a number between ``low`` and ``high``, neither included."""
        text = self.get_text(name, repr(default))
        number = _read_number(text.removesuffix("mm") if name == "focal_length" else text, f"{self._what}, {name}")
        if not low < number < high:
            expected = f"a number above {low:g}" if high == math.inf else f"a number between {low:g} and {high:g}"
            raise InputError(f"{self._what}, {name}", expected=expected, got=f"{number:g}", action="mend the file")
        return number


def _read_sensor(values: _Values, sensor: Element, defaults: _Defaults, what: str) -> Camera:
    film = _Values(next(sensor.iter("film"), None), defaults, what)
    width, height = film.get_number("width", 768.0, 0.0), film.get_number("height", 576.0, 0.0)
    matrix = np.eye(4)
    for transform in sensor.iter("transform"):
        for step in transform:
            matrix = _make_step(step, defaults, what) @ matrix
    if "focal_length" in values:
        # Of 35 mm film, whose diagonal is 43.27 mm.
        focal = values.get_number("focal_length", 50.0, 0.0)
        angle, axis = math.degrees(2.0 * math.atan(0.5 * math.hypot(36.0, 24.0) / focal)), "diagonal"
    else:
        angle, axis = values.get_number("fov", 50.0, 0.0, 180.0), values.get_text("fov_axis", "x")
    half_width = _compute_half_width(math.tan(math.radians(angle) / 2.0), axis, width / height)
    half_height = half_width * height / width
    part = [film.get_number(f"crop_{name}", whole, 0.0) for name, whole in (("width", width), ("height", height))]
    start = [film.get_number(f"crop_offset_{axis}", 0.0) for axis in "xy"]
    moved = [values.get_number(f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
    # The centre of the image, from that of the film in units of its half extent: columns to the right, rows downwards.
    across = (2.0 * start[0] + part[0]) / width - 1.0 + 2.0 * moved[0]
    down = (2.0 * start[1] + part[1]) / height - 1.0 + 2.0 * moved[1]
    return Camera(
        matrix[:3, 3],
        matrix[:3, 2],
        matrix[:3, 1],
        2.0 * math.atan(half_height * part[1] / height),
        shift=(half_width * across, -half_height * down),
    )


def _compute_half_width(half: float, axis: str, aspect: float) -> float:
    """Return half the width at distance 1 of a half extent along an axis by Mitsuba's names."""
    if axis == "smaller":
        axis = "y" if aspect > 1.0 else "x"
    elif axis == "larger":
        axis = "x" if aspect > 1.0 else "y"
    if axis == "y":
        return half * aspect
    return half if axis == "x" else half / math.hypot(1.0, 1.0 / aspect)


def _fill(text: str, defaults: _Defaults, what: str) -> str:
    """Return a text with its parameters put in."""
    for name, value in defaults.items():
        if "$" not in text:
            break
        text = text.replace(f"${name}", value)
        if len(text) > MAX_TEXT:
            expected = f"values of at most {MAX_TEXT} letters"
            raise InputError(what, expected=expected, got="a longer one", action="shorten its parameters")
    return text


def _read_number(text: str, what: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(what, expected="a finite number", got=repr(text[:40]), action="mend the file")
    return number


def _make_step(step: Element, defaults: _Defaults, what: str) -> Matrix:
    """Return one step of a Mitsuba transform, (4, 4), for column vectors."""
    what = f"{what}, <{step.tag[:40]}>"

    def take(name: str, default: str, *counts: int) -> Matrix:
        words = _fill(step.get(name, default), defaults, what).replace(",", " ").split()
        if len(words) not in counts:
            expected = f"{' or '.join(map(str, counts))} numbers"
            raise InputError(f"{what}, {name}", expected=expected, got=f"{len(words)}", action="mend the file")
        return np.array([_read_number(word, f"{what}, {name}") for word in words])

    def take_axes(default: str) -> Matrix:
        if step.get("value"):
            return np.broadcast_to(take("value", "", 1, 3), 3)
        return np.array([take(axis, default, 1)[0] for axis in "xyz"])

    matrix = np.eye(4)
    if step.tag == "matrix":
        return take("value", "", 16).reshape(4, 4)
    if step.tag == "lookat":
        origin, target, up = take("origin", "0, 0, 0", 3), take("target", "0, 0, 0", 3), take("up", "0, 1, 0", 3)
        if (target == origin).all():
            expected, got = "another point than the origin", "the same"
            raise InputError(f"{what}, target", expected=expected, got=got, action="write the point that it sees")
        forward = (target - origin) / np.linalg.norm(target - origin)
        left = np.cross(up, forward)
        left /= np.linalg.norm(left)
        matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    elif step.tag == "translate":
        matrix[:3, 3] = take_axes("0")
    elif step.tag == "scale":
        matrix[:3, :3] = np.diag(take_axes("1"))
    elif step.tag == "rotate":
        angle = take("angle", "0", 1)[0]
        matrix[:3, :3] = _turn(take_axes("0"), math.radians(angle))
    else:
        expected = "matrix, lookat, translate, scale or rotate"
        raise InputError(what, expected=expected, got="another step", action="write the camera as JSON")
    return matrix


def _turn(axis: Matrix, angle: float) -> Matrix:
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Matrix = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return turned
