"""A finished frame behind the page, without a page."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lobewise.camera import Camera
from lobewise.cli.main import run
from lobewise.denoising import denoise
from lobewise.errors import FileError, InputError
from lobewise.frame import Frame, GBuffer, Radiance
from lobewise.interchange import read_frame as read_any
from lobewise.io import read_frame, read_image, read_sparse_frame, write_frame, write_sparse_frame
from lobewise.sparse_frame import make_sparse
from lobewise.upsampling import upsample
from lobewise.viewer.frames import FrameTarget
from lobewise.viewer.looks import FrameLook, name_sides
from lobewise.viewer.messages import FrameReading, Request, Window

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
RENDERED = ("blender_4.5_seed1.exr", "blender_5.2_multipart.exr", "luxcore/RGB.exr")
NORMAL = FrameLook(similarity="normal", quality="fast", radius=2, form="separable")


def ask(look: FrameLook, other: FrameLook | None = None, client: int = 0) -> Request:
    return Request(client, 1, Window(8, 8), look, other)


class TestWholeFrames:
    def test_what_it_allows(self, floor_file):
        found = FrameTarget(str(floor_file)).describe()
        assert (found.width, found.height, found.camera, found.sparse) == (48, 32, None, False)
        assert found.similarities[0] == "auto"
        assert (found.qualities, found.look.quality) == (("auto", "fast", "balanced", "high"), "balanced")
        assert found.hit_distance
        assert set(found.views) > {"image", "noisy", "specular", "sharpness", "weight_sum", "hit_distance", "normal"}

    def test_color_alone_is_filtered_too(self, tmp_path, rng):
        path = tmp_path / "plain.exr"
        write_frame(path, Frame(Radiance(rng.random((4, 5, 3)))))
        target = FrameTarget(str(path))
        found = target.describe()
        assert found.similarities == ("normal", "none")
        assert found.look.similarity == "normal"
        assert found.views == ("image", "noisy", "weight_sum", "effective_samples")
        look = replace(found.look, quality="fast")
        expected = denoise(read_frame(path), similarity="normal", quality="fast")
        np.testing.assert_array_equal(target.render(ask(look, look))[0].image, expected.image)

    def test_it_is_filtered_as_asked(self, floor_file):
        target = FrameTarget(str(floor_file))
        shot, other = target.render(ask(NORMAL, FrameLook(similarity="none")))
        expected = denoise(read_frame(floor_file), similarity="normal", radius=2, form="separable")
        np.testing.assert_array_equal(shot.image, expected.image)
        np.testing.assert_array_equal(other.image, read_frame(floor_file).radiance.color)
        weight = shot.get_view("weight_sum")
        np.testing.assert_allclose(weight, expected.weight_sum / (1.0 + expected.weight_sum), rtol=1e-6)

    @pytest.mark.nightly
    def test_a_quality_is_filtered_as_asked(self, floor_file):
        looks = [FrameLook(similarity="normal", quality=quality, radius=2) for quality in ("fast", "balanced")]
        shots = FrameTarget(str(floor_file)).render(ask(*looks))
        for look, shot in zip(looks, shots, strict=True):
            expected = denoise(read_frame(floor_file), similarity="normal", quality=look.quality, radius=2)
            np.testing.assert_array_equal(shot.image, expected.image)
        assert not np.allclose(shots[0].image, shots[1].image, rtol=0.01)
        assert name_sides(*looks) == ("A: fast", "B: balanced")

    def test_what_was_filtered_once_is_there(self, floor_file):
        target = FrameTarget(str(floor_file))
        assert target.is_slow(ask(NORMAL))
        first = target.render(ask(NORMAL))[0]
        assert not target.is_slow(ask(NORMAL, client=5))
        assert target.render(ask(NORMAL, client=5))[0].image is first.image

    def test_few_results_are_kept(self, floor_file):
        target = FrameTarget(str(floor_file))
        looks = [replace(NORMAL, normal_exponent=8.0 + step) for step in range(12)]
        for look in looks:
            target.render(ask(look))
        assert target.is_slow(ask(looks[0]))
        assert not target.is_slow(ask(looks[-1]))

    def test_every_view_is_an_image(self, floor_file):
        target = FrameTarget(str(floor_file))
        shot = target.render(ask(NORMAL))[0]
        for view in target.describe().views:
            values = shot.get_view(view)
            assert values.shape[:2] == (32, 48), view
            assert np.isfinite(values).all()
            if values.ndim == 2:
                assert values.min() >= 0.0
                assert values.max() <= 1.0

    def test_sharp_lobes_are_bright(self, floor_frame, tmp_path):
        alpha = np.where(np.arange(48) < 24, 0.5, 0.05) * np.ones((32, 1))
        path = tmp_path / "two.exr"
        write_frame(path, floor_frame.with_changes(gbuffer=replace(floor_frame.gbuffer, alpha_u=alpha)), half=False)
        shown = FrameTarget(str(path)).render(ask(FrameLook(similarity="none")))[0].get_view("sharpness")
        assert shown[:, 24:].min() > shown[:, :24].max() + 0.1

    def test_hit_distance_as_a_share(self, floor_file, floor_frame):
        shown = FrameTarget(str(floor_file)).render(ask(NORMAL))[0].get_view("hit_distance")
        depth = np.asarray(floor_frame.gbuffer.depth)
        np.testing.assert_allclose(shown, 2.0 / (2.0 + depth), rtol=1e-5)

    def test_saving_what_is_seen(self, floor_file, tmp_path):
        target = FrameTarget(str(floor_file))
        shot = target.render(ask(NORMAL, client=3))[0]
        for client, expected in ((3, shot.image), (4, read_image(floor_file))):
            np.testing.assert_allclose(read_image(target.write(client, tmp_path)), expected, rtol=1e-6)
        target.forget(3)

    def test_a_missing_file(self, tmp_path):
        with pytest.raises(FileError, match="no such file"):
            FrameTarget(str(tmp_path / "none.exr"))


class TestFramesOfOtherRenderers:
    @pytest.mark.sampled("blender_4.5_seed1.exr")
    @pytest.mark.parametrize("name", RENDERED)
    def test_they_are_read_filtered_and_saved_as_by_denoise(self, name, tmp_path):
        source, written = FOREIGN / name, tmp_path / "command.exr"
        assert run(["denoise", str(source), "-o", str(written), "--quality", "fast"]) == 0
        target = FrameTarget(str(source))
        found = target.describe()
        assert found.notes[0].startswith("Read as ")
        assert {"diffuse", "specular", "normal"} < set(found.views)
        shot = target.render(ask(replace(found.look, quality="fast")))[0]
        np.testing.assert_array_equal(shot.image, denoise(read_any(source), quality="fast").image)
        assert target.write(0, tmp_path).read_bytes() == written.read_bytes()

    def test_options_say_what_a_file_does_not(self, floor_file):
        plain = FrameTarget(str(FOREIGN / RENDERED[0])).describe()
        assert "sharpness" in plain.views
        # Read as its own image alone, there is nothing that tells lobes.
        reading = FrameReading(preset="generic", mapping={"color": "Combined"})
        found = FrameTarget(str(FOREIGN / RENDERED[0]), reading).describe()
        assert "an unknown renderer" in found.notes[0]
        camera = Camera((0.0, 1.0, 4.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 0.5)
        looks = [FrameTarget(str(floor_file), FrameReading(camera=one)) for one in (None, camera)]
        one, other = (target.render(ask(FrameLook(quality="fast")))[0].image for target in looks)
        np.testing.assert_array_equal(other, denoise(read_any(floor_file, camera=camera), quality="fast").image)
        assert not np.array_equal(one, other)


def test_they_are_shown_where_mitsuba_is_not_installed(floor_file):
    code = f"""
