"""Runs the refining network: calls its kernels layer by layer and level by level.

The network is a U-Net: it halves the image four times, and enlarges the features again. A pyramid of filters then uses
weights that it predicts. Features, sums and vectors are images of (row, channel, column).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from lobewise import engine
from lobewise.backend.buffers import Image
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.refinement.convolutions import Reading, make_convolution, pad_columns
from lobewise.filters.refinement.pyramid import FILTER_STRIP_ROWS, SUMS_OF_IMAGE, make_averages, make_filter, make_sums
from lobewise.filters.refinement.shape import LAYERS, LEVEL_COUNT
from lobewise.records.frame import FloatArray

SMALL_LEVEL, SMALL_STRIP_ROWS = 3, 2
"""From this level on images are so small that a thread takes so few rows of a convolution."""
NEUTRAL = np.ones((1, 1, COLORS), np.float32)
"""The tint of all levels but the finest, whose every pixel it stands for."""


class LevelSize(NamedTuple):
    """Rows and columns of a level: numbers, or names of axes where the recipe is recorded."""

    height: Any
    width: Any


class RefiningNetwork:
    """The network on one image.

    Parameters
    ----------
    weights : array
        Result of `lobewise.filters.refinement.run.pack_weights`.
    images : dict of str to Image
        Results of the kernel of planes: "planes", "light", "vectors", "tint". The network takes out what it does not
        read again.
    brightness : float
        As of `lobewise.filters.refinement.run.refine_image`.
    """

    def __init__(self, weights: FloatArray, images: dict[str, Any], brightness: float) -> None:
        self._weights, self._images = engine.hold("refinement_weights", weights), images
        self._brightness = brightness
        self._sizes = [LevelSize(*images["tint"].shape[:2])]
        for _ in range(LEVEL_COUNT - 1):
            self._sizes.append(LevelSize(*map(engine.halve, self._sizes[-1])))
        self._free: dict[tuple[int, ...], list[Image]] = {}

    def run(self) -> Image:
        """Return the refined image, (height, width, 3)."""
        features = self._compute_features()
        # Memory that the filters do not need again.
        self._free.clear()
        sums, vectors = [self._weigh_light(features[0])], [self._images["vectors"]]
        for level in range(1, LEVEL_COUNT):
            sums.append(self._average(sums[-1], level))
            vectors.append(self._average(vectors[-1], level))
        filtered = self._filter(LEVEL_COUNT - 1, features.pop(), sums.pop(), vectors.pop(), None)
        for level in reversed(range(LEVEL_COUNT - 1)):
            filtered = self._filter(level, features.pop(), sums.pop(), vectors.pop(), filtered)
        return filtered

    def _compute_features(self) -> list[Image]:
        """Return the features of each level."""
        planes, skipped = self._images.pop("planes"), {}
        last = self._convolve("stem", 1, planes, reading=Reading.BLOCKS)
        for level in range(1, LEVEL_COUNT):
            reading = Reading.HALVED if level > 1 else Reading.SAME
            joined = self._convolve(f"down.{level - 1}.0", level, last, reading=reading)
            if level == 1:
                self._give_back(last)
            last = skipped[level] = self._convolve(f"down.{level - 1}.1", level, joined)
            self._give_back(joined)
        features = [last]
        for level in reversed(range(1, LEVEL_COUNT - 1)):
            joined = self._convolve(f"up.{level - 1}.0", level, features[0], skipped[level], reading=Reading.ENLARGED)
            self._give_back(skipped[level])
            features.insert(0, self._convolve(f"up.{level - 1}.1", level, joined))
            self._give_back(joined)
        squeezed = self._convolve("squeeze", 1, features[0])
        # The finest level's images are the largest, and of another size.
        del last, joined, skipped
        self._free.clear()
        joined = self._convolve("fine.0", 0, squeezed, planes, reading=Reading.ENLARGED)
        del planes, squeezed
        return [self._convolve("fine.1", 0, joined), *features]

    def _convolve(
        self, name: str, level: int, first: Image, second: Image | None = None, reading: Reading = Reading.SAME
    ) -> Image:
        """Return the result of a layer on a level; without ``second`` it reads one image."""
        layer, size = LAYERS[name], self._sizes[level]
        below = level - 1 if reading in (Reading.HALVED, Reading.BLOCKS) else level
        numbers = {
            "start": layer.start,
            "side": layer.side,
            "reading": reading.value,
            "first_width": self._sizes[below].width,
            "width": size.width,
            "height": size.height,
            "channels_of_second": 0 if second is None else second.shape[1],
            "strip_rows": SMALL_STRIP_ROWS if level >= SMALL_LEVEL else FILTER_STRIP_ROWS,
        }
        images = {"first": first, "second": first if second is None else second, "weights": self._weights}
        return self._call(make_convolution, level, layer.outputs, images, numbers, f"layer {name}")

    def _weigh_light(self, features: Image) -> Image:
        """Return the sums of the finest level."""
        images = {"features": features, "weights": self._weights}
        images |= {name: self._images[name] for name in ("light", "tint")}
        numbers = {"brightness": self._brightness}
        return self._call(make_sums, 0, 2 * SUMS_OF_IMAGE, images, numbers, "weighted light")

    def _average(self, source: Image, level: int) -> Image:
        """Return the sums or vectors of a level from those of the level below."""
        numbers = {"source_width": self._sizes[level - 1].width}
        return self._call(make_averages, level, source.shape[1], {"source": source}, numbers, f"means of level {level}")

    def _filter(self, level: int, features: Image, sums: Image, vectors: Image, above: Image | None) -> Image:
        """Return the filtered light of a level, (height, width, 3); the finest is the refined image."""
        neutral = engine.hold("neutral_tint", NEUTRAL)
        images = {
            "features": features,
            "sums": sums,
            "vectors": vectors,
            "above": neutral if above is None else above,
            "tint": neutral if level else self._images["tint"],
            "weights": self._weights,
        }
        numbers = {
            "start": LAYERS[f"heads.{level}"].start,
            "width": self._sizes[level].width,
            "has_above": int(above is not None),
            # The neutral tint of the other levels is 1.
            "brightness": 1.0 if level else self._brightness,
        }
        return self._call(make_filter, level, None, images, numbers, f"filter of level {level}")

    def _call(
        self,
        make: Callable[[hl.Target], Scheduled],
        level: int,
        channels: int | None,
        images: Mapping[str, Image],
        numbers: Mapping[str, Any],
        text: str,
    ) -> Image:
        """Return what a kernel writes: features of a level, or without ``channels`` its light."""
        height, width = self._sizes[level]
        sizes = {"height": height, "width": width}
        if channels is not None:
            sizes |= {"channels": channels, "columns": pad_columns(width)}
        shape = height, *((width, COLORS) if channels is None else (channels, sizes["columns"]))
        free = self._free.get(shape)
        into, key = free.pop() if free else None, ("refinement", make.__name__)
        (out,) = engine.kernel(key, make, images, numbers, sizes=sizes, into=into, text=text).values()
        return out  # type: ignore[no-any-return]

    def _give_back(self, image: Image) -> None:
        """Let other layers write into an image that nobody reads any more."""
        self._free.setdefault(image.shape, []).append(image)
