"""Who may see the page and speak to it, and what may be said; asked without a browser."""

import contextlib
import math
import re
import socket
import sys
import time
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from lobewise.cli.program import run
from lobewise.cli.viewing import Page
from lobewise.errors import InputError, MissingDependencyError
from lobewise.viewer import Viewer, worker_process
from lobewise.viewer.http.access import MIN_TOKEN_CHARACTERS, Access, HttpRequest
from lobewise.viewer.http.browser_messages import (
    CAMERA,
    MAX_MESSAGE_BYTES,
    MAX_WINDOW_ASPECT,
    MAX_WINDOW_PIXELS,
    UPDATE,
    Control,
    MessageError,
    check_message,
    clamp_window,
    read_message,
)
from lobewise.viewer.http.site import LOOPBACK
from lobewise.viewer.messages import Window
from lobewise.viewer.pictures import MAX_PIXELS_WITH_BARS, fit_window
from tests.mistakes import refuses
from tests.viewer.conftest import ask
from tests.viewer.slow_worker import UNSEEN, run_slow_worker

TOKEN = "a-token-of-the-tests"
PATIENCE = 60.0
VIEW = {
    "type": CAMERA,
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, 0.0, 4.0],
    "fov": 0.8,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 400,
    "image_width": 600,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0, 1, 0],
}
CONTROLS = {"list": Control(choices=("image", "normals")), "slider": Control(low=-10, high=10.5), "box": Control()}


def visit(
    *, host: str | None = "localhost:8080", origin: str | None = None, token: str = "", cookie: str = "", **more: Any
) -> HttpRequest:
    return HttpRequest(
        f"/?token={token}" if token else "/",
        [] if host is None else [host],
        [] if origin is None else [origin],
        [cookie] if cookie else [],
        **more,
    )


def change(identity: object, value: object) -> dict[str, Any]:
    return {"type": UPDATE, "uuid": identity, "updates": {"value": value}}


class TestAccess:
    def test_the_token_opens_and_leaves_a_cookie_that_opens(self):
        access = Access("127.0.0.1", TOKEN)
        first = visit(token=TOKEN)
        assert access.refuse(first) == ""
        crumbs = access.make_cookie(first).split("; ")
        assert crumbs == [f"lobewise-8080={TOKEN}", "Path=/", "HttpOnly", "SameSite=Strict"]
        origin = "http://localhost:8080"
        for cookie in (crumbs[0], f"theirs=1; {crumbs[0]}; lobewise-9=x"):
            assert access.refuse(visit(cookie=cookie)) == ""
            assert access.refuse(visit(cookie=cookie, origin=origin, is_socket=True)) == ""

    @pytest.mark.parametrize(
        "wrong",
        [
            {},
            {"token": "wrong"},
            {"token": TOKEN[:-1]},
            {"token": TOKEN + "x"},
            {"token": "%00%ff"},
            {"cookie": f"lobewise-8081={TOKEN}"},
            {"cookie": f"token={TOKEN}"},
            {"cookie": "lobewise-8080="},
            {"cookie": "lobewise-8080"},
        ],
    )
    def test_without_the_right_token_nothing_opens(self, wrong):
        access = Access("127.0.0.1", TOKEN)
        assert "token" in access.refuse(visit(**wrong))
        assert "token" in access.refuse(visit(**wrong, origin="http://localhost:8080", is_socket=True))

    @pytest.mark.parametrize(
        "origin",
        [
            "http://evil.example",
            "http://localhost:8081",
            "http://localhost",
            "http://127.0.0.1:8080",
            "null",
            "file://",
            "",
            "localhost:8080",
            "chrome-extension://localhost:8080",
        ],
    )
    def test_another_page_gets_nothing_even_with_token_and_cookie(self, origin):
        access = Access("127.0.0.1", TOKEN)
        for is_socket in (False, True):
            asked = visit(token=TOKEN, cookie=f"lobewise-8080={TOKEN}", origin=origin, is_socket=is_socket)
            assert "own page" in access.refuse(asked)

    def test_a_socket_without_an_origin_needs_the_token_in_its_url(self):
        access = Access("127.0.0.1", TOKEN)
        assert "token in its URL" in access.refuse(visit(cookie=f"lobewise-8080={TOKEN}", is_socket=True))
        assert access.refuse(visit(token=TOKEN, is_socket=True)) == ""

    @pytest.mark.parametrize(
        ("bound", "host", "welcome"),
        [
            ("127.0.0.1", "127.0.0.1:8080", True),
            ("127.0.0.1", "LOCALHOST:8080", True),
            ("127.0.0.1", "[::1]:8080", True),
            ("127.0.0.1", "localhost:9000", True),
            ("127.0.0.1", "localhost", True),
            ("127.0.0.3", "127.0.0.3:8080", True),
            ("127.0.0.1", "evil.example:8080", False),
            ("127.0.0.1", "localhost.evil.example:8080", False),
            ("127.0.0.1", "127.0.0.1.evil.example", False),
            ("127.0.0.1", "192.0.2.7:8080", False),
            ("127.0.0.1", "", False),
            ("127.0.0.1", None, False),
            ("127.0.0.1", "user@localhost:8080", False),
            ("127.0.0.1", "localhost:8080:1", False),
            ("0.0.0.0", "192.0.2.7:8080", True),
            ("0.0.0.0", "[2001:db8::7]:8080", True),
            ("::", "192.0.2.7:8080", True),
            ("0.0.0.0", "localhost:8080", True),
            ("0.0.0.0", "this-machine:8080", True),
            ("0.0.0.0", "this-machine.local:8080", True),
            ("0.0.0.0", "evil.example:8080", False),
            ("192.0.2.7", "192.0.2.7:8080", True),
            ("render.studio", "render.studio:8080", True),
        ],
    )
    def test_only_names_of_this_server_reach_it(self, monkeypatch, bound, host, welcome):
        monkeypatch.setattr("socket.gethostname", lambda: "This-Machine")
        refusal = Access(bound, TOKEN).refuse(visit(host=host, token=TOKEN))
        assert (refusal == "") is welcome
        assert welcome or "not reached by" in refusal

    def test_headers_that_come_twice(self):
        access = Access("127.0.0.1", TOKEN)
        assert access.refuse(HttpRequest(f"/?token={TOKEN}", ["localhost:8080", "localhost:8080"]))
        assert access.refuse(
            HttpRequest(f"/?token={TOKEN}", ["localhost:8080"], ["http://localhost:8080", "http://evil.example"])
        )

    def test_every_viewer_has_a_token_of_its_own(self):
        tokens = {Access("127.0.0.1").token for _ in range(50)}
        assert len(tokens) == 50
        assert min(map(len, tokens)) >= 40

    @pytest.mark.parametrize("token", ["", "short", "a" * (MIN_TOKEN_CHARACTERS - 1), "with spaces and &c. in it"])
    def test_a_token_that_protects_nothing_is_refused(self, token):
        with refuses(InputError, "--token", expected="at least 16 letters, digits and any of . _ ~ -"):
            Viewer("thing", token=token)

    @pytest.mark.parametrize(
        ("words", "token"), [([], "of the environment"), (["--token", "of the line"], "of the line")]
    )
    def test_the_program_takes_a_token(self, words, token, monkeypatch):
        tokens = []

        def note(*_, **options):
            tokens.append(options["token"])
            raise InputError("noted")

        monkeypatch.setattr("lobewise.viewer.Viewer", note)
        monkeypatch.setenv("LOBEWISE_TOKEN", "of the environment")
        assert run(["view", "showroom", *words]) == 2
        assert tokens == [token]


