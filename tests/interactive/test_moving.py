"""A session whose objects and lights move: frames are those of the new scene, and histories follow."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.interactive import InteractiveFrame, InteractiveSettings, Session
from lobewise.interactive.changes import SceneChanges
from lobewise.render import load_scene
from tests.mistakes import refuses
from tests.render.moving.places import slide, turn

pytestmark = [pytest.mark.mitsuba, pytest.mark.nightly]

SIZE = 48
QUICK = InteractiveSettings(similarity="sg", radius=1)
CUBE = (2.3, 0.32, 1.5)
"""Middle of the showroom's cube."""


@pytest.fixture
def session(mi: Any) -> Session:
    return Session(load_scene("showroom", width=SIZE, height=SIZE), settings=QUICK)


def place(step: int) -> dict[str, np.ndarray]:
    """Return the places of a ball that slides and a cube that turns."""
    return {"plastic": slide(-0.1 * step, 0.0, 0.0), "cube": turn(4.0 * step, CUBE)}


def look_up_number(session: Session, name: str) -> int:
    """Return the number of a shape among the first hits."""
    import drjit as dr
    import mitsuba as mi

    shape = next(each for each in session.scene.shapes() if each.id() == name)
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def mark_pixels(session: Session, frame: InteractiveFrame, name: str) -> np.ndarray:
    """Return the pixels that show a shape."""
    return np.asarray(frame.parts.hits.shape == look_up_number(session, name))


def test_frames_show_the_scene_as_it_is_now(mi: Any, session: Session) -> None:
    """Replayed functions once read vertices from the memory of the places before."""
    for step in range(6):
        session.set_transforms(place(step))
        found = session.render().parts.hits.gbuffer
    alone = Session(load_scene("showroom", width=SIZE, height=SIZE), settings=QUICK)
    alone.set_transforms(place(5))
    expected = alone.render().parts.hits.gbuffer
    for name in ("position", "normal", "hit_distance", "diffuse_albedo"):
        one, other = getattr(found, name), getattr(expected, name)
        assert np.allclose(one, other, atol=1e-4, rtol=1e-4), name


def test_motion_leads_to_where_the_point_was(session: Session) -> None:
    size = 128
    session.resize(size, size)
    session.set_transforms(place(0))
    before = session.render()
    assert before.parts.hits.gbuffer.motion is None
    session.set_transforms(place(1))
    frame = session.render()
    guides = frame.parts.hits.gbuffer
    row, column = np.mgrid[:size, :size]
    where = np.floor(np.stack([column, row], axis=-1) + 0.5 + guides.motion).astype(int).clip(0, size - 1)
    there = before.parts.hits.gbuffer.position[where[..., 1], where[..., 0]]
    still = np.ones((size, size), bool)
    for name, now, then in (("plastic", place(1), place(0)), ("cube", place(1), place(0))):
        pixels = mark_pixels(session, frame, name)
        assert pixels.sum() > 20
        still &= ~pixels
        back = then[name] @ np.linalg.inv(now[name])
        was = guides.position @ back[:3, :3].T + back[:3, 3]
        # A pixel is some 0.045 wide at the distance of these objects, and the surfaces may lie aslant.
        assert (np.linalg.norm(there - was, axis=-1)[pixels] < 0.08).mean() > 0.8
        assert (np.linalg.norm(there - guides.position, axis=-1)[pixels] < 0.01).mean() < 0.5
    assert np.abs(guides.motion[still]).max() < 1e-3
    # What stands still since the frame before has no motion to tell.
    assert session.render().parts.hits.gbuffer.motion is None


def test_motion_is_that_since_the_stream_was_last_shown(session: Session) -> None:
    """Two streams of one session saw the scene at different times."""
    other = replace(QUICK, similarity="normal")
    session.render_pair(None, QUICK, other)
    for step in (1, 2):
        session.set_transforms(place(step))
        session.render()
    session.set_transforms(place(3))
    first, second = session.render_pair(None, QUICK, other)
    ball = mark_pixels(session, first, "plastic")
    motions = [frame.parts.hits.gbuffer.motion for frame in (first, second)]
    assert np.median(motions[1][ball][:, 0]) == pytest.approx(3.0 * np.median(motions[0][ball][:, 0]), rel=0.1)


def test_reflected_motion_is_that_of_what_is_reflected(session: Session) -> None:
    session.resize(96, 96)
    session.set_transforms(place(0))
    assert session.render().parts.hits.gbuffer.reflected_motion is None
    session.set_transforms(place(1))
    frame = session.render()
    hits, found = frame.parts.hits, frame.parts.hits.gbuffer.reflected_motion
    ball, cube = (hits.seen_shape == look_up_number(session, name) for name in ("plastic", "cube"))
    assert ball.sum() > 20
    assert cube.sum() > 20
    np.testing.assert_allclose(found[ball], np.broadcast_to((0.1, 0.0, 0.0), found[ball].shape), atol=1e-6)
    assert not found[~ball & ~cube].any()
    # The cube turns by 4 degrees about its middle, by 0.08 at its edges.
    length = np.linalg.norm(found[cube], axis=-1)
    assert 0.02 < length.max() < 0.085
    assert np.abs(found[cube][:, 1]).max() < 1e-6


@pytest.mark.parametrize("knows", [True, False])
def test_histories_follow_what_moves(session: Session, knows: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not knows:
        monkeypatch.setattr(SceneChanges, "add_motion", lambda self, hits, seen: hits)
    for step in range(6):
        session.set_transforms({"plastic": slide(-0.25 * step, 0.0, 0.0)})
        frame = session.render()
    lengths = frame.parts.history
    ball = mark_pixels(session, frame, "plastic")
    assert ball.sum() > 20
    assert (np.mean(lengths[ball]) > 3.0) == knows


def test_a_change_ends_the_average_of_all_sessions(session: Session) -> None:
    sibling = session.make_sibling()
    for one in (session, sibling):
        assert [one.render().accumulated for _ in range(2)] == [1, 2]
    session.move("plastic", slide(-0.1, 0.0, 0.0))
    assert [one.render().accumulated for one in (sibling, session)] == [1, 1]
    session.move("plastic", slide(-0.1, 0.0, 0.0))
    assert session.render().accumulated == 2
    session.update_lights()
    assert [one.render().accumulated for one in (sibling, session)] == [1, 1]


def test_a_light_that_changes_keeps_the_history(session: Session) -> None:
    for _ in range(4):
        session.render()
    session.update_lights()
    assert np.median(session.render().get_view("history")) > 4.0 / 40.0
    session.update_scene()
    assert np.median(session.render().get_view("history")) < 1.1 / 40.0


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_histories_follow_the_light(mi: Any, factor: float) -> None:
    scene = load_scene("showroom", width=SIZE, height=SIZE)
    session = Session(scene, settings=replace(QUICK, spp=4))
    for _ in range(8):
        before = session.render().get_view("indirect").mean()
    values = mi.traverse(scene)
    values["lamp.emitter.radiance.value"] = values["lamp.emitter.radiance.value"] * factor
    values.update()
    session.update_lights()
    seen = []
    for _ in range(3):
        after = session.render().get_view("indirect").mean()
        seen.append(after / before)
    assert seen == pytest.approx([factor] * 3, rel=0.05)


def test_wrong_moves_are_told(session: Session) -> None:
    with refuses(InputError, "shape"):
        session.move("plastics", np.eye(4))
    with refuses(InputError, "transform of 'cube'"):
        session.set_transforms({"cube": np.zeros((4, 4)) + np.diag([0, 0, 0, 1.0])})
