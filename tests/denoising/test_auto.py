"""What the quality "auto" stands for, with and without Open Image Denoise, and what is said of it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise import peers
from lobewise.denoising import also, combining, denoise
from lobewise.denoising.automatic import ask, choose_quality
from lobewise.denoising.recipe import FEATURES_SOFTENED
from lobewise.errors import InputError
from lobewise.features import ScreenFeature
from lobewise.interchange import write_result
from lobewise.io import read_frame, write_frame
from lobewise.mitsuba import Denoiser
from lobewise.recipes.streaming.recipe import denoise_file
from lobewise.recipes.temporal import TemporalFilter
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.settings import DenoiseSettings
from tests.mistakes import refuses

MISSING = "Open Image Denoise is not installed; pip install 'lobewise[best]'"
CHEAP: dict[str, Any] = {"similarity": "normal"}


@pytest.fixture
def absent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make Open Image Denoise one that is not installed."""
    monkeypatch.setattr(peers, "look_up_oidn_fault", lambda: peers.OidnFault(*MISSING.split("; "), is_installed=False))


@pytest.fixture
def present(monkeypatch: pytest.MonkeyPatch) -> list[Frame]:
    """Make Open Image Denoise one that gives light of 3 everywhere; return the frames that it is given."""
    given: list[Frame] = []

    def run(frame: Frame, **_: str) -> tuple[np.ndarray, float]:
        given.append(frame)
        return np.full((*frame.shape, 3), 3.0, np.float32), 0.1

    monkeypatch.setattr(peers, "look_up_oidn_fault", lambda: None)
    monkeypatch.setattr(combining, "denoise_oidn", run)
    return given


def join_light(frame: Frame) -> Frame:
    """Return a frame whose light is not told apart."""
    return frame.with_changes(radiance=Radiance(frame.radiance.color), half_a=None, half_b=None, variance=None)


@pytest.mark.usefixtures("present")
def test_parts_near_the_largest_number_do_not_overflow(make_frame: Callable[..., Frame]) -> None:
    frame = make_frame(height=12, width=16).with_changes(half_a=None, half_b=None, variance=None)
    light = {name: np.array(getattr(frame.radiance, name)) for name in ("color", "diffuse", "specular")}
    for image in light.values():
        image[5, 5] = np.finfo(np.float32).max
    image = denoise(frame.with_changes(radiance=Radiance(**light)), **CHEAP).image
    assert np.isfinite(image).all()
    assert image.min() >= 0.0


def share_out_black(surface: np.ndarray | None) -> combining.Shares:
    """Share a mixture out over two parts, which have light in the left half of the image alone."""
    parts = [np.zeros((20, 60, 3), np.float32) for _ in range(2)]
    parts[0][:, ::2], parts[1][:, ::2] = 0.75, 0.25
    for part in parts:
        part[:, 30:] = 0.0
    return combining.share_out(np.full((20, 60, 3), 0.5, np.float32), sum(parts), parts, surface)


def test_black_pixels_keep_the_mixture_and_their_parts_share_it_as_around() -> None:
    shares = share_out_black(None)
    reach = 28 + combining.NEAR_RADIUS
    np.testing.assert_allclose(shares.image[:, : reach + 1], 0.5)
    np.testing.assert_allclose(sum(shares.parts), shares.image, rtol=1e-6)
    np.testing.assert_allclose(shares.parts[0][:, : reach + 1], 0.375, rtol=1e-6)
    assert not shares.image[:, reach + 1 :].any()


def test_light_of_surfaces_does_not_reach_the_background() -> None:
    surface = np.zeros((20, 60), np.bool_)
    surface[:, :29] = True
    shares = share_out_black(surface)
    np.testing.assert_allclose(shares.image[:, :29], 0.5)
    assert not shares.image[:, 29:].any()


def test_fog_has_light_between_its_samples() -> None:
    """Nothing solid is there, and most pixels around have light."""
    before = np.ones((11, 11, 3), np.float32)
    before[5, 5:7] = 0.0
    shares = combining.share_out(np.full_like(before, 0.5), before, [before], np.zeros((11, 11), np.bool_))
    np.testing.assert_allclose(shares.image, 0.5)
    np.testing.assert_allclose(shares.parts[0], 0.5, rtol=1e-6)


