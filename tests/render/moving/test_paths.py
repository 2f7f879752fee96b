"""Files that say where shapes are over time."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.errors import FileError, InputError
from tests.mistakes import refuses
from tests.render.moving.places import slide, stretch, turn

pytestmark = pytest.mark.mitsuba


def read(mi: Any, folder: Path, told: Any) -> Any:
    from lobewise.render import read_object_paths

    path = folder / "moves.json"
    path.write_text(told if isinstance(told, str) else json.dumps(told))
    return read_object_paths(path)


def test_keys_are_interpolated(mi: Any, tmp_path: Path) -> None:
    about = (1.0, 2.0, 3.0)
    keys = [
        {"frame": 2},
        {"frame": 4, "degrees": 90, "translate": [1, 0, -2]},
        {"frame": 5, "degrees": 450, "translate": [1, 0, -2], "scale": [1, 2, 3]},
    ]
    paths = read(mi, tmp_path, {"cube": {"about": list(about), "keys": keys}})
    middle = slide(*about)
    for frame, expected in (
        (1, np.eye(4)),
        (2, np.eye(4)),
        (3, slide(0.5, 0, -1) @ turn(45.0, about)),
        (4, slide(1, 0, -2) @ turn(90.0, about)),
        (4.5, slide(1, 0, -2) @ turn(270.0, about) @ middle @ stretch(1, 1.5, 2) @ np.linalg.inv(middle)),
        (9, slide(1, 0, -2) @ turn(90.0, about) @ middle @ stretch(1, 2, 3) @ np.linalg.inv(middle)),
    ):
        np.testing.assert_allclose(paths.compute_places(frame)["cube"], expected, atol=1e-12, err_msg=str(frame))


def test_turns_are_right_handed_about_any_axis(mi: Any, tmp_path: Path) -> None:
    """Against Mitsuba's own rotations."""
    keys = [{"frame": 1, "degrees": 30, "scale": 2}]
    for axis in ([1, 0, 0], [0, 0, 2], [1, -2, 3]):
        found = read(mi, tmp_path, {"a": {"axis": axis, "keys": keys}}).compute_places(1)["a"]
        expected = np.array(
            mi.ScalarTransform4f().rotate((np.array(axis) / np.linalg.norm(axis)).tolist(), 30).matrix
        ) @ stretch(2, 2, 2)
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_matrices_are_those_of_the_frames(mi: Any, tmp_path: Path) -> None:
    steps = [slide(0.1 * k, 0, 0) for k in range(3)]
    paths = read(mi, tmp_path, {"a": {"matrices": [step.tolist() for step in steps]}})
    for frame, step in enumerate(steps, start=1):
        np.testing.assert_array_equal(paths.compute_places(frame)["a"], step)
    paths.require_frames(3)
    with refuses(InputError, "moving objects 'moves.json', shape 'a'", "3", "at least 4 matrices, one for each frame"):
        paths.require_frames(4)


def test_sequences_take_placed_scenes(mi: Any, tmp_path: Path) -> None:
    from lobewise.render import PlacedScene, get_camera, load_scene, render_sequence

    scene = load_scene("showroom", width=48, height=48)
    keys = [{"frame": 1}, {"frame": 3, "degrees": 60}]
    moving = PlacedScene(scene, read(mi, tmp_path, {"cube": {"about": [2.3, 0.32, 1.5], "keys": keys}}))
    frames = list(render_sequence(moving, [get_camera(scene)] * 3, spp=1, scale=4))
    assert frames[0].gbuffer.motion is None
    for number, frame in enumerate(frames[1:], start=1):
        position = frame.gbuffer.position.astype(np.float64)
        local = position @ turn(-30.0 * number - 30.0, (0, 0, 0))[:3, :3].T
        centre = turn(-30.0 * number - 30.0, (0, 0, 0))[:3, :3] @ (2.3, 0.32, 1.5)
        cube = np.abs(local - centre).max(axis=-1) < 0.321
        cube &= position[..., 1] > 1e-3
        assert cube.sum() > 20
        assert np.linalg.norm(frame.gbuffer.motion[cube], axis=-1).max() > 1.0
        assert np.linalg.norm(frame.gbuffer.motion[~cube], axis=-1).max() < 1e-2


