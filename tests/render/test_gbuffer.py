"""Guides against geometry that is known: planes, mirrors, a moving camera, what lies behind a mask."""

from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, LobeKind
from tests.mistakes import refuses
from tests.render.items import make_camera, make_square
from tests.render.tolerances import EXACT

pytestmark = pytest.mark.mitsuba

EYE = (0.5, 2.0, 6.0)
TARGET = (0.0, 0.5, 0.0)


def make_sensor(mi: Any, width: int = 32, height: int = 20, **changes: Any) -> dict[str, Any]:
    return make_camera(
        mi, EYE, TARGET, up=(0.1, 1, 0), size=(width, height), **{"fov": 50.0, "near_clip": 0.5, **changes}
    )


def make_floor(mi: Any, bsdf: dict[str, Any]) -> dict[str, Any]:
    transform = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(40)
    return {"type": "rectangle", "to_world": transform, "bsdf": bsdf}


def render(mi: Any, *, spp: int = 4, sensor: dict[str, Any] | None = None, **items: Any) -> Frame:
    from lobewise.render import render_frame

    previous = items.pop("previous_camera", None)
    scene = mi.load_dict({"type": "scene", "sensor": sensor or make_sensor(mi), **items})
    return render_frame(scene, spp=spp, previous_camera=previous)


MIRROR = {"type": "twosided", "inner": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.01}}


def test_plane_has_the_depth_position_and_normal_of_the_pixel_centre_ray(mi: Any) -> None:
    frame = render(mi, floor=make_floor(mi, MIRROR), spp=1)
    camera, gbuffer = frame.camera, frame.gbuffer
    assert np.allclose(camera.position, EYE)
    rays = camera.make_ray_directions(frame.width, frame.height).astype(np.float64)
    expected = np.where(rays[..., 1] < 0, -EYE[1] / rays[..., 1], 0.0)
    hit = (expected > 0) & (np.abs(rays[..., 1]) > 0.06)
    assert 0.3 < hit.mean() < 0.99
    # From the eye, although Mitsuba's rays begin at the near plane half a unit away.
    assert np.allclose(gbuffer.depth[hit], expected[hit], rtol=1e-4)
    assert np.allclose(gbuffer.position[hit], (EYE + rays * expected[..., None])[hit], atol=1e-3)
    assert np.allclose(gbuffer.normal[hit], (0, 1, 0), atol=EXACT)
    assert np.allclose(np.abs(gbuffer.tangent[hit]), (1, 0, 0), atol=EXACT)
    sky = rays[..., 1] > 0
    assert sky.any()
    for name in ("depth", "position", "normal", "tangent", "alpha_u", "lobe_kind", "hit_distance"):
        assert np.all(getattr(gbuffer, name)[sky] == 0), name


@pytest.mark.parametrize("axis", ["x", "y", "smaller", "larger"])
@pytest.mark.parametrize(("width", "height"), [(32, 20), (20, 32)])
def test_camera_projects_what_it_sees_to_its_pixel(mi: Any, axis: str, width: int, height: int) -> None:
    from lobewise.records.camera import project_points

    sensor = make_sensor(mi, width, height, fov_axis=axis)
    frame = render(mi, sensor=sensor, floor=make_floor(mi, MIRROR), spp=1)
    pixels = project_points(frame.camera, frame.gbuffer.position, width, height)
    hit = frame.gbuffer.depth > 0
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    assert np.allclose(pixels[hit], np.stack([column, row], axis=-1)[hit], atol=2e-3)
    expected = {"x": width, "y": height, "smaller": min(width, height), "larger": max(width, height)}[axis]
    half = np.tan(np.deg2rad(25.0)) * np.array([width, height]) / expected
    assert np.allclose(frame.camera.get_half_extent(width, height), half, rtol=1e-5)


def test_other_sensors_are_refused(mi: Any) -> None:
    sensor = make_sensor(mi, 1, 1)
    del sensor["fov"], sensor["near_clip"]
    with refuses(InputError, "sensor"):
        render(mi, sensor={**sensor, "type": "radiancemeter"}, floor=make_floor(mi, MIRROR))


CROP = {"crop_offset_x": 3, "crop_offset_y": 8, "crop_width": 24, "crop_height": 11}