class TestMessages:
    def test_what_a_page_sends_is_handed_on(self):
        for message in (VIEW, change("list", "normals"), change("slider", -3), change("box", True)):
            assert check_message(message, CONTROLS).message == message

    @pytest.mark.parametrize(
        "message",
        [
            None,
            5,
            [],
            {},
            {"type": 5},
            {"type": CAMERA},
            {**VIEW, "more": 1},
            {**VIEW, "position": "abc"},
            {**VIEW, "position": [1.0, 2.0]},
            {**VIEW, "position": [1.0, 2.0, None]},
            {**VIEW, "wxyz": [True, 0.0, 0.0, 0.0]},
            {**VIEW, "fov": "0.8"},
            {**VIEW, "image_width": [600]},
            {"type": UPDATE},
            change(5, 1),
            {**change("slider", 1), "updates": 7},
            {**change("slider", 1), "updates": {"update_cb": []}},
            {**change("slider", 1), "updates": {"value": 1, "visible": False}},
            change("slider", "3"),
            change("slider", True),
            change("slider", None),
            change("list", 1),
            change("box", 1),
        ],
        ids=str,
    )
    def test_what_no_page_sends_ends_the_connection(self, message):
        with pytest.raises(MessageError):
            check_message(message, CONTROLS)

    @pytest.mark.parametrize(
        "message",
        [
            {"type": "Nothing" * 99},
            {"type": "FileTransferStartUpload"},
            *(
                {**VIEW, name: [value] * len(VIEW[name])}
                for name in ("position", "wxyz")
                for value in (math.nan, 1e308)
            ),
            *({**VIEW, name: value} for name in ("fov", "image_width", "near") for value in (math.nan, math.inf)),
            {**VIEW, "fov": 0.0},
            {**VIEW, "fov": 4.0},
            {**VIEW, "look_at": [10**18, 0, 0]},
            change("slider", math.nan),
            change("list", "something else"),
        ],
        ids=lambda message: str(message)[:60],
    )
    def test_what_has_no_meaning_is_ignored_and_named(self, message):
        checked = check_message(message, CONTROLS)
        assert checked.message is None
        assert 10 < len(checked.remark) < 200

    def test_a_control_that_is_gone_is_ignored(self):
        assert check_message(change("gone", 1), CONTROLS) == check_message(change("", "x"), {})
        assert check_message(change("gone", 1), CONTROLS).message is None

    def test_numbers_are_moved_into_their_ranges(self):
        for value, expected in ((1e300, 10.5), (-(2**63), -10), (0.25, 0.25)):
            found = check_message(change("slider", value), CONTROLS).message
            assert found["updates"]["value"] == expected

    @pytest.mark.parametrize("size", [(1e9, 400), (400, 1e9), (1e9, 1e9), (0, 0), (-5, 3), (1e300, 1)])
    def test_windows_are_those_that_there_are(self, size):
        found = check_message({**VIEW, "image_width": size[0], "image_height": size[1]}, {}).message
        width, height = found["image_width"], found["image_height"]
        assert isinstance(width, int)
        assert min(width, height) >= 1
        assert max(width, height) <= MAX_WINDOW_ASPECT * min(width, height)
        assert width * height <= MAX_WINDOW_PIXELS

    @pytest.mark.parametrize("size", [(1280, 720), (7680, 4320), (430, 932), (5120, 1440), (3000, 200)])
    def test_windows_of_screens_stay_as_they_are(self, size):
        assert clamp_window(*size) == size

    @pytest.mark.parametrize(
        "data",
        [b"", b"\xff\x00\xc1", "text", b"\x91" * 9999 + b"\xc0", b"\x81\x90\xc0", b"\xc0" * (MAX_MESSAGE_BYTES + 1)],
    )
    def test_bytes_that_are_no_message(self, data):
        pytest.importorskip("msgspec", reason="pip install 'lobewise[viewer]'")
        with pytest.raises(MessageError):
            read_message(data, CONTROLS)

    def test_bytes_are_handed_on_as_they_came_unless_something_was_moved(self):
        msgpack = pytest.importorskip("msgspec", reason="pip install 'lobewise[viewer]'").msgpack
        plain = msgpack.encode(VIEW)
        assert read_message(plain, CONTROLS) == (plain, "")
        moved, _ = read_message(msgpack.encode({**VIEW, "image_width": 1e9}), CONTROLS)
        assert msgpack.decode(moved) == {**VIEW, "image_width": 6400}


