"""Pixels that nothing was sampled for take no light from others: those of a checkerboard, and the gutters of a bake."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from renderers import WRITERS, Written, make_scene, write

import lobewise
from lobewise.cli.program import run
from lobewise.guides.squares import compute_square_maximum
from lobewise.interchange import import_file
from lobewise.interchange.checks.unsampled import fill_gutters, mark_gutters, mark_pattern
from lobewise.metrics import rel_mse

PATTERNS = {
    "checkerboard": lambda y, x: (y + x) % 2 == 1,
    "rows": lambda y, x: y % 2 == 0,
    "one of 2x2": lambda y, x: (y % 2 == 1) | (x % 2 == 1),
    "a quarter": lambda y, x: (y % 2 == 1) & (x % 2 == 1),
}


def read_planes(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.parts[0].channels
        color = np.stack([channels[name].pixels for name in "RGB"], axis=-1).astype(np.float32)
        return color, channels["A"].pixels.copy() if "A" in channels else None


def test_a_checkerboard_keeps_its_light(field_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = field_folder / "checkerboard.exr", tmp_path / "out.exr"
    assert run(["denoise", str(source), "-o", str(out)]) == 0
    assert "50 % of the pixels hold no light, in a pattern that repeats" in " ".join(capsys.readouterr().err.split())
    clean, truth = read_planes(out)[0], np.load(field_folder / "plain_names_ref.npy")[:48, :48]
    lit = (read_planes(source)[0] > 0.0).any(axis=-1)
    assert clean.mean() == pytest.approx(truth.mean(), rel=0.04)
    assert rel_mse(clean[~lit][None], truth[~lit][None]) < 0.03
    assert rel_mse(clean, truth) < 0.02


@pytest.mark.parametrize("pattern", PATTERNS)
def test_every_pass_that_a_pattern_left_out_is_filled(pattern: str, tmp_path: Path) -> None:
    """Of layers and light groups too; guides that are there stay."""
    written = WRITERS["cycles"](make_scene())
    height, width = next(iter(written.channels.values())).shape
    left_out = PATTERNS[pattern](*np.mgrid[:height, :width])
    channels = {
        name: plane if "Normal" in name or "Position" in name else np.where(left_out, np.float32(0.0), plane)
        for name, plane in written.channels.items()
    }
    paths = tmp_path / "whole.exr", tmp_path / "left_out.exr"
    for path, each in zip(paths, (written.channels, channels), strict=True):
        write(path, Written(written.preset, each, written.attributes))
    whole, part = (import_file(path, light_passes=True).frame for path in paths)
    assert [layer.name for layer in part.layers] == [layer.name for layer in whole.layers] != []
    np.testing.assert_array_equal(part.gbuffer.normal, whole.gbuffer.normal)
    clean, expected = (lobewise.denoise(frame, quality="balanced", with_oidn=False) for frame in (part, whole))
    assert clean.image.mean() == pytest.approx(expected.image.mean(), rel=0.1)
    for name, light in expected.layers.items():
        assert clean.layers[name].mean() == pytest.approx(light.mean(), rel=0.2), name


def test_a_bake_keeps_its_light_at_the_borders_of_its_charts(field_folder: Path, tmp_path: Path) -> None:
    source, out = field_folder / "lightmap.exr", tmp_path / "out.exr"
    assert run(["denoise", str(source), "-o", str(out)]) == 0
    (noisy, alpha), (clean, kept) = read_planes(source), read_planes(out)
    assert alpha is not None
    np.testing.assert_array_equal(kept, alpha)
    gutters = alpha == 0.0
    assert not clean[gutters].any()
    border = (compute_square_maximum(gutters.astype(np.float32), 2) > 0.0) & ~gutters
    assert clean[border].mean() == pytest.approx(noisy[border].mean(), rel=0.02)


def test_what_a_camera_sees_before_nothing_is_no_bake(field_folder: Path, rng: np.random.Generator) -> None:
    color, alpha = read_planes(field_folder / "lightmap.exr")
    assert alpha is not None
    assert mark_gutters(color, alpha) is not None
    soft = alpha.copy()
    soft[4, 4] = 0.5  # a silhouette
    assert mark_gutters(color, soft) is None
    assert mark_gutters(color, np.ones_like(alpha)) is None
    lit = color.copy()
    lit[0, 0] = 1.0  # a background, or light that is straight
    assert mark_gutters(lit, alpha) is None


@pytest.mark.parametrize("shape", [(37, 50), (8, 8), (1, 9)])
def test_gutters_take_the_light_near_them(shape: tuple[int, int], rng: np.random.Generator) -> None:
    known = np.zeros(shape, np.bool_)
    known[:, : shape[1] // 3] = True
    image = rng.random((*shape, 3), dtype=np.float32)
    filled = fill_gutters(np.where(known[..., None], image, np.float32(np.nan)), known)
    np.testing.assert_array_equal(filled[known], image[known])
    assert np.isfinite(filled).all()
    assert image[known].min() <= filled.min() <= filled.max() <= image[known].max()


def test_few_lit_pixels_are_no_pattern(rng: np.random.Generator) -> None:
    """As of caustics or of the first samples."""
    color = np.zeros((64, 64, 3), np.float32)
    color[rng.random((64, 64)) < 0.02] = 1.0
    assert mark_pattern(color) is None
    assert mark_pattern(np.zeros((64, 64, 3), np.float32)) is None
    assert mark_pattern(np.ones((64, 64, 3), np.float32)) is None


@pytest.mark.nightly
def test_no_frame_of_a_renderer_is_taken_for_a_pattern(exr_folder: Path) -> None:
    for path in sorted(exr_folder.glob("*.exr")):
        found = import_file(path)
        assert mark_pattern(found.frame.radiance.color) is None, path.name
        assert found.outputs["color"].divided_by is None, path.name