def test_parts_of_a_layer_sum_to_light_that_the_mixture_adds() -> None:
    parts = [np.zeros((9, 9, 3), np.float32) for _ in range(2)]
    parts[0][4, 4], parts[1][4, 4] = 3.0, 1.0
    clean = np.full((9, 9, 3), 2.0, np.float32)
    brought = also.bring_parts(("direct", "indirect"), parts, clean)
    np.testing.assert_allclose(brought["direct"], 1.5, rtol=1e-6)
    np.testing.assert_allclose(brought["indirect"], 0.5, rtol=1e-6)


def test_images_of_a_sum_take_light_where_all_are_black() -> None:
    black, image = np.zeros((7, 7, 3), np.float32), np.full((7, 7, 3), 0.6, np.float32)
    shared = combining.share_by_noise(image, [black, black], [black, black])
    np.testing.assert_allclose(shared, 0.3, rtol=1e-6)


@pytest.mark.usefixtures("present")
def test_a_mixture_with_a_huge_image_is_not_negative(
    full_frame: Frame, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    huge = (1e28 * rng.random((*full_frame.shape, 3))).astype(np.float32)
    monkeypatch.setattr(combining, "denoise_oidn", lambda frame, **_: (huge, 0.1))
    shares = np.full((*full_frame.shape, 3), 1.0 / 3.0, np.float32)
    shares[..., 0] += np.float32(1.0 / 3.0)
    monkeypatch.setattr(combining, "compute_mixture", lambda *images, **told: shares)
    assert denoise(full_frame, **CHEAP).image.min() >= 0.0


@pytest.mark.parametrize("quality", ["auto", "fast", "balanced", "high"])
@pytest.mark.parametrize("with_oidn", ["auto", True, False])
@pytest.mark.parametrize("is_here", [True, False])
def test_it_is_taken_where_it_is_left_open_or_asked_for(
    quality: Any, with_oidn: Any, is_here: bool, request: pytest.FixtureRequest
) -> None:
    request.getfixturevalue("present" if is_here else "absent")
    if with_oidn is True and quality == "fast":
        with refuses(InputError, "quality"):
            DenoiseSettings(quality=quality, with_oidn=True)
        return
    chosen = ask(DenoiseSettings(quality=quality, with_oidn=with_oidn), {})
    assert chosen.with_oidn is (with_oidn is True or (with_oidn == "auto" and quality == "auto" and is_here))
    assert chosen.quality == (("balanced" if chosen.with_oidn else "high") if quality == "auto" else quality)
    # What is chosen once stays so.
    assert ask(chosen, {}) == chosen
    # A part of an image is left to our own filters.
    if with_oidn != True:  # noqa: E712
        assert ask(DenoiseSettings(quality=quality, with_oidn=with_oidn), {}, whole=False).with_oidn is False


@pytest.mark.usefixtures("present")
@pytest.mark.parametrize("form", ["separable", "atrous"])
def test_other_forms_are_fast_without_it(form: Any) -> None:
    chosen = ask(DenoiseSettings(form=form), {})
    assert (chosen.quality, chosen.with_oidn) == ("fast", False)
    assert choose_quality(DenoiseSettings(form=form)) == "fast"


def test_the_default_mixes(make_frame: Callable[..., Frame], present: list[Frame]) -> None:
    frame = make_frame(height=12, width=16)
    result = denoise(frame, **CHEAP)
    # With guides, without, and each layer.
    assert len(present) == 4
    assert (result.settings["quality"], result.settings["with_oidn"]) == ("balanced", True)
    assert result.method == (
        "Open Image Denoise with and without albedo and normal and layer by layer, mixed pixel by pixel with "
        "lobewise's own filters, comparing which way surfaces face"
    )
    ours = denoise(frame, **CHEAP, with_oidn=False)
    assert len(present) == 4
    assert ours.method == "lobewise's own filters, comparing which way surfaces face, quality high"


@pytest.mark.usefixtures("present")
def test_halves_prove_what_the_mixture_lost(rng: np.random.Generator) -> None:
    """A texture of single pixels, which no network knows, and another denoiser that is wrong everywhere."""
    shape, noise = (60, 80, 3), 0.01
    texture = np.repeat(rng.uniform(0.2, 0.8, (*shape[:2], 1)), 3, axis=-1)
    a, b = ((texture * (1.0 + noise * rng.normal(size=shape))).astype(np.float32) for _ in range(2))
    normal = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), shape).copy()
    normal[:, :40] = 0.6, 0.0, 0.8
    guides = GBuffer(normal=normal, diffuse_albedo=np.full(shape, 0.6, np.float32))
    frame = Frame(Radiance(0.5 * (a + b)), guides, half_a=Radiance(a), half_b=Radiance(b), spp=64)
    after, before = (float(np.mean((image - texture) ** 2)) for image in (denoise(frame).image, frame.radiance.color))
    assert after < 1.1 * before


