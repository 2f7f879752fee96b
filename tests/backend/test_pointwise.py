"""The seam of the pointwise kernels: structure, sizes, truth, numbers; and that threads change no bit."""

import halide as hl
import numpy as np
import pytest

from lobewise import engine
from lobewise.backend.jit import count_compiled_kernels
from lobewise.backend.pointwise import Grid, Vector, is_finite, select_or_nan
from lobewise.errors import InputError
from tests.mistakes import refuses

SIZES = [(1, 1), (1, 7), (3, 16), (2, 17), (17, 3), (5, 33), (64, 67)]


def define_sums(grid: Grid, sign: int) -> list[Vector]:
    """Every kind of input and of output."""
    colour, (weight,), there = grid.read("colour"), grid.read("weight"), grid.read_one("there")
    offset, (scale,) = grid.get("offset"), grid.get("scale")
    shifted = [value * hl.f32(sign) + step for value, step in zip(colour, offset, strict=True)]
    place = hl.f32(grid.x) + hl.f32(1000.0) * hl.f32(grid.y)
    pair = [hl.f32(hl.f64(weight) * scale), place]
    return [shifted, [hl.u8((there != 0) & (weight > hl.f32(0.0)))], pair, [grid.share([weight + weight])[0]]]


def define_neighbours(grid: Grid) -> list[Vector]:
    (width, height), row = grid.size, grid.keep([grid.read_one("weight"), hl.f32(grid.x)])
    left, right = hl.max(grid.x - 1, 0), hl.min(grid.x + 1, width - 1)
    below = grid.read_one("weight") if grid.narrow else grid.read("weight", y=hl.min(grid.y + 1, height - 1))[0]
    return [[row(left, grid.y)[0], row(right, grid.y)[1], below]]


def define_tests(grid: Grid) -> list[Vector]:
    value = grid.read_one("value")
    good = is_finite(value)
    return [[hl.u8(good)], [select_or_nan(good & (value > hl.f32(0.0)), value)], [hl.u8(value * value < hl.f32(4.0))]]


def make_images(rng: np.random.Generator, size: tuple[int, int]) -> dict[str, np.ndarray]:
    return {
        "colour": rng.normal(size=(*size, 3)).astype(np.float32),
        "weight": rng.normal(size=size).astype(np.float32),
        "there": rng.random(size) < 0.5,
    }


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_every_pixel_of_every_size(rng: np.random.Generator, size: tuple[int, int]) -> None:
    images = make_images(rng, size)
    numbers = {"offset": np.float32([1.0, -2.0, 0.5]), "scale": 1.0 / 3.0}
    shifted, truth, pair, twice = engine.pixels(define_sums, images, numbers, -1)
    np.testing.assert_array_equal(shifted, np.float32([1.0, -2.0, 0.5]) - images["colour"])
    np.testing.assert_array_equal(truth, images["there"] & (images["weight"] > 0.0))
    np.testing.assert_array_equal(pair[..., 0], (images["weight"].astype(np.float64) / 3.0).astype(np.float32))
    np.testing.assert_array_equal(pair[..., 1], np.arange(size[1]) + 1000.0 * np.arange(size[0])[:, None])
    np.testing.assert_array_equal(twice, 2.0 * images["weight"])
    assert truth.dtype == np.bool_
    assert shifted.dtype == pair.dtype == twice.dtype == np.float32
    assert all(image.flags.c_contiguous for image in (shifted, truth, pair, twice))


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_neighbours(rng: np.random.Generator, size: tuple[int, int]) -> None:
    weight = rng.normal(size=size).astype(np.float32)
    (out,) = engine.pixels(define_neighbours, {"weight": weight}, {})
    columns = np.arange(size[1])
    np.testing.assert_array_equal(out[..., 0], weight[:, np.maximum(columns - 1, 0)])
    np.testing.assert_array_equal(out[..., 1], np.broadcast_to(np.minimum(columns + 1, size[1] - 1), size))
    if size[1] > 16:
        np.testing.assert_array_equal(out[..., 2], weight[np.minimum(np.arange(size[0]) + 1, size[0] - 1)])


def test_what_is_no_number_is_told_apart() -> None:
    strange = np.float32([0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 3.4e38, -3.4e38, 1e-42])
    value = np.tile(strange, (3, 4))
    good, positive, small = engine.pixels(define_tests, {"value": value}, {})
    np.testing.assert_array_equal(good, np.isfinite(value))
    np.testing.assert_array_equal(positive, np.where(np.isfinite(value) & (value > 0.0), value, np.nan))
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(small, value * value < 4.0)


def test_one_structure_is_compiled_once(rng: np.random.Generator) -> None:
    numbers = {"offset": np.float32([1.0, -2.0, 0.5]), "scale": 2.0}
    engine.pixels(define_sums, make_images(rng, (4, 40)), numbers, 1)
    before = count_compiled_kernels()
    again = {"offset": np.float32([0.0, 3.0, 0.5]), "scale": -1.0}
    engine.pixels(define_sums, make_images(rng, (40, 80)), again, 1)
    assert count_compiled_kernels() == before
    engine.pixels(define_sums, make_images(rng, (4, 40)), numbers, 2)
    assert count_compiled_kernels() == before + 1


def test_read_only_and_strided_images(rng: np.random.Generator) -> None:
    weight = rng.normal(size=(6, 80)).astype(np.float32)
    expected = engine.pixels(define_neighbours, {"weight": weight[::2, ::2].copy()}, {})
    strided = weight[::2, ::2]
    strided.flags.writeable = False
    np.testing.assert_array_equal(engine.pixels(define_neighbours, {"weight": strided}, {}), expected)


def test_images_of_unlike_size_are_refused(rng: np.random.Generator) -> None:
    images = make_images(rng, (4, 5))
    images["there"] = np.ones((4, 6), bool)
    with refuses(InputError, "guides"):
        engine.pixels(define_sums, images, {"offset": np.zeros(3, np.float32), "scale": 1.0}, 1)