WRONG = {
    "no object": ([1], "", "a list"),
    "empty": ({}, "", "an empty object"),
    "text": ("{", "", "text that is no JSON: it ends too soon, in line 1"),
    "path": ({"a": 3}, ", shape 'a'", "a number"),
    "key of a path": ({"a": {"key": []}}, ", shape 'a', key", "'key'"),
    "both": ({"a": {"keys": [{"frame": 1}], "matrices": []}}, ", shape 'a'", "keys, matrices"),
    "axis of matrices": ({"a": {"axis": [0, 1, 0], "matrices": []}}, ", shape 'a'", "axis, matrices"),
    "no list": ({"a": {"keys": 3}}, ", shape 'a', keys", "a number"),
    "no keys": ({"a": {"keys": []}}, ", shape 'a', keys", "an empty list"),
    "no frame": ({"a": {"keys": [{"degrees": 3}]}}, ", shape 'a', key 1", "degrees"),
    "frame 0": ({"a": {"keys": [{"frame": 0}]}}, ", shape 'a', key 1, frame", "0"),
    "order": ({"a": {"keys": [{"frame": 2}, {"frame": 2}]}}, ", shape 'a', frame", "2 and then 2"),
    "unknown": ({"a": {"keys": [{"frame": 2, "turn": 2}]}}, ", shape 'a', key 1, key", "'turn'"),
    "short": ({"a": {"keys": [{"frame": 2, "translate": [1, 2]}]}}, ", shape 'a', key 1, translate", "[1, 2]"),
    "scale 0": ({"a": {"keys": [{"frame": 2, "scale": 0}]}}, ", shape 'a', key 1, scale", "0"),
    "mirror": ({"a": {"keys": [{"frame": 2, "scale": [1, -1, 1]}]}}, ", shape 'a', key 1, scale", "[1, -1, 1]"),
    "large": ({"a": {"keys": [{"frame": 2, "translate": [1e300, 0, 0]}]}}, ", shape 'a', key 1, translate", "1e+300"),
    "no axis": ({"a": {"axis": [0, 0, 0], "keys": [{"frame": 2}]}}, ", shape 'a', axis", "a length of 0"),
    "rows": ({"a": {"matrices": [[[1, 0, 0, 0]]]}}, ", shape 'a', matrix 1", "1 of them"),
    "row": ({"a": {"matrices": [[[1, 0, 0]] * 4]}}, ", shape 'a', matrix 1, row 1", "[1, 0, 0]"),
    "singular": (
        {"a": {"matrices": [np.diag([1.0, 0.0, 1.0, 1.0]).tolist()]}},
        ", shape 'a', matrix 1",
        "a singular one",
    ),
}


@pytest.mark.parametrize(("told", "where", "got"), WRONG.values(), ids=WRONG)
def test_wrong_files_are_told_in_a_sentence(mi: Any, tmp_path: Path, told: Any, where: str, got: str) -> None:
    with refuses((InputError, FileError), f"moving objects 'moves.json'{where}", got):
        read(mi, tmp_path, told)


def test_shapes_that_are_not_there_are_told_before_the_first_frame(mi: Any, tmp_path: Path) -> None:
    from lobewise.render import PlacedScene, load_scene

    scene = load_scene("showroom", width=8, height=8)
    with refuses(InputError, "shape", holder="moving objects 'moves.json'"):
        PlacedScene(scene, read(mi, tmp_path, {"cub": {"keys": [{"frame": 1}]}}))
    with refuses(InputError, "transform of 'gold'", holder="moving objects 'moves.json'"):
        PlacedScene(scene, read(mi, tmp_path, {"gold": {"keys": [{"frame": 1}, {"frame": 2, "scale": [1, 2, 1]}]}}))