@pytest.mark.parametrize(
    "changes",
    [
        {"principal_point_offset_x": 0.1, "principal_point_offset_y": -0.2},
        {"film": {"type": "hdrfilm", "width": 32, "height": 20, **CROP}},
    ],
    ids=["principal point", "crop"],
)
def test_off_centre_cameras_project_what_they_see_to_its_pixel(mi: Any, changes: dict[str, Any]) -> None:
    from lobewise.records.camera import project_points
    from lobewise.render.camera import get_camera, set_camera

    sensor = make_sensor(mi, **changes)
    frame = render(mi, sensor=sensor, floor=make_floor(mi, MIRROR), spp=1)
    assert max(map(abs, frame.camera.shift)) > 0.01
    height, width = frame.shape
    hit = frame.gbuffer.depth > 0
    assert hit.mean() > 0.3
    pixels = project_points(frame.camera, frame.gbuffer.position, width, height)
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    assert np.allclose(pixels[hit], np.stack([column, row], axis=-1)[hit], atol=2e-3)
    scene = mi.load_dict({"type": "scene", "sensor": sensor})
    set_camera(scene, frame.camera)
    again = get_camera(scene)
    assert np.allclose(again.shift, frame.camera.shift, atol=1e-5)
    assert np.isclose(again.fov_y, frame.camera.fov_y, rtol=1e-5)


def test_a_crop_window_shows_a_part_of_the_whole_film(mi: Any) -> None:
    whole = render(mi, floor=make_floor(mi, MIRROR), spp=1)
    film = {"type": "hdrfilm", "width": 32, "height": 20, **CROP}
    part = render(mi, sensor=make_sensor(mi, film=film), floor=make_floor(mi, MIRROR), spp=1)
    assert part.shape == (11, 24)
    for name in ("position", "normal", "depth"):
        expected = getattr(whole.gbuffer, name)[8:19, 3:27]
        assert np.allclose(getattr(part.gbuffer, name), expected, atol=1e-3), name


def test_mirrored_camera_is_refused(mi: Any) -> None:
    flipped = make_sensor(mi)["to_world"] @ mi.ScalarTransform4f().scale([-1, 1, 1])
    with refuses(InputError, "sensor"):
        render(mi, sensor=make_sensor(mi, to_world=flipped), floor=make_floor(mi, MIRROR))


def test_scene_without_sensor_or_of_another_variant_is_refused(mi: Any) -> None:
    from lobewise.render import render_frame

    with refuses(InputError, "scene", "none"):
        render_frame(mi.load_dict({"type": "scene"}), spp=1)
    with refuses(InputError, "scene", "a str under the variant llvm_ad_rgb"):
        render_frame("showroom", spp=1)


def test_hit_of_a_mirror_is_where_the_mirrored_ray_lands(mi: Any) -> None:
    """A floor nearly a mirror, and a wall at z = -4: the distance is that of the mirror image, whatever the sample."""
    wall = make_square(mi.ScalarTransform4f().translate([0, 0, -4]).scale(60), bsdf={"type": "diffuse"})
    frame = render(mi, floor=make_floor(mi, MIRROR), wall=wall, spp=16)
    gbuffer, camera = frame.gbuffer, frame.camera
    on_floor = (gbuffer.lobe_kind == LobeKind.GGX) & (gbuffer.position[..., 2] > -1)
    assert on_floor.mean() > 0.2
    out = (gbuffer.position - camera.position) * np.array([1, -1, 1])
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    distance = (-4 - gbuffer.position[..., 2]) / out[..., 2]
    assert np.allclose(gbuffer.hit_distance[on_floor], distance[on_floor], rtol=0.1)
    hit = gbuffer.position + out * distance[..., None]
    error = np.linalg.norm(gbuffer.hit_position - hit, axis=-1)
    assert np.all(error[on_floor] < 0.1 * distance[on_floor])
    assert np.allclose(gbuffer.hit_position[on_floor][:, 2], -4.0, atol=1e-3)
    on_wall = gbuffer.position[..., 1] > 1.0
    assert on_wall.any()
    assert np.all(gbuffer.hit_distance[on_wall] == 0)