@pytest.mark.parametrize("window", [Window(6400, 400), Window(400, 6400)])
def test_a_long_window_gets_a_coarse_picture_of_its_aspect(window):
    picture = np.full((320, 480, 3), 200, np.uint8)
    found = fit_window(picture, window)
    assert found.shape[0] * found.shape[1] <= 1.01 * MAX_PIXELS_WITH_BARS * 320 * 480
    assert found.shape[1] / found.shape[0] == pytest.approx(window.width / window.height, rel=0.02)
    assert (found == 200).any()


@pytest.fixture(scope="module")
def slow_viewer():
    """Return a viewer of nothing much, and what it told whoever started it."""
    pytest.importorskip("viser", reason="pip install 'lobewise[viewer]'")
    told: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker_process, "run_worker", run_slow_worker)
        with Viewer("foggy", port=0, tell=told.append) as viewer:
            yield SimpleNamespace(viewer=viewer, told=told)


def connect(viewer: Viewer, **options: Any) -> Any:
    """Return a WebSocket as the page opens it."""
    import viser
    from websockets.sync.client import connect as open_socket

    address = options.pop("address", viewer.url).replace("http", "ws", 1)
    protocol: Any = f"viser-v{viser.__version__}"
    return open_socket(address, subprotocols=[protocol], compression=None, max_size=None, **options)


def read_to_the_end(page: Any) -> None:
    while True:
        page.recv(timeout=PATIENCE)


