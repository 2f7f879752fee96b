"""Frames as OpenEXR files: read, write, and write back into a copy of the input; every write is all or nothing."""

from __future__ import annotations

import json
import struct
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.camera import Camera
from lobewise.errors import FileError, InputError, LobewiseError, MissingChannelError, describe_problem, require_choice
from lobewise.frame import FloatArray, Frame, Radiance, Result
from lobewise.io.container import Attribute, Container, Part, read_container, show_name
from lobewise.io.files import PathLike, open_atomic, require_writable
from lobewise.io.materials import lobe_table_from_json, lobe_table_to_json
from lobewise.io.pixels import Pixels, decode_part, encode_file, encode_part
from lobewise.io.schema import (
    BEAUTY,
    CAMERA,
    DENOISED,
    LOBES,
    SCHEMA,
    SCHEMA_VERSION,
    SLOTS,
    SPARSE,
    SPP,
    Slot,
    build_frame,
    find_beauty,
    find_foreign,
)
from lobewise.io.splice import write_container
from lobewise.lobe_table import LobeTable

MAX_HALF = 65504.0
# Below this a half loses relative precision.
MIN_NORMAL_HALF = 2.0**-14


def read_frame(path: PathLike, *, lobe_tables: Sequence[LobeTable] | None = None) -> Frame:
    """Return the frame of an EXR file in lobewise's own channel names (``docs/conventions.md``).

    Pixels that are NaN, infinite or negative come through as they are. Of a multi-part file the first part with
    channels R, G and B is the image; further channels may stand in it or in other parts with the same data window.

    Parameters
    ----------
    path : path
        The file.
    lobe_tables : sequence of LobeTable, optional
        What the channel ``material.I`` counts, in place of the tables in the file's header.

    Raises
    ------
    FileError
        If the file is missing, unreadable, damaged, truncated or of zero size, or a lobe table in the header is none.
    MissingChannelError
        If there is no R, G and B, or an image has only some of its channels.
    InputError
        If the camera in the header makes no sense, or a pixel names a lobe table that is not there.
    """
    container = read_container(path)
    require_shaded(container)
    return read_whole(path, container, lobe_tables)


def require_shaded(container: Container) -> None:
    """Raise InputError if a file holds a frame that was shaded sparsely, MissingChannelError if it holds none."""
    if require_beauty(container).get(SPARSE) is not None:
        raise InputError(
            f"input {str(container.path)!r}",
            expected="radiance at every pixel",
            got="a frame that was shaded sparsely",
            action="upsample it (lobewise upsample)",
        )


def read_whole(path: PathLike, container: Container, lobe_tables: Sequence[LobeTable] | None = None) -> Frame:
    """Return every pixel of a file, shaded or not; see `read_frame`."""
    beauty = require_beauty(container)
    images: dict[tuple[str, str], FloatArray] = {}
    for part, slots in plan_reading(container, beauty):
        images |= make_images(slots, decode_part(container, part))
    with name_file(path):
        tables = read_lobe_tables(beauty) if lobe_tables is None else tuple(lobe_tables)
        return build_frame(dict(images), read_camera(beauty), read_spp(beauty), tables)


def make_images(slots: Iterable[Slot], pixels: Mapping[str, Pixels]) -> dict[tuple[str, str], FloatArray]:
    """Return the images of some slots by owner and field, from channels in the types that they were stored in."""
    images = {}
    for slot in slots:
        image = _join([pixels[name] for name in slot.channels])
        images[slot.owner, slot.field] = image[..., 0] if slot.kind == "geometry" and image.shape[2] == 1 else image
    return images


@contextmanager
def name_file(path: PathLike) -> Iterator[None]:
    """Put the name of the file that was read before whatever is wrong with what it holds."""
    try:
        yield
    except LobewiseError as problem:
        raise type(problem)(f"input {str(path)!r}: {problem}") from None


def read_image(path: PathLike) -> FloatArray:
    """Return only the image of any EXR file with channels R, G and B: float32, shape (height, width, 3).

    Raises
    ------
    FileError
        If the file is missing, unreadable, damaged, truncated or of zero size.
    MissingChannelError
        If there is no R, G and B.
    """
    container = read_container(path)
    pixels = decode_part(container, require_beauty(container))
    return _join([pixels[name] for name in BEAUTY.channels])


