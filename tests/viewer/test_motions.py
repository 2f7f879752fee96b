"""Objects that move in the viewer, without a browser: moments, places, loops, and what is asked for."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.interactive.settings import InteractiveSettings
from lobewise.scenes import BY_THEMSELVES
from lobewise.viewer.browser import Browser
from lobewise.viewer.messages import Description, Picture, Request, Window
from lobewise.viewer.status import write_figures
from tests.mistakes import refuses
from tests.render.moving.places import slide

LOOK = InteractiveSettings(similarity="none", temporal=False, adaptive=0.0, filter_direct=False, scale=4)
SIZE = (40, 32)
ROOM = """<scene version="3.0.0"><integrator type="path"/>
  <sensor type="perspective"><transform name="to_world">
    <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="32"/></film></sensor>
  <shape type="sphere" id="ball"><float name="radius" value="0.5"/></shape>
  <emitter type="constant"/></scene>"""


def open_target(name: str, moving: str | None) -> Any:
    from lobewise.viewer.scene_target import SceneTarget

    return SceneTarget(name, SIZE, lambda done, total: None, moving)


def ask(target: Any, client: int = 1, speed: float = 1.0, **changes: Any) -> float | None:
    """Return the moment of a browser's next picture."""
    camera = target.describe().camera
    request = Request(client, 1, Window(*SIZE), LOOK, camera=camera, size=SIZE, speed=speed, **changes)
    (_,) = target.render(request)
    return target.moments.get(client)


def list_positions(target: Any, client: int = 1) -> np.ndarray:
    """Return the surface points in a browser's last picture."""
    return np.asarray(target._last[client][0].parts.hits.gbuffer.position)


@pytest.fixture
def room(mi: Any, tmp_path: Path) -> tuple[str, str]:
    """Return the files of a ball, and of its motion to the right over four frames."""
    scene, motion = tmp_path / "room.xml", tmp_path / "motion.json"
    scene.write_text(ROOM)
    keys = [{"frame": 1}, {"frame": 5, "translate": [0.8, 0.0, 0.0]}]
    motion.write_text(json.dumps({"ball": {"keys": keys}}))
    return str(scene), str(motion)


@pytest.mark.mitsuba
def test_objects_of_a_file_move_and_begin_again(room: tuple[str, str]) -> None:
    target = open_target(*room)
    assert target.describe().moves
    found = []
    for _ in range(7):
        moment = ask(target)
        position = list_positions(target)
        found.append((moment, position[..., 0][position[..., 2] > 0.3].mean()))
    moments, places = zip(*found, strict=True)
    assert moments == (0.0, 1.0, 2.0, 3.0, 4.0, 0.0, 1.0)
    # The middle of the visible part of a ball is seen a little aside.
    np.testing.assert_allclose(places, 0.2 * np.array(moments), atol=0.04)


@pytest.mark.mitsuba
def test_speed_and_rest_are_those_of_each_browser(room: tuple[str, str]) -> None:
    target = open_target(*room)
    for _ in range(2):
        ask(target)
    assert ask(target, speed=0.5) == 1.5
    assert [ask(target, speed=0.0) for _ in range(2)] == [1.5, 1.5]
    ask(target, speed=0.0)
    assert target._last[1][0].accumulated == 4
    assert ask(target, client=2) == 0.0
    here, there = (list_positions(target, client)[..., 0].max() for client in (1, 2))
    assert here - there == pytest.approx(0.3, abs=0.1)
    target.forget(1)
    assert ask(target) == 0.0


@pytest.mark.mitsuba
def test_what_is_shown_again_does_not_move(room: tuple[str, str]) -> None:
    target = open_target(*room)
    for _ in range(2):
        ask(target)
    assert ask(target, fresh=False) == 1.0


@pytest.mark.mitsuba
@pytest.mark.nightly
def test_objects_of_a_built_in_scene_are_where_the_scene_has_them(mi: Any) -> None:
    from lobewise.render import load_scene
    from lobewise.viewer.scene_target import SceneTarget

    target = open_target("showroom", BY_THEMSELVES)
    for _ in range(3):
        ask(target, speed=4.0)
    whole = SceneTarget("showroom", SIZE, lambda done, total: None)
    assert not whole.describe().moves
    assert ask(whole) is None
    still = list_positions(whole)
    whole._first = type(whole._first)(load_scene("showroom", width=SIZE[0], height=SIZE[1], time=8.0))
    ask(whole, client=2)
    moved = list_positions(target)
    np.testing.assert_allclose(moved, list_positions(whole, 2), atol=1e-3)
    assert np.abs(moved - still).max() > 0.1


@pytest.mark.mitsuba
def test_shapes_that_are_not_there_are_told(room: tuple[str, str], tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text(json.dumps({"bell": {"matrices": [slide(0.0, 0.0, 0.0).tolist()]}}))
    with refuses(InputError, "shape", holder="moving objects 'wrong.json'"):
        open_target(room[0], str(wrong))


def make_browser(speed: float) -> Browser:
    """Return a browser that shows a picture of objects at a speed."""
    client = SimpleNamespace(camera=SimpleNamespace(image_width=64, image_height=64), client_id=1)
    browser = Browser(client, SimpleNamespace(), fixed_size=True)  # type: ignore[arg-type]
    browser.panel = SimpleNamespace(speed=speed, accumulate=False)  # type: ignore[assignment]
    browser.picture = make_picture()
    return browser


def make_picture(moment: float | None = None) -> Picture:
    return Picture(1, 1, np.zeros((8, 8, 3), np.uint8), (64, 64), 0.0, moment=moment)


@pytest.mark.parametrize(("speed", "more"), [(1.0, True), (0.1, True), (0.0, False)])
def test_pictures_follow_each_other_while_objects_move(speed: float, more: bool) -> None:
    found = Description(LOOK, 64, 64, camera=SimpleNamespace(), moves=True)  # type: ignore[arg-type]
    assert make_browser(speed).needs_more(found) == more


def test_the_status_tells_the_moment() -> None:
    assert "objects at 12.5" in write_figures(make_picture(12.5), 1, None)
    assert "objects" not in write_figures(make_picture(), 1, None)
