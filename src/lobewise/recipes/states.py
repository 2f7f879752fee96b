"""Files of what a filter over time remembers. They may be damaged or malicious, and are read so."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.io.files import open_record

State = dict[str, NDArray[Any]]
"""The memory of a filter: arrays by name."""

_STATE_PREFIX = "state/"
"""Beginning of the names of the arrays that a filter remembers."""
_MAX_PROOF_BYTES = 4096
"""Size limit of the proof; all other arrays are read only if it is the wanted one."""


def save_state(path: Path, proof: str, state: State) -> None:
    """Write what a filter remembers, whole or not at all; ``proof`` stands for the frames that it has seen.

    Raises InputError if the state is not made of plain arrays, and FileError if the file cannot be written.
    """
    arrays: dict[str, Any] = {_STATE_PREFIX + name: np.asarray(value) for name, value in state.items()}
    if any(array.dtype.hasobject for array in arrays.values()):
        raise InputError(
            "state of the filter", expected="plain arrays", got="Python objects", action="give numbers or text"
        )
    with open_record(path, what="record") as stream:
        np.savez(stream, proof=np.array(proof), **arrays)


def load_state(path: Path, proofs: Sequence[str]) -> tuple[int, State] | None:
    """Return a state, and the place of its proof among ``proofs``; None if it is of other frames, or damaged."""
    # NumPy raises many kinds of errors on a damaged file.
    with suppress(Exception), path.open("rb") as stream, zipfile.ZipFile(stream) as file:
        arrays = _Arrays(file, path.stat().st_size)
        return proofs.index(str(arrays.load("proof", max_bytes=_MAX_PROOF_BYTES))), arrays.load_state()
    return None


class _Arrays:
    """Arrays of a file: reading them never takes more memory than the file has bytes.

    Raises ValueError unless the arrays are stored as `save_state` writes them: without compression (a megabyte may
    unpack to terabytes), each name once, and with the sizes that their headers say.
    """

    def __init__(self, file: zipfile.ZipFile, size: int) -> None:
        self._file = file
        self._members = {item.filename.removesuffix(".npy"): item for item in file.infolist()}
        stored = all(
            item.compress_type == zipfile.ZIP_STORED and item.compress_size == item.file_size
            for item in file.infolist()
        )
        total = sum(item.file_size for item in file.infolist())
        if not stored or total > size or len(self._members) < len(file.infolist()):
            raise ValueError("arrays that are not stored as they are")

    def load(self, name: str, *, max_bytes: int | None = None) -> NDArray[Any]:
        """Return an array; raise ValueError if it has more than ``max_bytes``."""
        item = self._members[name]
        if max_bytes is not None and item.file_size > max_bytes:
            raise ValueError(f"{name} of {item.file_size} bytes")
        with self._file.open(item) as stream:
            version = np.lib.format.read_magic(stream)
            if version != (1, 0):
                raise ValueError(f"version {version}")
            shape, _, kind = np.lib.format.read_array_header_1_0(stream)
            # Check before reading: NumPy allocates the size in the header at once.
            if kind.kind not in "biufU" or math.prod(shape) * kind.itemsize != item.file_size - stream.tell():
                raise ValueError(f"{name} of another size than it says")
        with self._file.open(item) as stream:
            array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
            return array

    def load_state(self) -> State:
        """Return the memory of the filter."""
        return {
            name.removeprefix(_STATE_PREFIX): self.load(name)
            for name in self._members
            if name.startswith(_STATE_PREFIX)
        }
