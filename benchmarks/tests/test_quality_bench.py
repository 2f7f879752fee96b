"""The bench of quality: which pixel is of which class, references in pieces, means of ratios, goals, and its page."""

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.display.tones import choose_exposure, map_tones
from lobewise.metrics import EPSILON, rel_mse
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, LobeKind, Radiance

quality: Any = None
quality_frames: Any = None
quality_methods: Any = None
quality_summary: Any = None
quality_page: Any = None
stats: Any = None


@pytest.fixture(scope="module", autouse=True)
def bench() -> None:
    """Import the bench, which needs Mitsuba and SciPy, when a test runs and not when it is collected."""
    pytest.importorskip("mitsuba", reason="the bench renders its frames: pip install 'lobewise[mitsuba]'")
    pytest.importorskip("scipy", reason="the bench blurs with SciPy: pip install 'lobewise[fit]'")
    parts = {"quality": "measure", **{f"quality_{name}": name for name in ("frames", "methods", "summary")}}
    globals().update({name: import_module(f"benchmarks.quality.{part}") for name, part in parts.items()})
    globals().update(stats=import_module("scipy.stats"), quality_page=import_module("benchmarks.pages.quality"))


HEIGHT, WIDTH = 40, 48
# Four chunks estimate a variance with a deviation of 0.8 of it per value; 3 x 1000 values bring that to 1.5 %.
CHUNK_TOLERANCE = 0.06


def make_wall(**changes: Any) -> Frame:
    """Return a frame that shows a metal wall of alpha 0.1, seen head-on; ``changes`` replace guides."""
    camera = Camera(position=(0.0, 0.0, 0.0), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.8)
    rays = camera.make_ray_directions(WIDTH, HEIGHT)
    plane = np.ones((HEIGHT, WIDTH), dtype=np.float32)
    color = np.ones((HEIGHT, WIDTH, 3), dtype=np.float32)
    guides: dict[str, Any] = {
        "depth": 3.0 / -rays[..., 2],
        "normal": np.broadcast_to((0.0, 0.0, 1.0), color.shape),
        "alpha_u": 0.1 * plane,
        "alpha_v": 0.1 * plane,
        "lobe_kind": float(LobeKind.GGX) * plane,
        "diffuse_albedo": 0.0 * color,
        "specular_albedo": 0.8 * color,
    }
    radiance = Radiance(color=color, diffuse=0.6 * color, specular=0.4 * color)
    return Frame(radiance=radiance, gbuffer=GBuffer(**{**guides, **changes}), camera=camera, spp=64)


