"""How far a call is: shares that never fall, the clock between steps, time left, and cancelling."""

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise import peers
from lobewise.denoising.automatic import resolve_all
from lobewise.denoising.plan import list_frame_steps
from lobewise.denoising.recipe import NEGATIVE, OPACITY
from lobewise.errors import CancelledError, InputError
from lobewise.peers import has_oidn, name_call
from lobewise.settings import DenoiseSettings
from lobewise.settings.choices import get_quality
from lobewise.work import progress
from lobewise.work.limits import check_limits
from lobewise.work.progress import Progress, enter_stage, follow_stage, plan_stages, raise_cost, watch_call
from tests.mistakes import refuses
from tests.streaming.frames import make_scene


class Clock:
    """A clock that stands until it is set."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(progress, "time", made)
    return made


def require_growing(told: list[Progress]) -> None:
    """Fail unless shares never fall, and end at 1."""
    shares = [each.share for each in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1], told[-1].stage, told[-1].seconds_left) == (0.0, 1.0, "done", 0.0)


def test_stages_share_the_call_by_their_costs(clock: Clock) -> None:
    told: list[Progress] = []
    with watch_call(told.append), plan_stages({"first": 1.0, "second": 0.0, "third": 0.0, "": 3.0}):
        raise_cost("third", 4.0)
        enter_stage("first")
        enter_stage("third")
        enter_stage("third", (0.5, 1.0))
        enter_stage("")
        with plan_stages({"inner": 1.0, "last": 1.0}):
            enter_stage("unplanned")
            enter_stage("last")
    assert [(each.stage, each.share) for each in told] == [
        *(("first", 0.0), ("third", 1 / 8), ("third", 3 / 8), ("last", 5 / 8)),
        ("done", 1.0),
    ]


def test_inner_stages_are_details(clock: Clock) -> None:
    told: list[Progress] = []
    with watch_call(told.append), plan_stages({"outer": 1.0, "next": 1.0}):
        enter_stage("outer")
        with plan_stages({"a": 1.0, "b": 1.0}):
            enter_stage("a")
            enter_stage("b")
        enter_stage("next")
    assert [(each.stage, each.detail, each.share) for each in told] == [
        *(("outer", "", 0.0), ("outer", "a", 0.0), ("outer", "b", 0.25), ("next", "", 0.5)),
        ("done", "", 1.0),
    ]


def test_between_steps_the_clock_goes_on_at_the_speed_so_far(clock: Clock) -> None:
    told: list[Progress] = []
    with watch_call(told.append), plan_stages({"first": 1.0, "second": 3.0}):
        enter_stage("first")
        check_limits()
        clock.now += 2.0
        enter_stage("second")
        clock.now += 2.0
        check_limits()
        # So soon nothing is told.
        clock.now += 0.01
        check_limits()
        clock.now += 60.0
        check_limits()
    shares = [each.share for each in told]
    np.testing.assert_allclose(shares, [0.0, 0.25, 0.5, 0.25 + 0.95 * 0.75, 1.0])
    assert [each.seconds_left for each in told[:3]] == [None, 6.0, 4.0]


@pytest.mark.parametrize("quality", ["fast", "balanced", "high"])
def test_a_frame_tells_the_steps_of_its_plan(quality: str) -> None:
    frame, told = make_scene((40, 21)), list[Progress]()
    clean = lobewise.denoise(frame, quality=quality, with_oidn=False, progress=told.append)
    require_growing(told)
    chosen = resolve_all(frame, DenoiseSettings(quality=quality, with_oidn=False))
    steps = {step.text for steps in list_frame_steps(frame, chosen) for step in steps}
    assert {each.stage for each in told} - {OPACITY} == {*steps, "done"}
    np.testing.assert_array_equal(clean.image, lobewise.denoise(frame, quality=quality, with_oidn=False).image)


def test_opacity_and_light_below_0_have_their_share() -> None:
    frame, told = make_scene((40, 21)), list[Progress]()
    color = frame.radiance.color.copy()
    color[3:9] -= 2.0
    alpha = np.linspace(0.0, 1.0, 40 * 21, dtype=np.float32).reshape(40, 21)
    changed = frame.with_changes(radiance=lobewise.Radiance(color), half_a=None, half_b=None, alpha=alpha)
    lobewise.denoise(changed, quality="fast", progress=told.append)
    require_growing(told)
    first = {each.stage: each.share for each in reversed(told)}
    light, opacity = (get_quality(each).seconds_per_megapixel for each in ("fast", "high"))
    assert first[OPACITY] == pytest.approx(light / (light + opacity))
    assert 0.3 < first[NEGATIVE] / first[OPACITY] < 0.7


def make_sparse() -> lobewise.SparseFrame:
    return lobewise.make_sparse(make_scene((40, 21)), 2)


CALLS: dict[str, Callable[..., Any]] = {
    "denoise": lambda **more: lobewise.denoise(make_scene((40, 21)), quality="high", with_oidn=False, **more),
    "upsample": lambda **more: lobewise.upsample(make_sparse(), **more),
    "upsample bilinear": lambda **more: lobewise.upsample(make_sparse(), bilinear=True, **more),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_callers_watch_and_cancel(call: Callable[..., Any]) -> None:
    told: list[Progress] = []
    call(progress=told.append)
    require_growing(told)
    count = 0

    def stop(_: Progress) -> bool:
        nonlocal count
        count += 1
        return count < 2

    with refuses(CancelledError):
        call(progress=stop)
    assert count == 2

    def fail(_: Progress) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        call(progress=fail)
    with refuses(InputError, "progress"):
        call(progress=3)
    # Nothing watches the next call.
    call()
    assert count == 2


@pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise")
def test_open_image_denoise_is_watched_and_cancelled() -> None:
    frame, told, threads = make_scene((100, 80)), list[Progress](), set[int]()

    def watch(record: Progress) -> None:
        told.append(record)
        threads.add(threading.get_ident())

    clean = lobewise.denoise(frame, progress=watch)
    require_growing(told)
    assert threads == {threading.get_ident()}
    np.testing.assert_array_equal(clean.image, lobewise.denoise(frame).image)
    last = "Open Image Denoise with color"
    with pytest.raises(CancelledError):
        lobewise.denoise(frame, progress=lambda each: each.detail != last)
    np.testing.assert_array_equal(clean.image, lobewise.denoise(frame).image)


def test_the_library_is_cancelled_while_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyoidn")
    monkeypatch.setattr(progress, "MIN_SECONDS_BETWEEN", 0.0)
    frame, shares = make_scene((200, 160)), list[float]()

    def stop(record: Progress) -> bool:
        shares.append(record.share)
        return record.share < 0.5

    with pytest.raises(CancelledError), watch_call(stop), plan_stages({name_call(["color", "albedo", "normal"]): 1.0}):
        lobewise.denoise_oidn(frame, guides="centre")
    assert 0.5 <= shares[-1] < 0.9


def test_the_library_does_not_work_on_after_a_cancel(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyoidn")
    monkeypatch.setattr(progress, "MIN_SECONDS_BETWEEN", 0.0)
    cancelled, shares = threading.Event(), list[float]()

    class Shares(SimpleQueue):
        """Takes the shares that the library tells, and keeps it waiting for the cancel."""

        def put(self, share: float | None) -> None:
            super().put(share)
            if share is not None:
                shares.append(share)
                assert share < 0.3 or cancelled.wait(60.0)

    monkeypatch.setattr(peers, "SimpleQueue", Shares)
    monkeypatch.setattr(peers, "Event", lambda: cancelled)
    stage = {name_call(["color", "albedo", "normal"]): 1.0}
    with pytest.raises(CancelledError), watch_call(lambda each: each.share < 0.3), plan_stages(stage):
        lobewise.denoise_oidn(make_scene((200, 160)), guides="centre")
    assert max(shares) < 0.9


def test_shares_never_fall(clock: Clock) -> None:
    told: list[Progress] = []
    with watch_call(told.append), plan_stages({"first": 1.0, "second": 1.0}):
        enter_stage("first")
        follow = follow_stage()
        assert follow is not None
        for share in (0.9, 0.2):
            clock.now += 1.0
            follow(share)
        enter_stage("first", (0.5, 1.0))
    require_growing(told)
    assert [each.share for each in told] == [0.0, 0.45, 0.45, 0.45, 1.0]


def test_an_inner_call_without_a_function_tells_the_outer_one() -> None:
    told: list[Progress] = []
    with watch_call(told.append), plan_stages({"outer": 1.0}):
        enter_stage("outer")
        CALLS["denoise"]()
    assert {each.stage for each in told} == {"outer", "done"}
    assert "refine the image by the network that weighs neighbours" in {each.detail for each in told}