def wait_until(condition: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


class TestServer:
    def test_the_page_comes_with_the_token_and_then_with_the_cookie(self, slow_viewer):
        place = urlsplit(slow_viewer.viewer.url)
        status, headers, text = ask(slow_viewer.viewer, f"/?{place.query}")
        assert (status, b"<html" in text) == (200, True)
        assert headers["Referrer-Policy"] == "no-referrer"
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
        cookie = headers["Set-Cookie"].partition(";")[0]
        assert cookie.startswith(f"lobewise-{place.port}=")
        assert ask(slow_viewer.viewer, "/", Cookie=cookie)[0] == 200

    @pytest.mark.parametrize(
        ("path", "headers"),
        [
            ("/", {}),
            ("/?token=wrong", {}),
            ("/index.html", {}),
            ("/?{token}", {"Host": "evil.example"}),
            ("/?{token}", {"Origin": "http://evil.example"}),
            ("//[?%", {}),
        ],
    )
    def test_nobody_else_gets_it(self, slow_viewer, path, headers):
        path = path.format(token=urlsplit(slow_viewer.viewer.url).query)
        status, found, text = ask(slow_viewer.viewer, path, **headers)
        assert status == 403
        assert text.endswith(b"open the URL that lobewise printed.\n")
        assert text.count(b".\n") == 1
        assert "Set-Cookie" not in found

    @pytest.mark.skipif(sys.platform != "linux", reason="elsewhere 127.0.0.2 is no address of this machine")
    def test_it_listens_at_one_address_of_this_machine(self, slow_viewer):
        port = urlsplit(slow_viewer.viewer.url).port
        assert Page().host == LOOPBACK
        with socket.create_connection((LOOPBACK, port), PATIENCE):
            pass
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port), PATIENCE)

    def test_sockets_open_only_from_the_page(self, slow_viewer):
        from websockets.exceptions import InvalidStatus

        viewer = slow_viewer.viewer
        place = urlsplit(viewer.url)
        bare = own = f"http://{place.netloc}"
        cookie = {"Cookie": f"lobewise-{place.port}={place.query.removeprefix('token=')}"}
        for options in (
            {"address": bare},
            {"address": bare, "origin": own},
            {"origin": "http://evil.example"},
            {"address": bare, "origin": "http://evil.example", "additional_headers": cookie},
            {"address": bare, "origin": "null", "additional_headers": cookie},
            {"address": bare, "additional_headers": cookie},
        ):
            with pytest.raises(InvalidStatus, match="403"), connect(viewer, **options):
                pass
        for options in ({}, {"origin": own}, {"address": bare, "origin": own, "additional_headers": cookie}):
            with connect(viewer, **options) as page:
                assert page.recv(timeout=PATIENCE)

    def test_what_is_not_shown_is_told(self, slow_viewer):
        wait_until(lambda: slow_viewer.told)
        assert slow_viewer.told[0] == UNSEEN

    def test_strange_messages_end_nothing_and_take_one_line_each(self, slow_viewer, capfd, caplog):
        import msgspec
        from websockets.exceptions import ConnectionClosed

        encode = msgspec.msgpack.encode
        viewer, told = slow_viewer.viewer, slow_viewer.told
        wait_until(lambda: told)
        seen = viewer.statistics["browsers"]
        with connect(viewer) as honest:
            honest.send(encode(VIEW))
            wait_until(lambda: viewer._browsers.controls and viewer.statistics["browsers"] == seen + 1)
            controls = viewer._browsers.controls
            number = next(name for name, control in controls.items() if control.low == -10)
            word = next(name for name, control in controls.items() if control.choices)
            for bad in (b"\xff\xc1", "text", encode({"type": CAMERA}), encode(change(number, "x")), b"\xc0" * 70_000):
                told.clear()
                with connect(viewer) as page:
                    page.send(encode(VIEW))
                    page.send(bad)
                    with pytest.raises(ConnectionClosed):
                        read_to_the_end(page)
                assert len(told) <= 1, told
            told.clear()
            with connect(viewer) as page:
                page.send(encode(VIEW))
                for odd in (
                    {**VIEW, "position": [math.nan] * 3},
                    {**VIEW, "image_width": 1e12},
                    {"type": "Nothing"},
                    {"type": "RunJavascriptMessage", "source": "1"},
                    change("nobody's", 3),
                    change(number, math.inf),
                    change(number, 1e300),
                    change(word, "something else"),
                ):
                    page.send(encode(odd))
                wait_until(lambda: viewer.statistics["browsers"] == seen + 2)
                wait_until(lambda: len(told) == 1)
                assert re.match(r"A browser sent a camera whose position is not finite", told[0])
            before = viewer.statistics["frames"]
            honest.send(encode(change(number, 2.0)))
            wait_until(lambda: viewer.statistics["frames"] > before)
        assert capfd.readouterr() == ("", "")
        assert [record.getMessage() for record in caplog.records if record.levelname != "DEBUG"] == []
        assert viewer.statistics["restarts"] == 0

    def test_a_viser_that_serves_otherwise_is_not_started(self, monkeypatch):
        pytest.importorskip("viser", reason="pip install 'lobewise[viewer]'")
        monkeypatch.setattr(worker_process, "run_worker", run_slow_worker)
        monkeypatch.setattr("lobewise.viewer.http.guard.guard_serving", lambda *_: contextlib.nullcontext())
        viewer = Viewer("thing", port=0)
        with refuses(MissingDependencyError, action="pip install 'viser==1.1.1'"):
            viewer.start()
        assert viewer._server is None
        assert not viewer._browsers.worker._process.is_alive()
