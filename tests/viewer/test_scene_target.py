"""A scene in the page: it is rendered while a browser looks at it."""

import io
import os
import signal

import numpy as np
import pytest

from lobewise.io import read_frame
from lobewise.scenes import BY_THEMSELVES
from tests.viewer.conftest import compare, run_viewer

pytestmark = [pytest.mark.nightly, pytest.mark.mitsuba]

CHEAP = {"similarity": "none", "adaptive": 0.0, "temporal": False, "filter_direct": False, "scale": 8}
"""Settings whose kernels are few."""
SIZE = (96, 64)
BLOCK = 48
"""Pixels of the page over which noise is averaged before pictures are compared."""
NOISE = 12.0
"""Codes by which the means of blocks differ from one moment to the next while nothing moves, and a margin."""


@pytest.fixture(scope="module")
def showroom_viewer(mi):
    """Return a viewer of the showroom, small and unfiltered; skip where Mitsuba cannot run."""
    with run_viewer("showroom", size=SIZE, changes=CHEAP) as viewer:
        yield viewer


def drag(page, steps, pixels=6):
    """Drag the camera; wait for a picture after every step."""
    page.page.mouse.move(150, 300)
    page.page.mouse.down()
    for step in range(1, steps + 1):
        seen = page.viewer.statistics["frames"]
        # To and fro, so that the camera sees the room all along.
        offset = 16 - abs(16 - step % 32)
        page.page.mouse.move(150 + pixels * offset, 300 + offset)
        page.wait_for_frames(1, since=seen)
    page.page.mouse.up()


def has_line(picture, place):
    """Return whether the wipe's line is at that share of the width."""
    column = picture[:, round(place * picture.shape[1])].astype(float).mean(axis=0)
    return column[0] > 150.0 and column[0] - column[2] > 60.0


def locate(viewer):
    """Return where the first browser's camera is."""
    return np.array(viewer.statistics["eyes"][0])


def arrive(visit, viewer):
    """Return a page whose window has its final shape and whose picture is calm."""
    page = visit(viewer)
    page.page.get_by_text("Similarity", exact=True).first.wait_for()
    page.page.wait_for_timeout(300)
    seen = viewer.statistics["frames"]
    page.wait_for_frames(8, since=seen)
    return page


