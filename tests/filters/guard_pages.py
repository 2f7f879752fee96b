"""Buffers next to protected pages: a kernel that reads or writes beyond a buffer crashes.

As a plugin (``pytest -p tests.filters.guard_pages``) it moves all buffers of kernels on the processor to a protected
page: behind them or before them, as the environment variable ``GUARD_PAGES`` says ("end", "start"). Outputs are copied
back, and memory between the rows of a part of an image must not change. Kernels may only assume that entries are
aligned to their own size (`lobewise.backend.buffers.lend`).
"""

import ctypes
import mmap
import os
from typing import Any

import numpy as np

from lobewise.backend.buffers import Buffer
from lobewise.backend.jit import Kernel

PLACE = "GUARD_PAGES"
PAGE = mmap.PAGESIZE
UNTOUCHED = 0xA5
"""A byte between the rows of a part of an image."""


class GuardedCopy:
    """A copy of an array with its strides, between two pages that nobody may touch."""

    def __init__(self, array: np.ndarray, place: str) -> None:
        # Bytes before and behind the first entry: strides may be negative.
        reach = [(length - 1) * stride for length, stride in zip(array.shape, array.strides, strict=True)]
        before = -sum(each for each in reach if each < 0)
        span = before + sum(each for each in reach if each > 0) + array.itemsize
        inside = -(-span // PAGE) * PAGE
        self._memory = mmap.mmap(-1, inside + 2 * PAGE)
        address = ctypes.addressof(ctypes.c_char.from_buffer(self._memory))
        for page in (address, address + PAGE + inside):
            protect(page, PAGE)
        offset = PAGE if place == "start" else PAGE + inside - span
        self._whole = np.frombuffer(self._memory, np.uint8, span, offset)
        self._whole[:] = UNTOUCHED
        self.array = np.ndarray(array.shape, array.dtype, self._memory, offset + before, array.strides)
        self.array[...] = array
        used = np.zeros(span, bool)
        for byte in range(array.itemsize):
            np.ndarray(array.shape, bool, used, before + byte, array.strides)[...] = True
        self._gaps = ~used

    def check_gaps(self) -> None:
        """Require that nothing was written between the rows."""
        assert (self._whole[self._gaps] == UNTOUCHED).all(), "a kernel wrote between the rows of its buffer"


def protect(address: int, length: int) -> None:
    """Let any access to whole pages end the process."""
    library = ctypes.CDLL(None, use_errno=True)
    nobody = 0
    if library.mprotect(ctypes.c_void_p(address), ctypes.c_size_t(length), nobody) != 0:
        raise OSError(ctypes.get_errno(), "mprotect")


def guard_kernels(place: str, shift: int = 0) -> list[str]:
    """Put every buffer of every call of a kernel on the processor between guard pages, from now on.

    Parameters
    ----------
    place : {"start", "end"}
        Which guard page the buffers touch.
    shift : int
        Entries by which kernels are lied to about where buffers begin, to see that the pages guard.

    Returns
    -------
    list of str
        The names of the kernels that were called, which grows.
    """
    call, called = Kernel.__call__, []

    def call_guarded(kernel: Kernel, **arguments: Any) -> None:
        buffers = {name: each for name, each in arguments.items() if isinstance(each, Buffer) and each.array.size}
        if any(each.device for each in buffers.values()):
            return call(kernel, **arguments)
        copies = {name: GuardedCopy(each.array, place) for name, each in buffers.items()}
        guarded = {name: Buffer(copy.array, buffers[name].first) for name, copy in copies.items()}
        for buffer in guarded.values():
            buffer._raw.host += shift * buffer.array.itemsize
        called.append(kernel.name)
        call(kernel, **{**arguments, **guarded})
        for copy in copies.values():
            copy.check_gaps()
        for each in kernel.outputs:
            if each.name in copies:
                buffers[each.name].array[...] = copies[each.name].array
        return None

    Kernel.__call__ = call_guarded  # type: ignore[method-assign]
    return called


if PLACE in os.environ:
    guard_kernels(os.environ[PLACE])
