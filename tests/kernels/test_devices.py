"""Devices: which there are, why one is missing, and what stays on one between kernels."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest

from lobewise import denoise
from lobewise.backend import devices
from lobewise.backend.buffers import (
    Buffer,
    DeviceImage,
    comes_down,
    lend,
    make_output,
    stay_on_device,
    to_host,
    transfers,
)
from lobewise.backend.devices import DEVICES, Device, choose_device, list_devices
from lobewise.errors import DeviceError, InputError
from lobewise.features import ScreenFeature
from lobewise.filters.cross_filter import FilterOutput, run_filter
from lobewise.settings import DenoiseSettings

pytestmark = pytest.mark.processor  # each test says itself what it runs on

# Float32 in another order of operations and with other roundings of quotients and roots, over two or three passes.
DEVICE_RELATIVE = 1e-4


@pytest.fixture
def vulkan() -> str:
    found = {each.name: each for each in list_devices()}["vulkan"]
    if not found.available:
        pytest.skip(found.reason)
    return "vulkan"


def pretend(monkeypatch: pytest.MonkeyPatch, **found: bool) -> None:
    """Let there be devices of these names: a card (False), or software (True)."""
    told = [Device(name, name in found or name == "cpu", f"why {name}", found.get(name, False)) for name in DEVICES]
    monkeypatch.setattr(devices, "list_devices", lambda: told)


class TestChoice:
    def test_list_tells_names_or_reasons(self):
        found = list_devices()
        assert [each.name for each in found] == list(DEVICES)
        assert found[0].available
        assert all(each.reason for each in found)

    @pytest.mark.parametrize(
        ("found", "expected"),
        [
            ({}, "cpu"),
            ({"vulkan": True}, "cpu"),
            ({"vulkan": False}, "vulkan"),
            ({"vulkan": False, "cuda": False}, "cuda"),
            ({"metal": False}, "metal"),
        ],
        ids=str,
    )
    def test_auto_takes_a_card(self, monkeypatch, found, expected):
        pretend(monkeypatch, **found)
        assert choose_device("auto") == expected

    def test_software_is_taken_when_asked_for(self, monkeypatch):
        pretend(monkeypatch, vulkan=True)
        assert choose_device("vulkan") == "vulkan"

    def test_missing_and_unknown(self, monkeypatch):
        pretend(monkeypatch)
        with pytest.raises(DeviceError, match="expected one that runs here, got cuda; why cuda; use --device cpu"):
            choose_device("cuda")
        with pytest.raises(InputError, match="did you mean 'vulkan'"):
            choose_device("vulcan")

    def test_a_library_that_is_missing(self, monkeypatch):
        def load(name: str) -> Any:
            raise OSError(name)

        monkeypatch.setattr(ctypes, "CDLL", load)
        devices._probe.cache_clear()
        reasons = {each.name: each.reason for each in list_devices()}
        devices._probe.cache_clear()
        assert "no Vulkan loader" in reasons["vulkan"]
        assert "no CUDA driver" in reasons["cuda"]


class TestStay:
    def test_up_once_and_down_once(self, vulkan, rng):
        shape = 20, 30
        light = rng.random((*shape, 3)).astype(np.float32)
        features, mask = [ScreenFeature(2.0)], np.ones(shape, bool)
        given: dict[str, Any] = {"form": "separable", "radius": 2, "device": vulkan}
        expected = run_filter(light, mask, features, form="separable", radius=2).image
        transfers.clear()
        with stay_on_device():
            for _ in range(3):
                output = run_filter(light, mask, features, **given)
        assert transfers == {"up": 2, "down": 3}
        np.testing.assert_allclose(output.image, expected, rtol=DEVICE_RELATIVE)
        transfers.clear()
        run_filter(light, mask, features, **given)
        assert transfers == {"up": 2, "down": 1}

    def test_what_nobody_reads_stays_there(self, vulkan):
        transfers.clear()
        with stay_on_device():
            _, image = make_output((4, 4), vulkan)
            assert isinstance(image, DeviceImage)
            assert lend(image, vulkan) is image.buffer
            del image
        assert not transfers

    def test_memory_goes_back_in_the_opposite_order(self, vulkan, rng, monkeypatch):
        taken, given = [], []
        take, give = Buffer.take_memory, Buffer.give_memory
        monkeypatch.setattr(Buffer, "take_memory", lambda self, device: (taken.append(id(self)), take(self, device)))
        monkeypatch.setattr(Buffer, "give_memory", lambda self, device: (given.append(id(self)), give(self, device)))
        light = rng.random((8, 9, 3)).astype(np.float32)
        run_filter(light, np.ones((8, 9), bool), [ScreenFeature(1.0)], form="separable", radius=1, device=vulkan)
        assert len(taken) == 4  # radiance, mask, what the first pass writes, the result
        assert given == taken[::-1]

    def test_an_image_outlives_its_stay(self, vulkan, rng):
        light = rng.random((8, 9, 3)).astype(np.float32)
        with stay_on_device():
            found = comes_down(run_filter)(
                light, np.ones((8, 9), bool), [ScreenFeature(1.0)], form="full", radius=1, device=vulkan
            )
            image = found.weight_sum
        again = run_filter(
            np.repeat(np.asarray(image)[..., None], 3, 2),
            np.ones((8, 9), bool),
            [],
            form="full",
            radius=0,
            device=vulkan,
        )
        np.testing.assert_allclose(again.image[..., 0], np.asarray(image), rtol=DEVICE_RELATIVE)

    def test_behaves_like_an_array(self, vulkan):
        with stay_on_device():
            buffer, image = make_output((2, 3), vulkan)
            buffer.array[...] = np.arange(6.0).reshape(2, 3)
            assert image.shape == (2, 3)
            assert len(image) == 2
            assert image.dtype == np.float32
            np.testing.assert_array_equal(image + 1.0, buffer.array + 1.0)
            np.testing.assert_array_equal(2.0 * image, 2.0 * buffer.array)
            np.testing.assert_array_equal(
                np.where(image > 2.0, image, 0.0), np.where(buffer.array > 2.0, buffer.array, 0)
            )
            np.testing.assert_array_equal(image[1], [3.0, 4.0, 5.0])
            assert image.mean() == 2.5
            assert np.stack([image, image]).shape == (2, 2, 3)
            assert isinstance(to_host(FilterOutput(image, image, image)).image, np.ndarray)

    def test_nothing_leaks_between_sizes(self, vulkan, rng):
        # Sizes that the runtime's allocator once mixed up: many, unlike each other and no multiple of anything.
        for shape in [(67, 41), (17, 3), (64, 64), (67, 41), (5, 71), (71, 5), (67, 41)]:
            light = rng.random((*shape, 3)).astype(np.float32)
            mask = np.ones(shape, bool)
            for form in ("full", "separable", "atrous"):
                found, expected = (
                    run_filter(light, mask, [ScreenFeature(2.0)], form=form, radius=2, device=device).image
                    for device in (vulkan, "cpu")
                )
                np.testing.assert_allclose(found, expected, rtol=DEVICE_RELATIVE)


@pytest.mark.slow
@pytest.mark.vulkan
@pytest.mark.parametrize("quality", ["fast", "balanced", "high"])
def test_denoise_gives_the_same_on_another_device(vulkan, make_frame, quality):
    frame = make_frame(height=40, width=50)
    expected = denoise(frame, DenoiseSettings(quality=quality, radius=4))
    transfers.clear()
    found = denoise(frame, DenoiseSettings(quality=quality, radius=4, device=vulkan))
    assert type(found.image) is np.ndarray
    assert type(found.weight_sum) is np.ndarray
    np.testing.assert_allclose(found.image, expected.image, rtol=1e-3, atol=1e-5)
    assert transfers["up"] <= {"fast": 16, "balanced": 24, "high": 48}[quality]
