"""Filtered bands, kept on the disk until all bands are filtered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray


class _Place(NamedTuple):
    """Place of an image in the file."""

    start: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]


class KeptBands:
    """Images of bands in a binary file; they are read in the order in which they were added."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._bands: list[dict[str, _Place]] = []

    def add(self, images: Mapping[str, NDArray[Any]]) -> None:
        """Keep the images of a band, by name."""
        places = {}
        for name, image in images.items():
            places[name] = _Place(self._file.seek(0, 2), image.shape, image.dtype)
            self._file.write(np.ascontiguousarray(image).data)
        self._bands.append(places)

    def read(self) -> Iterator[dict[str, NDArray[Any]]]:
        """Return the images of one band after the other."""
        for places in self._bands:
            images = {}
            for name, place in places.items():
                self._file.seek(place.start)
                image = np.empty(place.shape, place.dtype)
                self._file.readinto(image.data.cast("B"))  # type: ignore[attr-defined]
                images[name] = image
            yield images
