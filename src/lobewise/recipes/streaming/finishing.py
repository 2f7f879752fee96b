"""The steps after all bands are filtered: share out light, fill holes, write rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.also import bring_parts
from lobewise.denoising.bad_pixels import refill
from lobewise.denoising.light_loss import share_light
from lobewise.filters.forms import ATROUS_REACH
from lobewise.io.exr.bands import BandReader, BandWriter
from lobewise.recipes.streaming.kept import KeptBands
from lobewise.records.frame import FloatArray
from lobewise.work.progress import WRITE, enter_stage


def finish_bands(
    reader: BandReader, held: KeptBands, writer: BandWriter, finisher: Finisher, gains: Sequence[float]
) -> None:
    """Add the gain of every layer to the bands, fill their holes and hand them to the writer."""
    height, _ = reader.shape
    reader.forget(height)
    row = 0
    for images in held.read():
        before, holes, row = row, images.pop("holes"), row + len(images["color"])
        enter_stage(WRITE, (before / height, row / height))
        masks = [images.pop(f"mask{number}") for number in range(len(gains))]
        names = reader.layers or ("color",)
        if any(gains):
            total, parts = share_light(images["color"], [images[name] for name in names], masks, gains)
            images |= {**dict(zip(names, parts, strict=True)), "color": total}
        finisher.add({**images, **finish_parts(names, images)}, holes)
        last = row == height
        done = finisher.release(last=last)
        if done is not None:
            writer.add(done)
        reader.forget(writer.row)


def finish_parts(layers: Sequence[str], images: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the parts of layers, ``layer/part``, brought to the results of their layers."""
    finished: dict[str, FloatArray] = {}
    for layer in layers:
        refined = {name: image for name, image in images.items() if name.startswith(f"{layer}/")}
        if refined:
            finished |= bring_parts(refined, list(refined.values()), images[layer])
    return finished


class Finisher:
    """Holds filtered rows until the rows around their holes have arrived."""

    def __init__(self, compute_mean: Callable[[], FloatArray]) -> None:
        self._compute_mean = compute_mean
        self._images: dict[str, FloatArray] = {}
        self._holes: NDArray[np.bool_] = np.zeros((0, 0), bool)
        self._context = 0
        """Number of held rows that are released already: the holes of later rows read them."""

    def add(self, images: dict[str, FloatArray], holes: NDArray[np.bool_]) -> None:
        """Take the next rows."""
        if not self._images:
            self._images, self._holes = images, holes
            return
        self._images = {field: np.concatenate([self._images[field], image]) for field, image in images.items()}
        self._holes = np.concatenate([self._holes, holes])

    def release(self, *, last: bool) -> dict[str, FloatArray] | None:
        """Return the rows that later rows cannot change; None if there are none."""
        first, count = self._context, len(self._holes)
        # A row without holes is final.
        stop = count if last or not self._holes[first:].any() else count - ATROUS_REACH
        if stop <= first:
            return None
        done = {field: image[first:stop] for field, image in self._images.items()}
        if self._holes[first:stop].any():
            begin, end = max(first - ATROUS_REACH, 0), min(stop + ATROUS_REACH, count)
            around = self._images["color"][begin:end], self._holes[begin:end]
            done["color"] = refill(*around, self._compute_mean())[first - begin : stop - begin]
        for field in [name for name in done if name.startswith("below ")]:
            done[field.removeprefix("below ")] = done[field.removeprefix("below ")] - done.pop(field)
        keep = max(stop - ATROUS_REACH, 0)
        # Copy, so that the memory of the rows above is freed.
        self._images = {field: image[keep:].copy() for field, image in self._images.items()}
        self._holes = self._holes[keep:].copy()
        self._context = stop - keep
        return done
