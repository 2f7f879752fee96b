"""Read and write lobewise's attributes in headers: camera, sample count, lobe tables, settings."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from lobewise.display.colors import PRIMARIES_OF_SPACES, Chromaticities, are_plausible
from lobewise.errors import FileError, InputError
from lobewise.io.documents import parse_json
from lobewise.io.exr.container import Attribute, Container, Part
from lobewise.io.exr.schema import CAMERA, DENOISED, LOBES, SPP
from lobewise.io.materials import lobe_table_from_json
from lobewise.records.camera import Camera
from lobewise.records.lobe_table import LobeTable

MAX_PIXEL_ASPECT = 100.0
"""Largest plausible ratio of the sides of a pixel."""
ENVMAP, ENVMAP_LATLONG = "envmap", 0
"""OpenEXR's attribute of maps of the surroundings, and its value for a map by latitude and longitude."""
REPLACED = "replaced"
"""Key, beside the settings, of the denoised channels by the name of their part."""


def make_headers(
    container: Container, beauty: Part, settings: Mapping[str, Any], replaced: Mapping[int, Iterable[str]]
) -> list[list[Attribute]]:
    """Return the attributes of every part of a denoised copy: the old ones, the settings and the denoised channels.

    ``replaced`` names the denoised channels by the index of their part. Channels that were denoised before are listed
    too.
    """
    headers = [list(part.attributes) for part in container.parts]
    before = read_replaced(container) or {}
    both = {index: {*replaced.get(index, ()), *before.get(index, ())} for index in {*replaced, *before}}
    named = {container.parts[index].name: sorted(names) for index, names in both.items() if names}
    note = json.dumps({**settings, REPLACED: named}, sort_keys=True, default=str).encode("utf-8")
    headers[beauty.index] = [item for item in headers[beauty.index] if item.name != DENOISED]
    headers[beauty.index].append(Attribute(DENOISED, "string", note))
    return headers


def read_replaced(container: Container) -> dict[int, frozenset[str]] | None:
    """Return the channels that lobewise denoised, by the index of their part; None for a file without its attribute.

    Earlier versions wrote the attribute without a list: then every channel counts as denoised.
    """
    marks = [item for part in container.parts if (item := part.get(DENOISED)) is not None]
    if not marks:
        return None
    everything = {part.index: frozenset(channel.name for channel in part.channels) for part in container.parts}
    replaced: dict[int, set[str]] = {}
    for item in marks:
        try:
            document = parse_json(item.value, what=f"attribute {DENOISED}")
        except FileError:
            return everything
        named = document.get(REPLACED) if isinstance(document, dict) else None
        if not isinstance(named, dict):
            return everything
        for part in container.parts:
            names = named.get(part.name)
            replaced.setdefault(part.index, set()).update(
                name for name in (names if isinstance(names, list) else ()) if isinstance(name, str)
            )
    return {index: there for index, names in replaced.items() if (there := frozenset(names) & everything[index])}


def read_camera(part: Part) -> Camera | None:
    """Return the camera of a part's header, or None.

    Raises InputError if some of its attributes are missing or invalid.
    """
    items = {item.name[len(CAMERA) :]: item for item in part.attributes if item.name.startswith(CAMERA)}
    if not items:
        return None
    values: dict[str, Any] = {}
    for name, size in (("position", 3), ("forward", 3), ("up", 3), ("fov_y", 1), ("fov_x", 1), ("shift", 2)):
        numbers = _read_numbers(items.get(name), size)
        if numbers is None and not (name in ("fov_x", "shift") and name not in items):
            raise InputError(
                "camera in the header",
                expected=f"the attribute {CAMERA}{name} with {size} real number{'s' if size > 1 else ''}",
                got="another type" if name in items else "none",
                action="write position, forward, up and fov_y, or no camera at all",
            )
        if numbers is not None:
            values[name] = numbers if size > 1 else numbers[0]
    window = part.data_window
    return Camera(**values).with_pixel_aspect(window.width, window.height, read_pixel_aspect(part) or 1.0)


