"""The page as a user meets it, in a headless browser."""

from __future__ import annotations

import io
import os
import signal
from pathlib import Path

import numpy as np
import pytest

from lobewise.cli.main import run
from lobewise.denoising import denoise
from lobewise.io import read_frame, read_image
from tests.viewer.conftest import run_viewer

pytestmark = pytest.mark.nightly

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
CHEAP = {"similarity": "none", "adaptive": 0.0, "temporal": False, "filter_direct": False}
"""Settings whose kernels compile at once."""


@pytest.fixture(scope="module")
def floor_viewer(floor_file):
    """Return a viewer of the floor; its first look filters nothing."""
    with run_viewer(str(floor_file), is_frame=True, changes={"similarity": "none"}) as viewer:
        yield viewer


class TestFinishedFrame:
    def test_first_picture_with_controls(self, floor_viewer, visit):
        page = visit(floor_viewer)
        for label in ("Show", "Similarity", "Compare A, B", "Save"):
            page.page.get_by_text(label, exact=True).first.wait_for()
        picture = page.settle().astype(float)
        assert picture[:, : picture.shape[1] // 3].mean() > 1.5 * picture[:, -picture.shape[1] // 3 :].mean()

    def test_filtering_live(self, floor_viewer, visit):
        page = visit(floor_viewer)
        noisy = page.settle()
        assert not page.shows("Radius")
        page.choose("Similarity", "normal-aware")
        clean = page.settle_after(noisy, least=5.0)
        roughness = [np.abs(np.diff(image.astype(float), axis=1)).mean() for image in (noisy, clean)]
        assert roughness[1] < 0.6 * roughness[0]
        assert page.shows("Radius")
        assert page.shows("Normal exponent")
        assert not page.shows("Auto band-limit")
        assert not page.shows("Kernel")
        page.choose("Quality", "fast")
        clean = page.settle_after(clean, least=0.2)
        assert page.shows("Kernel")
        page.choose("Show", "weight sum")
        page.settle_after(clean)
        assert not page.shows("Exposure, stops")

    def test_wipe(self, floor_viewer, visit):
        page = visit(floor_viewer)
        noisy = page.settle().astype(float)
        page.tick("Compare A, B")
        wiped = page.settle_after(noisy).astype(float)
        # B filters: left of the line is what was there, right of it is smoother.
        edge = noisy.shape[1] // 2
        left, right = np.abs(wiped - noisy)[:, : edge - 60].mean(), np.abs(wiped - noisy)[:, edge + 60 :].mean()
        assert right > 3.0 * left
        page.slide("Line", "Home")
        all_right = page.settle_after(wiped)
        assert np.abs(all_right.astype(float) - noisy)[:, 60 : edge - 60].mean() > 3.0 * left

    def test_exposure_and_zoom(self, floor_viewer, visit):
        page = visit(floor_viewer)
        before = page.settle()
        page.slide("Exposure, stops", "ArrowRight", times=10)
        brighter = page.settle_after(before, least=5.0)
        assert brighter.mean() > before.mean()
        page.page.get_by_role("button", name="Auto exposure").click()
        exposed = page.settle_after(brighter, least=3.0)
        page.page.mouse.move(200, 300)
        page.page.mouse.wheel(0, -600)
        zoomed = page.settle_after(exposed, least=5.0)
        page.page.get_by_role("button", name="Show all").click()
        np.testing.assert_array_equal(page.settle_after(zoomed, least=5.0), exposed)

    def test_saving(self, floor_viewer, floor_file, visit, tmp_path):
        from PIL import Image

        page = visit(floor_viewer)
        name, data = page.save("PNG")
        assert name == "floor.png"
        assert Image.open(io.BytesIO(data)).size == (48, 32)
        before = page.settle()
        page.choose("Similarity", "normal-aware")
        page.settle_after(before, least=5.0)
        name, data = page.save("EXR")
        assert name == "floor-lobewise.exr"
        saved = tmp_path / name
        saved.write_bytes(data)
        expected = denoise(read_frame(floor_file), similarity="normal", quality="balanced").image
        np.testing.assert_allclose(read_image(saved), expected, rtol=1e-6)

    def test_a_file_of_blender(self, visit, tmp_path):
        source, written = FOREIGN / "blender_5.2_multipart.exr", tmp_path / "command.exr"
        assert run(["denoise", str(source), "-o", str(written), "--quality", "fast"]) == 0
        with run_viewer(str(source), is_frame=True, changes={"similarity": "none", "quality": "fast"}) as viewer:
            viewer.wait_until_open()
            page = visit(viewer)
            noisy = page.settle()
            assert len(np.unique(noisy)) > 50
            page.choose("Similarity", "auto")
            page.settle_after(noisy, least=0.5)
            _, data = page.save("EXR")
            assert data == written.read_bytes()
            page.choose("Show", "lobe sharpness")
            page.settle_after(noisy)
            page.close()

    def test_two_browsers_have_settings_of_their_own(self, floor_viewer, visit):
        first, second = visit(floor_viewer), visit(floor_viewer)
        first.wait(lambda: floor_viewer.statistics["browsers"] == 2, "two browsers")
        before = [page.settle() for page in (first, second)]
        first.choose("Show", "normals")
        first.settle_after(before[0], least=5.0)
        second.page.wait_for_timeout(300)
        np.testing.assert_array_equal(second.look(), before[1])

    def test_a_browser_that_goes_away_in_mid_frame(self, floor_viewer, visit):
        page = visit(floor_viewer)
        # Its kernel has to be compiled first.
        page.choose("Similarity", "single SG")
        page.close()
        other = visit(floor_viewer)
        other.wait(lambda: floor_viewer.statistics["browsers"] == 1, "the first browser to be forgotten")

    def test_a_renderer_that_dies_is_started_again(self, floor_viewer, visit):
        page = visit(floor_viewer)
        page.settle()
        before = floor_viewer.statistics
        os.kill(before["process"], signal.SIGKILL)
        page.wait(lambda: floor_viewer.statistics["restarts"] == before["restarts"] + 1, "a new process")
        page.page.get_by_text("was killed by signal 9 and was started again").first.wait_for()
        # Counted from before the kill: the new process may be quicker than the notification.
        page.wait_for_frames(1, since=before["frames"])
        assert floor_viewer.statistics["process"] != before["process"]

    def test_many_pictures_in_a_row(self, floor_viewer, visit):
        page = visit(floor_viewer)
        before = floor_viewer.statistics["restarts"]
        for frame in range(12):
            seen = floor_viewer.statistics["frames"]
            page.slide("Exposure, stops", "ArrowRight" if frame % 2 else "ArrowLeft")
            page.wait_for_frames(1, since=seen)
        assert page.closed_sockets == 0
        assert floor_viewer.statistics["restarts"] == before
        assert floor_viewer.statistics["memory"] > 0
