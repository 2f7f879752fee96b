"""Open Image Denoise is given the guides that were asked for, as they came or through its own filter."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise import peers
from lobewise.errors import InputError
from lobewise.peers import OIDN_GUIDES, denoise_oidn, has_oidn, name_oidn_guides
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from tests.mistakes import refuses
from tests.pythons import run_python

pytestmark = pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[compare]'")

# What noise of this much leaves: a convolution over some dozen pixels and more lets a third of it through at the most.
NOISE, LEFT = 0.1, 0.35


@pytest.fixture
def full_frame(make_frame: Callable[..., Frame]) -> Frame:
    """Return a frame of a size that the library takes as it is."""
    return make_frame(height=17, width=20)


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return what the last call gave to the library's network beside the colour."""
    import pyoidn

    seen: dict[str, Any] = {}

    class Recorder(pyoidn.Filter):
        """A filter of the library that notes what it gets."""

        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            self.given: dict[str, Any] = {}

        def set_image(self, name: str, data: Any, *rest: Any) -> None:
            super().set_image(name, data, *rest)
            self.given[name] = data

        def set_bool(self, name: str, value: bool) -> None:
            super().set_bool(name, value)
            self.given[name] = value

        def set_int(self, name: str, value: int) -> None:
            super().set_int(name, value)
            self.given[name] = value

        def execute(self) -> None:
            if "color" in self.given:
                seen.update({"albedo": None, "normal": None, **self.given})
            elif "albedo" in self.given:
                seen["noisy albedo"] = self.given["albedo"]
            super().execute()

    monkeypatch.setattr(pyoidn, "Filter", Recorder)
    return seen


def make_noisy_guides(rng: np.random.Generator) -> tuple[Frame, FloatArray, FloatArray]:
    """Return a frame with noisy guides, and albedo and normal without noise: two halves that face apart."""
    height, width = 64, 64
    right = np.arange(width)[None, :, None] >= width // 2
    albedo = np.broadcast_to(np.where(right, 0.3, 0.7), (height, width, 3)).astype(np.float32)
    normal = np.where(right, np.array([0.6, 0.0, 0.8]), np.array([-0.6, 0.0, 0.8]))
    normal = np.broadcast_to(normal, (height, width, 3)).astype(np.float32)
    noisy_albedo = albedo + rng.uniform(-NOISE, NOISE, albedo.shape)
    noisy_normal = normal + rng.uniform(-NOISE, NOISE, normal.shape)
    gbuffer = GBuffer(normal=noisy_normal, diffuse_albedo=noisy_albedo)
    return Frame(radiance=Radiance(color=np.ones((height, width, 3))), gbuffer=gbuffer), albedo, normal


def test_guides_come_as_asked_for(full_frame: Frame, given: dict[str, Any]) -> None:
    import pyoidn

    denoise_oidn(full_frame, guides="mean", quality="fast")
    np.testing.assert_array_equal(given["albedo"], full_frame.gbuffer.denoiser_albedo)
    np.testing.assert_array_equal(given["normal"], full_frame.gbuffer.denoiser_normal)
    guides = replace(full_frame.gbuffer, denoiser_albedo=None, denoiser_normal=None)
    full_frame = full_frame.with_changes(gbuffer=guides)
    guides = full_frame.gbuffer
    samples = np.minimum(guides.diffuse_albedo + guides.specular_albedo, 1.0)
    area = np.minimum(guides.mean_diffuse_albedo + guides.mean_specular_albedo, 1.0)
    for kind, normal, albedo in (("centre", guides.normal, samples), ("mean", guides.mean_normal, area)):
        denoise_oidn(full_frame, guides=kind, quality="fast")
        assert normal is not None
        np.testing.assert_array_equal(given["normal"], normal)
        np.testing.assert_array_equal(given["albedo"], albedo)
        assert given["cleanAux"]
        assert given["hdr"]
        assert given["quality"] == pyoidn.OIDN_QUALITY_FAST


def test_a_frame_without_mean_normals_gives_its_own(
    full_frame: Frame, given: dict[str, Any], make_frame: Callable[..., Frame]
) -> None:
    without = full_frame.with_changes(gbuffer=GBuffer(normal=full_frame.gbuffer.normal))
    denoise_oidn(without, guides="mean")
    np.testing.assert_array_equal(given["normal"], full_frame.gbuffer.normal)
    np.testing.assert_array_equal(given["albedo"], 1.0)