@pytest.mark.usefixtures("present")
def test_without_guides_it_is_all(make_frame: Callable[..., Frame]) -> None:
    frame = join_light(make_frame(height=12, width=16))
    flat = np.zeros((12, 16, 3), np.float32)
    flat[..., 2] = 1.0
    result = denoise(frame.with_changes(gbuffer=GBuffer(normal=flat)), **CHEAP)
    np.testing.assert_array_equal(result.image, 3.0)
    assert result.method == (
        "Open Image Denoise without guides, alone, because the frame has neither albedo nor normals"
    )
    assert "mixed pixel by pixel" in denoise(frame, **CHEAP).method


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        (("albedo", "normal"), "with and without albedo and normal,"),
        (("normal",), "with and without normal,"),
        (("albedo",), "with and without albedo,"),
        ((), "without guides,"),
    ],
)
@pytest.mark.usefixtures("present")
def test_guides_are_named(kept: tuple[str, ...], words: str, make_frame: Callable[..., Frame]) -> None:
    frame = join_light(make_frame(height=12, width=16))
    changes: dict[str, Any] = {}
    if "albedo" not in kept:
        names = ("diffuse_albedo", "specular_albedo", "mean_diffuse_albedo", "mean_specular_albedo", "denoiser_albedo")
        changes |= dict.fromkeys(names)
    if "normal" not in kept:
        # As a reader makes them up, but none where a lamp is.
        flat = np.zeros((12, 16, 3), np.float32)
        flat[..., 2] = 1.0
        flat[3, 4] = 0.0
        changes |= {"normal": flat, "mean_normal": None, "denoiser_normal": None}
    frame = frame.with_changes(gbuffer=replace(frame.gbuffer, **changes))
    assert f"Open Image Denoise {words}" in denoise(frame, **CHEAP).method


@pytest.mark.nightly
def test_features_of_your_own_leave_it_out(make_frame: Callable[..., Frame], present: list[Frame]) -> None:
    frame = make_frame(height=12, width=16)
    result = denoise(frame, **CHEAP, features=[ScreenFeature(2.0)])
    assert not present
    assert result.settings["quality"] == "balanced"
    assert result.method.endswith("neither Open Image Denoise nor the network of 'high' knows features of your own)")
    assert FEATURES_SOFTENED not in result.notes
    assert denoise(frame, **CHEAP, features=[ScreenFeature(2.0)], with_oidn=True).settings["with_oidn"] is True
    # With guides, both layers, and the color alone.
    assert len(present) == 4
    asked = denoise(frame, **CHEAP, features=[ScreenFeature(2.0)], quality="high")
    assert asked.settings["quality"] == "high"
    assert FEATURES_SOFTENED in asked.notes
    assert FEATURES_SOFTENED not in denoise(frame, **CHEAP, quality="high").notes


