"""What a user adds where a file does not tell: presets and maps of their own, a second render, files beside it."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from renderers import WRITERS, make_scene, name, write

import lobewise
from lobewise.cli.program import run
from lobewise.interchange.reading import import_file
from lobewise.metrics import rel_mse

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
SEEDS = [FOREIGN / f"blender_4.5_seed{seed}.exr" for seed in (1, 2)]

PRESET = """
title = "House renderer"
color = ["beauty"]
normal = [{ pass = "n", convert = ["encoded"] }]
position = ["where"]
roughness = ["alpha"]
layer = [
    { name = "diffuse", lobe = "diffuse", light = ["lambert"], albedo = "paint" },
    { name = "specular", lobe = "glossy", light = ["shine"] },
]
"""


def write_house_file(path: Path) -> None:
    """Write the scene by names that no preset knows."""
    scene, written = make_scene(), WRITERS["mitsuba"](make_scene())
    written.attributes.clear()
    written.channels.clear()
    for head, image, letters in (
        ("beauty", scene.diffuse + scene.specular, "RGB"),
        ("lambert", scene.diffuse, "RGB"),
        ("shine", scene.specular, "RGB"),
        ("paint", scene.diffuse_albedo, "RGB"),
        ("n", 0.5 + 0.5 * scene.normal, "XYZ"),
        ("where", scene.position, "XYZ"),
        ("alpha", scene.roughness, "Y"),
    ):
        written.channels.update(name(head, image, letters))
    write(path, written)


def test_a_preset_of_the_users_own(tmp_path: Path) -> None:
    write_house_file(tmp_path / "a.exr")
    (tmp_path / "house.toml").write_text(PRESET)
    scene = make_scene()
    found = import_file(tmp_path / "a.exr", preset=tmp_path / "house.toml")
    frame = found.frame
    assert [layer.name for layer in frame.layers] == ["diffuse", "specular"]
    np.testing.assert_allclose(frame.gbuffer.normal[scene.surface], scene.normal[scene.surface], atol=1e-5)
    np.testing.assert_allclose(frame.gbuffer.alpha_u[scene.surface], scene.roughness[scene.surface], atol=1e-6)
    assert frame.camera is not None
    out = tmp_path / "b.exr"
    assert run(["denoise", str(tmp_path / "a.exr"), "-o", str(out), "--preset", str(tmp_path / "house.toml")]) == 0
    written = import_file(out, preset=tmp_path / "house.toml").frame
    assert not np.array_equal(written.radiance.color, frame.radiance.color)


def test_a_map_says_the_same(tmp_path: Path) -> None:
    write_house_file(tmp_path / "a.exr")
    mapping = {"color": "beauty", "normal": "n:encoded", "position": "where", "roughness": "alpha"}
    frame = lobewise.read_frame(tmp_path / "a.exr", mapping=mapping)
    scene = make_scene()
    np.testing.assert_allclose(frame.gbuffer.normal[scene.surface], scene.normal[scene.surface], atol=1e-5)
    command = ["inspect", str(tmp_path / "a.exr")]
    for role, text in mapping.items():
        command += ["--map", f"{role}={text}"]
    assert run(command) == 0


def test_a_second_render_is_the_other_half() -> None:
    found = import_file(SEEDS[0], half=SEEDS[1])
    one, other = (import_file(path).frame for path in SEEDS)
    frame = found.frame
    np.testing.assert_allclose(frame.radiance.color, 0.5 * (one.radiance.color + other.radiance.color), rtol=1e-5)
    np.testing.assert_array_equal(frame.half_a.color, one.radiance.color)
    np.testing.assert_array_equal(frame.half_b.color, other.radiance.color)
    assert frame.spp == 2 * one.spp
    for layer, mine, its in zip(frame.layers, one.layers, other.layers, strict=True):
        np.testing.assert_array_equal(layer.half_a, mine.radiance)
        np.testing.assert_array_equal(layer.half_b, its.radiance)
    assert any("halves" in note for note in found.notes)


@pytest.mark.nightly
def test_halves_go_through_the_command(tmp_path: Path) -> None:
    out = [tmp_path / "a.exr", tmp_path / "b.exr"]
    assert run(["denoise", str(SEEDS[0]), "--half", str(SEEDS[1]), "-o", str(out[0])]) == 0
    assert run(["denoise", str(SEEDS[0]), "-o", str(out[1])]) == 0
    both, alone, start = (lobewise.read_frame(path).radiance.color for path in (*out, SEEDS[0]))
    # Twice the samples: the result lies nearer to what it is made of than the noisy image does.
    assert 0.0 < rel_mse(both, alone) < rel_mse(start, both)


@pytest.fixture
def luxcore(tmp_path: Path) -> Path:
    """Return a folder with a file for each pass."""
    return Path(shutil.copytree(FOREIGN / "luxcore", tmp_path / "luxcore"))


def test_files_beside_it_are_its_passes(luxcore: Path) -> None:
    """Without them only the image is left."""
    whole = import_file(luxcore / "RGB.exr")
    assert whole.preset == "luxcore"
    assert whole.frame.gbuffer.alpha_u is not None or whole.frame.gbuffer.is_placed
    for path in luxcore.glob("*.exr"):
        if path.name != "RGB.exr":
            path.unlink()
    alone = import_file(luxcore / "RGB.exr")
    assert alone.preset == "generic"
    np.testing.assert_array_equal(alone.frame.radiance.color, whole.frame.radiance.color)
    assert not alone.frame.gbuffer.is_placed


@pytest.mark.parametrize("left_out", ["SHADING_NORMAL", "AVG_SHADING_NORMAL"])
def test_either_normal_of_luxcore_tells_its_files(left_out: str, luxcore: Path) -> None:
    """The pages name the averaged normals, and a scene that asks for those alone was not recognised."""
    (luxcore / f"{left_out}.exr").unlink()
    found = import_file(luxcore / "RGB.exr")
    assert found.preset == "luxcore"
    assert found.frame.gbuffer.normal is not None
    assert found.frame.layers


def test_a_damaged_file_beside_it_is_not_its_pass(luxcore: Path) -> None:
    other = sorted(path for path in luxcore.glob("*NORMAL*.exr"))[0]
    other.write_bytes(other.read_bytes()[:50])
    frame = import_file(luxcore / "RGB.exr").frame
    assert frame.radiance.color.shape == import_file(FOREIGN / "luxcore" / "RGB.exr").frame.radiance.color.shape


def test_alpha_tells_silhouettes_against_the_background(tmp_path: Path) -> None:
    scene, written = make_scene(), WRITERS["arnold"](make_scene())
    alpha = scene.surface.astype(np.float32)
    inside = np.argwhere(scene.surface & ~np.roll(scene.surface, 1, axis=0))
    row, column = next((row, column) for row, column in inside if row > 0)
    alpha[row - 1, column] = 0.25
    written.channels["A"] = alpha
    write(tmp_path / "a.exr", written)
    found = import_file(tmp_path / "a.exr")
    coverage = found.frame.gbuffer.coverage
    assert any("Silhouettes against the background" in note for note in found.notes), found.notes
    # Three quarters are the background that it stands for itself; the rest is what lies below, and perhaps beside, it.
    np.testing.assert_allclose(coverage[row - 1, column, 4], 0.75, atol=1e-5)
    np.testing.assert_allclose(coverage[row - 1, column].sum(), 1.0, atol=1e-5)
    assert coverage[row - 1, column, 7] > 0.0
    written.channels["A"] = np.ones_like(alpha)
    write(tmp_path / "b.exr", written)
    assert import_file(tmp_path / "b.exr").frame.gbuffer.coverage is None
