"""The resting picture of the chain against Mitsuba's own integrators, for scenes of every kind."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.interactive import InteractiveSettings, Session
from lobewise.render.camera import make_matrix
from tests.render.any_scene import SCENES, SIZE, load, make_ball, make_room, make_sensor

pytestmark = [pytest.mark.mitsuba, pytest.mark.nightly]

PLAIN = InteractiveSettings(similarity="none", scale=1, adaptive=0.0, temporal=False, spp=4)
"""Nothing is filtered, so that the resting picture is the mean of each pixel's own samples."""
FRAMES = 64
FEW_FRAMES, MANY_SAMPLES = 16, 16
"""Frames, and samples of each, where the scene's integrator is asked for every frame, which takes long to begin."""
LENS_FRAMES = 80
"""The sharp picture of the first frame must have vanished."""
BLOCK = 8
"""Width of the blocks whose means are compared, pixels."""
BLOCK_NOISE = 0.08
"""Largest difference of a block, relative to it and to a tenth of the image's mean: four times its noise."""
MEAN_NOISE = 0.02
"""Largest relative difference of the whole image: four times its noise."""


def sample_reference(mi: Any, scene: Any, spp: int = 1024) -> np.ndarray:
    """Return the light of the scene's integrator along rays through the centres of pixels, (height, width, 3)."""
    import drjit as dr

    sensor = scene.sensors()[0]
    width, height = (int(length) for length in sensor.film().crop_size())
    count = width * height * spp
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, count)
    pixel = dr.arange(mi.UInt32, count) % (width * height)
    place = mi.Point2f((mi.Float(pixel % width) + 0.5) / width, (mi.Float(pixel // width) + 0.5) / height)
    aperture = sampler.next_2d() if sensor.class_name() == "ThinLensCamera" else mi.Point2f(0.5)
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, place, aperture)
    light = scene.integrator().sample(scene, sampler, ray, sensor.get_medium())[0]
    return np.array(light).T.reshape(spp, height, width, 3).mean(axis=0)


def check_picture(image: np.ndarray, reference: np.ndarray) -> None:
    """Compare the means of blocks, and of the image."""
    assert np.isfinite(image).all()
    mean = reference.mean()
    blocks = [
        picture.reshape(picture.shape[0] // BLOCK, BLOCK, -1, BLOCK, 3).mean(axis=(1, 3, 4))
        for picture in (image, reference)
    ]
    difference = np.abs(blocks[0] - blocks[1]) / (blocks[1] + 0.1 * mean)
    assert difference.max() < BLOCK_NOISE, difference.round(3)
    assert abs(image.mean() / mean - 1.0) < MEAN_NOISE


@pytest.mark.parametrize("name", SCENES)
def test_a_resting_picture_is_what_mitsuba_renders(mi: Any, name: str) -> None:
    scene = load(name)
    session, settings, frames = Session(scene, settings=PLAIN), PLAIN, FRAMES
    if session._stages.own_light is not None:
        settings, frames = replace(PLAIN, spp=MANY_SAMPLES), FEW_FRAMES
    for _ in range(frames):
        frame = session.render(settings=settings)
    check_picture(frame.image, sample_reference(mi, scene))


def make_lens_scene(mi: Any, **more: Any) -> Any:
    return mi.load_dict(make_room(mi, object=make_ball({"type": "roughplastic"}), sensor=make_sensor(mi, **more)))


LENS = {"type": "thinlens", "aperture_radius": 0.4, "focus_distance": 1.5}


def test_a_lens_is_seen_when_the_camera_rests(mi: Any) -> None:
    scene = make_lens_scene(mi, **LENS)
    session = Session(scene, settings=replace(PLAIN, spp=MANY_SAMPLES))
    first = session.render()
    for _ in range(LENS_FRAMES):
        last = session.render()
    blurred, sharp = sample_reference(mi, scene), sample_reference(mi, make_lens_scene(mi))
    assert np.abs(first.image - sharp).mean() < np.abs(first.image - blurred).mean()
    assert np.abs(last.image - blurred).mean() < 0.25 * np.abs(sharp - blurred).mean()
    check_picture(last.image, blurred)


def test_a_moved_lens_is_seen(mi: Any) -> None:
    scene = make_lens_scene(mi, **LENS)
    # A session moves the scene's own lens, so the picture of the lens at its place comes first.
    blurred, sharp = sample_reference(mi, scene), sample_reference(mi, make_lens_scene(mi))
    session = Session(scene, settings=replace(PLAIN, spp=MANY_SAMPLES))
    moved = replace(session.camera, position=session.camera.position + 0.4 * session.camera.right)
    for _ in range(LENS_FRAMES):
        last = session.render(moved)
    assert np.abs(last.image - blurred).mean() > 0.5 * np.abs(sharp - blurred).mean()
    matrix = mi.ScalarTransform4f(make_matrix(moved))
    check_picture(last.image, sample_reference(mi, make_lens_scene(mi, **LENS, to_world=matrix)))


def test_a_cropped_film_can_be_resized(mi: Any) -> None:
    scene = load("cropped film")
    session = Session(scene, width=2 * SIZE, height=2 * SIZE, settings=PLAIN)
    for _ in range(32):
        frame = session.render()
    small = frame.image.reshape(SIZE, 2, SIZE, 2, 3).mean(axis=(1, 3))
    check_picture(small, sample_reference(mi, scene))


@pytest.mark.parametrize("method", ["voxel_cones", "virtual_lights"])
@pytest.mark.parametrize("name", ["mask with a texture", "parallel rays"])
def test_every_method_renders_every_scene(name: str, method: Any) -> None:
    session = Session(load(name), options={"voxel_cones": {"resolution": 16}})
    for _ in range(3):
        frame = session.render(settings=InteractiveSettings(method=method))
    assert frame.image.shape == (SIZE, SIZE, 3)
    assert np.isfinite(frame.image).all()
    assert frame.image.mean() > 0.01


@pytest.mark.filterwarnings("error")
def test_a_scene_without_light_is_black(mi: Any) -> None:
    room = make_room(mi)
    del room["lamp"], room["sky"]
    session = Session(mi.load_dict(room))
    for _ in range(2):
        assert session.render().image.max() == 0.0


def test_light_of_surfaces_that_the_guides_do_not_name_is_filtered() -> None:
    """The guides behind a mask of metal name the wall, which has no specular lobe."""
    session = Session(load("mask of metal"))
    first = session.render().get_view("direct")
    for _ in range(64):
        mean = session.render().get_view("direct")
    assert np.sqrt(np.square(first - mean).mean()) < 0.3 * mean.mean()