@pytest.mark.parametrize("radius", [None, 0.0, 4.0])
def test_lamps_out_of_focus_go_by_its_image_of_the_color_alone(
    radius: float | None, make_frame: Callable[..., Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(frame: Frame, **_: str) -> tuple[np.ndarray, float]:
        return np.full((*frame.shape, 3), 3.0 if frame.gbuffer.names else 9.0, np.float32), 0.1

    monkeypatch.setattr(peers, "look_up_oidn_fault", lambda: None)
    monkeypatch.setattr(combining, "denoise_oidn", run)
    frame = make_frame(height=12, width=40)
    lamp = np.zeros((12, 40, 1), np.float32)
    lamp[:, 20:] = 3.0
    parts = {name: np.where(lamp > 0.0, 0.0, getattr(frame.radiance, name)) for name in ("diffuse", "specular")}
    light = Radiance(sum(parts.values()) + lamp, **parts)
    blur = None if radius is None else np.where(lamp[..., 0] > 0.0, np.float32(radius), np.float32(0.0))
    bare: dict[str, Any] = {"half_a": None, "half_b": None, "variance": None}
    image = denoise(
        frame.with_changes(radiance=light, gbuffer=replace(frame.gbuffer, blur_radius=blur), **bare), **CHEAP
    ).image
    assert (image[2:-2, 32:] == 9.0).all() == bool(radius)
    assert not (image[:, :11] == 9.0).any()


@pytest.mark.usefixtures("absent")
def test_without_it_the_default_is_high_and_says_why(make_frame: Callable[..., Frame]) -> None:
    frame = make_frame(height=12, width=16)
    result = denoise(frame, **CHEAP)
    assert (result.settings["quality"], result.settings["with_oidn"]) == ("high", False)
    assert result.method == f"lobewise's own filters, comparing which way surfaces face, quality high ({MISSING})"
    for changes in ({"quality": "high"}, {"with_oidn": False}):
        same = denoise(frame, **CHEAP, **changes)
        assert same.method == "lobewise's own filters, comparing which way surfaces face, quality high"
        np.testing.assert_array_equal(same.image, result.image)


@pytest.mark.usefixtures("present")
def test_bands_are_of_our_own_filters_and_say_why(make_frame: Callable[..., Frame], tmp_path: Path) -> None:
    source = tmp_path / "in.exr"
    write_frame(source, make_frame(height=24, width=16).with_changes(lobe_tables=(), gbuffer=make_plain(make_frame)))
    done = denoise_file(source, tmp_path / "bands.exr", rows=8, **CHEAP)
    assert (done.settings["quality"], done.settings["with_oidn"]) == ("high", False)
    assert done.method == (
        "lobewise's own filters, comparing which way surfaces face, quality high "
        "(Open Image Denoise takes whole images, and this one is denoised in bands)"
    )
    result = denoise(read_frame(source), **CHEAP, with_oidn=False)
    write_result(tmp_path / "whole.exr", result, source=source)
    np.testing.assert_array_equal(
        read_frame(tmp_path / "bands.exr").radiance.color, read_frame(tmp_path / "whole.exr").radiance.color
    )
    assert denoise_file(source, tmp_path / "b.exr", rows=8, quality="high", **CHEAP).method.endswith("quality high")


def make_plain(make_frame: Callable[..., Frame]) -> Any:
    """Return guides that a file of 16 by 24 pixels can hold without lobe tables; normals without noise, in focus."""
    gbuffer = make_frame(height=24, width=16).gbuffer
    return replace(gbuffer, material=None, normal=np.full((24, 16, 3), 3.0**-0.5), blur_radius=None)


def test_a_history_and_an_alpha_leave_it_out(make_frame: Callable[..., Frame], present: list[Frame]) -> None:
    frame = make_frame(height=12, width=16)
    assert TemporalFilter(similarity="normal").add(frame).settings["with_oidn"] is False
    assert not present
    clean = Denoiser((16, 12), denoise_alpha=True, **CHEAP)
    noisy = np.concatenate([frame.radiance.color, np.ones((12, 16, 1), np.float32)], axis=-1)
    image = clean(noisy, normals=frame.gbuffer.normal)
    assert len(present) == 2
    assert "Used: Open Image Denoise with and without normal" in " ".join(clean.notes)
    np.testing.assert_allclose(image[..., 3], 1.0, rtol=1e-5)


def test_an_installation_that_cannot_be_loaded_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(name: str) -> None:
        raise OSError("libOpenImageDenoise.so: wrong ELF class\n")

    monkeypatch.setattr(peers.importlib, "import_module", fail)
    monkeypatch.setattr(peers, "look_up_oidn_fault", peers.look_up_oidn_fault.__wrapped__)
    assert not peers.has_oidn()
    assert "cannot be loaded (libOpenImageDenoise.so: wrong ELF class" in peers.explain_no_oidn()