def test_hit_of_the_sky_is_infinitely_far(mi: Any) -> None:
    gbuffer = render(mi, floor=make_floor(mi, MIRROR), sky={"type": "constant"}, spp=8).gbuffer
    near = (gbuffer.depth > 0) & (gbuffer.depth < 8)
    assert near.any()
    assert np.all(np.isinf(gbuffer.hit_distance[near]))
    assert np.all(gbuffer.hit_position[near] == 0)
    assert np.isfinite(gbuffer.hit_position).all()


def test_hit_distance_is_a_harmonic_mean_and_its_position_agrees(mi: Any) -> None:
    from lobewise.render.images import finish_hits
    from lobewise.render.tracing.samples import make_sums

    totals = make_sums(4, True).totals
    # Two samples at 2 and 6 along x; one at 2 and one miss; two misses; none.
    totals.hit_count = mi.Float([2, 2, 2, 0])
    totals.hit_inverse = mi.Float([1 / 2 + 1 / 6, 1 / 2, 0, 0])
    totals.hit_position = mi.Vector3f([2, 1, 0, 0], 0, 0)
    nothing = {"mirror_count": mi.Float(0, 0, 0, 0), "mirror_inverse": mi.Float(0, 0, 0, 0)}
    distance, position = finish_hits(totals, {**nothing, "mirror_position": mi.Vector3f([0, 0, 0, 0], 0, 0)})
    assert np.allclose(distance, [3.0, 4.0, np.inf, 0.0])
    assert np.allclose(position[:, 0], [3.0, 2.0, 0.0, 0.0])


def test_hit_distance_averages_the_inverse_over_the_lobe_misses_included(mi: Any) -> None:
    """Half a ceiling over a rough square: the same mean of 1/t, by sampling the BSDF and cutting the plane by hand."""
    import drjit as dr

    count, height, edge = 200_000, 2.0, 0.8
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.4}
    view = np.array([-0.6, 0.0, 0.8])
    sensor = make_camera(mi, (1.5 * view).tolist(), size=(4, 4), fov=0.05, near_clip=0.1)
    ceiling = mi.ScalarTransform4f().translate([edge + 50, 0, height]).scale(50)
    frame = render(
        mi,
        sensor=sensor,
        square={"type": "rectangle", "bsdf": metal},
        ceiling={"type": "rectangle", "to_world": ceiling},
        lamp={"type": "point", "position": [0, 0, 1], "intensity": 1.0},
        spp=2048,
    )
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(view.tolist())
    rng = mi.PCG32(count)
    point = mi.Point2f(rng.next_float32(), rng.next_float32())
    chosen, weight = mi.load_dict(metal).sample(mi.BSDFContext(), si, rng.next_float32(), point)
    out = np.array(chosen.wo).T[np.array(weight[0]) > 0]
    distance = height / out[:, 2]
    inverse = np.where((distance * out[:, 0] > edge) & (distance * out[:, 0] < edge + 100), 1.0 / distance, 0.0)
    assert 0.3 < np.mean(inverse > 0) < 0.9
    assert np.allclose(1.0 / frame.gbuffer.hit_distance.mean(), inverse.mean(), rtol=0.02)
    where = (distance[:, None] * out * inverse[:, None]).sum(axis=0) / inverse.sum()
    assert np.allclose(frame.gbuffer.hit_position.mean(axis=(0, 1)), where, atol=0.05)


def test_guides_of_a_silhouette_belong_to_one_surface(mi: Any) -> None:
    """No pixel may show a normal, position or alpha between the ball's and the floor's."""
    ball = {"type": "sphere", "center": [0, 1, 0], "radius": 1.0, "bsdf": {"type": "roughconductor", "alpha": 0.5}}
    gbuffer = render(mi, floor=make_floor(mi, MIRROR), ball=ball, spp=16).gbuffer
    rough = np.isclose(gbuffer.alpha_u, 0.5)
    smooth = np.isclose(gbuffer.alpha_u, 0.01)
    assert rough.sum() > 20
    assert np.all(rough | smooth | (gbuffer.depth == 0))
    center = np.array([0.0, 1.0, 0.0])
    assert np.allclose(gbuffer.normal[rough], gbuffer.position[rough] - center, atol=1e-4)
    assert np.allclose(gbuffer.normal[smooth], (0, 1, 0), atol=EXACT)
    assert np.all(gbuffer.lobe_kind[rough] == LobeKind.BECKMANN)
    # Albedos are averages over the samples, and so do blend there.
    blends = gbuffer.specular_albedo[..., 0]
    assert len(np.unique(np.round(blends[rough | smooth], 3))) > 10


