"""The interactive chain: what it promises to a script that drives it without a window."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.interactive import InteractiveSettings, Session
from lobewise.interactive.settings import VIEWS
from lobewise.interactive.views import STAGES
from lobewise.metrics import rel_mse
from lobewise.recipes.temporal import TemporalFilter
from lobewise.records.camera import Camera
from lobewise.records.frame import Radiance
from lobewise.render import load_scene, make_orbit
from tests.mistakes import refuses

pytestmark = [pytest.mark.mitsuba, pytest.mark.nightly]

SIZE = 48
QUICK = InteractiveSettings(similarity="sg", radius=1)


@pytest.fixture(scope="module")
def scene(mi: Any) -> Any:
    return load_scene("showroom", width=SIZE, height=SIZE)


@pytest.fixture(scope="module")
def base(scene: Any) -> Session:
    return Session(scene, settings=QUICK, options={"voxel_cones": {"resolution": 32}})


@pytest.fixture
def session(base: Session) -> Session:
    """Return a session without history; what is compiled is shared."""
    base.resize(SIZE, SIZE)
    return base.make_sibling()


@pytest.fixture(scope="module")
def path(base: Session) -> list[Camera]:
    return make_orbit(base.camera, (0.0, 0.75, -0.6), 6, 1.0)


def test_frames_of_a_path(session: Session, path: list[Camera]) -> None:
    frames = list(session.frames(path))
    assert len(frames) == len(path)
    for frame, camera in zip(frames, path, strict=True):
        assert frame.image.shape == (SIZE, SIZE, 3)
        assert frame.image.dtype == np.float32
        assert np.isfinite(frame.image).all()
        assert (frame.image >= 0).all()
        assert frame.camera is camera
        assert frame.accumulated == 1
        assert set(frame.seconds) == {*STAGES, "total"}
        assert frame.seconds["total"] == pytest.approx(sum(frame.seconds[name] for name in STAGES))
        assert 0 < frame.recomputed <= 0.05 * SIZE * SIZE


@pytest.mark.parametrize("temporal", [True, False])
def test_what_is_shaded_again_enters_the_history(
    session: Session, path: list[Camera], temporal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    added = []
    original = TemporalFilter.add_samples

    def record(self: TemporalFilter, rows: Any, columns: Any, radiance: Radiance, weights: Any) -> None:
        added.append(len(rows))
        original(self, rows, columns, radiance, weights)

    monkeypatch.setattr(TemporalFilter, "add_samples", record)
    frames = [session.render(camera, replace(QUICK, temporal=temporal)) for camera in path[:2]]
    assert added == ([frame.recomputed for frame in frames] if temporal else [])


def test_the_same_calls_give_the_same_bits(session: Session, base: Session, path: list[Camera]) -> None:
    first = [frame.image for frame in session.frames(path[:3])]
    second = [frame.image for frame in base.make_sibling().frames(path[:3])]
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one, other)
    assert not np.array_equal(first[0], first[1])


def render_centres(session: Session, camera: Camera) -> np.ndarray:
    """Return the truth that the chain is after: light at the centres of pixels, by many samples."""
    from lobewise.render.tracing.paths import PathLight

    stages = session._stages
    stages.place_camera(camera, *session.size)
    rows, columns = (index.ravel() for index in np.indices(session.size[::-1]))
    method = PathLight(stages.scene, stages.materials)
    diffuse, specular, *_ = stages.shade_indirect(method, rows, columns, 512, 999)
    direct = [stages.trace_first(camera, seed)[1] for seed in range(1000, 1064)]
    return np.mean([light.emitted + light.diffuse + light.specular for light in direct], axis=0) + (
        diffuse + specular
    ).reshape(*session.size[::-1], 3)


def test_a_history_makes_later_frames_better(session: Session, path: list[Camera]) -> None:
    session.resize(128, 128)
    frames = list(session.frames(path))
    alone = list(session.frames(path, replace(QUICK, temporal=False)))
    reference = render_centres(session, path[-1])
    assert rel_mse(frames[-1].image, reference) < 0.6 * rel_mse(alone[-1].image, reference)


def test_a_still_picture_converges(session: Session) -> None:
    reference = render_centres(session, session.camera)
    errors = []
    for count in range(1, 129):
        frame = session.render()
        assert frame.accumulated == count
        if count in (1, 12, 128):
            errors.append(rel_mse(frame.image, reference))
    assert errors[1] < 0.85 * errors[0]
    assert errors[2] < 0.5 * errors[1]


def test_movement_and_settings_begin_a_new_average(session: Session, path: list[Camera]) -> None:
    assert [session.render(path[0]).accumulated for _ in range(3)] == [1, 2, 3]
    assert session.render(path[1]).accumulated == 1
    assert session.render(path[1]).accumulated == 2
    assert session.render(path[1], replace(QUICK, adaptive=0.0)).accumulated == 1
    assert session.render(path[1], replace(QUICK, adaptive=0.0, accumulate=False)).accumulated == 1
    assert session.render(path[1], replace(QUICK, adaptive=0.0, accumulate=False)).accumulated == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"similarity": "none"},
        {"similarity": "normal"},
        {"scale": 1},
        {"scale": 16},
        {"temporal": False},
        {"adaptive": 0.0},
        {"adaptive": 1.0},
        {"filter_direct": False},
        {"spp": 30},
        {"beta": 4.0},
        {"radius": 3},
    ],
    ids=str,
)
def test_every_setting_gives_a_picture_like_the_others(session: Session, changes: dict[str, Any]) -> None:
    usual = session.render(None, replace(QUICK, spp=16)).image
    asked = replace(QUICK, **{"spp": 16, **changes})
    for _ in range(2):
        frame = session.render(None, asked)
        assert np.isfinite(frame.image).all()
        assert frame.image.mean() == pytest.approx(usual.mean(), rel=0.2)
        assert frame.settings == asked
    if changes.get("adaptive") == 0.0 or changes.get("scale") == 1:
        assert frame.recomputed == 0


@pytest.mark.parametrize("method", ["voxel_cones", "virtual_lights"])
def test_methods_agree_about_the_brightness(session: Session, method: str) -> None:
    """Coarse voxels and clamped lights: a quarter is their bias, not a factor of two that a lost term would be."""
    asked = replace(QUICK, spp=16, adaptive=0.0)
    expected = session.render(None, asked).get_view("indirect").mean()
    frames = [session.render(None, replace(asked, method=method)) for _ in range(2)]
    assert frames[0].get_view("indirect").mean() == pytest.approx(expected, rel=0.25)
    # What is recorded in the first frame is replayed in the second, with other random numbers.
    samples = [frame.parts.sparse.radiance.color for frame in frames]
    assert samples[1].mean() == pytest.approx(samples[0].mean(), rel=0.25)


def test_lobes_are_no_sharper_than_virtual_lights_are_dense(scene: Any) -> None:
    session = Session(scene, options={"virtual_lights": {"kind": "points"}})
    asked = replace(QUICK, method="virtual_lights")
    found = {}
    for limit, settings in ((True, asked), (False, replace(asked, limit_lobes=False))):
        found[limit] = session.render(None, settings).parts.result.settings["tau"]
    assert found[True] > 1.5 * found[False]
    # What a user sets is left alone.
    assert session.render(None, replace(asked, tau=0.02)).parts.result.settings["tau"] == 0.02


def test_virtual_lights_are_clusters_unless_points_are_asked_for(scene: Any) -> None:
    asked = replace(QUICK, method="virtual_lights")
    found = {}
    for kind in (None, "gaussians", "points"):
        options = {"virtual_lights": {"kind": kind}} if kind else None
        found[kind] = Session(scene, options=options).render(None, asked).get_view("indirect")
    np.testing.assert_array_equal(found[None], found["gaussians"])
    assert not np.allclose(found[None], found["points"], rtol=0.05)


def test_lights_that_change_are_noticed(mi: Any) -> None:
    scene = load_scene("showroom", width=SIZE, height=SIZE)
    session = Session(scene, settings=replace(QUICK, method="voxel_cones"), options={"voxel_cones": {"resolution": 16}})
    before = session.render()
    parameters = mi.traverse(scene)
    name = next(key for key in parameters.keys() if key.endswith("radiance.value"))  # noqa: SIM118
    parameters[name] = parameters[name] * 3.0
    parameters.update()
    session.update_lights()
    after = session.render()
    for part in ("direct", "indirect"):
        ratio = after.get_view(part).mean() / before.get_view(part).mean()
        assert ratio == pytest.approx(3.0, rel=0.05), part


def render_direct(session: Session, path: list[Camera], changes: int = 0, **settings: Any) -> np.ndarray:
    """Return direct light at the end of a path; lights are said to have changed before the last ``changes`` frames."""
    stream = session.make_sibling()
    asked = replace(QUICK, adaptive=0.0, **settings)
    for number, camera in enumerate(path):
        if number >= len(path) - changes:
            stream.update_lights()
        frame = stream.render(camera, asked)
    return frame.get_view("direct")


def compute_direct(session: Session, camera: Camera) -> np.ndarray:
    """Return direct light of a session that becomes 96 pixels wide and high, without noise."""
    session.resize(96, 96)
    reference = session.make_sibling()
    raw = replace(QUICK, adaptive=0.0, temporal=False, filter_direct=False)
    return [reference.render(camera, raw) for _ in range(128)][-1].get_view("direct")


def test_direct_light_has_a_history(session: Session, path: list[Camera]) -> None:
    truth = compute_direct(session, path[-1])
    kept, alone = (render_direct(session, path, temporal=temporal) for temporal in (True, False))
    assert rel_mse(kept, truth) < rel_mse(alone, truth)
    # The history is left behind when lights change.
    np.testing.assert_array_equal(render_direct(session, path, changes=1), alone)
    assert not np.array_equal(kept, alone)


def test_direct_light_gets_better_while_the_camera_rests(session: Session, path: list[Camera]) -> None:
    truth = compute_direct(session, path[-1])
    images = [render_direct(session, [*path, *[path[-1]] * count]) for count in (0, 4, 24)]
    errors = [rel_mse(image, truth) for image in images]
    assert errors[1] < errors[0]
    assert errors[2] < 0.5 * errors[1]


def test_options_are_for_methods_that_exist(scene: Any) -> None:
    with refuses(InputError, "method"):
        Session(scene, options={"voxels": {"resolution": 64}})


def test_views_show_what_they_say(session: Session, path: list[Camera]) -> None:
    for camera in path[:3]:
        frame = session.render(camera)
    views = {name: frame.get_view(name) for name in VIEWS}
    for name, view in views.items():
        radiance = name in ("image", "noisy", "direct", "indirect", "normal", "albedo")
        assert view.shape == ((SIZE, SIZE, 3) if radiance else (SIZE, SIZE)), name
        assert view.dtype == np.float32
        assert np.isfinite(view).all()
        assert view.max() > 0.0, name
        if not radiance or name in ("normal", "albedo"):
            assert view.min() >= 0.0
            assert view.max() <= 1.0
    assert np.allclose(views["direct"] + views["indirect"], views["image"], atol=1e-6)
    assert views["recomputed"].sum() == frame.recomputed
    # A frame later most of the picture goes on.
    assert np.median(views["history"]) > 1.5 / 40.0
    with refuses(InputError, "view"):
        frame.get_view("colour")


def test_history_is_seen_to_be_off(session: Session) -> None:
    session.render()
    assert not session.render(None, replace(QUICK, temporal=False)).get_view("history").any()


def test_a_pair_is_two_streams_of_one_scene(session: Session, base: Session, path: list[Camera]) -> None:
    other = replace(QUICK, similarity="none")
    for camera in path[:2]:
        first, second = session.render_pair(camera, QUICK, other)
    assert np.array_equal(first.parts.hits.gbuffer.depth, second.parts.hits.gbuffer.depth)
    assert not np.array_equal(first.image, second.image)
    alone = base.make_sibling()
    for camera in path[:2]:
        expected = alone.render(camera, QUICK)
    assert np.array_equal(first.image, expected.image)


def test_siblings_do_not_disturb_each_other(session: Session, base: Session, path: list[Camera]) -> None:
    expected = [frame.image for frame in session.frames(path[:3])]
    one, two = base.make_sibling(), base.make_sibling()
    two.resize(32, 24)
    seen = []
    for camera in path[:3]:
        seen.append(one.render(camera).image)
        assert two.render(path[-1]).image.shape == (24, 32, 3)
    for image, alone in zip(seen, expected, strict=True):
        assert np.array_equal(image, alone)


def test_another_size_begins_anew(session: Session) -> None:
    session.render()
    session.resize(40, 24)
    assert session.size == (40, 24)
    frame = session.render()
    assert frame.image.shape == (24, 40, 3)
    assert frame.accumulated == 1


def test_frame_and_result_can_be_written(session: Session, tmp_path: Any) -> None:
    import lobewise

    frame = session.render()
    lobewise.write_frame(tmp_path / "noisy.exr", frame.make_frame())
    lobewise.write_result(tmp_path / "clean.exr", frame.make_result(), source=tmp_path / "noisy.exr")
    read = lobewise.read_frame(tmp_path / "clean.exr")
    assert np.allclose(read.radiance.color, frame.image, rtol=1e-2, atol=1e-3)
    assert np.allclose(read.gbuffer.position, frame.make_frame().gbuffer.position, atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({"method": "radiosity"}, ("method",)),
        ({"similarity": "cosine"}, ("similarity",)),
        ({"scale": 0}, ("scale", "0")),
        ({"scale": 17}, ("scale", "17")),
        ({"spp": 0}, ("spp",)),
        ({"adaptive": 1.5}, ("adaptive",)),
        ({"radius": -1}, ("radius",)),
        ({"beta": 0.0}, ("beta",)),
    ],
    ids=str,
)
def test_bad_settings_are_told(changes: dict[str, Any], refused: tuple[str, ...]) -> None:
    with refuses(InputError, *refused):
        InteractiveSettings(**changes)


def test_bad_sizes_and_scenes_are_told(session: Session, make_furnace: Callable[..., Any]) -> None:
    with refuses(InputError, "width"):
        session.resize(0, 8)
    with refuses(InputError, "scene"):
        Session("showrom")


def test_samples_of_paths_know_their_rays(mi: Any) -> None:
    session = Session("showroom", width=32, height=32)
    rays = session.render(settings=InteractiveSettings(spp=1)).parts.sparse.rays
    assert rays.weight.shape == (8, 8)
    assert 0.5 < rays.weight.mean() < 2.0
    assert np.unique(rays.weight).size > 5
    lights = session.render(settings=InteractiveSettings(method="virtual_lights"))
    assert lights.parts.sparse.rays is None