def write_frame(
    path: PathLike,
    frame: Frame,
    *,
    half: bool = True,
    compression: str = "zip",
    attributes: Mapping[str, str] | None = None,
) -> None:
    """Write a frame in lobewise's own channel names, with its camera, sample count and lobe tables in the header.

    Parameters
    ----------
    path : path-like
        The output; replaced in one step, or left as it was on failure.
    frame : Frame
        What to write.
    half : bool
        Whether radiance, variance and albedo may be stored as 16-bit floats where their range permits: no finite
        value beyond 65504, and for variance none between 0 and 6.1e-5. Geometry is always stored as 32-bit floats. With
        False the file holds the frame exactly.
    compression : str
        One of ``none, rle, zips, zip, piz, zstd``: those that lose nothing.
    attributes : mapping of str to str, optional
        Further header attributes.

    Raises
    ------
    FileError
        If the path cannot be written.
    InputError
        If the compression is unknown.
    """
    require_choice("compression", compression, ("none", "rle", "zips", "zip", "piz", "zstd"))
    require_writable(path)
    pixels: dict[str, Pixels] = {}
    for slot in SLOTS:
        owner = getattr(frame, slot.owner)
        image = None if owner is None else getattr(owner, slot.field)
        if image is None:
            continue
        narrow = half and _fits_half(image, slot.kind)
        planes = image.reshape(*image.shape[:2], -1).astype(np.float16 if narrow else np.float32)
        pixels.update({name: planes[..., index] for index, name in enumerate(slot.channels)})
    header: dict[str, Any] = {SCHEMA: SCHEMA_VERSION, **(attributes or {})}
    if frame.spp is not None:
        header[SPP] = frame.spp
    if frame.camera is not None:
        header.update(_describe_camera(frame.camera))
    header.update({f"{LOBES}{k}": lobe_table_to_json(table) for k, table in enumerate(frame.lobe_tables, start=1)})
    _write(path, encode_file(header, pixels, compression=compression))


def write_image(path: PathLike, image: ArrayLike, *, half: bool = False, compression: str = "zip") -> None:
    """Write one image of shape (height, width, 3) as channels R, G and B.

    Raises
    ------
    FileError
        If the path cannot be written.
    InputError
        If the array is not such an image.
    """
    write_frame(path, Frame(Radiance(np.asarray(image))), half=half, compression=compression)


def write_result(path: PathLike, result: Result, *, source: PathLike) -> None:
    """Write a copy of the EXR file ``source`` in which the radiance is replaced by the denoised one.

    Replaced are R, G and B, and where both the file and the result have them ``diffuse`` and ``specular``. Everything
    else stays: the other parts byte for byte, the other channels in their pixel types, every attribute, the windows
    and the compression. A channel stored as 16-bit float stays one, and values beyond its range become 65504. One
    attribute is added, ``lobewise/denoised``, with the settings as JSON.

    Raises
    ------
    FileError
        If ``source`` cannot be read or ``path`` cannot be written; an existing file is then as it was.
    MissingChannelError
        If ``source`` has no R, G and B.
    InputError
        If the result does not have the size of the image in ``source``.
    """
    require_writable(path)
    container = read_container(source)
    beauty = require_beauty(container)
    window = beauty.data_window
    given = {"color": result.image, "diffuse": result.diffuse, "specular": result.specular}
    images = {field: image for field, image in given.items() if image is not None}
    chunks = {}
    for part, slots in plan_writing(container, beauty, images):
        for field in (slot.field for slot in slots):
            if images[field].shape != (window.height, window.width, 3):
                raise InputError(
                    f"result.{'image' if field == 'color' else field}",
                    expected=f"the size of {str(source)!r}, {window.width}x{window.height} pixels",
                    got=f"an array of shape {images[field].shape}",
                    action="denoise that file",
                )
        chunks[part.index] = encode_part(container, part, put_images(slots, images, decode_part(container, part)))
    with container.path.open("rb") as stream, open_atomic(path) as out:
        write_container(out, container, stream, make_headers(container, beauty, result.settings), chunks)


