"""Cameras that stand still, go round, or follow a file; sensors that take them."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.errors import FileError, InputError
from lobewise.records.camera import Camera
from tests.mistakes import refuses

pytestmark = pytest.mark.mitsuba

SINGLE = 2e-6
"""The sensor holds single precision, of numbers up to 8."""

CAMERA = Camera(position=(1.0, 2.0, 5.0), forward=(-0.2, -0.3, -1.0), up=(0.1, 1.0, 0.0), fov_y=0.7)


@pytest.fixture(scope="module")
def scene(mi: Any) -> Any:
    from lobewise.render import load_scene

    return load_scene("showroom", width=20, height=12)


class TestSetCamera:
    def test_the_scene_returns_the_camera_it_was_given(self, scene: Any) -> None:
        from lobewise.render import get_camera, set_camera

        set_camera(scene, CAMERA)
        found = get_camera(scene)
        for name in ("position", "forward", "up", "fov_y"):
            np.testing.assert_allclose(getattr(found, name), getattr(CAMERA, name), rtol=SINGLE, atol=SINGLE)

    def test_rays_are_those_of_the_camera(self, scene: Any, mi: Any) -> None:
        from lobewise.render import render_frame, set_camera

        set_camera(scene, CAMERA)
        guides = render_frame(scene, spp=1, aov_only=True).gbuffer
        expected = CAMERA.make_positions(guides.depth)
        seen = guides.depth > 0
        assert seen.all()
        np.testing.assert_allclose(guides.position[seen], expected[seen], atol=1e-4)

    def test_pixels_that_are_not_square_are_refused(self, scene: Any) -> None:
        from lobewise.render import set_camera

        with refuses(InputError, "camera fov_x", expected="square pixels on an image of 20x12"):
            set_camera(scene, Camera(CAMERA.position, CAMERA.forward, CAMERA.up, fov_y=0.7, fov_x=0.8))

    def test_another_sensor_is_refused(self, mi: Any) -> None:
        from lobewise.render import set_camera

        film = {"type": "hdrfilm", "width": 1, "height": 1}
        wide = mi.load_dict({"type": "scene", "sensor": {"type": "radiancemeter", "film": film}})
        with refuses(InputError, "sensor"):
            set_camera(wide, CAMERA)


class TestOrbit:
    CENTRE = np.array([0.3, 0.5, -1.0])

    def test_the_first_camera_is_the_given_one(self, mi: Any) -> None:
        from lobewise.render import make_orbit

        first = make_orbit(CAMERA, self.CENTRE, 3, 5.0)[0]
        for name in ("position", "forward", "up"):
            np.testing.assert_allclose(getattr(first, name), getattr(CAMERA, name), atol=1e-12)

    def test_the_camera_turns_about_its_up_and_sees_the_centre_at_the_same_place(self, mi: Any) -> None:
        from lobewise.render import make_orbit

        path = make_orbit(CAMERA, self.CENTRE, 4, 30.0)
        assert len(path) == 4
        for before, after in pairwise(path):
            arms = [camera.position - self.CENTRE for camera in (before, after)]
            flat = [arm - CAMERA.up * (arm @ CAMERA.up) for arm in arms]
            angle = np.arctan2(np.cross(flat[0], flat[1]) @ CAMERA.up, flat[0] @ flat[1])
            assert np.rad2deg(angle) == pytest.approx(30.0, abs=1e-9)
            assert arms[0] @ CAMERA.up == pytest.approx(arms[1] @ CAMERA.up, abs=1e-12)
            # The centre has the same coordinates for both cameras.
            for name in ("forward", "up", "right"):
                was, now = (getattr(camera, name) @ arm for camera, arm in zip((before, after), arms, strict=True))
                assert now == pytest.approx(was, abs=1e-12), name
        assert (path[1].position - path[0].position) @ CAMERA.right > 0.0
        assert path[0].fov_y == path[3].fov_y == CAMERA.fov_y

    @pytest.mark.parametrize(
        ("arguments", "what"),
        [((CENTRE, 0), "frames"), (((1.0, 2.0), 3), "centre"), ((CENTRE, 3, np.nan), "degrees_per_frame")],
    )
    def test_impossible_orbits_are_errors(self, mi: Any, arguments: tuple[Any, ...], what: str) -> None:
        from lobewise.render import make_orbit

        with refuses(InputError, what):
            make_orbit(CAMERA, *arguments)

    def test_the_centre_is_what_the_middle_of_the_image_shows(self, mi: Any) -> None:
        from lobewise.render import find_orbit_centre, load_scene, render_frame

        loaded = load_scene("showroom", width=21)
        guides = render_frame(loaded, spp=1, aov_only=True).gbuffer
        np.testing.assert_allclose(find_orbit_centre(loaded), guides.position[10, 10], atol=1e-4)

    def test_without_a_surface_it_is_the_middle_of_the_scene(self, mi: Any) -> None:
        from lobewise.render import find_orbit_centre

        ball = {"type": "sphere", "center": [3.0, 4.0, 5.0], "radius": 0.5}
        away = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, -1], up=[0, 1, 0])
        loaded = mi.load_dict({"type": "scene", "ball": ball, "eye": {"type": "perspective", "to_world": away}})
        np.testing.assert_allclose(find_orbit_centre(loaded), (3.0, 4.0, 5.0), atol=1e-6)


class TestFile:
    @pytest.fixture
    def read(self, mi: Any, tmp_path: Path) -> Any:
        from lobewise.render import read_camera_path

        def read(content: Any) -> list[Camera]:
            path = tmp_path / "path.json"
            path.write_text(content if isinstance(content, str) else json.dumps(content))
            return read_camera_path(path, CAMERA)

        return read

    def test_cameras_are_as_written(self, read: Any) -> None:
        first, second = read(
            [
                {"position": [0, 1, 5], "target": [0, 1, 0]},
                {"position": [1, 1, 5], "forward": [0, 0, -2], "up": [1, 0, 0], "fov_y": 90},
            ]
        )
        np.testing.assert_allclose(first.forward, (0, 0, -1))
        np.testing.assert_allclose(first.up, (0, 1, 0))
        assert first.fov_y == CAMERA.fov_y
        np.testing.assert_allclose(second.position, (1, 1, 5))
        np.testing.assert_allclose(second.up, (1, 0, 0))
        assert second.fov_y == pytest.approx(np.pi / 2)

    @pytest.mark.parametrize(
        ("content", "refused"),
        [
            ("{}", ("camera path 'path.json'", "an object")),
            ("[]", ("camera path 'path.json'", "an empty list")),
            ("[3]", ("camera path 'path.json', entry 1", "a number")),
            ([{"position": [0, 0, 0]}], ("camera path 'path.json', entry 1", "position")),
            (
                [{"position": [0, 0, 0], "target": [1, 0, 0], "forward": [1, 0, 0]}],
                ("camera path 'path.json', entry 1", "position, target, forward"),
            ),
            ([{"position": [0, 0], "target": [1, 0, 0]}], ("camera path 'path.json', entry 1, position", "[0, 0]")),
            (
                [{"position": [0, 0, True], "target": [1, 0, 0]}],
                ("camera path 'path.json', entry 1, position", "[0, 0, true]"),
            ),
            ([{"position": [0, 0, 0], "target": [0, 0, 0]}], ("camera path 'path.json', entry 1, target",)),
            ([{"position": [0, 0, 0], "target": [0, 2, 0]}], ("camera up",)),
            (
                [{"position": [0, 0, 0], "target": [0, 0, 1], "fov_y": 180}],
                ("camera path 'path.json', entry 1, fov_y",),
            ),
            ([{"positoin": [0, 0, 0], "target": [0, 0, 1]}], ("camera path 'path.json', entry 1, key",)),
        ],
    )
    def test_mistakes_are_one_sentence(self, read: Any, content: Any, refused: tuple[str, ...]) -> None:
        with refuses(InputError, *refused) as caught:
            read(content)
        assert "\n" not in str(caught.value)
        assert "path.json" in str(caught.value)

    @pytest.mark.parametrize(
        ("content", "got"),
        [
            ("[{", "text that is no JSON: it ends too soon, in line 1"),
            ('[{"position": [1%s, 0, 0], "target": [0, 0, 0]}]' % (400 * "0"), "a whole number of 401 digits"),
            ("[" * 200_000, "lists or objects more than 64 deep"),
            ('[{"position": [0, 0, 0], "position": [1, 0, 0]}]', "the key 'position' twice"),
        ],
        ids=["no end", "number", "brackets", "twice"],
    )
    def test_what_is_no_json_is_one_sentence(self, read: Any, content: str, got: str) -> None:
        with refuses(FileError, "camera path 'path.json'", got):
            read(content)

    def test_numbers_beyond_single_precision_are_refused(self, read: Any) -> None:
        for far in (1e308, 1e200, 4e38):
            with refuses(InputError, "camera position", holder="camera path 'path.json', entry 1"):
                read([{"position": [far, 0, 0], "target": [-far, 0, 0]}])

    def test_a_missing_file_is_a_file_error(self, mi: Any, tmp_path: Path) -> None:
        from lobewise.render import read_camera_path

        with refuses(FileError, "camera path 'absent.json'"):
            read_camera_path(tmp_path / "absent.json", CAMERA)
