"""Every test of a kernel runs on every device that CI has: the processor, and Vulkan in software."""

import os
from collections.abc import Iterator

import pytest

from lobewise import engine
from lobewise.backend.devices import list_devices

RUNS = (
    "run_filter",
    "PassRequest",
    "reproject",
    "run_upsampling",
    "SampleGrid",
    "bound_fireflies",
    "split_highlights",
    "compute_features",
    "make_noise_guide",
    "measure_light",
    "mix_candidates",
    "refine_image",
)
"""What runs kernels on a device: the tests of modules that name one of these run on every device."""


CARD = os.environ.get("LOBEWISE_TEST_DEVICE", "vulkan")
"""The device beside the processor: "cuda" tests a real card."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run the tests of a module that calls kernels on every device, on the card in every build only where sampled."""
    calls = any(hasattr(metafunc.module, name) for name in RUNS)
    if calls and metafunc.definition.get_closest_marker("processor") is None:
        sampled = metafunc.definition.get_closest_marker("sampled")
        is_sampled = sampled is not None and any(case.startswith("vulkan") for case in sampled.args)
        marks = [pytest.mark.vulkan] if is_sampled else [pytest.mark.vulkan, pytest.mark.nightly]
        metafunc.parametrize("device", ["cpu", pytest.param(CARD, marks=marks, id="vulkan")], indirect=True)


@pytest.fixture(autouse=True)
def device(request: pytest.FixtureRequest) -> Iterator[str]:
    """Return the device on which everything in this test runs."""
    name = str(getattr(request, "param", "cpu"))
    found = {each.name: each for each in list_devices()}[name]
    if not found.available:
        assert "CI" not in os.environ, found.reason
        pytest.skip(f"{name}: {found.reason}")
    with engine.on(name):
        yield name