def test_what_tells_nothing_is_left_out(full_frame: Frame, given: dict[str, Any]) -> None:
    guides, flat = full_frame.gbuffer, np.zeros((*full_frame.shape, 3), np.float32)
    # As a reader makes normals up where a file has none, but none where a lamp is.
    flat[..., 2] = 1.0
    flat[3, 4] = 0.0
    for gbuffer, names in (
        (GBuffer(), ()),
        (GBuffer(normal=flat), ()),
        (GBuffer(normal=flat, diffuse_albedo=guides.diffuse_albedo), ("albedo",)),
        (GBuffer(normal=guides.normal, diffuse_albedo=guides.diffuse_albedo), ("albedo", "normal")),
    ):
        frame = full_frame.with_changes(gbuffer=gbuffer)
        assert name_oidn_guides(frame) == names
        denoise_oidn(frame)
        assert tuple(name for name in ("albedo", "normal") if given[name] is not None) == names
        # A network for guides without noise needs some.
        assert given["cleanAux"] is bool(names)
    image, _ = denoise_oidn(full_frame.with_changes(gbuffer=GBuffer()))
    assert image.shape == (*full_frame.shape, 3)


def test_guides_that_are_no_numbers_do_not_reach_it(full_frame: Frame, given: dict[str, Any]) -> None:
    normal, albedo = np.array(full_frame.gbuffer.normal), np.array(full_frame.gbuffer.diffuse_albedo)
    normal[2, 3], albedo[2, 4], albedo[2, 5] = np.nan, np.nan, np.inf
    frame = full_frame.with_changes(gbuffer=GBuffer(normal=normal, diffuse_albedo=albedo))
    denoise_oidn(frame, guides="mean")
    np.testing.assert_array_equal(given["normal"][2, 3], 0.0)
    np.testing.assert_array_equal(given["albedo"][2, 4:6], 0.0)
    denoise_oidn(frame)
    assert all(np.isfinite(given[name]).all() for name in ("albedo", "normal"))


@pytest.mark.parametrize("kind", ["mean", "prefiltered"])
def test_an_albedo_without_a_mean_of_the_area_is_that_of_the_samples(
    kind: str, full_frame: Frame, given: dict[str, Any]
) -> None:
    guides = replace(full_frame.gbuffer, denoiser_albedo=None)
    for missing in ("diffuse_albedo", "specular_albedo"):
        without = replace(guides, **{f"mean_{missing}": None})
        denoise_oidn(full_frame.with_changes(gbuffer=without), guides=kind)
        parts = [
            getattr(guides, name if name == missing else f"mean_{name}")
            for name in ("diffuse_albedo", "specular_albedo")
        ]
        albedo = given["albedo" if kind == "mean" else "noisy albedo"]
        np.testing.assert_array_equal(albedo, np.minimum(parts[0] + parts[1], 1.0))


def test_prefiltered_guides_are_made_of_the_means_of_the_area(full_frame: Frame, given: dict[str, Any]) -> None:
    guides = full_frame.gbuffer
    alone = GBuffer(normal=guides.mean_normal, diffuse_albedo=guides.mean_diffuse_albedo)
    denoise_oidn(full_frame.with_changes(gbuffer=alone))
    expected = given["albedo"]
    both = replace(alone, diffuse_albedo=guides.diffuse_albedo, mean_diffuse_albedo=guides.mean_diffuse_albedo)
    denoise_oidn(full_frame.with_changes(gbuffer=both))
    np.testing.assert_array_equal(given["albedo"], expected)


def test_prefiltered_guides_lose_their_noise_and_keep_their_edge(
    rng: np.random.Generator, given: dict[str, Any]
) -> None:
    frame, albedo, normal = make_noisy_guides(rng)
    denoise_oidn(frame)
    assert frame.gbuffer.diffuse_albedo is not None
    assert frame.gbuffer.normal is not None
    for after, before, clean in (
        (given["albedo"], frame.gbuffer.diffuse_albedo, albedo),
        (given["normal"], frame.gbuffer.normal, normal),
    ):
        assert np.abs(after - clean).mean() < LEFT * np.abs(before - clean).mean()
        # Beside the edge too, where a blur would not pass.
        edge = (slice(4, -4), slice(30, 34))
        assert np.abs(after - clean)[edge].mean() < np.abs(before - clean)[edge].mean()


