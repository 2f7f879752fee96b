"""Read and write frames as OpenEXR files. Every file is written whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import require_choice, require_kind
from lobewise.io.exr.container import Container
from lobewise.io.exr.header import ENVMAP, ENVMAP_LATLONG, describe_camera, read_camera, read_lobe_tables, read_spp
from lobewise.io.exr.layout import (
    MAX_HALF,
    build_frame,
    make_images,
    name_file,
    plan_reading,
    require_beauty,
    require_shaded,
)
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import Pixels, decode_part, encode_file
from lobewise.io.exr.schema import LOBES, SCHEMA, SCHEMA_VERSION, SLOTS, SPP
from lobewise.io.files import PathLike, open_atomic, require_writable
from lobewise.io.materials import lobe_table_to_json
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.lobe_table import LobeTable
from lobewise.work.limits import require_memory

MIN_NORMAL_HALF = 2.0**-14
"""Smallest normal number of a 16-bit float: smaller numbers have less relative precision."""


def read_frame(path: PathLike, *, lobe_tables: Sequence[LobeTable] | None = None) -> Frame:
    """Return the frame of an EXR file in lobewise's own channel names (``docs/developers/conventions.md``).

    Pixels that are NaN, infinite or negative stay as they are. The image of a multi-part file is the first part with
    channels R, G and B. Its other channels may be in this part or in other parts with an equal data window.

    Parameters
    ----------
    path : path
        The file.
    lobe_tables : sequence of LobeTable, optional
        The tables that the channel ``material.I`` numbers, in place of the tables in the file's header.

    Raises
    ------
    FileError
        If the file is missing, unreadable, damaged, truncated or of zero size, or a lobe table in the header is
        invalid.
    MissingChannelError
        If there is no R, G and B, or an image has only some of its channels.
    InputError
        If the camera in the header is invalid, or a pixel names a lobe table that does not exist.
    """
    container = read_container(path)
    require_shaded(container)
    return read_whole(path, container, lobe_tables)


def read_whole(path: PathLike, container: Container, lobe_tables: Sequence[LobeTable] | None = None) -> Frame:
    """Return every pixel of a file, shaded or not; see `read_frame`."""
    beauty = require_beauty(container)
    images: dict[tuple[str, str], FloatArray] = {}
    planned = plan_reading(container, beauty)
    require_memory(sum(part.data_window.area * 4 * len(slot.channels) for part, slots in planned for slot in slots))
    for part, slots in planned:
        images |= make_images(slots, decode_part(container, part, {name for slot in slots for name in slot.channels}))
    with name_file(path):
        tables = read_lobe_tables(beauty) if lobe_tables is None else tuple(lobe_tables)
        return build_frame(images, read_camera(beauty), read_spp(beauty), tables)


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
        One of the lossless compressions ``none, rle, zips, zip, piz, zstd``.
    attributes : mapping of str to str, optional
        Further header attributes.

    Raises
    ------
    FileError
        If the path cannot be written.
    InputError
        If the compression is unknown.
    """
    require_kind("frame", frame, Frame)
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
        header.update(describe_camera(frame.camera))
    if frame.wraps:
        header[ENVMAP] = ENVMAP_LATLONG
    header.update({f"{LOBES}{k}": lobe_table_to_json(table) for k, table in enumerate(frame.lobe_tables, start=1)})
    with open_atomic(path) as out:
        out.write(encode_file(header, pixels, compression=compression))


def write_image(path: PathLike, image: ArrayLike, *, half: bool = False, compression: str = "zip") -> None:
    """Write one image of shape (height, width, 3) as channels R, G and B.

    Raises
    ------
    FileError
        If the path cannot be written.
    InputError
        If the array is not such an image.
    """
    write_frame(path, Frame(Radiance(image)), half=half, compression=compression)


def _fits_half(image: NDArray[Any], kind: str) -> bool:
    if kind == "geometry":
        return False
    finite = np.abs(image[np.isfinite(image)])
    if finite.size and finite.max() > MAX_HALF:
        return False
    # Ratios of variances are taken, so small variances need full relative precision.
    return kind != "variance" or not np.any((finite > 0.0) & (finite < MIN_NORMAL_HALF))
