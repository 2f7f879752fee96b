"""What NumPy computes of images pixel by pixel, some rows at a time.

NumPy's arrays between are small then. Those of whole images would be fresh memory, which the system clears first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from numpy.typing import NDArray

from lobewise.backend.buffers import make_array
from lobewise.records.images import FloatArray
from lobewise.work.chunks import Chunk, cut_rows, run_chunks


def compute_rows(compute: Callable[..., FloatArray], *images: NDArray[Any], channels: int = 3) -> FloatArray:
    """Return what ``compute`` makes of the same rows of images, (height, width, channels)."""
    height, width = images[0].shape[:2]
    result: FloatArray = make_array((height, width, channels))

    def work(rows: Chunk) -> None:
        result[rows] = compute(*(image[rows] for image in images))

    run_chunks(work, height, width)
    return result


def list_rows(*images: FloatArray) -> Iterator[tuple[FloatArray, ...]]:
    """Yield the same rows of images, some rows after others."""
    for rows in cut_rows(*images[0].shape[:2]):
        yield tuple(image[rows] for image in images)