def plan_writing(container: Container, beauty: Part, fields: Collection[str]) -> list[tuple[Part, list[Slot]]]:
    """Return which of a result's images, by their fields, replace what in which part; those that none has are left out.

    In a file of another renderer only the total is replaced.
    """
    known = SLOTS if find_foreign(container.parts) is None else (BEAUTY,)
    plan: dict[int, list[Slot]] = {}
    for slot in known:
        if slot.owner != "radiance" or slot.field not in fields:
            continue
        for part in _list_readable(container, beauty):
            if {channel.name for channel in part.channels}.issuperset(slot.channels):
                plan.setdefault(part.index, []).append(slot)
                break
    return [(container.parts[index], slots) for index, slots in plan.items()]


def put_images(
    slots: Iterable[Slot], images: Mapping[str, FloatArray], pixels: Mapping[str, Pixels]
) -> dict[str, Pixels]:
    """Return the channels of a part with those of some slots replaced, in the types that they were stored in."""
    changed = dict(pixels)
    for slot in slots:
        for index, name in enumerate(slot.channels):
            changed[name] = _convert(images[slot.field][..., index], pixels[name].dtype)
    return changed


def make_headers(container: Container, beauty: Part, settings: Mapping[str, Any]) -> list[list[Attribute]]:
    """Return the attributes of every part of a denoised copy: as they were, and the settings."""
    headers = [list(part.attributes) for part in container.parts]
    note = json.dumps(settings, sort_keys=True, default=str).encode("utf-8")
    headers[beauty.index] = [item for item in headers[beauty.index] if item.name != DENOISED]
    headers[beauty.index].append(Attribute(DENOISED, "string", note))
    return headers


def plan_reading(container: Container, beauty: Part) -> list[tuple[Part, list[Slot]]]:
    """Return which images of a frame are read from which part.

    Raises
    ------
    MissingChannelError
        If an image has only some of its channels.
    """
    known = SLOTS if find_foreign(container.parts) is None else (BEAUTY,)
    plan: dict[int, list[Slot]] = {}
    for slot in known:
        best: list[str] = []
        for part in _list_readable(container, beauty):
            names = {channel.name for channel in part.channels}
            have = [name for name in slot.channels if name in names]
            if len(have) == len(slot.channels):
                plan.setdefault(part.index, []).append(slot)
                best = []
                break
            best = max(best, have, key=len)
        if best:
            raise MissingChannelError(_say_incomplete(container.path, slot.label, "only " + ", ".join(best)))
    found = {(slot.owner, slot.field) for slots in plan.values() for slot in slots}
    for owner in ("half_a", "half_b", "variance"):
        if (owner, "color") not in found and any(who == owner for who, _ in found):
            got = "none of them beside its other images"
            raise MissingChannelError(_say_incomplete(container.path, f"{owner}.R/G/B", got))
    return [(container.parts[index], slots) for index, slots in sorted(plan.items())]


def read_camera(part: Part) -> Camera | None:
    """Return the camera of a part's header, or None.

    Raises
    ------
    InputError
        If some of its attributes are missing, or make no sense.
    """
    found = {item.name[len(CAMERA) :]: item for item in part.attributes if item.name.startswith(CAMERA)}
    if not found:
        return None
    values: dict[str, Any] = {}
    for name, size in (("position", 3), ("forward", 3), ("up", 3), ("fov_y", 1), ("fov_x", 1)):
        numbers = _read_numbers(found.get(name), size)
        if numbers is None and not (name == "fov_x" and name not in found):
            raise InputError(
                "camera in the header",
                expected=f"the attribute {CAMERA}{name} with {size} real number{'s' if size > 1 else ''}",
                got="another type" if name in found else "none",
                action="write position, forward, up and fov_y, or no camera at all",
            )
        if numbers is not None:
            values[name] = numbers if size > 1 else numbers[0]
    return Camera(**values)


def read_spp(part: Part) -> int | None:
    """Return the sample count of a part's header, or None."""
    item = part.get(SPP)
    return int(struct.unpack("<i", item.value)[0]) if item and item.type == "int" and len(item.value) == 4 else None