def test_frame_and_kept_filters_are_left_as_they_were(rng: np.random.Generator) -> None:
    frame, _, _ = make_noisy_guides(rng)
    normal, albedo = np.array(frame.gbuffer.normal), np.array(frame.gbuffer.diffuse_albedo)
    first, _ = denoise_oidn(frame)
    # A frame of another size in between binds the kept filters anew.
    small = Frame(
        radiance=Radiance(color=np.ones((9, 13, 3))),
        gbuffer=GBuffer(normal=np.ones((9, 13, 3)), diffuse_albedo=np.full((9, 13, 3), 0.5)),
    )
    assert denoise_oidn(small)[0].shape == (9, 13, 3)
    again, seconds = denoise_oidn(frame)
    assert seconds > 0.0
    np.testing.assert_array_equal(again, first)
    np.testing.assert_array_equal(frame.gbuffer.normal, normal)
    np.testing.assert_array_equal(frame.gbuffer.diffuse_albedo, albedo)


def test_memory_of_the_library_is_freed_after_the_call(rng: np.random.Generator) -> None:
    frame, _, _ = make_noisy_guides(rng)
    with peers.keep_library_memory():
        denoise_oidn(frame)
        assert set(peers._opened.filters) == {("normal",), ("albedo",), ("color", "albedo", "normal")}
        kept = peers._opened.filters["color", "albedo", "normal"]
        denoise_oidn(frame)
        assert peers._opened.filters["color", "albedo", "normal"] is kept
    assert not peers._opened.filters


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads the memory of a process from Linux")
def test_guides_and_color_share_memory(rng: np.random.Generator) -> None:
    """Three filters with memory of their own would take three times this."""
    program = """
import numpy as np
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.peers import denoise_oidn
from tests.fuzz.worker import read_status
light = np.random.default_rng(0).random((400, 1000, 3), dtype=np.float32)
denoise_oidn(Frame(Radiance(light[:64, :64])))
start = read_status("VmHWM")
denoise_oidn(Frame(Radiance(light), GBuffer(normal=light, diffuse_albedo=light)))
print((read_status("VmHWM") - start) / light[..., 0].size)
"""
    assert float(run_python("-c", program)) < 1200.0  # bytes a pixel


def test_mistakes_are_told(full_frame: Frame) -> None:
    with refuses(InputError, "guides"):
        denoise_oidn(full_frame, guides="prefilterd")
    assert OIDN_GUIDES[0] == "prefiltered"


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (5, 3), (1, 64), (15, 40)])
def test_small_images_keep_their_light(shape: tuple[int, int]) -> None:
    color = np.full((*shape, 3), [0.7, 0.5, 0.3], np.float32)
    image, _ = denoise_oidn(Frame(Radiance(color), GBuffer(normal=np.ones((*shape, 3)), diffuse_albedo=color)))
    np.testing.assert_allclose(image, color, rtol=0.08)
    np.testing.assert_allclose(image.mean(axis=(0, 1)), color[0, 0], rtol=0.03)


def test_gray_images_stay_gray(rng: np.random.Generator) -> None:
    color = np.repeat(rng.gamma(2.0, 0.5, (40, 50, 1)), 3, axis=-1)
    albedo = np.repeat(rng.uniform(0.3, 0.6, (40, 50, 1)), 3, axis=-1)
    image, _ = denoise_oidn(Frame(Radiance(color), GBuffer(diffuse_albedo=albedo)))
    np.testing.assert_array_equal(image[..., 0], image[..., 2])
    tinted, _ = denoise_oidn(Frame(Radiance(color * [1.0, 1.0, 0.9]), GBuffer(diffuse_albedo=albedo)))
    assert (tinted[..., 0] != tinted[..., 2]).any()


def test_gray_light_on_colored_surfaces_may_have_color(rng: np.random.Generator) -> None:
    """The colour of the surfaces is no reason for the light to lose what the library makes of it."""
    color = np.repeat(rng.gamma(2.0, 0.5, (40, 50, 1)), 3, axis=-1)
    albedo = rng.uniform(0.3, 0.6, (40, 50, 1)) * np.array([1.0, 0.7, 0.3])
    image, _ = denoise_oidn(Frame(Radiance(color), GBuffer(diffuse_albedo=albedo)))
    assert (image[..., 0] != image[..., 2]).any()
