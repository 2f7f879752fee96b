"""The bench of the frames that users have: scenes made ready, guide sets, cells, promises and the page."""

import subprocess
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.io.exr import write_frame, write_image
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.settings import QUALITY_NAMES

pytest.importorskip("mitsuba", reason="the bench shares modules with those that render")
pytest.importorskip("pyoidn", reason="the bench cleans its references with Open Image Denoise")
pytest.importorskip("flip_evaluator", reason="FLIP is one of the figures")
users, guides, measuring, methods, scenes, summary = (
    import_module(f"benchmarks.users.{part}")
    for part in ("__main__", "guides", "measuring", "methods", "scenes", "summary")
)
fetch, mending, interiors = (import_module(f"benchmarks.interiors.{part}") for part in ("fetch", "mending", "scenes"))
page = import_module("benchmarks.pages.users")

SIZE = 64
NOISE, REFERENCE_NOISE = 0.3, 0.2
# 64x64x3 squares of normal deviates have a mean that is off by 1.3 % on average; the references' noise adds as much.
SAMPLING = 0.06
# What is left of the product of the references' deviations, 0.2 each: 0.04 over the root of 12,288, thrice.
NOTHING = 1.1e-3
OLD_SCENE = """<scene version="0.6.0">
<default name="method" value="sppm"/>
<integrator type="$method"><integer name="maxDepth" value="65"/></integrator>
<sensor type="perspective"><sampler type="independent"/><film type="hdrfilm"><boolean name="banner" value="false"/></film></sensor>
<bsdf type="phong" id="floor"><float name="exponent" value="48"/>
 <texture name="diffuseReflectance" type="bitmap"><string name="filename" value="there.png"/><string name="filterType" value="trilinear"/></texture></bsdf>
<bsdf type="twosided" id="metal"><bsdf type="roughconductor"><float name="alpha" value="0.1"/><float name="extEta" value="1"/></bsdf></bsdf>
<bsdf type="ward" id="lamp"><spectrum name="diffuseReflectance" value="0"/><float name="alpha" value="0.4"/></bsdf>
<bsdf type="roughdiffuse" id="rough"><float name="alpha" value="0.4"/></bsdf>
<bsdf type="diffuse" id="rug"><texture name="reflectance" type="bitmap"><string name="filename" value="gone.png"/></texture></bsdf>
<shape type="rectangle"><ref id="floor"/></shape>
<shape type="obj"><string name="filename" value="gone.obj"/><ref id="metal"/></shape>
<emitter type="sunsky"><vector name="sunDirection" x="0" y="1" z="0"/><float name="sunRadiusScale" value="2"/></emitter>
</scene>"""  # noqa: E501


@pytest.fixture
def old_scene(tmp_path: Path, mi: Any) -> Path:
    """Return a scene file of Mitsuba 0.6 in a folder with one texture of the two that it names."""
    folder = tmp_path / "clone" / "scenes" / "room"
    folder.mkdir(parents=True)
    mi.Bitmap(np.full((4, 4, 3), 100, dtype=np.uint8)).write(str(folder / "there.png"))
    (folder / "scene.xml").write_text(OLD_SCENE)
    return folder / "scene.xml"


def test_an_old_scene_is_made_one_that_mitsuba_loads(old_scene: Path, mi: Any) -> None:
    target = old_scene.with_name("mended.xml")
    mending.mend_scene(old_scene, target, (12, 9), ["gone.obj", "gone.png"])
    scene = mi.load_file(str(target))
    assert list(scene.sensors()[0].film().size()) == [12, 9]
    assert len(scene.shapes()) == 1
    kinds = {bsdf.get("id"): bsdf for bsdf in ET.parse(target).getroot().iter("bsdf")}
    # The root of 2 over 48 + 2.
    assert kinds["floor"].find("float").attrib == {"name": "alpha", "value": "0.2"}
    assert kinds["rug"].find("rgb").get("value") == "0.5, 0.5, 0.5"
    # The older factor, 2, is of the sun's own width.
    assert f"Sun aperture = {2.0 * 0.5358:g}" in str(scene.environment())