class TestScene:
    def test_it_is_there_and_comes_to_rest(self, showroom_viewer, visit):
        page = arrive(visit, showroom_viewer)
        page.wait(lambda: showroom_viewer.statistics["accumulated"][0] > 8, "frames to be averaged")
        page.page.get_by_text("averaged").first.wait_for()
        assert page.look().std() > 20.0
        width, height = showroom_viewer.statistics["size"][0]
        # As many pixels as asked for, at the aspect of the window.
        assert width * height == pytest.approx(SIZE[0] * SIZE[1], rel=0.15)
        canvas = page.page.locator("canvas").first.bounding_box()
        assert width / height == pytest.approx(canvas["width"] / canvas["height"], rel=0.12)

    def test_orbit_and_fly_and_reset(self, showroom_viewer, visit):
        page = arrive(visit, showroom_viewer)
        start, first = locate(showroom_viewer), page.look()
        drag(page, 6)
        orbited = locate(showroom_viewer)
        assert np.linalg.norm(orbited - start) > 0.3
        second = page.wait_for_change(first, least=NOISE, block=BLOCK)
        page.page.keyboard.down("w")
        page.wait(lambda: np.linalg.norm(locate(showroom_viewer) - orbited) > 1.0, "the camera to fly")
        page.page.keyboard.up("w")
        page.wait_for_change(second, least=NOISE, block=BLOCK)
        page.page.get_by_role("button", name="Reset camera").click()
        page.wait(lambda: np.linalg.norm(locate(showroom_viewer) - start) < 1e-3, "the camera to be back")
        page.wait(lambda: compare(page.look(), first, BLOCK) < NOISE, "the first view")

    def test_methods_views_and_wipe(self, showroom_viewer, visit):
        page = arrive(visit, showroom_viewer)
        image = page.look()
        page.choose("Show", "normals")
        normals = page.wait_for_change(image, least=10.0, block=BLOCK)
        page.choose("Show", "indirect light")
        page.wait_for_change(normals, least=10.0, block=BLOCK)
        for method in ("voxel cones", "virtual lights"):
            seen = showroom_viewer.statistics["frames"]
            page.choose("Method", method)
            page.wait_for_frames(2, since=seen)
            assert not page.page.get_by_text("went wrong").is_visible()
        page.choose("Show", "image")
        page.tick("Compare A, B")
        page.page.get_by_text("Line", exact=True).wait_for()
        page.choose("Method", "paths", side=1)
        page.wait(lambda: has_line(page.look(), 0.5), "the line")
        page.slide("Line", "Home")
        page.wait(lambda: not has_line(page.look(), 0.5), "the line to move")

    def test_saving(self, showroom_viewer, visit, tmp_path):
        from PIL import Image

        page = arrive(visit, showroom_viewer)
        name, data = page.save("EXR")
        assert name == "showroom.exr"
        (tmp_path / name).write_bytes(data)
        frame = read_frame(tmp_path / name)
        assert frame.gbuffer.normal is not None
        assert frame.camera is not None
        assert np.isfinite(frame.radiance.color).all()
        name, data = page.save("PNG")
        assert name == "showroom.png"
        assert Image.open(io.BytesIO(data)).size == (frame.width, frame.height)

    def test_two_browsers_have_cameras_of_their_own(self, showroom_viewer, visit):
        first, second = arrive(visit, showroom_viewer), arrive(visit, showroom_viewer)
        first.wait(lambda: showroom_viewer.statistics["browsers"] == 2, "two browsers")
        before = showroom_viewer.statistics["eyes"]
        first.page.keyboard.down("s")
        first.wait(lambda: showroom_viewer.statistics["eyes"][0][2] != before[0][2], "the first camera to fly")
        first.page.keyboard.up("s")
        np.testing.assert_allclose(showroom_viewer.statistics["eyes"][1], before[1], rtol=1e-9)
        # In the middle of a frame.
        first.close()
        second.wait(lambda: showroom_viewer.statistics["browsers"] == 1, "the first browser to be forgotten")
        drag(second, 2)

    def test_exposure(self, showroom_viewer, visit):
        page = arrive(visit, showroom_viewer)
        before = page.look()
        page.slide("Exposure, stops", "End")
        page.wait(lambda: page.look().mean() > before.mean() + 50.0, "a brighter picture")
        page.page.get_by_role("button", name="Auto exposure").click()
        page.wait(lambda: page.look().mean() < before.mean() + 50.0, "the exposure to come back")

    def test_a_renderer_that_dies_is_started_again(self, showroom_viewer, visit):
        page = arrive(visit, showroom_viewer)
        before = showroom_viewer.statistics
        os.kill(before["process"], signal.SIGKILL)
        page.wait(lambda: showroom_viewer.statistics["restarts"] == before["restarts"] + 1, "a new process")
        page.page.get_by_text("was killed by signal 9 and was started again").first.wait_for()
        # Counted from before the kill: the new process may be quicker than the notification.
        page.wait_for_frames(1, since=before["frames"])
        assert showroom_viewer.statistics["process"] != before["process"]

    def test_a_long_orbit(self, showroom_viewer, visit):
        page = arrive(visit, showroom_viewer)
        before = showroom_viewer.statistics["restarts"]
        drag(page, 16)
        assert page.closed_sockets == 0
        assert showroom_viewer.statistics["restarts"] == before


@pytest.fixture(scope="module")
def moving_viewer(mi):
    """Return a viewer of the showroom whose objects move."""
    with run_viewer("showroom", size=SIZE, changes=CHEAP, moving=BY_THEMSELVES) as viewer:
        yield viewer


def test_objects_play_and_pause(moving_viewer, visit):
    page = arrive(visit, moving_viewer)

    def tell() -> float:
        return moving_viewer.statistics["moments"][0]

    before = tell()
    page.wait(lambda: tell() > before + 3.0, "objects to move")
    assert moving_viewer.statistics["accumulated"] == [1]
    page.tick("Play")
    page.wait(lambda: moving_viewer.statistics["accumulated"][0] > 4, "objects to rest")
    rest = tell()
    page.slide("Speed", "End")
    page.tick("Play")
    page.wait(lambda: tell() > rest, "objects to go on")
    page.tick("Play")
    page.wait(lambda: moving_viewer.statistics["accumulated"][0] > 4, "objects to rest again")
    # Pictures at the fastest speed are four frames apart.
    assert (tell() - rest) % 4.0 == pytest.approx(0.0, abs=1e-6)
