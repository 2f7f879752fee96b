"""Collect the chunks of a part that is written some rows at a time in a temporary file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import BinaryIO

from lobewise.io.exr.container import Attribute, Chunk, Container, Part, crop_part
from lobewise.io.exr.parsing import parse_bytes
from lobewise.io.exr.pixels import Pixels, encode_whole, list_chunks, require_encodable
from lobewise.io.exr.splice import shift_tiles

DECREASING = 1
"""Value of the attribute ``lineOrder`` of a file whose chunks go from the bottom of the image to its top."""


class ChunkSpool:
    """The chunks of one part, encoded from the top of the image to its bottom.

    ``stream`` is a binary file that other parts may use as well. Raises FileError as `require_encodable`.
    """

    def __init__(self, container: Container, part: Part, stream: BinaryIO) -> None:
        require_encodable(container, part)
        self._part, self._stream = part, stream
        self._batches: list[list[Chunk]] = []
        self.made: Part | None = None
        """The part as the library wrote its last rows: with its list of channels and its compression."""

    @property
    def chunks(self) -> tuple[Chunk, ...]:
        """Every chunk, in the order of the chunk table of the whole part, with its offset in the stream."""
        return tuple(sorted((chunk for batch in self._batches for chunk in batch), key=lambda chunk: chunk.index))

    def look_up_made(self, name: str) -> Attribute | None:
        """Return an attribute as the library wrote it, or None."""
        return None if self.made is None else self.made.get(name)

    def add(self, first: int, stop: int, pixels: Mapping[str, Pixels]) -> bytes:
        """Encode the rows from ``first`` to before ``stop``, as for `crop_part`; return them as a file of their own."""
        cropped = crop_part(self._part, first, stop)
        data = encode_whole(cropped, pixels)
        self.made = parse_bytes(data).parts[0]
        across = len(self.made.chunks) // -(-(stop - first) // cropped.rows_per_chunk)
        above = first // cropped.rows_per_chunk * across
        batch = []
        for index, chunk in list_chunks(self.made, data):
            place = self._stream.seek(0, 2)
            self._stream.write(shift_tiles(chunk, cropped.tiles_above))
            batch.append(Chunk(above + index, place, len(chunk)))
        self._batches.append(batch)
        return data

    def read(self) -> Iterator[tuple[int, bytes]]:
        """Yield index in the chunk table and bytes without part number of every chunk, in the file's order."""
        falling = self._part.line_order == DECREASING
        for batch in reversed(self._batches) if falling else self._batches:
            for chunk in batch:
                self._stream.seek(chunk.offset)
                yield chunk.index, self._stream.read(chunk.size)
