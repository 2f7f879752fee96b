"""Opacity that is a fraction in whole areas is denoised with the picture: shadow catchers, things out of focus."""

from pathlib import Path

import numpy as np
import pytest
from renderers import WRITERS, Written, make_scene, read_channels, write

import lobewise
from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.interchange import import_file, write_result
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from tests.mistakes import refuses

CHANNEL = "View Layer.001.Combined.A"
SAMPLES = 16


def make_truth(shape: tuple[int, int]) -> FloatArray:
    """Return the opacity of a plane with a soft shadow."""
    height, width = shape
    rows, columns = np.mgrid[:height, :width] / max(shape)
    return (0.15 + 0.7 * np.exp(-30.0 * ((rows - 0.3) ** 2 + (columns - 0.5) ** 2))).astype(np.float32)


def make_noisy(truth: FloatArray) -> FloatArray:
    """Return the share of samples that hit."""
    return (np.random.default_rng(5).binomial(SAMPLES, truth) / SAMPLES).astype(np.float32)


def make_frame(alpha: FloatArray) -> Frame:
    """Return a noisy image with opacity."""
    light = np.random.default_rng(1).gamma(4.0, 0.05, (*alpha.shape, 3))
    return Frame(Radiance(light.astype(np.float32)), alpha=alpha)


def write_catcher(path: Path, *, with_passes: bool = True) -> FloatArray:
    """Write a file of Cycles with noisy opacity; return the truth."""
    written: Written = WRITERS["cycles"](make_scene())
    if not with_passes:
        for key in [key for key in written.channels if ".Combined." not in key and ".Normal." not in key]:
            del written.channels[key]
    truth = make_truth(make_scene().surface.shape)
    written.channels[CHANNEL] = make_noisy(truth)
    write(path, written)
    return truth


@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_opacity_is_denoised(quality: str) -> None:
    truth = make_truth((60, 80))
    frame = make_frame(make_noisy(truth))
    result = lobewise.denoise(frame, quality=quality)
    assert np.mean((result.alpha - truth) ** 2) < 0.3 * np.mean((frame.alpha - truth) ** 2)
    assert result.alpha.min() >= 0.0
    assert result.alpha.max() <= 1.0
    # The light is what it would be without opacity.
    np.testing.assert_array_equal(result.image, lobewise.denoise(frame.with_changes(alpha=None), quality=quality).image)


def test_named_qualities_count_as_high_and_colors_do_not_count() -> None:
    truth = make_truth((40, 50))
    truth[:, 20:] *= 0.3
    normal = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (40, 50, 3))
    plain = make_frame(make_noisy(truth)).with_changes(gbuffer=GBuffer(normal=normal))
    alphas = [lobewise.denoise(plain, quality=quality).alpha for quality in ("fast", "high")]
    np.testing.assert_array_equal(*alphas)
    stripes = np.where(np.arange(50) % 6 < 3, 0.2, 0.8)[None, :, None] * np.ones((40, 1, 3))
    guides = GBuffer(normal=normal, diffuse_albedo=stripes, specular_albedo=0.1 * stripes)
    colored = plain.with_changes(gbuffer=guides)
    np.testing.assert_array_equal(lobewise.denoise(colored, quality="high").alpha, alphas[1])


def test_surfaces_stay_opaque_and_the_background_clear() -> None:
    truth = make_truth((60, 80))
    alpha = make_noisy(truth)
    alpha[:20, :30], alpha[40:, 50:] = 1.0, 0.0
    clean = lobewise.denoise(make_frame(alpha), quality="balanced").alpha
    assert (clean[:17, :27] == 1.0).all()
    assert (clean[43:, 53:] == 0.0).all()


def test_many_samples_leave_opacity_as_it_is(tmp_path: Path) -> None:
    written = WRITERS["cycles"](make_scene())
    written.channels[CHANNEL] = make_noisy(make_truth(make_scene().surface.shape))
    written.attributes["cycles.View Layer.001.samples"] = "65"
    write(tmp_path / "a.exr", written)
    imported = import_file(tmp_path / "a.exr")
    assert imported.frame.spp == 65
    assert imported.frame.alpha is None
    assert any(note.endswith("and stays: 65 samples leave little noise in it.") for note in imported.notes)


def test_windows_keep_the_opacity_of_their_frame() -> None:
    truth = make_truth((40, 50))
    rng = np.random.default_rng(2)
    frames = [
        Frame(Radiance(rng.gamma(4.0, 0.05, (40, 50, 3)).astype(np.float32)), alpha=make_noisy(truth)) for _ in range(3)
    ]
    result = lobewise.WindowFilter(1, quality="fast").denoise(frames, 1)
    np.testing.assert_array_equal(result.alpha, lobewise.denoise(frames[1], quality="fast").alpha)


def test_a_filter_over_time_says_that_opacity_stays() -> None:
    frame = Frame(Radiance(np.ones((8, 9, 3), np.float32)), alpha=np.full((8, 9), 0.5, np.float32))
    result = lobewise.TemporalFilter().add(frame)
    assert result.alpha is None
    assert "The opacity of the frame is not filtered." in result.notes


def test_opacity_of_another_size_is_refused() -> None:
    with refuses(InputError, "alpha"):
        Frame(Radiance(np.ones((4, 5, 3), np.float32)), alpha=np.ones((5, 4), np.float32))


def test_the_channel_of_a_file_is_replaced(tmp_path: Path) -> None:
    truth = write_catcher(tmp_path / "a.exr")
    assert run(["denoise", str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.exr"), "--quality", "balanced"]) == 0
    noisy, clean = (read_channels(tmp_path / name)[CHANNEL] for name in ("a.exr", "b.exr"))
    assert np.mean((clean - truth) ** 2) < 0.5 * np.mean((noisy - truth) ** 2)
    imported = import_file(tmp_path / "a.exr")
    assert not any("alpha" in note for note in imported.frame.notes)
    assert "ViewLayer.Combined.A is a fraction" in " ".join(imported.notes).replace("View Layer.001", "ViewLayer")
    write_result(tmp_path / "c.exr", lobewise.denoise(imported.frame, quality="balanced"), source=imported)
    np.testing.assert_array_equal(read_channels(tmp_path / "c.exr")[CHANNEL], clean)


def test_bands_leave_opacity_as_it_is_and_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_catcher(tmp_path / "a.exr", with_passes=False)
    words = ["--quality", "fast", "--bands", "16"]
    assert run(["denoise", str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.exr"), *words]) == 0
    assert "Left noisy: alpha." in " ".join(capsys.readouterr().err.split())
    np.testing.assert_array_equal(*(read_channels(tmp_path / name)[CHANNEL] for name in ("a.exr", "b.exr")))


def test_silhouettes_alone_are_not_filtered(tmp_path: Path) -> None:
    written = WRITERS["cycles"](make_scene())
    surface = make_scene().surface.astype(np.float32)
    edge = np.abs(np.diff(surface, axis=1, prepend=surface[:, :1])) > 0.0
    written.channels[CHANNEL] = np.where(edge, 0.5, surface)
    write(tmp_path / "a.exr", written)
    assert import_file(tmp_path / "a.exr").frame.alpha is None