def test_normals_face_the_viewer(mi: Any) -> None:
    ball = {"type": "sphere", "radius": 20.0, "bsdf": {"type": "twosided", "inner": {"type": "roughconductor"}}}
    frame = render(mi, ball=ball, spp=1)
    toward = frame.camera.position - frame.gbuffer.position
    assert np.all(np.einsum("...i,...i", toward, frame.gbuffer.normal) > 0)
    assert np.allclose(np.linalg.norm(frame.gbuffer.normal, axis=-1), 1, atol=EXACT)
    assert np.abs(np.einsum("...i,...i", frame.gbuffer.tangent, frame.gbuffer.normal)).max() < EXACT


def test_centre_ray_passes_what_is_mostly_transparent(mi: Any) -> None:
    def veil(z: float, opacity: float) -> dict[str, Any]:
        bsdf = {"type": "mask", "opacity": opacity, "inner": {"type": "roughconductor", "alpha": 0.3}}
        return make_square(mi.ScalarTransform4f().translate([0, 0, z]).scale(30), bsdf=bsdf)

    back = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(60), "bsdf": MIRROR}
    for opacity, z in ((0.2, -2.0), (0.8, 1.0)):
        gbuffer = render(mi, a=veil(2.0, 0.3), b=veil(1.0, opacity), c=back, spp=2).gbuffer
        assert np.allclose(gbuffer.position[..., 2], z, atol=1e-3), opacity


def test_motion_is_where_the_point_was(mi: Any) -> None:
    """The camera moves and turns: every point seen by both must project to the pixel that the motion tells."""
    before = Camera(position=(0.2, 2.1, 6.3), forward=(-0.05, -0.3, -1.0), up=(0, 1, 0), fov_y=0.6)
    frame = render(mi, floor=make_floor(mi, MIRROR), previous_camera=before, spp=1)
    motion, gbuffer = frame.gbuffer.motion, frame.gbuffer
    row, column = 15, 7
    right = np.cross(before.forward, before.up)
    offset = gbuffer.position[row, column] - before.position
    half_height = np.tan(0.3)
    half_width = half_height * frame.width / frame.height
    x = (offset @ right) / (offset @ before.forward) / half_width
    y = (offset @ before.up) / (offset @ before.forward) / half_height
    there = np.array([(x + 1) / 2 * frame.width, (1 - y) / 2 * frame.height])
    assert gbuffer.depth[row, column] > 0
    assert np.allclose(motion[row, column], there - (column + 0.5, row + 0.5), atol=1e-3)


def test_motion_of_the_same_camera_is_none_and_of_the_sky_only_turns(mi: Any) -> None:
    still = render(mi, floor=make_floor(mi, MIRROR), spp=1)
    assert still.gbuffer.motion is None
    camera = still.camera
    assert camera is not None
    same = render(mi, floor=make_floor(mi, MIRROR), previous_camera=camera, spp=1).gbuffer.motion
    assert np.abs(same).max() < 5e-3
    shifted = Camera(camera.position + np.array([5.0, 0.0, 0.0]), camera.forward, camera.up, camera.fov_y)
    frame = render(mi, floor=make_floor(mi, MIRROR), previous_camera=shifted, spp=1)
    motion, sky = frame.gbuffer.motion, frame.gbuffer.depth == 0
    assert np.abs(motion[sky]).max() < 5e-3
    # The camera was further right, so every point stood further left.
    assert np.all(motion[(frame.gbuffer.depth > 0) & (frame.gbuffer.depth < 20)][:, 0] < -1)


def test_motion_of_what_was_behind_the_camera_leads_outside(mi: Any) -> None:
    before = Camera(position=(0.0, 2.0, -60.0), forward=(0, 0, -1), up=(0, 1, 0), fov_y=0.6)
    frame = render(mi, floor=make_floor(mi, MIRROR), previous_camera=before, spp=1)
    motion = frame.gbuffer.motion
    near = (frame.gbuffer.depth > 0) & (frame.gbuffer.depth < 20)
    assert np.all(motion[near] == (2 * frame.width, 2 * frame.height))
