"""Light that no surface scattered: lamps out of focus, what is written back, and backgrounds that are no part."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.interchange import import_file
from lobewise.interchange.lighting import is_smooth
from tests.interchange.renderers import HEIGHT, WIDTH, Written, make_scene, name, read_channels, write, write_cycles

BLUR = 5.0
"""Radius, pixels, over which the lens blurs."""
LAYER = "View Layer.001"
LIGHT = ("Emit", "Env")
LAYERS = (("DiffCol", "DiffDir", "DiffInd"), ("GlossCol", "GlossDir", "GlossInd"))

pytestmark = pytest.mark.filterwarnings("ignore::lobewise.errors.UnusedGuideWarning")


def test_noise_beside_a_clean_background_is_seen() -> None:
    rng = np.random.default_rng(5)
    image = np.full((64, 64, 3), 0.3, np.float32)
    image[40:] *= rng.gamma(8.0, 0.125, (24, 64, 1)).astype(np.float32)
    image[36:] *= 3.0
    assert np.array_equal(image[:36], np.broadcast_to(image[0, 0], (36, 64, 3)))
    assert not is_smooth(image)
    # Lamps on black have edges at most of their pixels, and no noise.
    lamps = np.zeros((64, 64, 3), np.float32)
    lamps[3:10, 5:12] = 20.0
    lamps[30:50, 8:40] = 5.0
    assert is_smooth(lamps)


def add_lamp(written: Written, *, told: bool) -> np.ndarray:
    """Add a lamp out of focus, as sixteen samples of every pixel see it, to a file, and return its light.

    ``told`` blurs the positions around it as well: those of the file are where the first ray through the lens hits.
    """
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    away = np.hypot(y - 12.0, x - 14.0)
    rng = np.random.default_rng(2)
    seen = (rng.binomial(16, np.clip((7.5 - away) / 4.0, 0.0, 0.8)) / 16.0).astype(np.float32)
    emission = 20.0 * seen[..., None] * np.float32([1.0, 0.8, 0.5])
    for number, letter in enumerate("RGB"):
        written.channels[f"{LAYER}.Emit.{letter}"] = emission[..., number]
        written.channels[f"{LAYER}.Combined.{letter}"] = (
            written.channels[f"{LAYER}.Combined.{letter}"] + emission[..., number]
        )
    if told:
        spread = np.where(away < 10.0, BLUR * np.sqrt(rng.random(away.shape)), 0.0)
        turn = rng.uniform(0.0, 2.0 * np.pi, away.shape)
        rows = np.rint(y + spread * np.sin(turn)).astype(int).clip(0, HEIGHT - 1)
        columns = np.rint(x + spread * np.cos(turn)).astype(int).clip(0, WIDTH - 1)
        for letter in "XYZ":
            written.channels[f"{LAYER}.Position.{letter}"] = written.channels[f"{LAYER}.Position.{letter}"][
                rows, columns
            ]
    return emission


def get(pixels: dict[str, np.ndarray], which: str) -> np.ndarray:
    return np.stack([pixels[f"{LAYER}.{which}.{letter}"] for letter in "RGB"], axis=-1)


def denoise(source: Path, target: Path, **settings: Any) -> dict[str, np.ndarray]:
    frame = lobewise.read_frame(source)
    lobewise.write_result(target, lobewise.denoise(frame, **settings), source=source)
    return read_channels(target)


@pytest.mark.parametrize("quality", ["balanced", pytest.param("high", marks=pytest.mark.nightly)])
def test_a_lamp_out_of_focus_is_shared_out_and_layers_still_add_up(quality: str, tmp_path: Path) -> None:
    written = write_cycles(make_scene())
    emission = add_lamp(written, told=True)
    write(tmp_path / "a.exr", written)
    found = import_file(tmp_path / "a.exr").frame
    assert list(found.unscattered) == ["emission", "environment"]
    after = denoise(tmp_path / "a.exr", tmp_path / "b.exr", quality=quality)
    emitted = get(after, "Emit")
    assert np.abs(emitted - emission).max() > 1.0
    total = sum((get(after, kind) for kind in LIGHT), np.zeros_like(emitted))
    for albedo, *parts in LAYERS:
        total = total + get(after, albedo) * sum(get(after, part) for part in parts)
    np.testing.assert_allclose(total, get(after, "Combined"), rtol=1e-3, atol=1e-3)
    # What a rim hands out goes by the luminance of all passes together.
    before = read_channels(tmp_path / "a.exr")
    sums = [sum(get(one, kind).sum() for kind in LIGHT) for one in (before, after)]
    assert sums[1] == pytest.approx(sums[0], rel=0.01)


@pytest.mark.parametrize(("quality", "told"), [("fast", True), ("balanced", False)])
def test_else_it_passes_as_it_is(quality: str, told: bool, tmp_path: Path) -> None:
    """The quality fast knows no noise, and a lamp in focus is sharp."""
    written = write_cycles(make_scene())
    emission = add_lamp(written, told=told)
    write(tmp_path / "a.exr", written)
    after = denoise(tmp_path / "a.exr", tmp_path / "b.exr", quality=quality)
    np.testing.assert_array_equal(get(after, "Emit"), emission)


@pytest.mark.parametrize(("fog", "noise"), [(True, True), (True, False), (False, True)])
def test_a_background_is_noisy_where_fog_hides_some_of_its_samples(fog: bool, noise: bool, tmp_path: Path) -> None:
    scene, rng = make_scene(), np.random.default_rng(7)
    written = write_cycles(scene)
    share = rng.binomial(16, 0.4, (HEIGHT, WIDTH, 1)) / np.float32(16.0) if noise else np.float32(0.4)
    background = (share * np.float32([0.3, 0.5, 0.9]) * np.ones((HEIGHT, WIDTH, 1))).astype(np.float32)
    light = np.full((HEIGHT, WIDTH, 3), 0.2 if fog else 0.0, np.float32)
    written.channels |= name(f"{LAYER}.VolumeDir", light) | name(f"{LAYER}.VolumeInd", np.zeros_like(light))
    written.channels |= name(f"{LAYER}.Env", background)
    written.channels |= name(f"{LAYER}.Combined", scene.color - scene.emission + background + light)
    write(tmp_path / "a.exr", written)
    frame = import_file(tmp_path / "a.exr").frame
    layers = {layer.name: layer.lobe for layer in frame.layers}
    assert (layers.get("environment") == "volume") == (fog and noise)
    assert ("environment" in frame.unscattered) != (fog and noise)
    if fog and noise:
        after = denoise(tmp_path / "a.exr", tmp_path / "b.exr", quality="fast")
        assert get(after, "Env")[..., 0].std() < 0.5 * background[..., 0].std()


def test_a_background_that_the_image_does_not_show_is_no_part_of_it(tmp_path: Path) -> None:
    """Film > Transparent: the pass holds the background, the image does not."""
    scene = make_scene()
    written = write_cycles(scene)
    shown = scene.color - scene.emission
    written.channels |= name(f"{LAYER}.Combined", shown)
    write(tmp_path / "a.exr", written)
    found = import_file(tmp_path / "a.exr")
    assert [layer.name for layer in found.frame.layers] == ["diffuse", "glossy"]
    assert not found.frame.unscattered
    assert any("Env.R/G/B holds more light than the image has beside the layers" in note for note in found.notes)
    after = denoise(tmp_path / "a.exr", tmp_path / "b.exr")
    np.testing.assert_array_equal(get(after, "Env"), scene.emission)
    assert np.abs(get(after, "Combined") - shown).max() > 0.01


def test_the_blur_is_found_where_it_is(tmp_path: Path) -> None:
    scene = make_scene()
    written = write_cycles(scene)
    add_lamp(written, told=True)
    write(tmp_path / "a.exr", written)
    surface, radius = scene.surface, lobewise.read_frame(tmp_path / "a.exr").gbuffer.blur_radius
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    away = np.hypot(y - 12.0, x - 14.0)
    assert np.median(radius[surface & (away < 8.0)]) == pytest.approx(BLUR, rel=0.15)
    assert np.nanmax(radius[away > 12.0]) < 0.1


def test_halves_are_joined(tmp_path: Path) -> None:
    images = []
    for seed, path in enumerate((tmp_path / "a.exr", tmp_path / "b.exr")):
        written = write_cycles(make_scene())
        emission = add_lamp(written, told=True) * np.float32(1.0 + 0.1 * seed)
        for number, letter in enumerate("RGB"):
            written.channels[f"{LAYER}.Combined.{letter}"] += 0.1 * seed * emission[..., number] / (1.0 + 0.1 * seed)
        written.channels |= name(f"{LAYER}.Emit", emission)
        write(path, written)
        images.append(emission)
    frame = lobewise.read_frame(tmp_path / "a.exr", half=tmp_path / "b.exr")
    np.testing.assert_allclose(frame.unscattered["emission"], 0.5 * (images[0] + images[1]), rtol=1e-6)
