"""Two independent images of a frame: from the file, or from neighbours."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lobewise.guides.halves import choose_halves
from lobewise.records.frame import FloatArray, Frame, Radiance

PARTS = "color", "diffuse", "specular"


def list_lights(frame: Frame) -> dict[str, FloatArray]:
    """Return the radiance of a frame and of its parts."""
    return {name: getattr(frame.radiance, name) for name in PARTS}


def put_bad(radiance: Radiance, name: str) -> Radiance:
    """Return a radiance with three bad pixels in one part."""
    image = np.array(getattr(radiance, name))
    image[0, 0, 1], image[2, 5, 0], image[4, 3, 2] = np.nan, np.inf, -1.0
    return replace(radiance, **{name: image})


BAD = ([0, 2, 4], [0, 5, 3])


def test_halves_of_the_samples(full_frame: Frame) -> None:
    frame = full_frame.with_changes(half_a=put_bad(full_frame.half_a, "specular"))
    halves = choose_halves(frame, list_lights(frame))
    assert halves.origin == "file"
    for name in PARTS:
        np.testing.assert_array_equal(halves.images[name][1], getattr(full_frame.half_b, name))
        expected = np.array(getattr(full_frame.half_a, name))
        if name == "specular":
            expected[BAD] = np.nan
        np.testing.assert_array_equal(halves.images[name][0], expected)
    assert "direct" not in halves.images


@pytest.mark.parametrize("missing", ["half_a", "half_b", "parts"])
def test_colours_of_a_checkerboard(full_frame: Frame, missing: str) -> None:
    frame = full_frame.with_changes(radiance=put_bad(full_frame.radiance, "diffuse"))
    if missing == "parts":
        frame = frame.with_changes(half_b=Radiance(frame.half_b.color))
    else:
        frame = frame.with_changes(**{missing: None})
    halves = choose_halves(frame, list_lights(frame))
    assert halves.origin == "neighbours"
    for name in PARTS:
        image = np.array(getattr(full_frame.radiance, name))
        if name == "diffuse":
            image[BAD] = np.nan
        a, b = (np.full(image.shape, np.nan, np.float32) for _ in range(2))
        for y, x in np.ndindex(*frame.shape):
            (a if (x + y) % 2 == 0 else b)[y, x] = image[y, x]
        np.testing.assert_array_equal(halves.images[name][0], a)
        np.testing.assert_array_equal(halves.images[name][1], b)


def test_missing_parts_stay_missing(make_frame: Callable[..., Frame]) -> None:
    frame = make_frame(height=1, width=3)
    color = Frame(radiance=Radiance(frame.radiance.color), half_a=frame.half_a, half_b=frame.half_b)
    for given, origin in ((color, "file"), (Frame(radiance=Radiance(frame.radiance.color)), "neighbours")):
        assert choose_halves(given, {"color": frame.radiance.color}).origin == origin
