"""A finished frame behind the page, without a page."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.cli.program import run
from lobewise.denoising import denoise
from lobewise.errors import FileError, InputError
from lobewise.interchange import read_frame as read_any
from lobewise.interchange import read_image
from lobewise.io import read_frame, read_sparse_frame, write_frame, write_sparse_frame
from lobewise.recipes.upsampling import DEFAULT_RADIUS, upsample
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import make_sparse
from lobewise.settings import DenoiseSettings
from lobewise.viewer import frame_target
from lobewise.viewer.frame_target import CONTROLS, FrameTarget
from lobewise.viewer.messages import FrameReading
from lobewise.viewer.pictures import RADIANCE, paint
from tests.mistakes import refuses
from tests.pythons import run_python

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
RENDERED = ("blender_4.5_seed1.exr", "blender_5.2_multipart.exr", "luxcore/RGB.exr")
NORMAL = DenoiseSettings(similarity="normal", quality="fast", radius=2, form="separable")


def list_controls(target: FrameTarget) -> dict[str, dict[str, Any]]:
    return {control["name"]: control for control in target.describe()["controls"]}


def show(target: FrameTarget, image: Any) -> np.ndarray:
    """Return an image as the page gets it."""
    return np.asarray(np.asarray(image) * np.float32(2.0**target.stops), np.float16)


class TestWholeFrames:
    def test_what_it_allows(self, floor_file):
        target = FrameTarget(str(floor_file))
        found, controls = target.describe(), list_controls(target)
        assert (found["name"], found["width"], found["height"]) == ("floor", 48, 32)
        assert tuple(controls) == CONTROLS
        assert controls["similarity"]["words"][0] == controls["similarity"]["default"] == "auto"
        assert controls["quality"]["words"] == ("auto", "fast", "balanced", "high", "best")
        assert controls["quality"]["default"] == "auto"
        assert list(found["pictures"])[:2] == ["noisy", "image"]
        assert set(found["pictures"]) > {"specular", "sharpness", "weight_sum", "hit_distance", "normal", "albedo"}
        assert "reference" not in found["pictures"]

    def test_what_has_no_effect_has_no_control(self, floor_file):
        when = {name: control["when"] for name, control in list_controls(FrameTarget(str(floor_file))).items()}
        assert when["form"] == {"quality": ["fast"]}
        assert when["radius"] == {"form": ["full", "separable"]}
        assert when["normal_exponent"] == {"similarity": ["normal"]}
        assert set(when["tau"]["similarity"]) == {"auto", "sg", "sg_mixture", "ggx"}

    @pytest.mark.parametrize(
        "values", [{"radius": "x"}, {"lobes": 2}, {"tau": [1]}, {"form": "atrous", "quality": "high"}]
    )
    def test_settings_that_the_page_does_not_have(self, values, floor_file):
        with pytest.raises(InputError):
            FrameTarget(str(floor_file)).make_settings(values)

    def test_color_alone_is_filtered_too(self, tmp_path, rng):
        path = tmp_path / "plain.exr"
        write_frame(path, Frame(Radiance(rng.random((4, 5, 3)))))
        target = FrameTarget(str(path))
        controls = list_controls(target)
        assert "similarity" not in controls
        assert controls["normal_exponent"]["when"] == {"similarity": ["normal", "auto"]}
        assert list(target.describe()["pictures"]) == ["noisy", "image", "weight_sum", "effective_samples"]
        expected = denoise(read_frame(path), quality="fast")
        np.testing.assert_array_equal(
            target.paint("image", target.make_settings({"quality": "fast"})), show(target, expected.image)
        )

    def test_it_is_filtered_as_asked(self, floor_file):
        target = FrameTarget(str(floor_file))
        expected = denoise(read_frame(floor_file), similarity="normal", radius=2, form="separable")
        np.testing.assert_array_equal(target.paint("image", NORMAL), show(target, expected.image))
        np.testing.assert_array_equal(
            target.paint("noisy", NORMAL), show(target, read_frame(floor_file).radiance.color)
        )
        weight = expected.weight_sum / (1.0 + expected.weight_sum)
        np.testing.assert_array_equal(target.paint("weight_sum", NORMAL), paint("weight_sum", weight, 1.0))

    def test_few_results_are_kept(self, floor_file, monkeypatch):
        calls: list[DenoiseSettings] = []
        filtered = frame_target.denoise_quietly

        def count(frame: Frame, settings: DenoiseSettings) -> Any:
            calls.append(settings)
            return filtered(frame, settings)

        monkeypatch.setattr(frame_target, "denoise_quietly", count)
        target = FrameTarget(str(floor_file))
        many = [replace(NORMAL, normal_exponent=8.0 + step) for step in range(12)]
        for settings in [*many, many[-1], many[0]]:
            target.paint("image", settings)
        assert calls == [*many, many[0]]

    def test_every_picture_has_the_size(self, floor_file):
        target = FrameTarget(str(floor_file))
        for name in target.describe()["pictures"]:
            picture = target.paint(name, NORMAL)
            assert picture.shape == (32, 48, 3), name
            assert picture.dtype == (np.float16 if name in RADIANCE else np.uint8)
            assert np.isfinite(picture).all()

    def test_sharp_lobes_are_bright(self, floor_frame, tmp_path):
        alpha = np.where(np.arange(48) < 24, 0.5, 0.05) * np.ones((32, 1))
        path = tmp_path / "two.exr"
        write_frame(path, floor_frame.with_changes(gbuffer=replace(floor_frame.gbuffer, alpha_u=alpha)), half=False)
        shown = FrameTarget(str(path)).paint("sharpness", NORMAL).astype(float).sum(axis=-1)
        assert shown[:, 24:].min() > shown[:, :24].max() + 30

    def test_hit_distance_as_a_share(self, floor_file, floor_frame):
        depth = np.asarray(floor_frame.gbuffer.depth, np.float32)
        expected = paint("hit_distance", 2.0 / (2.0 + depth), 1.0).astype(int)
        shown = FrameTarget(str(floor_file)).paint("hit_distance", NORMAL)
        assert np.abs(shown - expected).max() <= 4

    def test_values_of_a_pixel(self, floor_file, floor_frame):
        reference = str(floor_file)
        target = FrameTarget(str(floor_file), reference=reference)
        values = dict(target.list_values(5, 9, NORMAL))
        color = "  ".join(f"{value:.4g}" for value in floor_frame.radiance.color[9, 5])
        assert values["noisy"] == values["reference"] == color
        assert (values["specular light"], values["normal"]) == (color, "0  1  0")
        assert (values["alpha u"], values["hit distance"]) == ("0.2", "2")
        assert "denoised" not in values
        target.paint("image", NORMAL)
        result = denoise(read_frame(floor_file), similarity="normal", radius=2, form="separable").image[9, 5]
        assert dict(target.list_values(5, 9, NORMAL))["denoised"] == "  ".join(f"{value:.4g}" for value in result)
        assert target.list_values(48, 0, NORMAL) == []

    def test_a_reference_has_the_size(self, floor_file, tmp_path, rng):
        path = tmp_path / "small.exr"
        write_frame(path, Frame(Radiance(rng.random((4, 5, 3)))))
        with refuses(InputError, "--reference", "'small.exr' with 5x4", "the size of the frame, 48x32 pixels"):
            FrameTarget(str(floor_file), reference=str(path))
        target = FrameTarget(str(path), reference=str(path))
        np.testing.assert_array_equal(target.paint("reference", NORMAL), target.paint("noisy", NORMAL))

    def test_saving(self, floor_file, tmp_path):
        expected = denoise(read_frame(floor_file), similarity="normal", radius=2, form="separable").image
        saved = FrameTarget(str(floor_file)).write(NORMAL, tmp_path)
        assert saved.name == "floor-lobewise.exr"
        np.testing.assert_allclose(read_image(saved), expected, rtol=1e-6)

    def test_a_missing_file(self, tmp_path):
        with refuses(FileError, "input 'none.exr'"):
            FrameTarget(str(tmp_path / "none.exr"))


class TestFramesOfOtherRenderers:
    @pytest.mark.sampled("blender_4.5_seed1.exr")
    @pytest.mark.parametrize("name", RENDERED)
    def test_they_are_read_filtered_and_saved_as_by_denoise(self, name, tmp_path):
        source, written = FOREIGN / name, tmp_path / "command.exr"
        assert run(["denoise", str(source), "-o", str(written), "--quality", "fast"]) == 0
        target = FrameTarget(str(source))
        assert target.notes[0].startswith("Read as ")
        assert {"diffuse", "specular", "normal"} < set(target.describe()["pictures"])
        fast = DenoiseSettings(quality="fast")
        expected = denoise(read_any(source), quality="fast").image
        np.testing.assert_array_equal(target.paint("image", fast), show(target, expected))
        assert target.write(fast, tmp_path).read_bytes() == written.read_bytes()

    def test_options_say_what_a_file_does_not(self, floor_file):
        plain = FrameTarget(str(FOREIGN / RENDERED[0]))
        assert "sharpness" in plain.describe()["pictures"]
        # Read as its own image alone, there is nothing that tells lobes.
        reading = FrameReading(preset="generic", mapping={"color": "Combined"})
        found = FrameTarget(str(FOREIGN / RENDERED[0]), reading)
        assert "an unknown renderer" in found.notes[0]
        own = read_any(floor_file).require_camera("a test")
        camera = replace(own, fov_y=1.02 * own.fov_y)
        targets = [FrameTarget(str(floor_file), FrameReading(camera=one)) for one in (None, camera)]
        one, other = (target.paint("image", DenoiseSettings(quality="fast")) for target in targets)
        expected = denoise(read_any(floor_file, camera=camera), quality="fast").image
        np.testing.assert_array_equal(other, show(targets[1], expected))
        assert not np.array_equal(one, other)


def test_they_are_shown_where_mitsuba_is_not_installed(floor_file):
    code = f"""