def test_scenes_are_taken_out_of_a_clone(old_scene: Path, tmp_path: Path) -> None:
    repository = tmp_path / "clone"
    (old_scene.parent / "variation.xml").write_text("<scene/>")
    git = ["git", "-C", str(repository), "-c", "user.name=a", "-c", "user.email=a@b"]
    for step in (["init", "-q"], ["add", "."], ["commit", "-qm", "scenes"]):
        subprocess.run([*git, *step], check=True)
    commit = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()
    source = interiors.Source("public", str(repository), commit)
    interior = interiors.Interior("room", source, "scenes/room", (12, 9), "nobody's", without=("gone.obj", "gone.png"))
    for clones in ({}, {"public": repository}):
        cache = tmp_path / f"cache{len(clones)}"
        assert fetch.prepare(interior, cache, clones) == cache / "room" / fetch.SCENE
        there = sorted(path.name for path in (cache / "room").iterdir())
        assert there == ["mended.xml", "scene.xml", "there.png"]


def test_guide_sets_keep_what_they_say(full_frame: Frame) -> None:
    passes, plain, color = (guides.reduce_frame(full_frame, name) for name in ("passes", "plain", "color"))
    own = full_frame.gbuffer
    for reduced in (passes, plain, color):
        assert np.array_equal(reduced.radiance.color, full_frame.radiance.color)
        assert reduced.half_a is reduced.variance is reduced.spp is None
    assert np.array_equal(passes.radiance.specular, full_frame.radiance.specular)
    assert np.array_equal(passes.gbuffer.specular_albedo, own.specular_albedo)
    assert passes.gbuffer.alpha_u == pytest.approx(np.sqrt(own.alpha_u * own.alpha_v))
    assert passes.camera == full_frame.camera
    assert plain.radiance.specular is plain.gbuffer.alpha_u is plain.camera is None
    albedo = np.minimum(own.diffuse_albedo + own.specular_albedo, 1.0)
    # Reading keeps an albedo that light is divided by away from 0.
    assert np.corrcoef(plain.gbuffer.diffuse_albedo.ravel(), albedo.ravel())[0, 1] > 0.99
    length = np.linalg.norm(own.mean_normal, axis=-1, keepdims=True)
    assert plain.gbuffer.normal == pytest.approx(own.mean_normal / length, abs=1e-5)
    assert color.gbuffer.depth is color.gbuffer.diffuse_albedo is None
    assert guides.reduce_frame(full_frame, "all") is full_frame
    assert np.array_equal(guides.make_peer(full_frame).gbuffer.diffuse_albedo, albedo)
    alone = full_frame.with_changes(radiance=Radiance(full_frame.radiance.color), half_a=None, half_b=None)
    assert guides.reduce_frame(alone, "passes") is None


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """Return a folder with one interior of 4 samples and its references, whose noise is known."""
    random = np.random.default_rng(3)
    truth = np.ones((SIZE, SIZE, 3)) * np.linspace(0.5, 2.0, SIZE)[:, None]

    def add_noise(deviation: float) -> Any:
        return (truth * random.normal(1.0, deviation, truth.shape)).astype(np.float32)

    folder = tmp_path / scenes.INTERIORS
    folder.mkdir()
    for half in (1, 2):
        write_image(folder / f"room-ref-{half}.exr", add_noise(REFERENCE_NOISE))
    for spp, deviation in ((4, NOISE), (16, 0.5 * NOISE)):
        albedo = np.full((SIZE, SIZE, 3), 0.5, dtype=np.float32)
        normal = np.tile(np.float32([0.0, 0.0, 1.0]), (SIZE, SIZE, 1))
        known = GBuffer(normal=normal, depth=np.ones((SIZE, SIZE)), diffuse_albedo=albedo)
        camera = Camera(position=(0.0, 0.0, 1.0), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7, fov_x=0.7)
        write_frame(folder / f"room-{spp}.exr", Frame(Radiance(add_noise(deviation)), known, camera, spp=spp))
    return tmp_path


