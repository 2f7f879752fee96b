"""The networks that mix images take what is nearer to the truth, and what they learn from is what it says."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.training import shares, textures
from benchmarks.training.candidates import (
    Candidates,
    denoise_all,
    list_samples,
    read_candidates,
    sum_albedo,
    vary_guides,
    write_candidates,
)
from lobewise.denoising.automatic import resolve_all
from lobewise.denoising.bad_pixels import mark_bad_pixels
from lobewise.denoising.chain import filter_rows
from lobewise.denoising.combining import compute_mixture
from lobewise.denoising.evidence import NAMES, unpack_network
from lobewise.filters.noise.detail import predict_shares
from lobewise.guides.usable import check_guides
from lobewise.settings import DenoiseSettings
from tests.streaming.frames import make_scene

SIZE = 48


def make_candidates(seed: int, rng: np.random.Generator) -> Candidates:
    """Return a frame whose filters blurred a texture, ours less than the peer."""
    truth = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    truth[:, : SIZE // 2 : 3] = 0.9

    def draw(noise: float) -> np.ndarray:
        return (truth * (1.0 + noise * rng.normal(size=truth.shape))).astype(np.float32).clip(0.0)

    blurred = truth.copy()
    blurred[:, : SIZE // 2] = truth[:, : SIZE // 2].mean()
    halves = draw(0.07), draw(0.07)
    return Candidates(
        seed=seed,
        spp=64,
        kind="all",
        noisy=0.5 * (halves[0] + halves[1]),
        balanced=blurred,
        high=blurred,
        peer=1.1 * blurred,
        clean=truth,
        reference_a=draw(0.02),
        reference_b=draw(0.02),
        half_a=halves[0],
        half_b=halves[1],
    )


def test_files_hold_what_was_written(tmp_path: Path, rng: np.random.Generator) -> None:
    before = make_candidates(7, rng)
    path = write_candidates(tmp_path, before)
    assert path.name == "00007-0064-all.npz"
    after = read_candidates(path)
    assert (after.seed, after.spp, after.kind) == (7, 64, "all")
    assert after.halves is not None
    np.testing.assert_allclose(after.half_a, before.half_a, rtol=1e-3)
    np.testing.assert_allclose(after.reference_b, before.reference_b, rtol=1e-3)


@pytest.mark.nightly
@pytest.mark.usefixtures("torch")
def test_they_take_what_is_nearer(tmp_path: Path, rng: np.random.Generator) -> None:
    for seed in range(1, 7):
        write_candidates(tmp_path, make_candidates(seed, rng))
    output, results = tmp_path / "out" / "weights.npz", tmp_path / "results.json"
    output.parent.mkdir()
    np.savez(output, other=np.ones(3, np.float32))
    words = ["--cache", str(tmp_path), "--steps", "200", "-o", str(output), "--results", str(results)]
    shares.main(words)
    told = json.loads(results.read_text())
    assert {(told[name]["scenes"], told[name]["scenes_kept_aside"]) for name in NAMES} == {(6, 1)}
    assert told["refined"]["kept aside"]["high all 64 spp"]["over_image"] < 0.4
    assert told["peer"]["kept aside"]["peer all 64 spp"]["over_image"] < 0.6
    with np.load(output) as arrays:
        noisy, peer = (unpack_network(arrays, kind) for kind in ("refined", "peer"))
        # What else the file holds stays.
        np.testing.assert_array_equal(arrays["other"], 1.0)
    found = make_candidates(8, rng)
    share = predict_shares(found.high, found.noisy, noisy, halves=found.halves, level=0.6)[..., 0]
    assert share[8:-8, 8:16].mean() > 0.5
    assert share[8:-8, -16:-8].mean() < 0.2
    ours = found.high + share[..., None] * (found.noisy - found.high)
    shares_found = compute_mixture(found.noisy, ours, found.peer, peer, halves=found.halves, shared=False)
    assert shares_found[..., :2].sum(axis=-1).mean() > 0.5


def test_guides_are_taken_away_by_the_seed() -> None:
    from tests.streaming.frames import make_scene

    frame = make_scene((8, 9))
    found = [dict(vary_guides(frame, np.random.default_rng(seed))) for seed in range(6)]
    assert {tuple(each) for each in found} == {("all", "plain", "passes", "color"), ("all", "plain", "shared", "color")}
    for each in found:
        assert each["all"] is frame
        assert each["plain"].gbuffer.alpha_u is None
        assert each["plain"].radiance.parts is None
        assert each["color"].gbuffer.names == ("normal",)
        assert each["color"].radiance.parts is None
        np.testing.assert_array_equal(sum_albedo(each["plain"]), sum_albedo(frame))
        assert all(one.half_a is None for name, one in each.items() if name != "all")
        assert ("shared" in each) == any(one.noise_is_shared for one in each.values())


def test_every_scene_has_few_samples_and_many() -> None:
    assert {list_samples(seed)[0] for seed in range(1, 9)} == {2, 4, 8, 16}
    assert all(list_samples(seed)[1:] == (64, 512) for seed in range(1, 9))


def test_drawn_frames_are_the_same_for_a_seed_and_as_noisy_as_they_say() -> None:
    assert len({tuple(textures.draw_frame(seed, SIZE)[1].ravel()[:6]) for seed in range(8)}) == 8
    for seed in range(8):
        frame, _ = textures.draw_frame(seed, SIZE)
        again, _ = textures.draw_frame(seed, SIZE)
        np.testing.assert_array_equal(frame.radiance.color, again.radiance.color)
        assert np.isfinite(frame.radiance.color).all()
        assert frame.radiance.color.min() >= 0.0
        if frame.half_a is not None:
            mean = 0.5 * (frame.half_a.color + frame.half_b.color)
            np.testing.assert_allclose(frame.radiance.color, mean, rtol=1e-6)
    rng, flat = np.random.default_rng(0), np.full((SIZE, SIZE, 3), 0.5, np.float32)
    for kind in textures.NOISES:
        noisy = textures.draw_noise(rng, flat, 0.2, kind)
        assert noisy.std() == pytest.approx(0.1, rel=0.1)
        assert noisy.mean() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("factor", [1, 3])
def test_drawn_textures_vary_between_0_and_1(factor: int) -> None:
    for draw in textures.TEXTURES:
        varies = 0
        for seed in range(5):
            rng = np.random.default_rng(seed)
            texture = draw(rng, textures.draw_coordinates(rng, SIZE * factor, factor))
            assert texture.shape == (SIZE * factor, SIZE * factor)
            assert 0.0 <= texture.min() <= texture.max() <= 1.0
            varies += texture.std() > 0.01
        # Stripes two pixels wide may have all pixels on one side.
        assert varies == 0 if draw is textures.draw_nothing else varies >= 3


def test_drawn_frames_become_candidates(tmp_path: Path) -> None:
    pytest.importorskip("pyoidn", reason="Open Image Denoise is not installed")
    textures.main(["--cache", str(tmp_path), "--count", "2", "--size", "48"])
    found = [read_candidates(path) for path in sorted(tmp_path.glob("*.npz"))]
    assert [(one.seed, one.spp, one.kind) for one in found] == [
        (textures.FIRST_SEED + k, 0, textures.DRAWN) for k in range(2)
    ]
    for one in found:
        np.testing.assert_array_equal(one.reference_a, one.reference_b)
        assert not np.array_equal(one.high, one.noisy)


def test_candidates_are_results_before_the_noisy_image_is_taken_back() -> None:
    pytest.importorskip("pyoidn", reason="Open Image Denoise is not installed")
    frame = check_guides(make_scene((32, 32))).frame
    images = denoise_all(frame)
    for quality in ("balanced", "high"):
        settings = resolve_all(frame, DenoiseSettings(quality=quality, with_oidn=False))
        found = filter_rows(frame, settings, (), mark_bad_pixels(frame))
        assert not np.array_equal(images[quality], found.image)
        np.testing.assert_array_equal(images[quality], (found.taken_from or found).image)
    assert not np.array_equal(images["balanced"], images["high"])
