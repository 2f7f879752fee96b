"""Panoramas by latitude and longitude: positions tell where the camera stands, and that the image wraps around."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import lobewise
from lobewise.cli.program import run
from lobewise.guides.lamps import keep_lamps
from lobewise.interchange.cameras.panorama import fit_panorama
from lobewise.interchange.reading import import_file
from lobewise.io import write_frame
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.sparse_frame import make_sparse

SIZE = 48, 96
EYE = np.array([1.0, -2.0, 1.5])
ROOM = np.array([[-4.0, -5.0, 0.0], [3.0, 6.0, 3.0]])
"""Two opposite corners of a room."""


def make_rays(heading: float = 0.7, roll: float = 0.2) -> FloatArray:
    """Return the directions of pixels in a right-handed world, of a camera that is turned and tilted."""
    height, width = SIZE
    latitude = (0.5 - (np.arange(height) + 0.5) / height)[:, None] * np.pi
    longitude = ((np.arange(width) + 0.5) / width * 2.0 - 1.0) * np.pi
    camera = Camera(EYE, (np.cos(heading), np.sin(heading), 0.1), (0.0, np.sin(roll), np.cos(roll)), 1.0)
    flat = np.cos(latitude)
    parts = flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude) + 0.0 * longitude
    axes = camera.forward, camera.right, camera.up
    return sum(part[..., None] * axis for part, axis in zip(parts, axes, strict=True))  # type: ignore[return-value]


def make_room(rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and normals of the walls of the room."""
    with np.errstate(divide="ignore"):
        distances = np.where(rays > 0.0, ROOM[1] - EYE, ROOM[0] - EYE) / rays
    axis = np.argmin(distances, axis=-1)[..., None]
    position = EYE + np.take_along_axis(distances, axis, -1) * rays
    normal = np.zeros_like(rays)
    np.put_along_axis(normal, axis, -np.sign(np.take_along_axis(rays, axis, -1)), -1)
    return position.astype(np.float32), normal.astype(np.float32)


POSITION, NORMAL = make_room(make_rays())
EVERYWHERE = np.ones(SIZE, np.bool_)


@pytest.mark.parametrize("turn", [0, 31])
@pytest.mark.parametrize("mirrored", [False, True])
def test_the_eye_is_found(turn: int, mirrored: bool) -> None:
    sign = np.array([-1.0 if mirrored else 1.0, 1.0, 1.0])
    fit = fit_panorama(np.roll(sign * POSITION, turn, axis=1).astype(np.float32), EVERYWHERE)
    np.testing.assert_allclose(fit.camera.position, sign * EYE, atol=1e-4)
    assert fit.error < 1e-3
    assert fit.camera.get_pixel_angle(SIZE[0]) == pytest.approx(np.pi / SIZE[0])


def test_positions_anywhere_in_their_pixels() -> None:
    random = np.random.default_rng(3)
    step = np.linalg.norm(POSITION - EYE, axis=-1, keepdims=True) * np.pi / SIZE[0]
    moved = POSITION + step * random.uniform(-0.5, 0.5, POSITION.shape)
    moved[::7, ::5] *= 3.0  # at silhouettes
    fit = fit_panorama(moved.astype(np.float32), EVERYWHERE)
    np.testing.assert_allclose(fit.camera.position, EYE, atol=0.02)