def test_cells_are_free_of_the_references_noise(frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (scene,) = scenes.list_scenes(frames)
    names = ["noisy", "fast", "oidn"]
    bench = users.Bench(tmp_path / "users.json")
    bench.measure_scene(scene, [4, 16], ["passes", "plain"], names)
    found = users.load(tmp_path / "users.json")["scenes"]["interiors/room"]["guides"]
    # Light is not told apart in this frame.
    assert list(found) == ["plain"]
    for spp, deviation in ((4, NOISE), (16, 0.5 * NOISE)):
        cells = found["plain"][str(spp)]["methods"]
        assert list(cells) == names
        assert cells["noisy"]["rel_mse"] == pytest.approx(deviation**2, rel=2 * SAMPLING)
        assert cells["noisy"]["energy"] == 1.0
        assert cells["noisy"]["doubt over noisy"] == 0.0
        # Of 4096 pixels: 2 d^2 v + v^2, where d is the noise of the frame and v that of the references; the mean over
        # the channels of a root is some percent less.
        expected = np.sqrt((2.0 * deviation**2 * REFERENCE_NOISE**2 + REFERENCE_NOISE**4) / SIZE**2)
        assert 0.6 * expected < cells["noisy"]["doubt"] < 1.1 * expected
        assert -NOTHING < cells["oidn"]["rel_mse"] < NOTHING
        assert 0.0 < cells["fast"]["rel_mse"] < 0.1 * cells["noisy"]["rel_mse"]
        assert cells["oidn"]["energy"] == pytest.approx(1.0, abs=0.02)
        assert cells["oidn"]["flip"] < cells["noisy"]["flip"]

    def refuse(*_: Any) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(users, "METHODS", dict.fromkeys(names, refuse))
    users.Bench(tmp_path / "users.json").measure_scene(scene, [4, 16], ["plain"], names)
    with pytest.raises(AssertionError, match="measured again"):
        users.Bench(tmp_path / "users.json", again=True).measure_scene(scene, [4], ["plain"], names)


def test_every_quality_has_a_column() -> None:
    assert {*QUALITY_NAMES, "auto"} <= set(users.METHODS)


def test_energy_and_error_tell_a_wrong_image(frames: Path) -> None:
    (scene,) = scenes.list_scenes(frames)
    first, second = scene.reference_images
    judge = measuring.make_reference_judge(first, second)
    truth = np.ones((SIZE, SIZE, 3), np.float32) * np.linspace(0.5, 2.0, SIZE, dtype=np.float32)[:, None]
    meter = measuring.Meter(judge, 0.5 * (first + second), truth)
    assert meter.measure(truth)["rel_mse"] == pytest.approx(0.0, abs=1e-3)
    off = meter.measure(1.1 * truth)
    assert off["energy"] == pytest.approx(1.1, abs=1e-4)
    # In numerator and denominator alike: with noisy squares below it would be 0.0102 and more.
    assert off["rel_mse"] == pytest.approx(0.01, rel=0.1)
    assert off["rel_mse"] > 3.0 * off["doubt"] > 0.0
    dotted = first.copy()
    dotted[20, 30] *= 50.0
    # One firefly of a reference is left out for all.
    assert measuring.make_reference_judge(dotted, second).measure(1.1 * truth)[0] == pytest.approx(0.01, rel=0.1)


def _make_cells(**errors: float) -> dict[str, Any]:
    return {
        name: {"rel_mse": error, "doubt": 0.005, "doubt over noisy": 0.001, "flip": 0.1, "energy": 1.0}
        for name, error in errors.items()
    }


@pytest.fixture
def measured() -> dict[str, Any]:
    """Return figures of three scenes, of which one is tuned on, with one broken promise of each kind."""
    errors = {
        "interiors/room": {"noisy": 0.2, "balanced": 0.1, "auto": 0.05, "oidn": 0.05},
        "own/street": {"noisy": 0.1, "balanced": 0.2, "auto": 0.06, "oidn": 0.05},
        "own/parlour": {"noisy": 1.0, "balanced": 0.5, "auto": 0.1, "oidn": -0.01},
    }
    found: dict[str, Any] = {
        name: {
            "held_out": name != "own/parlour",
            "size": [8, 8],
            "reference_error": 1e-3,
            "guides": {"plain": {"64": {"methods": _make_cells(**row), "skipped": {}}}},
        }
        for name, row in errors.items()
    }
    found["interiors/room"]["guides"]["plain"]["64"]["methods"]["balanced"]["energy"] = 0.9
    return found


def test_means_are_of_held_out_scenes_and_broken_promises_are_listed(measured: dict[str, Any]) -> None:
    found = summary.summarise(measured)
    over_noisy = found["ratios"]["held out"]["noisy"]["plain"]
    assert over_noisy["balanced"]["64"] == {"ratio": 1.0, "scenes": 2}
    assert over_noisy["auto"]["64"] == {"ratio": pytest.approx((0.25 * 0.6) ** 0.5, abs=1e-3), "scenes": 2}
    # An error that the references do not tell has no ratio.
    assert found["ratios"]["tuned on"]["oidn"] == {}
    assert [(one["scene"], one["method"], one["ratio"]) for one in found["over noisy"]] == [
        ("own/street", "balanced", 2.0)
    ]
    assert [(one["scene"], one["ratio"]) for one in found["over oidn"]] == [("own/street", 1.2)]
    assert found["energy"]["balanced"] == {
        "cells": 3,
        "off": 1,
        "least": [0.9, "interiors/room, plain, 64 spp"],
        "most": [1.0, "own/street, plain, 64 spp"],
    }


def test_random_shots_count_once_their_last_reference_is_there(tmp_path: Path) -> None:
    shot = tmp_path / "foreign" / "factory" / "fog_0"
    shot.mkdir(parents=True)
    for name in ("shot.json", "4.exr", "16.exr", "reference_1.exr", "reference_2.exr"):
        (shot / name).touch()
    assert scenes.list_scenes(tmp_path, tmp_path / "foreign") == []
    (shot / "reference_3.exr").touch()
    (found,) = scenes.list_scenes(tmp_path, tmp_path / "foreign")
    assert (found.key, list(found.frames), found.is_held_out) == ("factory/fog_0", [4, 16], True)


def make_random_shots() -> dict[str, Any]:
    """Return the figures of one shot of two kinds each; auto has half of the peer's error, then all of it."""

    def make_cell(error: float) -> dict[str, float]:
        figures = {"rel_mse": error, "without the worst": error, "doubt": 0.0, "energy": 1.0, "bright": 1, "dark": 2}
        return {**figures, "doubt over noisy": 0.0, "flip": 0.1}

    scenes = {}
    for name, auto in (("fog_0", 0.1), ("glass_bowl_1", 0.2)):
        errors = dict.fromkeys(page.TITLES, 0.4) | {"oidn": 0.2, "auto": auto}
        row = {"methods": {method: make_cell(error) for method, error in errors.items()}}
        guides = {each: {"16": row} for each in ("all", "plain", "color")}
        scenes[f"factory/{name}"] = {"held_out": True, "guides": guides}
    machine = {"processor": "a processor", "threads": 2, "commit": "abc"}
    return {"scenes": scenes, "summary": summary.summarise(scenes), "machine": machine}


def test_errors_on_random_shots_are_over_the_peer_s() -> None:
    shots = make_random_shots()
    table = page.make_shots(shots)
    assert "| all | `auto` | 0.71 | 0.71 | 1.00 | 0 | 2 | 4 | 1.000 to 1.000 |" in table
    assert "| all | noisy | 2.00 |" in table
    assert page.make_kinds(shots).splitlines()[0] == "| method | fog | glass_bowl |"
    assert page.make_kinds(shots).splitlines()[-2] == "| `auto` | 0.50 | 1.00 |"


def test_the_page_keeps_held_out_scenes_apart_and_lists_broken_promises(measured: dict[str, Any]) -> None:
    machine = {"processor": "a processor", "threads": 2, "commit": "abc"}
    tuning = {"64": {"normal_exponent": 16.0, "screen_sigma": 0.75}}
    data = {"scenes": measured, "summary": summary.summarise(measured), "tuning": tuning, "machine": machine}
    figures = page.make_figures(data, make_random_shots())
    assert "| plain | `balanced` | 1.00 |" in figures["held-out-over-noisy"]
    assert "| plain | `balanced` | 0.50 |" in figures["tuned-on-over-noisy"]
    assert "| own/street | plain | 64 | `balanced` | 2.00 |" in figures["promises"]
