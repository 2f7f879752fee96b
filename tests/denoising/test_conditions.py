"""Odd images and odd sizes, on every quality and device: nothing bad comes out, and nothing that went in is changed.

The conditions are those that the tests of Open Image Denoise check for its filters.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.backend.devices import list_devices
from lobewise.errors import InputError
from lobewise.io import write_frame
from lobewise.records.frame import Frame, GBuffer, Radiance
from tests.mistakes import refuses
from tests.streaming.frames import make_scene

QUALITIES = ("fast", "balanced", "high")
VALUES = (np.nan, np.inf, -np.inf, 10.0)
SIZES = ((1, 1), (1, 2), (2, 1), (3, 5), (17, 1), (1, 70), (33, 31))


@pytest.fixture(params=["cpu", pytest.param("vulkan", marks=[pytest.mark.nightly, pytest.mark.vulkan])])
def device(request: pytest.FixtureRequest) -> str:
    """Return the name of a device that is here."""
    found = {each.name: each for each in list_devices()}[request.param]
    if not found.available:
        pytest.skip(f"{request.param}: {found.reason}")
    return str(request.param)


def spoil(frame: Frame, what: str, value: float, where: Any) -> Frame:
    """Return a frame whose color, albedo or normal has another value at some pixels."""

    def put(image: np.ndarray) -> np.ndarray:
        image = image.copy()
        image[where] = value
        return image

    if what == "color":
        parts = {name: put(getattr(frame.radiance, name)) for name in frame.radiance.names}
        halves = {name: put(getattr(frame.half_a, name)) for name in frame.half_a.names} if frame.half_a else {}
        half = Radiance(**halves) if halves else None
        return frame.with_changes(radiance=Radiance(**parts), half_a=half, half_b=half)
    names = ("diffuse_albedo", "specular_albedo") if what == "albedo" else ("normal",)
    return frame.with_changes(
        gbuffer=replace(frame.gbuffer, **{name: put(getattr(frame.gbuffer, name)) for name in names})
    )


def require_clean(result: lobewise.Result) -> None:
    """Require that every image of a result is finite and not negative."""
    for image in (result.image, result.diffuse, result.specular, result.weight_sum, result.effective_samples):
        if image is not None:
            assert np.isfinite(image).all()
            assert image.min() >= 0.0


QUICK_CASES = pytest.mark.sampled(
    *(f"cpu-{what}-{quality}" for what in ("color", "albedo") for quality in QUALITIES),
    *("cpu-normal-fast", "cpu-normal-balanced"),
)


@QUICK_CASES
@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("what", ["color", "albedo", "normal"])
def test_odd_values_at_some_pixels(what: str, quality: str, device: str) -> None:
    frame = make_scene((19, 21))
    where = np.zeros(frame.shape, bool)
    where[4:7, 9], where[12, 3:6] = True, True
    honest = lobewise.denoise(frame, quality=quality, device=device)
    for value in VALUES:
        result = lobewise.denoise(spoil(frame, what, value, where), quality=quality, device=device)
        require_clean(result)
        assert result.image.max() <= max(25.0, 3.0 * honest.image.max())
        bad = where & (what == "color") & (not value >= 0.0 or value == np.inf)
        assert (result.bad_pixels & where).sum() == bad.sum()


@QUICK_CASES
@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("what", ["color", "albedo", "normal"])
def test_odd_values_everywhere(what: str, quality: str, device: str) -> None:
    frame = make_scene((19, 21))
    for value in VALUES:
        spoiled = spoil(frame, what, value, ...)
        if what == "color" and not 0.0 <= value < np.inf:
            with refuses(InputError, "radiance"):
                lobewise.denoise(spoiled, quality=quality, device=device)
        else:
            require_clean(lobewise.denoise(spoiled, quality=quality, device=device))


@pytest.mark.sampled("cpu-fast", "cpu-balanced", "cpu-high")
@pytest.mark.parametrize("quality", QUALITIES)
def test_sizes(quality: str, device: str) -> None:
    for size in SIZES:
        result = lobewise.denoise(make_scene(size), quality=quality, device=device)
        assert result.image.shape == (*size, 3)
        require_clean(result)


@pytest.mark.parametrize("shape", [(0, 0, 3), (0, 5, 3), (5, 0, 3)])
def test_no_pixels(shape: tuple[int, ...]) -> None:
    with refuses(InputError, "color"):
        Radiance(np.zeros(shape))


@pytest.mark.sampled("cpu-fast", "cpu-balanced", "cpu-high")
@pytest.mark.parametrize("quality", QUALITIES)
def test_black_and_constant(quality: str, device: str) -> None:
    frame = make_scene((19, 21))
    guides = GBuffer(normal=np.broadcast_to([0.0, 0.0, 1.0], (19, 21, 3)), depth=np.ones((19, 21)))
    for level in (0.0, 0.5, 1e-30, 1e30):
        same = np.full((19, 21, 3), level, np.float32)
        for with_halves in (True, False):
            half = Radiance(same) if with_halves else None
            plain = Frame(Radiance(same), guides, frame.camera, half_a=half, half_b=half)
            result = lobewise.denoise(plain, quality=quality, similarity="normal", device=device)
            require_clean(result)
            np.testing.assert_allclose(result.image, level, rtol=1e-4)


@pytest.mark.parametrize("quality", QUALITIES)
def test_the_largest_numbers_do_not_overflow(quality: str, device: str) -> None:
    frame = make_scene((19, 21))
    largest = spoil(frame, "color", float(np.finfo(np.float32).max), np.s_[5, 5])
    require_clean(lobewise.denoise(largest, quality=quality, device=device))


@pytest.mark.parametrize("quality", QUALITIES)
def test_inputs_stay_and_results_are_memory_of_their_own(quality: str, device: str) -> None:
    """So a result can be written over its input."""
    frame = make_scene((19, 21))
    color = np.array(frame.radiance.color)
    mine = frame.with_changes(radiance=replace(frame.radiance, color=color))
    before = color.copy()
    result = lobewise.denoise(mine, quality=quality, device=device)
    np.testing.assert_array_equal(color, before)
    images = [getattr(part, name) for part in (mine.radiance, mine.gbuffer) for name in part.names]
    for image in (result.image, result.diffuse, result.specular):
        assert image is not None
        assert not any(np.shares_memory(image, each) for each in images)
    kept = result.image.copy()
    color[...] = result.image
    np.testing.assert_array_equal(result.image, kept)


class Stop(Exception):
    """What the caller of a progress function raises."""


@pytest.mark.parametrize("quality", QUALITIES)
def test_progress_grows_and_cancels(quality: str, tmp_path: Any) -> None:
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    write_frame(source, make_scene((40, 21)))
    told: list[lobewise.Progress] = []
    lobewise.denoise_file(source, output, rows=9, quality=quality, progress=told.append)
    shares = [each.share for each in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    whole = output.read_bytes()

    def stop(record: lobewise.Progress) -> None:
        if record.stage == "filtering" and record.share >= 0.5:
            raise Stop

    with pytest.raises(Stop):
        lobewise.denoise_file(source, output, rows=9, quality=quality, progress=stop)
    assert output.read_bytes() == whole
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "b.exr"]
    # The next call works.
    output.unlink()
    lobewise.denoise_file(source, output, rows=9, quality=quality)
    assert output.read_bytes() == whole
