"""Images made from the sums over the samples of pixels."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.records.frame import FloatArray, GBuffer
from lobewise.records.images import make_read_only
from lobewise.render.tracing.samples import Lobes, Squares, Sums, Totals


def to_image(value: Any) -> FloatArray:
    """Return a Dr.Jit array as NumPy, pixels first: shape (pixels,) or (pixels, channels)."""
    array = np.array(value, dtype=np.float32)
    return np.ascontiguousarray(array.T) if array.ndim == 2 else array


def finish_hits(totals: Totals, guides: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Return hit distances (0 if unknown, inf for a miss) and hit positions of a run of pixels."""
    count = to_image(totals.hit_count) + to_image(guides["mirror_count"])
    inverse = to_image(totals.hit_inverse) + to_image(guides["mirror_inverse"])
    position = to_image(totals.hit_position) + to_image(guides["mirror_position"])
    distance = np.where(count > 0, np.float32(np.inf), np.float32(0))
    np.divide(count, inverse, out=distance, where=inverse > 0)
    safe = np.where(inverse > 0, inverse, 1.0)[:, None]
    return distance, np.where(inverse[:, None] > 0, position / safe, 0.0).astype(np.float32)


def finish_guides(sums: Sums, guides: dict[str, Any], spp: int) -> dict[str, FloatArray]:
    """Return the guides of a run of pixels, pixels first, by their path in `Frame`.

    Beside them ``shape``, ``seen_shape`` and ``seen_distance`` tell what `lobewise.render.gbuffer.add_motion` reads.
    """
    assert sums.totals is not None
    own = GBuffer.__dataclass_fields__
    images = {f"gbuffer.{name}": to_image(value) for name, value in guides.items() if name in own}
    images |= {name: to_image(guides[name]) for name in ("shape", "seen_shape")}
    inverse = to_image(guides["mirror_inverse"])
    images["seen_distance"] = np.divide(1.0, inverse, out=np.full_like(inverse, np.inf), where=inverse > 0.0)
    images["gbuffer.hit_distance"], images["gbuffer.hit_position"] = finish_hits(sums.totals, guides)
    for name in ("diffuse_albedo", "specular_albedo"):
        images[f"gbuffer.{name}"] = np.clip(to_image(getattr(sums.totals, name)) / np.float32(spp), 0.0, 1.0)
    return images


def finish_radiance(sums: Sums, spp: int, has_direct: bool) -> dict[str, FloatArray]:
    """Return radiance, halves and variance of a run of pixels, pixels first, by their path in `Frame`.

    Without ``has_direct`` there is no image of direct light. A black one would mean that no surface is lit directly.
    """
    assert sums.odd is not None and sums.squares is not None and sums.totals is not None
    even, odd = _to_images(sums.even), _to_images(sums.odd)
    images = _scale("radiance", Lobes(*(getattr(even, f.name) + getattr(odd, f.name) for f in fields(Lobes))), spp)
    for name in ("direct", "indirect") if has_direct else ("indirect",):
        images[f"radiance.{name}"] = to_image(getattr(sums.totals, name)) / np.float32(spp)
    if spp > 1:
        images |= _scale("half_a", even, (spp + 1) // 2) | _scale("half_b", odd, spp // 2)
        for field in fields(Squares):
            squares = to_image(getattr(sums.squares, field.name))
            images[f"variance.{field.name}"] = squares / np.float32(spp * (spp - 1))
    return images


def _to_images(lobes: Lobes) -> Lobes:
    return Lobes(*(to_image(getattr(lobes, field.name)) for field in fields(Lobes)))


def _scale(prefix: str, sums: Lobes, count: int) -> dict[str, FloatArray]:
    """Return the means of sums over a number of samples."""
    scale = np.float32(1.0 / count)
    return {f"{prefix}.{name}": getattr(sums, name) * scale for name in ("color", "diffuse", "specular")}


def join(tiles: list[dict[str, FloatArray]], width: int, height: int) -> dict[str, FloatArray]:
    """Return images, (height, width, ...) each, joined from successive runs of pixels."""
    whole = {name: np.concatenate([tile[name] for tile in tiles]) for name in tiles[0]}
    return {name: image.reshape(height, width, *image.shape[1:]) for name, image in whole.items()}


def select(images: dict[str, FloatArray], prefix: str) -> dict[str, FloatArray]:
    """Return the images whose path begins with a prefix, by the rest of the path, read-only."""
    begin = f"{prefix}."
    return make_read_only(**{name[len(begin) :]: value for name, value in images.items() if name.startswith(begin)})


def number_pixels(rows: NDArray[Any], columns: NDArray[Any], size: tuple[int, int]) -> NDArray[np.uint32]:
    """Return the row-major numbers of pixels of an image of a size (width, height); InputError if some lie outside."""
    where, (width, height) = (rows, columns), size
    whole = all(each.ndim == 1 and each.size and each.dtype.kind in "iu" for each in where)
    if not whole or rows.size != columns.size:
        shapes = f"{rows.dtype} of shape {rows.shape} and {columns.dtype} of shape {columns.shape}"
        raise InputError("rows and columns", expected="as many whole numbers", got=shapes, action="pass np.nonzero")
    if not ((rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)).all():
        expected = f"pixels of an image of {width}x{height}"
        got = f"rows {rows.min()} to {rows.max()}, columns {columns.min()} to {columns.max()}"
        raise InputError("rows and columns", expected=expected, got=got, action="count both from 0")
    return np.asarray(rows * width + columns, dtype=np.uint32)
