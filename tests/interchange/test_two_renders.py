"""Two renders are joined only if they show one frame, and each counts by the noise that it has."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from renderers import WRITERS, Written, make_scene, write

import lobewise
from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.interchange import import_file
from lobewise.interchange.checks.renders import compare_noise, measure_moved, measure_relit
from lobewise.interchange.joining import join_halves
from lobewise.metrics import rel_mse
from lobewise.records.frame import GBuffer

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
SEEDS = FOREIGN / "blender_4.5_seed1.exr", FOREIGN / "blender_4.5_seed2.exr"
SAMPLES = 64 / 4


def change_guides(gbuffer: GBuffer, change: object) -> GBuffer:
    return replace(gbuffer, **{name: change(name, getattr(gbuffer, name)) for name in gbuffer.names})


def test_a_render_of_few_samples_does_not_harm_one_of_many(field_folder: Path, tmp_path: Path) -> None:
    many, few = field_folder / "half_64spp.exr", field_folder / "half_4spp.exr"
    out = {"alone": [], "joined": ["--half", str(few)]}
    errors = {}
    for name, options in out.items():
        target = tmp_path / f"{name}.exr"
        assert run(["denoise", str(many), *options, "-o", str(target)]) == 0
        errors[name] = rel_mse(lobewise.read_frame(target).radiance.color, np.load(field_folder / "half_ref.npy"))
    assert errors["joined"] <= errors["alone"]


def test_the_order_of_unequal_renders_does_not_matter(field_folder: Path) -> None:
    many, few = field_folder / "half_64spp.exr", field_folder / "half_4spp.exr"
    first, second = import_file(many, half=few), import_file(few, half=many)
    np.testing.assert_allclose(first.frame.radiance.color, second.frame.radiance.color, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(first.frame.gbuffer.normal, second.frame.gbuffer.normal)
    assert first.frame.half_a is None
    assert 0.5 * SAMPLES < compare_noise(import_file(few).frame, import_file(many).frame) < 2.0 * SAMPLES
    assert any("times the noise of the first" in note for note in first.notes)


def test_renders_that_tell_their_samples_count_by_them() -> None:
    one, other = (import_file(path, light_passes=True) for path in SEEDS)
    longer = replace(other, frame=other.frame.with_changes(spp=3 * one.frame.spp))
    joined = join_halves(one, longer)
    for get in (lambda frame: frame.radiance.color, lambda frame: frame.layers[0].radiance):
        expected = 0.25 * get(one.frame) + 0.75 * get(other.frame)
        np.testing.assert_allclose(get(joined.frame), expected, rtol=1e-5, atol=1e-6)
    assert joined.frame.spp == 4 * one.frame.spp
    # Halves of unequal noise would be taken for halves of the samples.
    assert joined.frame.half_a is None
    assert all(layer.half_a is None for layer in joined.frame.layers)
    assert "The second render has 24 samples per pixel beside 8, and counts for 75 % of the light." in joined.notes


def test_halves_of_unequal_renders_are_joined_by_half() -> None:
    one, other = (import_file(path) for path in SEEDS)
    light = one.frame.radiance, other.frame.radiance
    halves = [each.frame.with_changes(half_a=light[0], half_b=light[1]) for each in (one, other)]
    longer = replace(other, frame=halves[1].with_changes(spp=3 * one.frame.spp))
    joined = join_halves(replace(one, frame=halves[0]), longer).frame
    np.testing.assert_allclose(joined.half_a.color, light[0].color, rtol=1e-5)
    np.testing.assert_allclose(joined.half_b.color, light[1].color, rtol=1e-5)


@pytest.mark.parametrize("name", ["cycles", "mitsuba", "arnold"])
def test_another_place_is_refused(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = WRITERS[name](make_scene())
    moved = {channel: np.roll(plane, 4, axis=1) for channel, plane in written.channels.items()}
    paths = tmp_path / "first.exr", tmp_path / "next.exr"
    for path, channels in zip(paths, (written.channels, moved), strict=True):
        write(path, Written(written.preset, channels, written.attributes))
    assert run(["denoise", str(paths[0]), "--half", str(paths[1]), "-o", str(tmp_path / "out.exr")]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "expected the same frame rendered again, with another seed, got other surfaces in" in told
    assert not (tmp_path / "out.exr").exists()


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
@pytest.mark.parametrize("strength", [0.02, 0.3, 1.0])
def test_guides_that_are_noise_move_nothing(share: float, strength: float, rng: np.random.Generator) -> None:
    """As those of hair, of fog and of what a lens or motion blurs."""

    def add_noise(name: str, image: np.ndarray) -> np.ndarray:
        scale = image.std() if name in ("position", "depth") else 1.0
        noise = rng.normal(0.0, strength * scale, image.shape)
        where = rng.random(image.shape[:2]) < share
        return (image + noise * (where[..., None] if image.ndim == 3 else where)).astype(np.float32)

    one, other = (change_guides(import_file(path).frame.gbuffer, add_noise) for path in SEEDS)
    assert measure_moved(one, other)[0] == 0.0


def test_an_object_that_moves_is_found() -> None:
    one, other = (import_file(path).frame.gbuffer for path in SEEDS)

    def move(name: str, image: np.ndarray) -> np.ndarray:
        moved, part = image.copy(), (slice(10, 22), slice(10, 26))
        moved[part] = np.roll(image, (5, 5), (0, 1))[part]
        return moved

    assert measure_moved(one, other)[0] == 0.0
    assert 0.005 < measure_moved(one, change_guides(other, move))[0] < 0.3


def test_refusal_says_by_what(rng: np.random.Generator) -> None:
    one, other = (import_file(path) for path in SEEDS)
    moved = change_guides(other.frame.gbuffer, lambda name, image: np.roll(image, 6, axis=1))
    with pytest.raises(InputError, match=r"by the (positions|normals|albedos)"):
        join_halves(one, replace(other, frame=other.frame.with_changes(gbuffer=moved)))


def render(truth: np.ndarray, samples: int, rng: np.random.Generator, *, chance: float) -> np.ndarray:
    """Return light of which each sample finds all or nothing."""
    hits = rng.binomial(samples, chance, truth.shape[:2]) / (samples * chance)
    return (truth * hits[..., None]).astype(np.float32)


@pytest.mark.parametrize("chance", [0.5, 0.1, 0.02])
@pytest.mark.parametrize("samples", [(1, 1), (1, 1024), (4, 64)])
def test_noise_is_no_other_light(
    chance: float, samples: tuple[int, int], rng: np.random.Generator, field_folder: Path
) -> None:
    truth = np.load(field_folder / "half_ref.npy")
    one, other = (render(truth, count, rng, chance=chance) for count in samples)
    assert measure_relit(one, other) == 0.0


def test_light_of_another_time_is_refused_without_any_guide(field_folder: Path) -> None:
    many, few = (import_file(field_folder / f"half_{count}spp.exr") for count in (64, 4))
    bare = [replace(one, frame=one.frame.with_changes(gbuffer=GBuffer())) for one in (many, few)]
    assert join_halves(*bare).frame.half_a is None
    moved = bare[1].frame.radiance
    for color in (np.roll(moved.color, 12, axis=1), 2.0 * moved.color):
        frame = bare[1].frame.with_changes(radiance=replace(moved, color=color))
        with pytest.raises(InputError, match="other light than noise explains, in"):
            join_halves(bare[0], replace(bare[1], frame=frame))


def test_seeds_of_real_renders_have_the_same_light() -> None:
    one, other = (import_file(path).frame.radiance.color for path in SEEDS)
    assert measure_relit(one, other) == 0.0
    assert measure_relit(one, np.roll(other, 20, axis=1)) > 0.0