def test_other_images_are_no_panorama() -> None:
    height, width = SIZE
    assert fit_panorama(POSITION[:, : width // 2], EVERYWHERE[:, : width // 2]) is None, "half of it"
    assert fit_panorama(POSITION[: height // 2], EVERYWHERE[: height // 2]) is None
    seen = EVERYWHERE.copy()
    seen[:, : width // 5] = False
    assert fit_panorama(POSITION, seen) is None
    random = np.random.default_rng(1)
    pinhole = Camera(EYE, (1, 0, 0), (0, 0, 1), 1.0).make_positions(random.uniform(2, 4, SIZE).astype(np.float32))
    assert fit_panorama(pinhole, EVERYWHERE) is None
    assert fit_panorama(random.normal(size=(*SIZE, 3)).astype(np.float32), EVERYWHERE) is None
    assert fit_panorama(np.ones((*SIZE, 3), np.float32), EVERYWHERE) is None


def write_passes(path: Path, images: dict[str, tuple[FloatArray, str]], **header: object) -> Path:
    """Write images and the letters of their channels as passes of Cycles."""
    planes = {
        f"ViewLayer.{name}.{letter}": np.ascontiguousarray(image[..., k], np.float32)
        for name, (image, letters) in images.items()
        for k, letter in enumerate(letters)
    }
    OpenEXR.File({"cycles.ViewLayer.samples": "4", **header}, planes).write(str(path))
    return path


def write(path: Path, position: FloatArray, **header: object) -> Path:
    """Write a noisy room with the names of Cycles."""
    random = np.random.default_rng(0)
    light = random.gamma(2.0, 0.5, (*SIZE, 1)) * (1.5 + NORMAL)
    images = {"Combined": (light, "RGB"), "Position": (position, "XYZ"), "Normal": (NORMAL, "XYZ")}
    images["Roughness"] = (np.full((*SIZE, 1), 0.3), "X")
    images["Depth"] = (np.linalg.norm(POSITION - EYE, axis=-1, keepdims=True), "Z")
    return write_passes(path, images, **header)


def test_positions_tell_a_panorama(tmp_path: Path) -> None:
    found = import_file(write(tmp_path / "a.exr", POSITION))
    frame = found.frame
    assert frame.wraps
    np.testing.assert_allclose(frame.camera.position, EYE, atol=1e-4)
    assert frame.gbuffer.position is not None
    np.testing.assert_allclose(frame.gbuffer.depth, np.linalg.norm(POSITION - EYE, axis=-1), rtol=1e-4)
    assert sum("wraps around, as its positions show" in note for note in found.notes) == 1
    assert not any("ViewLayer.Depth.Z is measured" in note for note in found.notes)
    assert found.findings == ()
    result = lobewise.denoise(frame, quality="fast")
    assert result.settings["similarity"] == "ggx"
    # The lobes are those of the views from the eye, not of a pinhole's rays.
    elsewhere = frame.with_changes(camera=Camera(frame.camera.position, (0, 1, 0), (0, 0, 1), frame.camera.fov_y))
    np.testing.assert_array_equal(result.image, lobewise.denoise(elsewhere, quality="fast").image)


def write_split(path: Path, turn: int) -> Path:
    """Write a turned image of light by lobe, whose alpha has edges beside its border."""
    random = np.random.default_rng(0)
    alpha = np.zeros((*SIZE, 1))
    alpha[:, :20], alpha[:, -1:] = 1.0, 0.4
    light = random.gamma(2.0, 0.5, (*SIZE, 3)) * alpha
    images = {"Combined": (np.concatenate([0.4 * light, alpha], -1), "RGBA"), "Normal": (NORMAL * alpha, "XYZ")}
    images |= dict.fromkeys(("DiffDir", "DiffInd"), (0.5 * light, "RGB"))
    images |= {"DiffCol": (np.full((*SIZE, 3), 0.4), "RGB")}
    images |= {name: (np.zeros((*SIZE, 3)), "RGB") for name in ("GlossDir", "GlossInd", "GlossCol")}
    turned = {name: (np.roll(image, turn, axis=1), letters) for name, (image, letters) in images.items()}
    return write_passes(path, turned)


def test_silhouettes_go_on_across_the_border(tmp_path: Path) -> None:
    plain, turned = (
        import_file(write_split(tmp_path / f"{turn}.exr", turn), wraps=True).frame.gbuffer for turn in (0, 40)
    )
    np.testing.assert_array_equal(np.roll(plain.coverage, 40, axis=1), turned.coverage)
    # The last column is owned by the background, and shows a part of the surface in the first one.
    assert plain.coverage[8, -1, 5] == pytest.approx(0.4)


def test_lamps_go_on_across_the_border() -> None:
    light = np.ones((*SIZE, 3), np.float32) * np.random.default_rng(0).gamma(2.0, 0.5, (*SIZE, 1)).astype(np.float32)
    light[20:26, :1] = light[20:26, -1:] = 200.0
    frame = Frame(Radiance(light), lobewise.GBuffer(normal=NORMAL), wraps=True)
    turned = Frame(Radiance(np.roll(light, 40, axis=1)), frame.gbuffer, wraps=True)
    counts = [keep_lamps(each)[1] for each in (frame, turned)]
    assert counts[0] == counts[1] > 0
    assert keep_lamps(frame.with_changes(wraps=False))[1] != counts[0]


def test_a_panorama_that_is_not_joined(tmp_path: Path) -> None:
    found = import_file(write(tmp_path / "a.exr", POSITION), wraps=False)
    assert not found.frame.wraps
    assert found.frame.camera is None
    cropped = (np.zeros(2, np.int32), np.array([SIZE[1] + 9, SIZE[0] - 1], np.int32))
    part = import_file(write(tmp_path / "b.exr", POSITION, displayWindow=cropped)).frame
    assert not part.wraps
    assert part.camera is None


def test_positions_of_another_image(tmp_path: Path) -> None:
    path = write(tmp_path / "a.exr", np.random.default_rng(0).normal(size=POSITION.shape).astype(np.float32))
    found = import_file(path)
    assert not found.frame.wraps
    assert any("Neither a pinhole camera nor a panorama" in note for note in found.notes)
    told = import_file(path, wraps=True)
    assert told.frame.wraps
    assert told.frame.camera is None
    assert any("not those of a panorama" in note for note in told.notes)


def test_the_summary_names_the_camera_of_a_panorama(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["inspect", str(write(tmp_path / "a.exr", POSITION))]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "wraps around, as its positions show" in told
    assert "what surfaces reflect" in told
    assert "positions:" not in told.partition("Missing")[2].partition("Noted")[0]


def test_a_panorama_in_a_file_of_our_own(tmp_path: Path) -> None:
    frame = import_file(write(tmp_path / "a.exr", POSITION)).frame
    write_frame(tmp_path / "b.exr", frame)
    again = lobewise.read_frame(tmp_path / "b.exr")
    assert again.wraps
    np.testing.assert_array_equal(again.camera.position, frame.camera.position)


def test_nothing_projects_by_the_camera_of_a_panorama(tmp_path: Path) -> None:
    frame = import_file(write(tmp_path / "a.exr", POSITION)).frame
    assert make_sparse(frame, 2).camera is None
    random = np.random.default_rng(5)
    others = [
        frame.with_changes(radiance=Radiance(frame.radiance.color * random.gamma(4.0, 0.25, (*SIZE, 1))))
        for _ in range(2)
    ]
    window = lobewise.WindowFilter(1, quality="fast").denoise([others[0], frame, others[1]], 1)
    # Without motion vectors nobody knows where pixels were.
    assert any("No other frame is used" in note for note in window.notes)
    assert window.settings["similarity"] == "ggx"
    over_time = lobewise.TemporalFilter()
    over_time.add(others[0])
    assert over_time.add(frame).settings["similarity"] == "normal"


def test_a_window_takes_the_motion_of_the_file(tmp_path: Path) -> None:
    frame = import_file(write(tmp_path / "a.exr", POSITION)).frame
    still = frame.with_changes(gbuffer=replace(frame.gbuffer, motion=np.zeros((*SIZE, 2), np.float32)))
    random = np.random.default_rng(5)
    other = still.with_changes(radiance=Radiance(frame.radiance.color * random.gamma(4.0, 0.25, (*SIZE, 1))))
    result = lobewise.WindowFilter(1, quality="fast").denoise([other, still], 1)
    assert result.settings["joined"] == (-1,)