def read_pixel_aspect(part: Part) -> float | None:
    """Return the width of a part's pixels over their height; None if the header has an implausible ratio."""
    item = part.get("pixelAspectRatio")
    aspect = 1.0 if item is None else float(struct.unpack("<f", item.value)[0])
    return aspect if 1.0 / MAX_PIXEL_ASPECT <= aspect <= MAX_PIXEL_ASPECT else None


def wraps_around(container: Container) -> bool:
    """Return whether a file is a map by latitude and longitude, as the attribute ``envmap`` of OpenEXR says.

    A part that is cropped has no borders that are neighbours.
    """
    return any(
        item is not None and item.type == ENVMAP and item.value == bytes([ENVMAP_LATLONG])
        for part in container.parts
        if part.data_window == part.display_window
        for item in (part.get(ENVMAP),)
    )


def read_chromaticities(container: Container) -> Chromaticities | None:
    """Return the primaries and the white of a file's light; None if no part has plausible ones.

    The name of the color space in ``colorInteropID`` counts more than the numbers of ``chromaticities``, as OpenEXR
    says. What OpenImageIO notes (``oiio:ColorSpace``) counts less: programs write it unasked.
    """
    return (
        _read_space(container, "colorInteropID")
        or _read_primaries(container)
        or _read_space(container, "oiio:ColorSpace")
    )


def _read_space(container: Container, name: str) -> Chromaticities | None:
    """Return the primaries of the color space that an attribute names; None if none is known by this name."""
    known = (PRIMARIES_OF_SPACES.get(part.get_text(name).casefold()) for part in container.parts)
    return next(filter(None, known), None)


def _read_primaries(container: Container) -> Chromaticities | None:
    for part in container.parts:
        item = part.get("chromaticities")
        if item is not None and item.type == "chromaticities":
            told = struct.unpack("<8f", item.value)
            return told if are_plausible(told) else None
    return None


def read_spp(part: Part) -> int | None:
    """Return the sample count of a part's header, or None."""
    item = part.get(SPP)
    return int(struct.unpack("<i", item.value)[0]) if item and item.type == "int" and len(item.value) == 4 else None


def read_lobe_tables(part: Part) -> tuple[LobeTable, ...]:
    """Return the lobe tables of a part's header, in the order of their numbers.

    Raises FileError if a number is missing or a table is invalid.
    """
    items = [item for item in part.attributes if item.name.startswith(LOBES)]
    tables = []
    for number in range(1, len(items) + 1):
        name = f"{LOBES}{number}"
        item = part.get(name)
        if item is None:
            raise FileError(
                "lobe tables in the header",
                expected=f"{len(items)}, numbered from 1",
                got="none with the number " + str(number),
                action="number them without gaps",
            )
        text = item.value.decode("utf-8", "replace") if item.type == "string" else ""
        tables.append(lobe_table_from_json(text, what=f"attribute {name}"))
    return tuple(tables)


def _read_numbers(item: Attribute | None, size: int) -> tuple[float, ...] | None:
    if item is None:
        return None
    code = {
        (3, "v3d"): "<3d",
        (3, "v3f"): "<3f",
        (2, "v2d"): "<2d",
        (2, "v2f"): "<2f",
        (1, "double"): "<d",
        (1, "float"): "<f",
    }.get((size, item.type))
    if code is None or struct.calcsize(code) != len(item.value):
        return None
    return struct.unpack(code, item.value)


def describe_camera(camera: Camera) -> dict[str, Any]:
    """Return the header attributes of a camera."""
    out: dict[str, Any] = {
        CAMERA + name: np.array(getattr(camera, name), dtype=np.float64) for name in ("position", "forward", "up")
    }
    # The library writes an array of one element as the attribute type `double`.
    out[CAMERA + "fov_y"] = np.array([camera.fov_y], dtype=np.float64)
    if camera.fov_x is not None:
        out[CAMERA + "fov_x"] = np.array([camera.fov_x], dtype=np.float64)
    if camera.shift != (0.0, 0.0):
        out[CAMERA + "shift"] = np.array(camera.shift, dtype=np.float64)
    return out
