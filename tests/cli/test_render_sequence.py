"""`lobewise render --frames`: numbered files, camera paths, moving objects and refused options."""

import json
from itertools import pairwise

import numpy as np
import pytest

from lobewise.cli.program import run
from lobewise.io import read_frame, read_sparse_frame
from lobewise.records.sparse_frame import list_places
from tests.cli import lines


@pytest.fixture
def render(mi, tmp_path, monkeypatch):
    """Return a function that renders the showroom, 16x12 pixels, into an empty folder with given options."""
    monkeypatch.chdir(tmp_path)

    def render(line):
        assert run(["render", "showroom", "--spp", "1", "--width", "16", "--height", "12", *line.split()]) == 0

    return render


def fail(capsys, line):
    return lines.fail(capsys, "render", "showroom", "--spp", "1", "--width", "16", "--height", "12", *line.split())


@pytest.mark.mitsuba
class TestSequence:
    def test_sparse_orbit(self, render, tmp_path, capsys):
        render("--frames 3 --scale 4 --speed 1 -o seq.####.exr")
        assert "seq.0001.exr to seq.0003.exr: 16x12 pixels, one of 4x4 pixels shaded" in capsys.readouterr().out
        assert sorted(path.name for path in tmp_path.iterdir()) == ["seq.0001.exr", "seq.0002.exr", "seq.0003.exr"]
        frames = [read_sparse_frame(tmp_path / f"seq.{number:04d}.exr") for number in (1, 2, 3)]
        assert [frame.place for frame in frames] == list_places(4)[:3]
        assert frames[0].gbuffer.motion is None
        forward = [frame.camera.forward for frame in frames]
        for before, after in pairwise(forward):
            assert np.rad2deg(np.arccos(before @ after)) == pytest.approx(1.0, abs=1e-3)
        for frame in frames[1:]:
            assert 0.1 < np.linalg.norm(frame.gbuffer.motion, axis=-1).max() < 1.0

    def test_rest_of_a_path_in_another_notation(self, render, tmp_path):
        render("--frames 3 --camera-path orbit -o a.####.exr --float")
        render("--frames 1 --start 3 -o b.%04d.exr --float")
        assert (tmp_path / "b.0003.exr").read_bytes() == (tmp_path / "a.0003.exr").read_bytes()

    def test_still_camera_with_moving_objects(self, render, tmp_path):
        render("--frames 2 --camera-path still --moving-objects -o m.#.exr")
        first, second = (read_frame(tmp_path / f"m.{number}.exr") for number in (1, 2))
        np.testing.assert_array_equal(first.camera.position, second.camera.position)
        moved = np.linalg.norm(second.gbuffer.motion, axis=-1) > 1e-2
        assert 0.01 < moved.mean() < 0.2

    def test_objects_move_as_a_file_says(self, render, tmp_path):
        up = {"keys": [{"frame": 1}, {"frame": 3, "translate": [0, 0.4, 0]}]}
        (tmp_path / "moves.json").write_text(json.dumps({"chalk": up}))
        render("--frames 3 --camera-path still --moving-objects moves.json --width 64 --height 64 -o m.#.exr --float")
        frames = [read_frame(tmp_path / f"m.{number}.exr") for number in (1, 2, 3)]
        for step, frame in enumerate(frames):
            # The ball of radius 0.38, which is nearest to the camera there.
            position = frame.gbuffer.position - np.array([0.95, 0.38 + 0.2 * step, 1.3])
            ball = np.abs(np.linalg.norm(position, axis=-1) - 0.38) < 1e-3
            assert ball.sum() > 10
            if step:
                assert (frame.gbuffer.motion[ball][:, 1] > 1.0).all()
                assert np.abs(frame.gbuffer.motion[~ball]).max() < 1e-2
        # A rest of the path is that of the whole.
        render(
            "--frames 1 --start 3 --camera-path still --moving-objects moves.json"
            " --width 64 --height 64 -o r.#.exr --float"
        )
        assert (tmp_path / "r.3.exr").read_bytes() == (tmp_path / "m.3.exr").read_bytes()

    def test_the_word_after_the_switch_may_be_the_scene(self, mi, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        line = "render --frames 2 --moving-objects showroom --spp 1 --width 8 --height 8 -o m.#.exr"
        assert run(line.split()) == 0
        assert read_frame(tmp_path / "m.2.exr").gbuffer.motion is not None

    def test_path_of_a_file(self, render, tmp_path, capsys):
        cameras = [{"position": [x, 3.0, 7.0], "target": [0, 0.7, 0]} for x in (0.0, 0.25)]
        (tmp_path / "path.json").write_text(json.dumps(cameras))
        render("--frames 2 --camera-path path.json --reference -o p.####.exr")
        second = read_frame(tmp_path / "p.0002.exr")
        np.testing.assert_allclose(second.camera.position, (0.25, 3.0, 7.0), rtol=1e-6)
        assert second.gbuffer.position is None
        assert "3 cameras" in fail(capsys, "--frames 3 --camera-path path.json -o p.####.exr").expected
        assert "3 cameras" in fail(capsys, "--frames 1 --start 3 --camera-path path.json -o p.#.exr").expected

    def test_one_frame_needs_no_pattern(self, render, tmp_path):
        render("--frames 1 --scale 2 -o one.exr")
        assert read_sparse_frame(tmp_path / "one.exr").place == (0, 0)


@pytest.mark.mitsuba
class TestMistakes:
    @pytest.mark.parametrize(
        ("moves", "message"),
        [
            ({"chalks": {"keys": [{"frame": 1}]}}, "did you mean 'chalk'"),
            ({"chalk": {"matrices": [np.eye(4).tolist()]}}, "at least 2 matrices"),
            ({"chalk": {"matrices": [np.eye(4).tolist(), np.zeros((4, 4)).tolist()]}}, "matrix 2: expected a matrix"),
            ({"chalk": {"matrices": [np.diag([1.0, 0, 1, 1]).tolist()] * 2}}, "got a singular one"),
            ({"chalk": {"keys": [{"frame": 2, "scale": [1, 2, 1]}]}}, "one scale"),
        ],
        ids=["id", "count", "last row", "singular", "sphere"],
    )
    def test_wrong_moves_of_a_file(self, render, tmp_path, capsys, moves, message):
        (tmp_path / "moves.json").write_text(json.dumps(moves))
        assert message in str(fail(capsys, "--frames 2 --moving-objects moves.json -o out.####.exr"))
        assert [path.name for path in tmp_path.iterdir()] == ["moves.json"]
