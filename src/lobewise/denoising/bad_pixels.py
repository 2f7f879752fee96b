"""Bad pixels, whose radiance is not finite or negative, and holes, to which no filter gave a value: both are filled."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.errors import InputError
from lobewise.features import ScreenFeature
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.forms import ATROUS_REACH
from lobewise.filters.glue import define_bad, define_emptied, define_patched, define_refilled
from lobewise.guides.negative import split_negative
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.sparse_frame import AnyFrame

HOLE_SIGMA = 1.0
"""Standard deviation of the weights that fill holes, pixels. What they leave of large holes becomes the mean colour:
wider rounds had more error."""
MAX_SHARE_BAD = 0.01
"""Share of the pixels above which bad ones are no accident, and the user is asked."""


def mark_good(image: FloatArray) -> NDArray[np.bool_]:
    """Return where all three channels are finite and not negative.

    Channel by channel: NumPy's reductions over an axis of three are several times slower.
    """
    # Two reductions tell that every pixel is good, as in most images. With a NaN both are NaN.
    if image.size and image.min() >= 0.0 and image.max() <= np.finfo(np.float32).max:
        return np.ones(image.shape[:-1], np.bool_)
    # NaN compares false with everything, so the test asks for good pixels.
    good_channels = (image >= 0.0) & (image <= np.finfo(np.float32).max)
    good: NDArray[np.bool_] = good_channels[..., 0] & good_channels[..., 1] & good_channels[..., 2]
    return good


def blacken_bad(image: FloatArray) -> FloatArray:
    """Return ``image`` with 0 where a pixel is not finite or negative."""
    good = mark_good(image)
    return image if good.all() else np.where(good[..., None], image, np.float32(0.0))


def mark_bad_pixels(frame: Frame) -> NDArray[np.bool_]:
    """Return where any radiance of the frame is NaN, infinite or negative, shape (height, width)."""
    light = [layer.radiance for layer in frame.layers] or frame.radiance.parts or ()
    images = {f"light{number}": image for number, image in enumerate((frame.radiance.color, *light))}
    (bad,) = engine.pixels(define_bad, images, {}, names=["bad"], text="bad pixels")
    return bad


def require_usable(frame: Frame) -> None:
    """Raise InputError if `lobewise.denoise` would find no usable pixel in a frame. No kernel runs."""
    frame, _ = split_negative(frame)
    light = [layer.radiance for layer in frame.layers] or frame.radiance.parts or ()
    good = np.logical_and.reduce([mark_good(image) for image in (frame.radiance.color, *light)])
    require_some_good(int(np.count_nonzero(~good)), good.size, "pixel")


def require_some_good(bad: int, count: int, what: str) -> None:
    """Raise InputError if all of ``count`` are bad; ``what`` is the word for one of them, "pixel" or "sample"."""
    if bad == count:
        raise InputError(
            "radiance",
            expected=f"at least one {what} that is finite and not negative",
            got=f"{bad} bad {what}s of {count}",
            action="check the render or the channel mapping",
        )


def describe_bad(bad: int, count: int) -> tuple[str, ...]:
    """Return the question that many bad pixels raise, or nothing; ``bad`` of ``count`` pixels are bad."""
    if bad <= MAX_SHARE_BAD * count:
        return ()
    return (
        f"{100.0 * bad / count:.2g} % of the pixels are NaN, infinite or far below the light around them, and are "
        "filled from their neighbours: is this channel the picture, and did its render end?",
    )


def fill_holes(image: FloatArray, holes: NDArray[np.bool_], frame: AnyFrame) -> FloatArray:
    """Return ``image`` with its holes refilled, at last with the mean colour of the frame's good pixels."""

    def run() -> FloatArray:
        mean = engine.total(measure_mean_color, [frame.radiance.color], name="mean_color", count=COLORS)
        return refill(image, holes, mean)

    left = engine.total(count_holes, [holes], name="holes_left")
    filled: FloatArray = engine.when(engine.compare(left, ">", 0.0), run, lambda: image)
    return filled


def refill(image: FloatArray, holes: NDArray[np.bool_], mean: FloatArray) -> FloatArray:
    """Return ``image`` with the pixels of ``holes`` replaced by the mean of the nearest others on the screen.

    Parameters
    ----------
    image : (height, width, 3)
        What is outside the holes is finite.
    holes : bool array, (height, width)
        What is to be replaced.
    mean : (3,)
        What a hole becomes that has nothing else in its reach.
    """
    filled: FloatArray = engine.own(image)
    # No hole depends on pixels outside of the box.
    engine.in_box(holes, ATROUS_REACH, partial(_fill_box, mean), filled, holes)
    return filled


def _fill_box(mean: FloatArray, image: FloatArray, holes: NDArray[np.bool_]) -> None:
    """Fill the holes of an image in place."""
    images = {"image": image, "holes": holes}
    source, everywhere = engine.pixels(
        define_emptied, images, {}, names=["emptied", "everywhere"], text="NaN in the holes"
    )
    around = run_filter(source, everywhere, [ScreenFeature(HOLE_SIGMA)], form="atrous", radius=0, name="around")
    images = {"image": source, "holes": holes, "filled": around.image, "weight": around.weight_sum}
    filled, left = engine.pixels(
        define_refilled, images, {}, names=["refilled", "holes"], text="fill holes from neighbours"
    )
    text = "the result, and the mean colour in the holes that are left"
    engine.pixels(define_patched, {"image": filled, "holes": left}, {"mean": mean}, into=[image], text=text)


def count_holes(holes: NDArray[np.bool_]) -> float:
    """Return the number of holes."""
    return float(np.count_nonzero(holes))


def measure_mean_color(color: FloatArray) -> FloatArray:
    """Return the mean colour of the good pixels of an image."""
    return compute_mean_color(sum_colors(color))


def sum_colors(color: FloatArray) -> NDArray[np.float64]:
    """Return the colours of every row's good pixels, summed, and how many there are, (height, 4)."""
    good = mark_good(color)
    lit = np.where(good[..., None], color, np.float32(0.0))
    # Row by row, so that rows add up to the same bits however an image was cut into bands of them.
    rows = [[row[:, k].sum(dtype=np.float64) for k in range(3)] for row in lit]
    return np.concatenate([rows, np.count_nonzero(good, axis=1)[:, None]], axis=1)


def compute_mean_color(rows: NDArray[np.float64]) -> FloatArray:
    """Return the mean colour of the good pixels of all rows, (3,), from what `sum_colors` gave; 0 without any."""
    *sums, count = rows.sum(axis=0)
    return np.asarray(np.array(sums) / max(count, 1.0), dtype=np.float32)
