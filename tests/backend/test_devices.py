"""Devices: which are found, why one is missing, and images that stay on a device between kernels."""

import ctypes
import sys
from typing import Any

import numpy as np
import pytest

from lobewise import denoise, engine
from lobewise.backend import devices
from lobewise.backend.buffers import (
    Buffer,
    DeviceImage,
    device_scope,
    download,
    lend,
    make_output,
    take_channel,
    transfers,
)
from lobewise.backend.devices import DEVICES, Device, choose_device, list_devices
from lobewise.errors import DeviceError, InputError
from lobewise.features import ScreenFeature
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.dual_buffer import PassRequest, filter_dual_buffer
from lobewise.filters.noise_guides import make_noise_guide
from lobewise.settings import DenoiseSettings
from tests.mistakes import refuses

pytestmark = pytest.mark.processor  # Each test names its own device.

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
    monkeypatch.setattr(devices, "may_have_card", lambda: True)


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

    @pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no file tells of a card")
    def test_auto_asks_no_driver_where_no_card_has_a_file(self, monkeypatch):
        monkeypatch.setattr(devices, "CARD_FILES", ())
        monkeypatch.setattr(devices, "list_devices", lambda: pytest.fail("a driver was asked"))
        assert choose_device("auto") == "cpu"
        monkeypatch.setattr(devices, "CARD_FILES", ("null",))
        assert devices.may_have_card()

    def test_software_is_taken_when_asked_for(self, monkeypatch):
        pretend(monkeypatch, vulkan=True)
        assert choose_device("vulkan") == "vulkan"

    def test_missing_and_unknown(self, monkeypatch):
        pretend(monkeypatch)
        with refuses(DeviceError, "device"):
            choose_device("cuda")
        with refuses(InputError, "device"):
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


class TestDeviceScope:
    @pytest.mark.nightly
    def test_up_once_and_down_once(self, vulkan, rng):
        shape = 20, 30
        light = rng.random((*shape, 3)).astype(np.float32)
        features, mask = [ScreenFeature(2.0)], np.ones(shape, bool)
        given: dict[str, Any] = {"form": "separable", "radius": 2}
        expected = run_filter(light, mask, features, form="separable", radius=2).image
        transfers.clear()
        with engine.on(vulkan), device_scope():
            for _ in range(3):
                output = run_filter(light, mask, features, **given)
        assert transfers == {"up": 2, "down": 3}
        np.testing.assert_allclose(output.image, expected, rtol=DEVICE_RELATIVE)
        transfers.clear()
        with engine.on(vulkan):
            run_filter(light, mask, features, **given)
        assert transfers == {"up": 2, "down": 1}

    def test_what_nobody_reads_stays_there(self, vulkan):
        transfers.clear()
        with device_scope():
            buffer, image = make_output((4, 4), vulkan)
            assert isinstance(image, DeviceImage)
            assert lend(image, vulkan) is buffer
        assert not transfers

    def test_memory_goes_back_in_the_opposite_order(self, vulkan, rng, monkeypatch):
        taken, given = [], []
        take, give = Buffer.take_memory, Buffer.give_memory
        monkeypatch.setattr(Buffer, "take_memory", lambda self, device: (taken.append(id(self)), take(self, device)))
        monkeypatch.setattr(Buffer, "give_memory", lambda self: (given.append(id(self)), give(self)))
        light = rng.random((8, 9, 3)).astype(np.float32)
        with engine.on(vulkan):
            run_filter(light, np.ones((8, 9), bool), [ScreenFeature(1.0)], form="separable", radius=1)
        assert len(taken) == 4  # radiance, mask, what the first pass writes, the result
        assert given == taken[::-1]

    def test_what_is_not_downloaded_is_gone_with_its_scope(self, vulkan, rng):
        a, b = rng.random((2, 8, 9, 3)).astype(np.float32)
        with engine.on(vulkan), device_scope():
            _, half = make_output((8, 9, 3), vulkan)
            guide, again = (make_noise_guide(a, b, 1.0) for _ in range(2))
            assert isinstance(guide, DeviceImage)
            found = download(again)
        np.testing.assert_allclose(found, make_noise_guide(a, b, 1.0), rtol=DEVICE_RELATIVE)
        np.testing.assert_array_equal(again.download(), found)
        with pytest.raises(TypeError, match="download"):
            guide.download()
        with pytest.raises(TypeError, match="download"), engine.on(vulkan):
            make_noise_guide(a, half, 1.0)

    def test_outside_a_scope_images_are_arrays(self, vulkan, rng):
        a, b = rng.random((2, 8, 9, 3)).astype(np.float32)
        request = PassRequest(halves=(a, b), mask=np.ones((8, 9), bool), radius=1)
        with engine.on(vulkan):
            found = filter_dual_buffer(request)
        assert all(type(image) is np.ndarray for image in found[:3])

    def test_it_is_no_array(self, vulkan):
        with device_scope():
            _, image = make_output((2, 3, 4), vulkan)
            assert (image.shape, image.dtype, image.ndim) == ((2, 3, 4), np.float32, 3)
            part = take_channel(image, 1)
            assert part.shape == (2, 3)
            for each in (image, part):
                for use in (
                    np.asarray,
                    np.log2,
                    lambda it: np.float32(2.0) * it,
                    lambda it: it + 1.0,
                    lambda it: np.ones((2, 3)) > it,
                    lambda it: np.where(np.ones((2, 3), bool), it, 0.0),
                    lambda it: it[0],
                    len,
                ):
                    with pytest.raises(TypeError):
                        use(each)
                with pytest.raises(AttributeError):
                    each.mean  # noqa: B018
            with pytest.raises(TypeError, match="download"):
                lend(part, vulkan)
            with pytest.raises(TypeError, match="download"):
                lend(image, "cpu")
            assert lend(image, vulkan).array.shape == (2, 3, 4)

    def test_nothing_leaks_between_sizes(self, vulkan, rng):
        # Sizes that the runtime's allocator once mixed up: many, unlike each other and no multiple of anything.
        for shape in [(67, 41), (17, 3), (64, 64), (67, 41), (5, 71), (71, 5), (67, 41)]:
            light = rng.random((*shape, 3)).astype(np.float32)
            mask = np.ones(shape, bool)
            for form in ("full", "separable", "atrous"):
                expected = run_filter(light, mask, [ScreenFeature(2.0)], form=form, radius=2).image
                with engine.on(vulkan):
                    found = run_filter(light, mask, [ScreenFeature(2.0)], form=form, radius=2).image
                np.testing.assert_allclose(found, expected, rtol=DEVICE_RELATIVE)


@pytest.mark.sampled("high")
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
    assert (
        transfers
        == {
            "fast": {"up": 17, "down": 2},
            "balanced": {"up": 13, "down": 18},
            # The guides of this frame are noise: the color alone is filtered as well.
            "high": {"up": 35, "down": 29},
        }[quality]
    )
