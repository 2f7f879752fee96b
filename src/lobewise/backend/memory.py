"""Memory of the images that kernels write: where it begins, and pools that use it again.

Large arrays begin at a page, and planes of many image sizes are a whole number of pages. Pixels of one place would then
share a few lines of the nearest cache, whose set is chosen by the place within a page, and a kernel that reads twenty
images would read each line several times. So images begin at different places of a page.

The system clears new memory before it hands it out, which takes as long as a simple kernel. Filters that run frame
after frame therefore keep the memory of the last frame in a `MemoryPool`.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

PAGE_BYTES = 4096
"""Addresses that are so far apart share their set of the nearest cache."""
CACHE_STEP_BYTES = 5 * 64
"""Distance of two images within a page: an odd number of cache lines, so that all sets are used."""
MIN_SPREAD_BYTES = 1 << 16
"""Size of an image from which its place within a page matters."""


class _Block:
    """Bytes that an array lies in. When the array is gone, they go back to their pool."""

    def __init__(self, pool: MemoryPool, memory: NDArray[np.uint8]) -> None:
        self._pool, self._memory = pool, memory
        self.__array_interface__ = memory.__array_interface__

    def __del__(self) -> None:
        self._pool._give_back(self._memory)


class MemoryPool:
    """The memory of arrays that are gone, for new arrays of the same size.

    It holds no more than its last two uses needed.
    """

    def __init__(self) -> None:
        self._free: dict[int, list[tuple[int, NDArray[np.uint8]]]] = {}
        self._uses = 0

    @contextmanager
    def use(self) -> Iterator[None]:
        """Take the memory of all images that kernels write inside the context from this pool."""
        before, _current.pool = _current.pool, self
        self._uses += 1
        try:
            yield
        finally:
            _current.pool = before
            for size, blocks in list(self._free.items()):
                self._free[size] = [block for block in blocks if block[0] >= self._uses - 1]
                if not self._free[size]:
                    del self._free[size]

    def clear(self) -> None:
        """Free all memory that is not in use."""
        self._free.clear()

    def take(self, size: int) -> NDArray[np.uint8]:
        """Return an array of ``size`` bytes, uninitialised."""
        blocks = self._free.get(size)
        memory = blocks.pop()[1] if blocks else np.empty(size, np.uint8)
        return np.asarray(_Block(self, memory))

    def _give_back(self, memory: NDArray[np.uint8]) -> None:
        self._free.setdefault(memory.nbytes, []).append((self._uses, memory))


class _Current(threading.local):
    pool: MemoryPool | None = None
    offset: int = 0
    """Place of the next image within a page, bytes."""


_current = _Current()


def make_planes(shape: tuple[int, ...], type: str = "float32") -> NDArray[Any]:
    """Return an uninitialised array whose entries along the first axis begin in different sets of the cache.

    Each entry is dense; there are gaps between entries.
    """
    count, *rest = shape
    entries = int(np.prod(rest, dtype=np.int64))
    size = np.dtype(type).itemsize
    if entries * size < MIN_SPREAD_BYTES:
        return np.empty(shape, type)
    step = -(-entries * size // PAGE_BYTES) * PAGE_BYTES + CACHE_STEP_BYTES
    total = count * step + 2 * PAGE_BYTES
    memory = np.empty(total, np.uint8) if _current.pool is None else _current.pool.take(total)
    # Count from the beginning of a page, wherever the allocator put the memory.
    start = -memory.ctypes.data % PAGE_BYTES + _current.offset
    _current.offset = (_current.offset + count * CACHE_STEP_BYTES) % PAGE_BYTES
    flat = memory[start : start + count * step].reshape(count, step)[:, : entries * size]
    return flat.view(type).reshape(shape)


def make_array(shape: tuple[int, ...], type: str = "float32") -> NDArray[Any]:
    """Return an uninitialised dense array, whose beginning differs from that of the array before."""
    array: NDArray[Any] = make_planes((1, *shape), type)[0]
    return array
