"""The pixels of each chunk of a part, in the order of the chunk table, and the largest expansion of compressed bytes.

Source: for the order, "OpenEXR File Layout", openexr.com; for the expansion, the formats that are named below.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from lobewise.io.exr.container import Channel, Window

MAX_EXPANSION = {
    # Bytes as they are.
    "none": 1,
    # Two bytes make a run of at most 128.
    "rle": 64,
    # Deflate (RFC 1951): a match of 258 bytes takes at least two bits.
    "zips": 1032,
    "zip": 1032,
    # A run of at most 255 values of two bytes takes a code of at least one bit and a count of eight.
    "piz": 454,
    # Deflate, of three bytes where a float has four.
    "pxr24": 1376,
    # 16 halves take at least three bytes.
    "b44": 11,
    "b44a": 11,
    # 64 floats take at least the two bytes of their mean, by Deflate.
    "dwaa": 132096,
    "dwab": 132096,
}
"""Most bytes of pixels that one byte of a chunk can decode to. The other compressions have no such bound."""
_SIZES = {"half": 2, "float": 4, "uint": 4}


@dataclass(frozen=True)
class Place:
    """The coordinates that a chunk's leader must have, and the size of the chunk.

    Parameters
    ----------
    coordinates : tuple of int
        For scanlines, the first row. For a tile, its column and row among the tiles, and its level in x and in y.
    width, height : int
        Pixels.
    """

    coordinates: tuple[int, ...]
    width: int
    height: int

    def count_bytes(self, channels: tuple[Channel, ...]) -> int:
        """Return the fewest bytes of the decoded pixels. A subsampled channel may have a few more."""
        return sum(
            _SIZES[each.pixel_type] * (self.width // each.x_sampling) * (self.height // each.y_sampling)
            for each in channels
        )


def list_rows(window: Window, rows: int) -> Iterator[Place]:
    """Yield the place of every chunk of scanlines, ``rows`` to a chunk."""
    for top in range(window.y_min, window.y_max + 1, rows):
        yield Place((top,), window.width, min(rows, window.y_max + 1 - top))


def list_tiles(window: Window, mode: int, width: int, height: int) -> Iterator[Place]:
    """Yield the place of every tile of ``width`` x ``height`` pixels; ``mode`` is that of the attribute ``tiles``."""
    for (level_x, level_y), (across, down) in zip(*list_levels(window, mode), strict=True):
        for row, top in enumerate(range(0, down, height)):
            for column, left in enumerate(range(0, across, width)):
                yield Place((column, row, level_x, level_y), min(width, across - left), min(height, down - top))


def list_levels(window: Window, mode: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Return the number in x and y of every resolution level, and its width and height."""

    def sizes(full: int) -> list[int]:
        out = [full]
        while out[-1] > 1:
            out.append((out[-1] + 1) // 2 if mode >> 4 else out[-1] // 2)
        if mode >> 4:
            # Round up from the original size. Rounding up each level before gives the same sizes.
            out = [max(1, -(-full // 2**level)) for level in range(len(out))]
        return out

    if mode & 0xF == 0:
        return [(0, 0)], [(window.width, window.height)]
    across, down = sizes(window.width), sizes(window.height)
    if mode & 0xF == 1:
        count = max(len(across), len(down))
        across += [1] * (count - len(across))
        down += [1] * (count - len(down))
        return [(level, level) for level in range(count)], list(zip(across, down, strict=True))
    numbers = [(x, y) for y in range(len(down)) for x in range(len(across))]
    return numbers, [(across[x], down[y]) for x, y in numbers]