def read_lobe_tables(part: Part) -> tuple[LobeTable, ...]:
    """Return the lobe tables of a part's header, in the order of their numbers.

    Raises
    ------
    FileError
        If one is missing before the last, or is no lobe table.
    """
    found = [item for item in part.attributes if item.name.startswith(LOBES)]
    tables = []
    for number in range(1, len(found) + 1):
        name = f"{LOBES}{number}"
        item = part.get(name)
        if item is None:
            raise FileError(
                "lobe tables in the header",
                expected=f"{len(found)}, numbered from 1",
                got="none with the number " + str(number),
                action="number them without gaps",
            )
        text = item.value.decode("utf-8", "replace") if item.type == "string" else ""
        tables.append(lobe_table_from_json(text, what=f"attribute {name}"))
    return tuple(tables)


def _read_numbers(item: Attribute | None, size: int) -> tuple[float, ...] | None:
    if item is None:
        return None
    code = {(3, "v3d"): "<3d", (3, "v3f"): "<3f", (1, "double"): "<d", (1, "float"): "<f"}.get((size, item.type))
    if code is None or struct.calcsize(code) != len(item.value):
        return None
    return struct.unpack(code, item.value)


def _describe_camera(camera: Camera) -> dict[str, Any]:
    out: dict[str, Any] = {
        CAMERA + name: np.array(getattr(camera, name), dtype=np.float64) for name in ("position", "forward", "up")
    }
    # The library writes an array of one element as the attribute type `double`.
    out[CAMERA + "fov_y"] = np.array([camera.fov_y], dtype=np.float64)
    if camera.fov_x is not None:
        out[CAMERA + "fov_x"] = np.array([camera.fov_x], dtype=np.float64)
    return out


def require_beauty(container: Container) -> Part:
    """Return the part that holds the image; raise MissingChannelError where none has R, G and B."""
    part = find_beauty(container.parts)
    if part is not None:
        return part
    names = [channel.name for part in container.parts for channel in part.channels]
    shown = ", ".join(map(show_name, names[:8])) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    raise MissingChannelError(
        f"input {str(container.path)!r}",
        expected="channels R, G and B",
        got=f"only {shown}",
        action="rename the channels of the image to R, G and B",
    )


def _list_readable(container: Container, beauty: Part) -> Iterable[Part]:
    """Yield the part of the image and those that can hold its other channels: same window and view, flat."""
    yield beauty
    for part in container.parts:
        same = part.data_window == beauty.data_window and part.view in ("", beauty.view)
        if part.index != beauty.index and same and not part.deep:
            yield part


def _say_incomplete(path: PathLike, label: str, got: str) -> str:
    return describe_problem(
        f"input {str(path)!r}", expected=f"all of {label}, or none", got=got, action="add or remove them"
    )


def _fits_half(image: NDArray[Any], kind: str) -> bool:
    if kind == "geometry":
        return False
    finite = np.abs(image[np.isfinite(image)])
    if finite.size and finite.max() > MAX_HALF:
        return False
    # A variance is used as a ratio: its small values need their relative precision.
    return kind != "variance" or not np.any((finite > 0.0) & (finite < MIN_NORMAL_HALF))


def _convert(plane: NDArray[Any], dtype: np.dtype[Any]) -> Pixels:
    """Return a plane in the type of the channel that it replaces."""
    if dtype == np.float16:
        plane = np.clip(plane, -MAX_HALF, MAX_HALF)
    elif dtype == np.uint32:
        plane = np.clip(np.rint(plane), 0, 2**32 - 1)
    out: Pixels = plane.astype(dtype)
    return out


def _join(planes: Sequence[Pixels]) -> FloatArray:
    """Return the image of these channels, each converted where it is put: a fifth of the time of two steps."""
    image = np.empty((*planes[0].shape, len(planes)), dtype=np.float32)
    for index, plane in enumerate(planes):
        image[..., index] = plane
    return image


def _write(path: PathLike, data: bytes) -> None:
    with open_atomic(path) as out:
        out.write(data)