import sys
sys.modules["mitsuba"] = sys.modules["drjit"] = sys.modules["viser"] = None
from lobewise.viewer.frame_target import FrameTarget
print(FrameTarget({str(floor_file)!r}).describe()["width"])
"""
    assert run_python("-c", code) == "48\n"


class TestSparseFrames:
    @pytest.fixture
    def sparse_file(self, floor_frame, tmp_path):
        path = tmp_path / "sparse.exr"
        write_sparse_frame(path, make_sparse(floor_frame, 4, (1, 2)), half=False)
        return path

    def test_it_is_upsampled(self, sparse_file):
        target = FrameTarget(str(sparse_file))
        assert not {"quality", "form"} & set(list_controls(target))
        settings = target.make_settings({"similarity": "normal"})
        assert (settings.quality, settings.radius) == ("fast", DEFAULT_RADIUS)
        expected = upsample(read_sparse_frame(sparse_file), similarity="normal")
        np.testing.assert_array_equal(target.paint("image", settings), show(target, expected.image))

    def test_it_tells_itself_how_it_is_read(self, sparse_file):
        with refuses(InputError, "--preset, --map, --camera, --half and --wrap"):
            FrameTarget(str(sparse_file), FrameReading(preset="cycles"))

    def test_unfiltered_each_sample_fills_its_block(self, sparse_file, floor_frame):
        target = FrameTarget(str(sparse_file))
        shown, color = target.paint("noisy", NORMAL), show(target, floor_frame.radiance.color)
        np.testing.assert_array_equal(shown[1::4, 2::4], color[1::4, 2::4])
        np.testing.assert_array_equal(shown[4, 5], color[1, 2])


def test_gbuffers_without_roughness_compare_normals(tmp_path, rng):
    path = tmp_path / "normals.exr"
    normal = np.broadcast_to([0.0, 0.0, 1.0], (6, 7, 3))
    write_frame(path, Frame(Radiance(rng.random((6, 7, 3))), GBuffer(normal=normal)))
    target = FrameTarget(str(path))
    assert "similarity" not in list_controls(target)
    assert "sharpness" not in target.describe()["pictures"]
