"""Pages of strangers in a real browser: none reaches the viewer, and its own page works as before."""

from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

from lobewise.viewer import Viewer, worker_process
from tests.viewer.conftest import PATIENCE, REBOUND
from tests.viewer.slow_worker import UNSEEN, run_slow_worker

pytestmark = pytest.mark.nightly

OPEN_SOCKET = """
address => new Promise(answer => {
    const socket = new WebSocket(address, ["viser-v1"]);
    socket.onopen = () => answer("open");
    socket.onerror = () => answer("refused");
})
"""


@pytest.fixture(scope="module")
def viewers(browser: Any) -> Iterator[tuple[Viewer, Viewer]]:
    """Return two viewers at once, the first of something foggy."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker_process, "run_worker", run_slow_worker)
        with Viewer("foggy", port=0) as first, Viewer("thing", port=0) as second:
            yield first, second


@pytest.fixture
def context(browser: Any) -> Iterator[Any]:
    """Return a browser without cookies."""
    context = browser.new_context(viewport={"width": 400, "height": 300})
    context.set_default_timeout(1e3 * PATIENCE)
    yield context
    context.close()


@pytest.fixture
def refusals(monkeypatch: pytest.MonkeyPatch, viewers: tuple[Viewer, Viewer]) -> list[str]:
    """Return a list of why the first viewer refused a WebSocket: that the browser itself did would prove nothing."""
    found: list[str] = []
    access = viewers[0].access
    plain = access.refuse

    def refuse(visit: Any) -> str:
        answer = plain(visit)
        if visit.is_socket:
            found.append(answer)
        return answer

    monkeypatch.setattr(access, "refuse", refuse)
    return found


def get_place(viewer: Viewer) -> str:
    return urlsplit(viewer.url).netloc


def wait_for_frame(page: Any, viewer: Viewer, before: int) -> None:
    page.get_by_text("Show", exact=True).first.wait_for()
    while viewer.statistics["frames"] == before:
        page.wait_for_timeout(20)


def test_two_viewers_in_one_browser_also_when_loaded_again(viewers, context, refusals):
    pages = [context.new_page() for _ in viewers]
    for page, viewer in zip(pages, viewers, strict=True):
        before = viewer.statistics["frames"]
        page.goto(viewer.url)
        wait_for_frame(page, viewer, before)
    cookies = context.cookies()
    assert {cookie["name"] for cookie in cookies} == {
        f"lobewise-{get_place(viewer).partition(':')[2]}" for viewer in viewers
    }
    assert {(cookie["httpOnly"], cookie["sameSite"]) for cookie in cookies} == {(True, "Strict")}
    assert pages[0].get_by_text(UNSEEN).first.is_visible()
    before = viewers[0].statistics["frames"]
    pages[0].reload()
    wait_for_frame(pages[0], viewers[0], before)
    # The cookie alone is enough, too.
    assert context.request.get(f"http://{get_place(viewers[0])}/").status == 200
    assert pages[0].evaluate(OPEN_SOCKET, f"ws://{get_place(viewers[0])}/") == "open"
    assert set(refusals) == {""}


def test_the_wrong_address_shows_a_sentence(viewers, context):
    parts = urlsplit(viewers[0].url)
    page = context.new_page()
    for address, reason in (
        (f"http://{parts.netloc}/", "token is missing or wrong"),
        (f"http://{parts.netloc}/?token=wrong", "token is missing or wrong"),
        (f"http://{REBOUND}:{parts.port}/?{parts.query}", f"not reached by '{REBOUND}"),
    ):
        answer = page.goto(address)
        assert answer.status == 403
        assert reason in page.inner_text("body")
    assert context.cookies() == []


def test_a_foreign_page_opens_no_socket(viewers, context, refusals):
    parts = urlsplit(viewers[0].url)
    other = parts.port - 1
    context.request.get(viewers[0].url)
    assert len(context.cookies()) == 1
    context.route(f"http://*:{other}/", lambda route: route.fulfill(body="<p>", content_type="text/html"))
    page = context.new_page()
    # Another port of this machine is the same site to a browser: the cookie comes with the request.
    for foreign in (f"http://127.0.0.1:{other}/", f"http://{REBOUND}:{other}/", "data:text/html,<p>"):
        page.goto(foreign)
        for query in ("", f"?{parts.query}"):
            assert page.evaluate(OPEN_SOCKET, f"ws://{parts.netloc}/{query}") == "refused"
    assert ["own page" in refusal for refusal in refusals] == [True] * 6


def test_a_rebound_page_opens_no_socket(viewers, context, refusals):
    parts = urlsplit(viewers[0].url)
    place = f"{REBOUND}:{parts.port}"
    # What its server said before the name pointed here.
    context.route(f"http://{place}/", lambda route: route.fulfill(body="<p>", content_type="text/html"))
    page = context.new_page()
    page.goto(f"http://{place}/")
    assert page.evaluate(OPEN_SOCKET, f"ws://{place}/?{parts.query}") == "refused"
    assert [f"not reached by '{REBOUND}" in refusal for refusal in refusals] == [True]
