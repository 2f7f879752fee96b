"""Limits of scenes: the nesting of their files, and the memory of their images."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from xml.parsers import expat

from lobewise.errors import InputError
from lobewise.work.limits import measure_machine_memory

MAX_SIDE = 32768
"""Largest width and height of an image, pixels."""
MAX_DEPTH = 64
"""Deepest nesting of elements in a scene file. Mitsuba's parser is recursive and crashes the process far beyond it."""
MAX_FILES = 1024
"""Most files that a scene includes and that are looked at."""
FRAME_BYTES_PER_PIXEL = 890
"""Memory of a frame with guides while it is rendered, measured with 2048x2048 pixels of the showroom."""
RADIANCE_BYTES_PER_PIXEL = 30
"""The same of radiance alone."""
VIEW_BYTES_PER_PIXEL = 1570
"""The same of an interactive session with its history."""
GIB = 1 << 30


def require_shallow(path: Path) -> None:
    """Raise InputError if the elements of a scene file, or of a file that it includes, are nested too deep.

    Text that is no XML, and includes whose names have parameters, are left to Mitsuba.
    """
    waiting, seen = [path], {path.absolute()}
    while waiting:
        file = waiting.pop()
        depth, included = _read_nesting(file)
        if depth > MAX_DEPTH:
            raise InputError(
                str(path),
                expected=f"elements at most {MAX_DEPTH} deep",
                got=f"deeper ones in {str(file)!r}",
                action="mend the file",
            )
        for name in included:
            other = file.absolute().parent / name
            if len(seen) < MAX_FILES and other not in seen and other.is_file():
                seen.add(other)
                waiting.append(other)


def _read_nesting(file: Path) -> tuple[int, list[str]]:
    """Return the depth of the deepest element of a file, at most one above `MAX_DEPTH`, and the files it includes."""
    depth, deepest = 0, 0
    included: list[str] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, deepest
        depth += 1
        deepest = max(deepest, depth)
        if deepest > MAX_DEPTH:
            raise _TooDeepError
        if tag == "include":
            included.append(attributes.get("filename", ""))

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    with suppress(expat.ExpatError, OSError, LookupError, ValueError, _TooDeepError), file.open("rb") as stream:
        parser.ParseFile(stream)
    return deepest, included


class _TooDeepError(Exception):
    """The rest of a file need not be read."""


def require_size(path: Path, width: int, height: int) -> None:
    """Raise InputError if the film of a scene file is larger than `MAX_SIDE` on a side, or empty."""
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise InputError(
            str(path),
            expected=f"a film of 1 to {MAX_SIDE} pixels on each side",
            got=f"{width}x{height}",
            action="change its width and height, or give others (--width, --height)",
        )


def require_memory(width: int, height: int, bytes_per_pixel: int) -> None:
    """Raise InputError if an image of this size would take more memory than the machine, or its container, has."""
    needed, there = width * height * bytes_per_pixel, measure_machine_memory()
    if there is not None and needed > there:
        raise InputError(
            "image size",
            expected=f"an image that fits the memory of this machine, {there / GIB:.3g} GiB",
            got=f"{width}x{height} pixels, which take about {needed / GIB:.3g} GiB",
            action="make it smaller (--width, --height), or render it in parts by the crop of its film",
        )
