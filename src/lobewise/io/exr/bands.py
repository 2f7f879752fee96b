"""Read frames from OpenEXR files, and write results to them, some rows at a time.

The meaning of channels is declared once, for whole files too (`lobewise.io.exr.layout`). Chunks are cut into parts of
their own, which the codec decodes and encodes separately. So the written file has the bytes of a file that was written
as a whole.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from lobewise.errors import FileError
from lobewise.io.exr.container import Container, Part, crop_part, show_name
from lobewise.io.exr.header import make_headers, read_camera, read_lobe_tables, read_spp
from lobewise.io.exr.layout import (
    build_frame,
    make_images,
    name_file,
    plan_reading,
    put_images,
    require_beauty,
    require_shaded,
)
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import DTYPES, Pixels, count_fitting_rows, decode_part
from lobewise.io.exr.splice import write_container
from lobewise.io.exr.spool import ChunkSpool
from lobewise.io.files import PathLike, open_atomic
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.lobe_table import LobeTable

SLAB_ROWS = 64
"""Rows that are decoded or encoded at once, about: enough work for all cores."""
MAX_KEPT_BYTES = 200
"""Most bytes per pixel of channels that are only copied, up to which they are kept instead of decoded twice."""


def count_slab_rows(part: Part) -> int:
    """Return how many rows of a part are decoded, or encoded, at a time."""
    rows = part.rows_per_chunk
    return min(rows * max(SLAB_ROWS // rows, 1), count_fitting_rows(part))


def read_slabs(container: Container, part: Part, names: Collection[str]) -> Iterator[tuple[int, dict[str, Pixels]]]:
    """Yield some rows of channels at a time, in their stored types, each with the number of the first row."""
    height, rows = part.data_window.height, count_slab_rows(part)
    for top in range(0, height, rows):
        yield top, decode_part(container, crop_part(part, top, min(top + rows, height)), names)


Place = tuple[Part, Sequence[str]]
"""A part, and those of its channels that hold an image."""


class BandReader:
    """Reads a frame some rows at a time. Every row is decoded once and kept until it is forgotten.

    ``lobe_tables`` are as in `lobewise.io.exr.read_frame`. ``wanted`` are owner and field of the images to read, if the
    file has them; by default all.

    Raises errors about the header as `lobewise.io.exr.read_frame`, and FileError if a part that is read has subsampled
    channels, which have fewer rows than the image.
    """

    def __init__(
        self,
        path: PathLike,
        *,
        lobe_tables: Sequence[LobeTable] | None = None,
        wanted: Collection[tuple[str, str]] | None = None,
    ) -> None:
        container = read_container(path)
        require_shaded(container)
        beauty = require_beauty(container)
        self._slots = [
            (part, slot)
            for part, slots in plan_reading(container, beauty)
            for slot in slots
            if wanted is None or (slot.owner, slot.field) in wanted
        ]
        self._start(container, beauty, [(part, slot.channels) for part, slot in self._slots])
        with name_file(path):
            self.camera = read_camera(beauty)
            self.spp = read_spp(beauty)
            self.lobe_tables = read_lobe_tables(beauty) if lobe_tables is None else tuple(lobe_tables)

    def _start(self, container: Container, beauty: Part, places: Sequence[Place]) -> None:
        """Keep the channels of the images at some places."""
        self.container, self.beauty, self._places = container, beauty, places
        self._slabs: dict[tuple[int, int], dict[str, Pixels]] = {}
        self._kept: dict[int, set[str]] = {}
        for part, names in places:
            self.keep(part, names)

    def reopen(self, wanted: Collection[tuple[str, str]] | None = None) -> BandReader:
        """Return another reader of the same file; ``wanted`` is as in `BandReader`."""
        return BandReader(self.container.path, lobe_tables=self.lobe_tables, wanted=wanted)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        window = self.beauty.data_window
        return window.height, window.width

    @property
    def images(self) -> frozenset[tuple[str, str]]:
        """Owner and field of every image that is read."""
        return frozenset((slot.owner, slot.field) for _, slot in self._slots)

    @property
    def layers(self) -> tuple[str, ...]:
        """The names of the layers of light, in their order; none where it is not told apart."""
        names = ("diffuse", "specular")
        return names if all(("radiance", name) in self.images for name in names) else ()

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the images of a result that the file has channels for."""
        return ("color", *self.layers)

    def count_bytes(self) -> tuple[int, int]:
        """Return bytes per pixel: of all kept channels in their stored types, and of the images of a frame."""
        stored = sum(
            DTYPES[channel.pixel_type].itemsize
            for index, names in self._kept.items()
            for channel in self.container.parts[index].channels
            if channel.name in names
        )
        return stored, sum(4 * len(names) for _, names in self._places)

    def count_more(self, part: Part) -> int:
        """Return bytes per pixel of the channels of a part that are not kept."""
        held = self._kept.get(part.index, set())
        return sum(DTYPES[channel.pixel_type].itemsize for channel in part.channels if channel.name not in held)

    def keep(self, part: Part, names: Collection[str]) -> None:
        """Keep these channels of a part too. Rows that were read without them are read again."""
        self._require_plain(part)
        self._kept.setdefault(part.index, set()).update(names)
        self._slabs = {key: slab for key, slab in self._slabs.items() if key[0] != part.index}

    def read_frame(self, first: int, stop: int) -> Frame:
        """Return the rows from ``first`` to before ``stop``, counted from the top, as a frame.

        Raises
        ------
        FileError
            If pixels are damaged.
        InputError
            If a pixel names a lobe table that does not exist.
        """
        images: dict[tuple[str, str], FloatArray] = {}
        for part, slot in self._slots:
            images |= make_images([slot], self.read_channels(part, slot.channels, first, stop))
        camera = None if self.camera is None else self.camera.crop_rows(first, self.shape[0])
        with name_file(self.container.path):
            return build_frame(images, camera, self.spp, self.lobe_tables)

    def list_targets(self, fields: Collection[str]) -> dict[str, Place]:
        """Return the places of a result's images, of those that the file has channels for."""
        return {slot.role: (part, slot.channels) for part, slot in self._slots if slot.role in fields}

    def read_part(self, part: Part, first: int, stop: int) -> dict[str, Pixels]:
        """Return rows of every channel of a part, in their stored types.

        If some of its channels are not kept, all are decoded again; then ``first`` and ``stop`` must fit whole chunks.
        """
        names = sorted(channel.name for channel in part.channels)
        if self._kept.get(part.index, set()).issuperset(names):
            return self.read_channels(part, names, first, stop)
        return decode_part(self.container, crop_part(part, first, stop))

    def forget(self, row: int) -> None:
        """Free the rows above ``row``."""
        for index, top in list(self._slabs):
            if top + count_slab_rows(self.container.parts[index]) <= row:
                del self._slabs[index, top]

    def read_channels(self, part: Part, names: Collection[str], first: int, stop: int) -> dict[str, Pixels]:
        """Return rows of channels that are kept, in their stored types."""
        step = count_slab_rows(part)
        pieces: dict[str, list[Pixels]] = {name: [] for name in names}
        for top in range(first // step * step, stop, step):
            if (part.index, top) not in self._slabs:
                bottom = min(top + step, part.data_window.height)
                cropped = crop_part(part, top, bottom)
                self._slabs[part.index, top] = decode_part(self.container, cropped, self._kept[part.index])
            for name in names:
                pieces[name].append(self._slabs[part.index, top][name][max(first - top, 0) : stop - top])
        return {name: np.concatenate(each) if len(each) > 1 else each[0] for name, each in pieces.items()}

    def _require_plain(self, part: Part) -> None:
        for channel in part.channels:
            if (channel.x_sampling, channel.y_sampling) != (1, 1):
                raise FileError(
                    f"input {str(self.container.path)!r}",
                    expected="channels that have every pixel, to be read in bands",
                    got=f"the subsampled channel '{show_name(channel.name)}'",
                    action="denoise it as a whole",
                )


@dataclass
class _Written:
    """A part that is being written."""

    part: Part
    channels: dict[str, Sequence[str]]
    """The channels of each image of the result."""
    row: int
    """The first row that is not written."""
    spool: ChunkSpool


class BandWriter:
    """Writes a copy of a reader's file with new radiance, from the top to the bottom.

    Create it before the reader reads any row: from then on the reader also keeps the channels that are only copied,
    unless they exceed `MAX_KEPT_BYTES`. ``fields`` are the images that `add` will be given, of ``color``, ``diffuse``
    and ``specular``. ``spool`` is a binary file for the chunks until all are written.

    Raises FileError if the part of an image cannot be written (see `require_encodable`).
    """

    def __init__(self, reader: BandReader, fields: Collection[str], spool: BinaryIO) -> None:
        self._reader = reader
        container = reader.container
        channels: dict[int, dict[str, Sequence[str]]] = {}
        for field, (part, names) in reader.list_targets(fields).items():
            channels.setdefault(part.index, {})[field] = names
        parts = [(container.parts[index], names) for index, names in channels.items()]
        self._written = [_Written(part, names, 0, ChunkSpool(container, part, spool)) for part, names in parts]
        for one_part in self._written:
            if reader.count_more(one_part.part) <= MAX_KEPT_BYTES:
                reader.keep(one_part.part, {channel.name for channel in one_part.part.channels})
        self._pending: dict[str, FloatArray] = {}
        self._top = self._bottom = 0

    @property
    def row(self) -> int:
        """The first row that is still needed from the reader."""
        return min(each.row for each in self._written)

    def add(self, images: Mapping[str, FloatArray]) -> None:
        """Write the next rows of every image, each (rows, width, 3)."""
        self._bottom += len(images["color"])
        for field, image in images.items():
            before = self._pending.get(field)
            self._pending[field] = image if before is None or not len(before) else np.concatenate([before, image])
        height, _ = self._reader.shape
        for written in self._written:
            rows = written.part.rows_per_chunk
            stop = self._bottom if self._bottom == height else self._bottom // rows * rows
            # Encode some rows at a time: a codec holds several copies of its pixels.
            while written.row < stop:
                self._encode(written, min(written.row + count_slab_rows(written.part), stop))
        self._pending = {field: image[self.row - self._top :] for field, image in self._pending.items()}
        self._top = self.row

    def finish(self, path: PathLike, settings: Mapping[str, Any]) -> None:
        """Write the file, whole or not at all, with ``settings`` in its header.

        Raises FileError if the path cannot be written.
        """
        container = self._reader.container
        replaced = {
            each.part.index: [name for names in each.channels.values() for name in names] for each in self._written
        }
        headers = make_headers(container, self._reader.beauty, settings, replaced)
        chunks = {each.part.index: self._list_chunks(each) for each in self._written}
        with container.path.open("rb") as stream, open_atomic(path) as out:
            write_container(out, container, stream, headers, chunks)

    def _encode(self, written: _Written, stop: int) -> None:
        part, first = written.part, written.row
        rows = slice(first - self._top, stop - self._top)
        images = {field: image[rows] for field, image in self._pending.items()}
        written.spool.add(first, stop, put_images(written.channels, images, self._reader.read_part(part, first, stop)))
        written.row = stop

    def _list_chunks(self, written: _Written) -> Iterator[tuple[int, bytes]]:
        return written.spool.read()
