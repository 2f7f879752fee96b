"""Built-in scenes are what their names promise; scene files load, or say in one sentence why not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.errors import FileError, InputError
from lobewise.records.frame import Frame, LobeKind
from lobewise.render import list_moving_scenes, list_scenes, load_scene
from tests.mistakes import refuses
from tests.render.tracing.test_paths import compare_with_mitsuba

Frames = Callable[[str], Frame]

SKY = {"stilllife": 0.2, "street": 0.2}
"""Scenes with something to be seen behind all surfaces, and the most of the picture that it may take."""

SLOW = dict.fromkeys(("kitchen", "street"), pytest.mark.nightly)
"""Scenes of so many materials that their kernels take seconds to compile."""

XML = """<scene version="3.0.0">
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="1,2,5" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="20"/></film>
  </sensor>
  <shape type="sphere"><bsdf type="roughplastic"/></shape>
  <emitter type="constant"/>
</scene>"""


def test_unknown_name_proposes_the_nearest() -> None:
    with refuses(InputError, "scene"):
        load_scene("showrom")


@pytest.mark.parametrize("size", [{"width": 0}, {"height": -3}, {"width": 100_000}])
def test_impossible_size_is_an_error(size: dict[str, int]) -> None:
    with refuses(InputError, next(iter(size))):
        load_scene("showroom", **size)


def test_missing_file_and_folder_are_file_errors(tmp_path: Path) -> None:
    with refuses(FileError, "absent.xml"):
        load_scene(tmp_path / "absent.xml")
    with pytest.raises(FileError, match="a folder"):
        load_scene(tmp_path)


@pytest.mark.parametrize("name", ["brushed", "scene.xml"])
def test_scenes_that_stand_still_have_no_other_time(name: str) -> None:
    with refuses(InputError, "scene", repr(name)):
        load_scene(name, time=1.0)


@pytest.mark.mitsuba
def test_scenes_are_the_same_every_time(mi: Any) -> None:
    # The order of lights decides which light a random number chooses.
    for _ in range(4):
        scene = load_scene("parlour", width=8)
        assert [light.get_shape().id() for light in scene.emitters()] == ["uplight_1", "uplight_2", "uplight_3"]


@pytest.mark.mitsuba
@pytest.mark.parametrize("name", list_moving_scenes())
def test_objects_begin_where_they_stand_and_move_on(mi: Any, name: str) -> None:
    from lobewise.render.loading import build_scene
    from lobewise.scenes import parts

    gray = parts.diffuse((0.5, 0.5, 0.5))
    standing = {
        "showroom": {
            "plastic": parts.sphere((-0.5, 0.45, 0.9), 0.45, gray),
            "cube": parts.box((2.3, 0.32, 1.5), (0.32, 0.32, 0.32), gray, 30),
        },
        "parlour": {
            "pearl": parts.sphere((0.55, 0.88, 0.45), 0.16, gray),
            "stool": parts.box((1.7, 0.2, 1.85), (0.30, 0.2, 0.30), gray, 20),
        },
    }[name]

    def list_boxes(scene: Any) -> dict[str, np.ndarray]:
        found = {each.id(): each.bbox() for each in scene.shapes()}
        return {key: np.array([found[key].min, found[key].max]) for key in standing}

    expected = list_boxes(build_scene({"type": "scene", **standing}))
    start, later = list_boxes(load_scene(name, width=8)), list_boxes(load_scene(name, width=8, time=5.0))
    for key, box in expected.items():
        np.testing.assert_array_equal(start[key], box)
        assert np.abs(later[key] - box).max() > 0.01


@pytest.mark.mitsuba
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "No document element"),
        ("<scene version='3.0.0'><shape", "Error parsing"),
        ("<scene version='3.0.0'><shape type='teapott'/></scene>", "teapott"),
        ("<bsdf version='3.0.0' type='diffuse'/>", "a BSDF"),
    ],
)
def test_bad_xml_is_one_sentence(mi: Any, tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.mitsuba
@pytest.mark.parametrize(
    ("size", "shape"),
    [({}, (20, 40)), ({"width": 60}, (30, 60)), ({"height": 10}, (10, 20)), ({"width": 8, "height": 8}, (8, 8))],
)
def test_scene_file_is_rendered_at_the_size_asked_for(
    mi: Any, tmp_path: Path, size: dict[str, int], shape: tuple[int, int]
) -> None:
    from lobewise.render import get_camera, render_frame

    path = tmp_path / "scene.xml"
    path.write_text(XML)
    scene = load_scene(path, **size)
    frame = render_frame(scene, spp=1)
    assert frame.shape == shape
    assert np.allclose(get_camera(scene).position, (1, 2, 5))
    assert set(np.unique(frame.gbuffer.lobe_kind)) == {LobeKind.NONE, LobeKind.BECKMANN}


@pytest.mark.sampled("showroom", "brushed", "sparks")
@pytest.mark.mitsuba
@pytest.mark.parametrize("name", [pytest.param(name, marks=SLOW.get(name, ())) for name in list_scenes()])
def test_scene_is_lit_and_glossy(built_in_frames: Frames, name: str) -> None:
    frame = built_in_frames(name)
    assert frame.shape == (24, 24)
    assert np.isfinite(frame.radiance.color).all()
    assert 0.05 < np.median(frame.radiance.color) < 1.5
    shiny = np.isin(frame.gbuffer.lobe_kind, (LobeKind.GGX, LobeKind.BECKMANN, LobeKind.DELTA))
    assert shiny.mean() > 0.3
    assert (~shiny).mean() > 0.1
    sky = (frame.gbuffer.depth == 0).mean()
    assert sky == 0 if name not in SKY else 0.02 < sky < SKY[name]


@pytest.mark.mitsuba
@pytest.mark.nightly
@pytest.mark.parametrize("name", list_scenes())
def test_built_in_scenes_agree_with_mitsuba(mi: Any, name: str, built_in_frames: Frames) -> None:
    frame = built_in_frames(name)
    scene = load_scene(name, width=frame.width)

    # Of small lights and their caustics some pixels catch one sample and some none; their variance means nothing.
    compare_with_mitsuba(mi, scene, frame.spp or 0, frame=frame, has_sparks=name == "sparks")


@pytest.mark.mitsuba
def test_showroom_floor_differs_in_nothing_but_its_lobes(built_in_frames: Frames) -> None:
    gbuffer = built_in_frames("showroom").gbuffer
    floor = np.abs(gbuffer.position[..., 1]) < 1e-4
    assert floor.mean() > 0.3
    assert np.allclose(gbuffer.normal[floor], (0, 1, 0), atol=1e-5)
    alpha = gbuffer.alpha_u[floor]
    assert alpha.min() == pytest.approx(0.03, abs=0.005)
    assert alpha.max() == pytest.approx(0.6, abs=0.02)
    assert len(np.unique(np.round(alpha, 3))) > 30
    # Albedos are averages over the samples: only the pixels at the edge of an object show any other.
    assert (gbuffer.diffuse_albedo[floor].max(axis=-1) == 0).mean() > 0.8


@pytest.mark.mitsuba
def test_showroom_floor_is_made_of_patches_and_ramps(mi: Any) -> None:
    from lobewise.scenes.showroom import TILE_COLUMNS, make_floor_alpha

    alpha = make_floor_alpha(32)
    assert alpha.min() >= 0.03
    assert alpha.max() <= 0.6
    corner = alpha[::32, ::32]
    assert np.all(corner[0, 1:] != corner[0, :-1])
    ramp = alpha[32]
    assert np.all(np.diff(ramp) < 0)
    assert ramp.max() / ramp.min() > 15
    assert len(ramp) == 32 * TILE_COLUMNS


@pytest.mark.mitsuba
def test_brushed_has_long_lobes_and_normals_that_vary(built_in_frames: Frames) -> None:
    gbuffer = built_in_frames("brushed").gbuffer
    ratio = gbuffer.alpha_u / np.maximum(gbuffer.alpha_v, 1e-6)
    assert ((ratio > 3) | ((ratio < 1 / 3) & (ratio > 0))).mean() > 0.3
    floor = np.abs(gbuffer.position[..., 1]) < 1e-4
    assert floor.mean() > 0.15
    assert gbuffer.normal[floor].std(axis=0).max() > 0.02


@pytest.mark.mitsuba
def test_parlour_is_lit_indirectly(built_in_frames: Frames) -> None:
    radiance = built_in_frames("parlour").radiance
    assert (radiance.indirect > radiance.direct).mean() > 0.75
    assert np.median(radiance.indirect) > 20.0 * np.median(radiance.direct)


@pytest.mark.mitsuba
def test_sparks_has_fireflies(built_in_frames: Frames) -> None:
    frame = built_in_frames("sparks")
    # Where one sample's standard deviation is seven times the mean, a few samples bring most of the light.
    deviation = np.sqrt(frame.variance.color * frame.spp).mean(axis=-1)
    assert (deviation > 7.0 * frame.radiance.color.mean(axis=-1)).mean() > 0.05
    assert (frame.gbuffer.lobe_kind == LobeKind.DELTA).mean() > 0.05


@pytest.mark.nightly
@pytest.mark.mitsuba
def test_stilllife_has_paint_glass_and_a_studio_all_around(built_in_frames: Frames) -> None:
    frame = built_in_frames("stilllife")
    gbuffer = frame.gbuffer
    sky = gbuffer.depth == 0
    # What is seen of the studio is of several colours.
    assert frame.radiance.color[sky].std(axis=0).min() > 0.05
    assert (gbuffer.lobe_kind == LobeKind.DELTA).mean() > 0.04
    alpha = gbuffer.alpha_u[gbuffer.lobe_kind == LobeKind.GGX]
    for low, high in ((0.015, 0.03), (0.1, 0.13), (0.15, 0.3)):  # lacquer, frosted glass, flakes and satin metal
        assert ((alpha > low) & (alpha < high)).mean() > 0.02


def test_studio_shines_from_soft_boxes_and_no_light_is_tiny() -> None:
    pytest.importorskip("mitsuba")
    from lobewise.render.variant import load_mitsuba

    load_mitsuba()
    from lobewise.scenes.stilllife import SUN_DEGREES, make_studio

    studio = make_studio(256).mean(axis=-1)
    solid_angle = np.sin((np.arange(256) + 0.5) / 256 * np.pi)[:, None] * np.full((1, 512), np.pi / 256 * np.pi / 256)
    assert solid_angle.sum() == pytest.approx(4.0 * np.pi, rel=1e-4)
    # A disc of the sun's width, whose soft edge makes it a little larger or smaller.
    disc = 2.0 * np.pi * (1.0 - np.cos(np.deg2rad(0.5 * SUN_DEGREES)))
    assert solid_angle[studio > 50.0].sum() == pytest.approx(disc, rel=0.15)
    power = solid_angle * studio
    bright = (studio > 2.0) & (studio < 50.0)
    assert 0.3 < power[bright].sum() / power.sum() < 0.9


@pytest.mark.mitsuba
def test_corridor_has_mirrors_beside_satin_and_a_floor_of_many_alphas(built_in_frames: Frames) -> None:
    frame = built_in_frames("corridor")
    gbuffer = frame.gbuffer
    x, y = gbuffer.position[..., 0], gbuffer.position[..., 1]
    left, right, floor = x < -1.6, x > 1.6, np.abs(y) < 1e-4
    assert ((gbuffer.lobe_kind == LobeKind.DELTA) & left).sum() > 10
    near_mirror = (gbuffer.alpha_u > 0.01) & (gbuffer.alpha_u < 0.031) & (gbuffer.lobe_kind == LobeKind.GGX)
    assert (near_mirror & left).sum() > 3
    satin = (gbuffer.alpha_u >= 0.149) & (gbuffer.alpha_u <= 0.301)
    assert (satin & right).sum() > 15
    assert np.ptp(gbuffer.alpha_u[floor]) > 0.12
    assert len(np.unique(np.round(gbuffer.alpha_u[floor], 3))) > 15
    # Light in a mirror was scattered before, except where a lamp is seen in it; large pixels show its frame too.
    mirror = (gbuffer.lobe_kind == LobeKind.DELTA) & left
    assert np.median(frame.radiance.direct[mirror]) < 0.25 * np.median(frame.radiance.indirect[mirror])


@pytest.mark.mitsuba
def test_lathe_is_the_body_that_its_outline_says(mi: Any) -> None:
    from lobewise.render.loading import build_scene
    from lobewise.scenes import parts

    # Half a circle from pole to pole: a ball, whose normals are its directions.
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 65)
    outline = 0.8 * np.stack([np.maximum(np.cos(angle), 0.0), np.sin(angle)], axis=-1)
    outline[[0, -1], 0] = 0.0
    scene = build_scene(
        {"type": "scene", "body": parts.lathe(outline, (0.3, 0.5, -0.2), parts.diffuse((0.5, 0.5, 0.5)))}
    )
    generator = np.random.default_rng(5)
    toward = generator.normal(size=(3, 400))
    toward /= np.linalg.norm(toward, axis=0)
    center = np.array([[0.3], [0.5], [-0.2]])
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(center + 3.0 * toward), mi.Vector3f(-toward)))
    assert np.all(np.array(si.is_valid()))
    # 96 facets around: their chords lie up to r (1 - cos(pi / 96)) = 0.0005 r inside.
    assert np.allclose(np.linalg.norm(np.array(si.p) - center, axis=0), 0.8, atol=1e-3)
    assert np.allclose(np.array(si.n), toward, atol=0.06)
    assert np.allclose(np.array(si.sh_frame.n), toward, atol=5e-3)
    assert np.array(si.uv).min() >= 0
    assert np.array(si.uv).max() <= 1


@pytest.mark.mitsuba
def test_curve_goes_through_its_points(mi: Any) -> None:
    from lobewise.scenes import parts

    points = ((0.0, 0.0), (0.4, 0.1), (0.5, 0.6), (0.2, 1.0))
    curve = parts.curve(points, steps=8)
    assert np.allclose(curve[::8], points)
    assert curve.shape == (25, 2)
    # Points on a line, evenly spaced, stay evenly spaced.
    line = parts.curve(((0.0, 0.0), (1.0, 2.0), (2.0, 4.0)), steps=4)
    assert np.allclose(line, np.linspace((0.0, 0.0), (2.0, 4.0), 9))


@pytest.mark.nightly
@pytest.mark.mitsuba
def test_kitchen_has_steel_brushed_both_ways_tiles_askew_and_lacquer(built_in_frames: Frames) -> None:
    gbuffer = built_in_frames("kitchen").gbuffer
    ratio = gbuffer.alpha_u / np.maximum(gbuffer.alpha_v, 1e-6)
    assert (ratio > 3).sum() > 4
    assert ((ratio < 1 / 3) & (ratio > 0)).sum() > 10
    tiles = np.isclose(gbuffer.position[..., 2], -2.0, atol=1e-4)
    assert tiles.mean() > 0.1
    assert gbuffer.normal[tiles].std(axis=0)[:2].min() > 0.01
    # Joints are dull, tiles are not.
    assert {LobeKind.GGX} <= set(gbuffer.lobe_kind[tiles])
    lacquer = (gbuffer.alpha_u == gbuffer.alpha_v) & (gbuffer.alpha_u >= 0.03) & (gbuffer.alpha_u <= 0.1)
    assert lacquer.mean() > 0.2


@pytest.mark.nightly
@pytest.mark.mitsuba
def test_street_has_puddles_in_bumpy_asphalt(built_in_frames: Frames) -> None:
    gbuffer = built_in_frames("street").gbuffer
    street = (np.abs(gbuffer.position[..., 1]) < 1e-4) & (gbuffer.depth > 0)
    assert street.mean() > 0.25
    alpha, normal = gbuffer.alpha_u[street], gbuffer.normal[street]
    puddle, asphalt = alpha < 0.03, alpha > 0.12
    assert puddle.mean() > 0.05
    assert asphalt.mean() > 0.3
    assert normal[asphalt][:, [0, 2]].std(axis=0).min() > 2.0 * normal[puddle][:, [0, 2]].std(axis=0).max() > 0


@pytest.mark.mitsuba
def test_waves_have_the_slopes_of_their_height(mi: Any) -> None:
    from lobewise.scenes.street import make_waves

    step = 1e-3
    x, y = np.meshgrid(np.arange(160) * 0.12, np.arange(160) * 0.12)
    _, slope_x, slope_y = make_waves(x, y, 40, (0.3, 1.6), 3)
    for slope, dx, dy in ((slope_x, step, 0.0), (slope_y, 0.0, step)):
        ahead, behind = (make_waves(x + k * dx, y + k * dy, 40, (0.3, 1.6), 3)[0] for k in (1, -1))
        assert np.allclose(slope, (ahead - behind) / (2.0 * step), atol=2e-3)  # third derivative times step squared
    # Forty waves of random direction: the two variances share what is one each on average.
    assert slope_x.var() + slope_y.var() == pytest.approx(2.0, rel=0.1)
