"""The page of a finished frame: who may ask it for what, and what a user meets in a headless browser."""

import base64
import contextlib
import http.client
import io
import json
import signal
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from lobewise.denoising import denoise
from lobewise.denoising.recipe import denoise_quietly
from lobewise.display.tones import map_tones
from lobewise.errors import InputError
from lobewise.interchange import read_image
from lobewise.io import read_frame, write_frame
from lobewise.records.frame import Frame, Radiance
from lobewise.viewer import FrameViewer, frame_target, frame_viewer
from lobewise.viewer.frame_viewer import MAX_WAITING
from lobewise.viewer.http.browser_messages import MAX_MESSAGE_BYTES
from lobewise.work.progress import enter_stage, plan_stages
from tests.interrupts import start_program
from tests.mistakes import refuses
from tests.viewer.conftest import ask

PATIENCE = 60.0
FAST = {"quality": "fast", "similarity": "normal"}


@pytest.fixture(scope="module")
def reference_file(floor_frame: Frame, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a gray image of the size of the floor."""
    path = tmp_path_factory.mktemp("reference") / "gray.exr"
    write_frame(path, Frame(Radiance(np.full((*floor_frame.shape, 3), 0.5))), half=False)
    return path


@pytest.fixture(scope="module")
def viewer(floor_file: Path, reference_file: Path) -> Iterator[FrameViewer]:
    """Return a viewer of the floor, with a reference; it filters quickly at first."""
    with FrameViewer(
        str(floor_file), port=0, changes={"similarity": "normal"}, reference=str(reference_file)
    ) as viewer:
        yield viewer


def get_token(viewer: FrameViewer) -> str:
    return urlsplit(viewer.url).query


def post(viewer: FrameViewer, path: str, **values: Any) -> tuple[int, bytes]:
    status, _, data = ask(viewer, f"{path}?{get_token(viewer)}", json.dumps(values).encode())
    return status, data


class TestDoor:
    def test_the_page_comes_with_the_token_and_then_with_the_cookie(self, viewer):
        status, headers, text = ask(viewer, f"/?{get_token(viewer)}")
        assert (status, b"<html" in text) == (200, True)
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["Cache-Control"] == "no-store"
        assert headers["Content-Security-Policy"].startswith("default-src 'none'")
        assert headers["Content-Security-Policy"].endswith("frame-ancestors 'none'")
        cookie = headers["Set-Cookie"].partition(";")[0]
        assert ask(viewer, "/", Cookie=cookie)[0] == 200
        assert ask(viewer, "/etc/passwd", Cookie=cookie)[0] == 404

    @pytest.mark.parametrize("body", [None, b"{}"])
    @pytest.mark.parametrize(
        ("path", "headers"),
        [
            ("/", {}),
            ("/values", {}),
            ("/?token=wrong", {}),
            ("/?{token}", {"Host": "evil.example"}),
            ("/?{token}", {"Origin": "http://evil.example"}),
            ("/?{token}", {"Origin": "null"}),
            ("//[?%", {}),
        ],
    )
    def test_nobody_else_gets_it(self, viewer, path, headers, body):
        status, found, text = ask(viewer, path.format(token=get_token(viewer)), body, **headers)
        assert status == 403
        assert text.endswith(b"open the URL that lobewise printed.\n")
        assert "Set-Cookie" not in found

    def test_requests_come_only_from_the_page(self, viewer):
        place = urlsplit(viewer.url)
        cookie = {"Cookie": f"lobewise-{place.port}={get_token(viewer).removeprefix('token=')}"}
        body = json.dumps({"stops": 0.0}).encode()
        # A page of another port of this machine is of the same site: its requests carry the cookie.
        for origin in ({}, {"Origin": f"http://127.0.0.1:{(place.port or 0) - 1}"}, {"Origin": "null"}):
            assert ask(viewer, "/tones", body, **cookie, **origin)[0] == 403
        status, _, tones = ask(viewer, "/tones", body, **cookie, Origin=f"http://{place.netloc}")
        assert (status, len(tones)) == (200, 65536)

    @pytest.mark.parametrize(
        ("path", "body"),
        [
            ("/tones", b"{"),
            ("/tones", b"[]"),
            ("/tones", b'{"stops": 1e999}'),
            ("/tones", b'{"stops": "1"}'),
            ("/values", b'{"x": -1, "y": 0, "settings": {}}'),
            ("/picture", b'{"name": "image"}'),
            ("/picture", b'{"name": "image", "settings": {"radius": 1e9}}'),
            ("/picture", b'{"name": "../secret", "settings": {}}'),
            ("/nothing", b'{"settings": {}}'),
            ("/tones", b" " * (MAX_MESSAGE_BYTES + 1)),
        ],
    )
    def test_strange_requests_are_refused_in_one_sentence(self, viewer, path, body):
        status, _, text = ask(viewer, f"{path}?{get_token(viewer)}", body)
        assert status == 400
        assert 10 < len(text) < 400
        assert text.count(b"\n") == 0

    def test_a_setting_that_the_page_does_not_have_is_refused_at_once(self, floor_file):
        with refuses(InputError, "radius"):
            FrameViewer(str(floor_file), changes={"radius": -1})


class TestStrangers:
    """Connections without the token leave the page to its owner."""

    @pytest.fixture
    def connect(self, viewer) -> Iterator[Any]:
        with contextlib.ExitStack() as stack:

            def connect() -> socket.socket:
                place = urlsplit(viewer.url)
                made = stack.enter_context(socket.create_connection((place.hostname, place.port), PATIENCE))
                made.sendall(b"GET / HTTP/1.1\r\nHost: ")
                return made

            yield connect

    def test_a_request_in_single_bytes_is_ended(self, monkeypatch, connect):
        monkeypatch.setattr(frame_viewer, "MAX_REQUEST_SECONDS", 1.0)
        stranger = connect()
        stranger.settimeout(0.05)
        end = time.monotonic() + PATIENCE
        with contextlib.suppress(ConnectionError):
            while time.monotonic() < end:
                stranger.sendall(b"a")
                with contextlib.suppress(TimeoutError):
                    if not stranger.recv(1):
                        break
        assert time.monotonic() < end

    def test_the_oldest_of_many_connections_are_ended(self, monkeypatch, viewer, connect):
        # The deadline must not end them here.
        monkeypatch.setattr(frame_viewer, "MAX_REQUEST_SECONDS", 2 * PATIENCE)
        strangers = [connect() for _ in range(2 * MAX_WAITING)]
        assert ask(viewer, f"/?{get_token(viewer)}")[0] == 200
        with contextlib.suppress(ConnectionError):
            assert strangers[0].recv(1) == b""
        strangers[-1].settimeout(0.1)
        with pytest.raises(TimeoutError):
            strangers[-1].recv(1)


class TestAnswers:
    def test_pictures_and_their_tones_are_those_of_lobewise(self, viewer, floor_frame):
        status, data = post(viewer, "/picture", name="noisy", settings={})
        assert status == 200
        halves = np.frombuffer(data, np.uint16).reshape(32, 48, 3)
        for stops in (-2.0, 1.5):
            tones = np.frombuffer(post(viewer, "/tones", stops=stops)[1], np.uint8)
            expected = map_tones(floor_frame.radiance.color, 2.0**stops).astype(int)
            assert np.abs(tones[halves] - expected).max() <= 1

    def test_values(self, viewer, floor_frame):
        rows = dict(json.loads(post(viewer, "/values", x=3, y=2, settings=FAST)[1]))
        assert rows["reference"] == "0.5  0.5  0.5"
        assert rows["noisy"] == "  ".join(f"{value:.4g}" for value in floor_frame.radiance.color[2, 3])

    def test_the_share_is_told_while_it_filters(self, viewer, monkeypatch):
        told = []

        def filter_and_ask(frame, settings):
            with plan_stages({"first": 1.0, "second": 3.0}):
                for stage in ("first", "second"):
                    enter_stage(stage)
                    told.append(json.loads(post(viewer, "/share")[1])["share"])
            return denoise_quietly(frame, settings)

        monkeypatch.setattr(frame_target, "denoise_quietly", filter_and_ask)
        assert post(viewer, "/picture", name="image", settings={**FAST, "beta": 3.0})[0] == 200
        told.append(json.loads(post(viewer, "/share")[1])["share"])
        assert told == [0.0, 0.25, 1.0]

    def test_the_file_is_that_of_denoise(self, viewer, floor_file, tmp_path):
        saved = tmp_path / "saved.exr"
        saved.write_bytes(post(viewer, "/file", settings=FAST)[1])
        expected = denoise(read_frame(floor_file), **FAST).image
        np.testing.assert_allclose(read_image(saved), expected, rtol=1e-6)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_ends_it_while_it_filters(floor_file: Path) -> None:
    running = start_program("view", floor_file, "--port", 0)
    line = running.stdout.readline()
    assert line.startswith(f"Showing {floor_file} at http://127.0.0.1:")
    place = urlsplit(line.split(" at ")[1].split()[0])
    connection = http.client.HTTPConnection(place.hostname or "", place.port, timeout=PATIENCE)
    with contextlib.closing(connection):
        wanted = json.dumps({"name": "image", "settings": {"quality": "high", "radius": 32}}).encode()
        connection.request("POST", f"/picture?{place.query}", wanted)
        time.sleep(0.1)
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=PATIENCE)
    assert (running.returncode, out, err) == (0, "", "")


@pytest.fixture
def page(browser: Any, viewer: FrameViewer) -> Iterator[Any]:
    """Return the page in a browser, with both pictures; no error may come to its console."""
    errors: list[str] = []
    context = browser.new_context(viewport={"width": 900, "height": 500}, accept_downloads=True)
    context.set_default_timeout(1e3 * PATIENCE)
    page = context.new_page()
    page.on("console", lambda message: message.type == "error" and errors.append(message.text))
    page.on("pageerror", lambda problem: errors.append(str(problem)))
    page.goto(viewer.url)
    wait_for(page, "left", "noisy")
    wait_for(page, "right", "normal")
    yield page
    context.close()
    assert errors == []


def wait_for(page: Any, side: str, shown: str) -> None:
    page.wait_for_selector(f'#{side}-canvas[data-shown="{shown}"]', state="attached")


def read_pixels(page: Any, side: str) -> np.ndarray:
    """Return the pixels of one picture of the wipe."""
    url = page.evaluate(f"document.getElementById('{side}-canvas').toDataURL()")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB"))


@pytest.mark.nightly
class TestPage:
    def test_it_opens_with_noisy_and_denoised(self, page, viewer, floor_frame):
        expected = map_tones(floor_frame.radiance.color, 2.0**viewer._target.stops).astype(int)
        assert np.abs(read_pixels(page, "left") - expected).max() <= 1
        rough = [np.abs(np.diff(read_pixels(page, side).astype(float), axis=1)).mean() for side in ("left", "right")]
        assert rough[1] < 0.6 * rough[0]

    def test_values_under_the_pointer(self, page, floor_frame):
        box = page.locator("#left-canvas").bounding_box()
        page.mouse.move(box["x"] + 7.5 / 48 * box["width"], box["y"] + 20.5 / 32 * box["height"])
        page.get_by_text("7  20", exact=True).wait_for()
        values = "  ".join(f"{value:.4g}" for value in floor_frame.radiance.color[20, 7])
        page.get_by_text(values, exact=True).first.wait_for()
        page.get_by_text("denoised", exact=True).wait_for()

    def test_the_reference_and_kept_results(self, page):
        page.select_option("#left", "reference")
        wait_for(page, "left", "reference")
        assert len(np.unique(read_pixels(page, "left"))) == 1
        page.click("#keep")
        wait_for(page, "left", "kept 1: normal")
        page.get_by_label("Similarity").select_option("auto")
        page.get_by_label("Quality").select_option("fast")
        wait_for(page, "right", "fast")
        assert not np.array_equal(read_pixels(page, "left"), read_pixels(page, "right"))

    def test_what_changes_nothing_is_hidden(self, page):
        assert page.get_by_label("Normal exponent").is_visible()
        assert not page.get_by_label("Kernel").is_visible()
        page.get_by_label("Similarity").select_option("auto")
        page.get_by_label("Quality").select_option("fast")
        page.get_by_label("Kernel").select_option("atrous")
        wait_for(page, "right", "fast, atrous")
        assert not page.get_by_label("Normal exponent").is_visible()
        assert not page.get_by_label("Radius").is_visible()

    def test_exposure_and_histogram(self, page):
        before, histogram = read_pixels(page, "left"), page.evaluate("document.getElementById('histogram').toDataURL()")
        page.locator("#stops").focus()
        for _ in range(10):
            page.keyboard.press("ArrowRight")
        page.wait_for_function("old => document.getElementById('histogram').toDataURL() !== old", arg=histogram)
        page.wait_for_timeout(300)
        assert read_pixels(page, "left").mean() > before.mean() + 10
        page.click("#expose")
        page.wait_for_timeout(300)
        np.testing.assert_array_equal(read_pixels(page, "left"), before)

    def test_saving(self, page, floor_file, tmp_path):
        page.get_by_label("Quality").select_option("fast")
        wait_for(page, "right", "normal, fast")
        for button, name in (("#png", "floor.png"), ("#exr", "floor-lobewise.exr")):
            with page.expect_download() as download:
                page.click(button)
            assert download.value.suggested_filename == name
            download.value.save_as(tmp_path / name)
        picture = np.asarray(Image.open(tmp_path / "floor.png").convert("RGB"))
        np.testing.assert_array_equal(picture[:, :24], read_pixels(page, "left")[:, :24])
        np.testing.assert_array_equal(picture[:, 24:], read_pixels(page, "right")[:, 24:])
        expected = denoise(read_frame(floor_file), **FAST).image
        np.testing.assert_allclose(read_image(tmp_path / "floor-lobewise.exr"), expected, rtol=1e-6)