import sys
sys.modules["mitsuba"] = sys.modules["drjit"] = None
from lobewise.viewer.frames import FrameTarget
print(FrameTarget({str(floor_file)!r}).describe().width)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "48\n"), done.stderr


class TestSparseFrames:
    @pytest.fixture
    def sparse_file(self, floor_frame, tmp_path):
        path = tmp_path / "sparse.exr"
        write_sparse_frame(path, make_sparse(floor_frame, 4, (1, 2)), half=False)
        return path

    def test_it_is_upsampled(self, sparse_file):
        target = FrameTarget(str(sparse_file))
        found = target.describe()
        assert (found.sparse, found.forms, found.width) == (True, ("full",), 48)
        assert (found.qualities, found.look.quality) == (("fast",), "fast")
        shot = target.render(ask(FrameLook(similarity="normal", quality="fast", radius=2)))[0]
        expected = upsample(read_sparse_frame(sparse_file), similarity="normal", radius=2)
        np.testing.assert_array_equal(shot.image, expected.image)

    def test_it_tells_itself_how_it_is_read(self, sparse_file):
        with pytest.raises(InputError, match=r"--preset.*sparse\.exr', which was shaded sparsely"):
            FrameTarget(str(sparse_file), FrameReading(preset="cycles"))

    def test_unfiltered_each_sample_fills_its_block(self, sparse_file, floor_frame):
        shot = FrameTarget(str(sparse_file)).render(ask(FrameLook(similarity="none")))[0]
        color = np.asarray(floor_frame.radiance.color)
        np.testing.assert_array_equal(shot.image[1::4, 2::4], color[1::4, 2::4])
        np.testing.assert_array_equal(shot.image[4, 5], color[1, 2])


def test_gbuffers_without_roughness_compare_normals(tmp_path, rng):
    path = tmp_path / "normals.exr"
    normal = np.broadcast_to([0.0, 0.0, 1.0], (6, 7, 3))
    write_frame(path, Frame(Radiance(rng.random((6, 7, 3))), GBuffer(normal=normal)))
    found = FrameTarget(str(path)).describe()
    assert found.similarities == ("normal", "none")
    assert "sharpness" not in found.views