def fill(left: float, right: float) -> FloatArray:
    """Return an image of two halves."""
    image = np.full((HEIGHT, WIDTH), left, dtype=np.float32)
    image[:, WIDTH // 2 :] = right
    return image


def list_classes(frame: Frame) -> set[str]:
    """Return the classes that hold all pixels of the frame but silhouettes."""
    masks = quality_frames.classify_pixels(frame)
    inside = ~masks["silhouette"]
    return {kind for kind, mask in masks.items() if kind != "silhouette" and (mask == inside).all()}


@pytest.mark.parametrize(
    ("alphas", "kinds"),
    [
        ((0.3, 0.3), {"rough"}),
        ((0.25, 0.25), {"glossy"}),
        ((0.07, 0.07), {"glossy"}),
        ((0.06, 0.06), {"near-mirror"}),
        ((0.0, 0.0), {"near-mirror"}),
        ((0.1, 0.13), {"glossy"}),
        ((0.14, 0.1), {"glossy", "anisotropic"}),
        ((0.02, 0.5), {"glossy", "anisotropic"}),
    ],
)
def test_metals_go_by_their_alphas(alphas: tuple[float, float], kinds: set[str]) -> None:
    # Half-way values are stored as 32-bit floats, as frames hold them.
    alpha = [np.full((HEIGHT, WIDTH), value, dtype=np.float32) * (1.0 - 1e-6) for value in alphas]
    frame = make_wall(alpha_u=alpha[0], alpha_v=alpha[1])
    assert list_classes(frame) == kinds
    assert not quality_frames.classify_pixels(frame)["silhouette"].any()


def test_coated_pixels_go_by_what_carries_their_radiance() -> None:
    color = np.ones((HEIGHT, WIDTH, 3), dtype=np.float32)
    coated = make_wall(diffuse_albedo=0.5 * color, specular_albedo=0.05 * color)
    assert list_classes(coated) == {"glossy"}
    for share, kinds in ((0.31, {"glossy"}), (0.29, {"diffuse"})):
        radiance = Radiance(color=color, diffuse=(1.0 - share) * color, specular=share * color)
        assert list_classes(coated.with_changes(radiance=radiance)) == kinds
    # A lobe of less than a twentieth of the albedo is none, whatever it shows.
    assert list_classes(make_wall(diffuse_albedo=0.5 * color, specular_albedo=0.02 * color)) == {"diffuse"}
    assert list_classes(make_wall(lobe_kind=0.0 * color[..., 0], diffuse_albedo=0.5 * color)) == {"diffuse"}
    emitter = make_wall(specular_albedo=0.0 * color)
    assert not any(mask.any() for mask in quality_frames.classify_pixels(emitter).values())


@pytest.mark.parametrize("guide", ["depth", "normal", "alpha_u", "lobe_kind", "material", "background"])
def test_silhouettes_are_the_two_columns_at_a_step(guide: str) -> None:
    wall = make_wall()
    depth, normal = wall.gbuffer.depth, wall.gbuffer.normal
    assert normal is not None
    tilted = np.where(fill(0.0, 1.0)[..., None] > 0.0, np.array([0.8, 0.0, 0.6]), normal)
    changes: dict[str, Any] = {
        "depth": depth * fill(1.0, 1.3),
        "normal": tilted,
        "alpha_u": 0.1 * fill(1.0, 2.5),
        "lobe_kind": fill(1.0, 2.0),
        "material": fill(0.0, 0.0),
        "background": depth * fill(1.0, 0.0),
    }
    name = "depth" if guide == "background" else guide
    edge = quality_frames.mark_silhouettes(make_wall(**{name: changes[guide]}))
    expected = np.zeros((HEIGHT, WIDTH), dtype=bool)
    if guide != "material":
        expected[:, WIDTH // 2 - 1 : WIDTH // 2 + 1] = True
    np.testing.assert_array_equal(edge, expected)


def test_a_corner_has_all_eight_neighbours() -> None:
    kind = np.ones((HEIGHT, WIDTH), dtype=np.float32)
    kind[10, 20] = 2.0
    edge = quality_frames.mark_silhouettes(make_wall(lobe_kind=kind))
    expected = np.zeros((HEIGHT, WIDTH), dtype=bool)
    expected[9:12, 19:22] = True
    np.testing.assert_array_equal(edge, expected)


def test_a_floor_seen_at_a_glance_is_no_silhouette() -> None:
    camera = Camera(position=(0.0, 1.0, 0.0), forward=(0.0, -0.35, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.6)
    rays = camera.make_ray_directions(WIDTH, HEIGHT)
    depth = 1.0 / np.maximum(-rays[..., 1], 0.02)
    assert depth[:, 0].max() > 2.0 * depth[:, 0].min()
    floor = make_wall(depth=depth, normal=np.broadcast_to((0.0, 1.0, 0.0), rays.shape)).with_changes(camera=camera)
    assert not quality_frames.mark_silhouettes(floor).any()


def test_pixels_that_saw_other_normals_are_silhouettes() -> None:
    wall = make_wall()
    mean = np.array(wall.gbuffer.normal)
    mean[5, 6] = 0.85 * mean[5, 6]
    mean[7, 8] = 0.95 * mean[7, 8]
    edge = quality_frames.mark_silhouettes(wall.with_changes(gbuffer=replace(wall.gbuffer, mean_normal=mean)))
    assert np.argwhere(edge).tolist() == [[5, 6]]


def test_chunks_tell_the_error_of_their_mean(rng: np.random.Generator) -> None:
    truth = rng.uniform(0.1, 2.0, (25, 40, 3))
    chunks = [(truth + rng.normal(0.0, 0.05, truth.shape)).astype(np.float32) for _ in range(quality_frames.CHUNKS)]
    mean, error = quality_frames.average_chunks(chunks)
    np.testing.assert_allclose(mean, np.sum(chunks, axis=0) / 4.0, rtol=1e-6)
    assert error == pytest.approx(np.mean(0.05**2 / 4.0 / (truth**2 + EPSILON)), rel=0.15)
    assert error == pytest.approx(rel_mse(mean, truth), rel=0.15)
    # Where all pixels have one truth the estimate is sharper.
    flat = [rng.normal(1.0, 0.05, (25, 40, 3)).astype(np.float32) for _ in range(4)]
    expected = 0.05**2 / 4.0 / (1.0 + EPSILON)
    assert quality_frames.average_chunks(flat)[1] == pytest.approx(expected, rel=CHUNK_TOLERANCE)


def test_an_interrupted_reference_goes_on(tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []

    def render(spp: int, seed: int) -> FloatArray:
        if len(calls) == 2:
            calls.append((0, 0))
            raise KeyboardInterrupt
        calls.append((spp, seed))
        return np.full((4, 5, 3), float(seed - quality_frames.REFERENCE_SEED), dtype=np.float32)

    with pytest.raises(KeyboardInterrupt):
        quality_frames.make_reference(tmp_path, "room-reference-64", 64, render)
    reference, error = quality_frames.make_reference(tmp_path, "room-reference-64", 64, render)
    assert [call for call in calls if call[0]] == [(16, 1000 + k) for k in range(4)]
    np.testing.assert_allclose(reference, 1.5, rtol=1e-6)
    # The variance of 0, 1, 2, 3 is 5/3, that of their mean a fourth of it.
    assert error == pytest.approx(5.0 / 12.0 / (1.5**2 + EPSILON))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room-reference-64.exr", "room-reference-64.json"]
    again, _ = quality_frames.make_reference(tmp_path, "room-reference-64", 64, lambda *_: pytest.fail("rendered anew"))
    np.testing.assert_array_equal(again, reference)


def test_ssim_is_that_of_its_authors_formula(rng: np.random.Generator) -> None:
    reference = rng.uniform(0.05, 1.0, (16, 18, 3)).astype(np.float32)
    image = np.maximum(reference + rng.normal(0.0, 0.1, reference.shape), 0.0).astype(np.float32)
    exposure = choose_exposure(reference)
    x, y = (map_tones(each, exposure) @ np.array([0.2126, 0.7152, 0.0722]) / 255.0 for each in (image, reference))
    place = np.arange(-5, 6)
    window = np.exp(-(place[:, None] ** 2 + place[None, :] ** 2) / (2.0 * 1.5**2))
    window /= window.sum()
    values = []
    for row in range(6):
        for column in range(8):
            a, b = (each[row : row + 11, column : column + 11] for each in (x, y))
            mean_a, mean_b = (window * a).sum(), (window * b).sum()
            variances = (window * (a - mean_a) ** 2).sum() + (window * (b - mean_b) ** 2).sum()
            covariance = (window * (a - mean_a) * (b - mean_b)).sum()
            ratio = (2.0 * mean_a * mean_b + 1e-4) * (2.0 * covariance + 9e-4)
            values.append(ratio / ((mean_a**2 + mean_b**2 + 1e-4) * (variances + 9e-4)))
    assert quality.compute_ssim(image, reference) == pytest.approx(np.mean(values), abs=1e-9)
    assert quality.compute_ssim(reference, reference) == pytest.approx(1.0, abs=1e-12)


def make_results(rng: np.random.Generator) -> dict[str, Any]:
    """Return results of every method on every scene, with one class that only a scene of each part shows."""
    scenes: dict[str, Any] = {}
    for scene in (*quality_summary.TRAIN, *quality_summary.HELD_OUT):
        kinds = [kind for kind in quality_summary.CLASSES if kind != "anisotropic" or scene in ("showroom", "brushed")]
        scenes[scene] = {"reference_rel_mse": 1e-4, "classes": dict.fromkeys(kinds, 0.2), "samples": {}}
        for spp in ("1", "4", "16", "64"):
            scenes[scene]["samples"][spp] = {
                name: {
                    "commit": "abc",
                    **{key: {kind: rng.uniform(0.1, 1.0, 3).tolist() for kind in kinds} for key in quality.METRICS},
                    "ssim": [0.8, 0.9, 0.7],
                    "flip": [0.2],
                }
                for name in quality_methods.METHODS
            }
    return scenes


def make_data(rng: np.random.Generator, tmp_path: Path) -> dict[str, Any]:
    """Return all that the JSON holds, made up."""
    data = quality.load(tmp_path / "none.json", quality_frames.Bench(tmp_path))
    data["scenes"] = make_results(rng)
    times = {name: 10.0 * (k + 1) for k, name in enumerate(quality_methods.METHODS)}
    row = {"spp": 1, "milliseconds": times, "over oidn": dict.fromkeys(times, 0.5)}
    data["speed"] = {quality_summary.WIDE: row}
    settings = {"normal_exponent": 64.0, "screen_sigma": 2.0}
    data["tuning"] = {spp: {"settings": settings, "rel_mse": 0.1, "commit": "def"} for spp in ("1", "4", "16", "64")}
    return data


def test_ratios_are_geometric_means(rng: np.random.Generator, tmp_path: Path) -> None:
    data = make_data(rng, tmp_path)
    scenes = data["scenes"]

    def take(name: str, kind: str, used: tuple[str, ...]) -> Any:
        return np.concatenate([scenes[scene]["samples"]["16"][name]["rel_mse"][kind] for scene in used])

    ratios = quality_summary.summarise(data)["ratios"]
    for part, used in quality_summary.PARTS.items():
        found = ratios[part]["oidn"]["high"]["glossy"]["16"]
        expected = stats.gmean(take("high", "glossy", used) / take("oidn", "glossy", used))
        assert found == {"ratio": pytest.approx(expected, abs=1e-4), "scenes": 4}
        one = used[:1]
        found = ratios[part]["single SG"]["balanced"]["anisotropic"]["16"]
        expected = stats.gmean(take("balanced", "anisotropic", one) / take("single SG", "anisotropic", one))
        assert found == {"ratio": pytest.approx(expected, abs=1e-4), "scenes": 1}
        assert "oidn" not in ratios[part]["oidn"]
    # A method that was not measured on a scene yet is compared on the others.
    del scenes["kitchen"]["samples"]["16"]["high"]
    found = quality_summary.compute_ratios(data, quality_summary.HELD_OUT, "high", "oidn", "all")
    assert [found[spp]["scenes"] for spp in ("4", "16")] == [4, 3]


def test_goals_are_judged_by_their_limits(rng: np.random.Generator, tmp_path: Path) -> None:
    data = make_data(rng, tmp_path)
    assert len(quality_summary.check_goals({}, {})) == 16
    assert all(set(goal["met"].values()) == {None} for goal in quality_summary.check_goals({}, {}))
    for scene in data["scenes"].values():
        for methods in scene["samples"].values():
            methods["high"]["rel_mse"]["all"] = (1.3 * np.array(methods["oidn"]["rel_mse"]["all"])).tolist()
    goals = {goal["goal"]: goal for goal in quality_summary.summarise(data)["goals"]}
    for spp, met in (("4", True), ("16", True), ("64", False)):
        assert set(goals[f"error of high over oidn, all pixels, {spp} spp"]["met"].values()) == {met}
    # Times are 10 ms times the place in the list of methods: balanced is the fifth, single SG the third.
    time = goals["time of balanced over single SG, 1920x1080"]
    assert time["values"] == {"time": pytest.approx(5.0 / 3.0, abs=1e-3)}
    assert time["met"] == {"time": True}
    lines = quality_summary.make_lines(quality_summary.summarise(data))
    assert any("all pixels, 64 spp <= 1.2: train 1.300 missed, held out 1.300 missed" in line for line in lines)


def test_results_survive_the_file(rng: np.random.Generator, tmp_path: Path) -> None:
    data, path = make_data(rng, tmp_path), tmp_path / "quality.json"
    quality.save(path, data)
    again = quality.load(path, quality_frames.Bench(tmp_path))
    assert json.dumps(again) == json.dumps(data)
    assert all("]" in line for line in path.read_text().splitlines() if '"flip": [' in line or '"glossy": [' in line)


def test_page_shows_every_part(rng: np.random.Generator, tmp_path: Path) -> None:
    data = make_data(rng, tmp_path)
    data = {**data, "machine": {"processor": "CPU", "threads": 2}, "summary": quality_summary.summarise(data)}
    figures = quality_page.make_figures(data)
    page = "\n".join(figures.values())
    ratio = data["summary"]["ratios"]["held out"]["oidn"]["high"]["all"]["16"]["ratio"]
    goal = next(line for line in page.splitlines() if "error of high over oidn, all pixels, 16 spp" in line)
    assert f"held out {ratio:.2f}" in goal
    cell = np.mean(data["scenes"]["street"]["samples"]["64"]["noisy"]["rel_mse"]["all"])
    assert f"| street | 64 | {cell:.4f} |" in page
    assert "None" not in page
    assert "nan" not in page
    assert "not measured" not in page
    # Before anything is measured the tables are empty, and nothing fails.
    empty = {**quality.load(tmp_path / "none.json", quality_frames.Bench(tmp_path)), "machine": data["machine"]}
    empty["skipped"] = {"high": "for a reason"}
    figures = quality_page.make_figures({**empty, "summary": quality_summary.summarise(empty)})
    assert "not measured: for a reason" in figures["commits"]


class StubBench:
    """A bench whose frames are made of random numbers about a reference."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.reference = rng.uniform(0.2, 1.0, (HEIGHT, WIDTH, 3)).astype(np.float32)

    def fetch(self, scene: str, spp: int, seed: int) -> Frame:
        noise = np.random.default_rng([spp, seed]).normal(0.0, 0.1, self.reference.shape)
        color = np.maximum(self.reference + noise, 0.0)
        radiance = Radiance(color=color, diffuse=0.5 * color, specular=0.5 * color)
        return make_wall().with_changes(radiance=radiance, spp=spp)

    def fetch_reference(self, scene: str) -> tuple[FloatArray, float]:
        return self.reference, 1.23456e-4


def test_one_method_again_keeps_the_rows_of_others(rng: np.random.Generator, tmp_path: Path) -> None:
    bench: Any = StubBench(rng)
    path = tmp_path / "quality.json"
    data = quality.load(path, quality_frames.Bench(tmp_path))
    others = {name: {"commit": "old", "rel_mse": {"all": [0.1, 0.1, 0.1]}} for name in ("oidn", "single SG")}
    data["scenes"]["brushed"] = {"samples": {"4": dict(others)}}
    quality.run_scene(bench, data, "brushed", [4], ["noisy"], path)
    scene = json.loads(path.read_text())["scenes"]["brushed"]
    rows = scene["samples"]["4"]
    assert list(rows) == ["noisy", "single SG", "oidn"]
    assert {name: rows[name] for name in others} == others
    images = [bench.fetch("brushed", 4, seed).radiance.color for seed in quality_frames.SEEDS]
    for kind in ("all", "glossy"):
        errors = [rel_mse(image, bench.reference) for image in images]
        assert rows["noisy"]["rel_mse"][kind] == pytest.approx(errors, rel=1e-3)
    assert rows["noisy"]["commit"]
    assert len(rows["noisy"]["flip"]) <= 1
    assert scene["classes"] == {"all": 1.0, "glossy": 1.0}
    assert scene["reference_rel_mse"] == 1.235e-4
    # After an interruption only what is missing is measured: here the next sample count.
    data["scenes"]["brushed"]["samples"]["4"]["noisy"]["commit"] = "kept"
    quality.run_scene(bench, data, "brushed", [4, 16], ["noisy"], path, missing=True)
    samples = json.loads(path.read_text())["scenes"]["brushed"]["samples"]
    assert samples["4"]["noisy"]["commit"] == "kept"
    assert list(samples["16"]) == ["noisy"]


def test_what_cannot_run_is_left_out_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quality_methods, "has_oidn", lambda: False)
    monkeypatch.setitem(quality.METHODS, "dream", quality_methods.Method(lambda frame, _: frame, ("lucid",)))
    names, skipped = quality.choose_methods(None, {})
    assert names[0] == "noisy"
    assert skipped["dream"] == "denoise has no setting lucid"
    assert skipped["oidn fast"] == "Open Image Denoise is not installed"
    assert "--tune" in skipped["normal-aware"]
    assert not set(names) & set(skipped)
    tuned = {str(spp): {} for spp in quality_frames.SAMPLES}
    assert quality.choose_methods(["normal-aware", "oidn"], tuned)[0] == ["normal-aware"]


def test_methods_are_timed_in_turn(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    for name in ("single SG", "oidn"):
        method = quality_methods.Method(lambda frame, _, name=name: calls.append(name))  # type: ignore[misc]
        monkeypatch.setitem(quality.METHODS, name, method)
    row = quality.time_methods(make_wall(), ["single SG", "oidn"], {})
    assert calls == ["single SG", "oidn"] * (1 + quality.TIMED_RUNS)
    assert set(row["milliseconds"]) == {"single SG", "oidn"}
    assert row["over single SG"]["single SG"] == 1.0


def test_tuning_finds_the_least_mean_error(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    bench: Any = StubBench(rng)

    def pretend(frame: Frame, tuning: Any) -> FloatArray:
        settings = tuning["4"]["settings"]
        off = abs(settings["normal_exponent"] - 64.0) / 64.0 + abs(settings["screen_sigma"] - 1.5)
        return np.asarray(bench.reference + 0.1 + off, dtype=np.float32)

    monkeypatch.setattr(quality_methods, "_run_normal", pretend)
    best = quality_methods.tune(bench, ("showroom", "parlour"), (4,))
    assert best["4"]["settings"] == {"normal_exponent": 64.0, "screen_sigma": 1.5}
    assert best["4"]["rel_mse"] == pytest.approx(rel_mse(bench.reference + np.float32(0.1), bench.reference), rel=1e-4)
