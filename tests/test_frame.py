"""Cameras against projection by hand; frames and their checks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.io import read_frame, write_frame
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance, Result
from lobewise.records.images import make_read_only
from lobewise.records.radiance import RadianceLayer
from lobewise.records.sparse_frame import make_sparse
from tests.mistakes import refuses


def make_camera(**changes: Any) -> Camera:
    """Return a tilted camera away from the origin."""
    return Camera(**{"position": (1, 2, 3), "forward": (1, -1, -2), "up": (0, 1, 0), "fov_y": 0.7, **changes})


def test_camera_basis_is_orthonormal_and_right_handed() -> None:
    camera = make_camera()
    basis = np.stack([camera.right, camera.up, camera.forward])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.cross(camera.right, camera.up), -camera.forward, atol=1e-12)


@pytest.mark.parametrize("fov_x", [None, 1.3])
def test_rays_project_back_to_pixel_centres(fov_x: float | None) -> None:
    width, height = 7, 5
    camera = make_camera(fov_x=fov_x)
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, rtol=1e-6)
    along = rays @ camera.forward
    half_height = np.tan(0.35)
    half_width = half_height * width / height if fov_x is None else np.tan(0.65)
    column = ((rays @ camera.right) / along / half_width + 1.0) * 0.5 * width
    row = (1.0 - (rays @ camera.up) / along / half_height) * 0.5 * height
    np.testing.assert_allclose(column, np.broadcast_to(np.arange(width) + 0.5, (height, width)), atol=1e-5)
    np.testing.assert_allclose(row, np.broadcast_to(np.arange(height)[:, None] + 0.5, (height, width)), atol=1e-5)


def test_pixel_angle_is_the_angle_between_central_rays() -> None:
    camera = make_camera()
    rays = camera.make_ray_directions(1, 1000).astype(np.float64)[:, 0]
    angle = np.linalg.norm(rays[499] - rays[500])
    assert camera.get_pixel_angle(1000) == pytest.approx(angle, rel=1e-2)


def test_positions_are_at_their_depth() -> None:
    camera = make_camera()
    depth = np.linspace(1.0, 9.0, 12, dtype=np.float32).reshape(3, 4)
    position = camera.make_positions(depth)
    np.testing.assert_allclose(np.linalg.norm(position - camera.position, axis=-1), depth, rtol=1e-5)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"position": (0, 0)}, "camera position"),
        ({"forward": (0, np.nan, 1)}, "camera forward"),
        ({"up": (2, -2, -4)}, "camera up"),
        ({"fov_y": 4.0}, "camera fov_y"),
    ],
)
def test_impossible_cameras_are_refused(changes: dict[str, Any], what: str) -> None:
    with refuses(InputError, what):
        make_camera(**changes)


@pytest.mark.parametrize(
    ("make", "refused"),
    [
        (lambda: Radiance(color=np.zeros((4, 5))), ("color", "float64 of shape (4, 5)")),
        (lambda: Radiance(color=np.zeros((0, 5, 3))), ("color", "an image of shape (0, 5, 3)")),
        (lambda: Radiance(color=np.zeros((4, 5, 3), complex)), ("color", "complex128 of shape (4, 5, 3)")),
        (
            lambda: Radiance(color=np.zeros((4, 5, 3)), diffuse=np.zeros((5, 4, 3))),
            ("diffuse",),
        ),
        (
            lambda: Frame(radiance=Radiance(color=np.zeros((4, 5, 3))), gbuffer=GBuffer(depth=np.ones((8, 10)))),
            ("gbuffer",),
        ),
        (lambda: Frame(radiance=Radiance(color=np.zeros((4, 5, 3))), spp=0), ("spp",)),
    ],
)
def test_wrong_images_are_named(make: Any, refused: tuple[str, ...]) -> None:
    with refuses(InputError, *refused):
        make()


@pytest.mark.parametrize("fov_x", [None, 1.1])
def test_a_band_is_seen_as_the_rows_of_the_whole_image(fov_x: float | None) -> None:
    camera = Camera((1.0, 2.0, 3.0), (0.3, -0.5, 1.0), (0.1, 1.0, 0.0), fov_y=0.9, fov_x=fov_x)
    rays = camera.make_ray_directions(17, 30)
    assert camera.get_rows(30) == (0, 30)
    for first, stop in ((0, 30), (3, 4), (11, 30)):
        band = camera.crop_rows(first, 30)
        assert band.get_rows(stop - first) == (first, 30)
        np.testing.assert_array_equal(band.make_ray_directions(17, stop - first), rays[first:stop])
        assert band.get_pixel_angle(stop - first) == camera.get_pixel_angle(30)
        assert band.get_half_extent(17, stop - first) == camera.get_half_extent(17, 30)
        # The vectors are not normalised once more, which would change bits.
        np.testing.assert_array_equal(band.forward, camera.forward)
        np.testing.assert_array_equal(band.up, camera.up)


def test_short_words_stand_for_images() -> None:
    image, number = np.zeros((40, 50, 3)), np.zeros((40, 50))
    radiance, guides = Radiance(image, diffuse=image), GBuffer(normal=image, depth=number)
    frame = Frame(radiance, guides, make_camera(), half_a=radiance, spp=4)
    assert repr(radiance) == "Radiance(50x40: color, diffuse)"
    assert repr(guides) == "GBuffer(50x40: depth, normal)"
    assert repr(GBuffer()) == "GBuffer()"
    content = "radiance (color, diffuse), gbuffer (depth, normal)"
    assert repr(frame) == f"Frame(50x40: {content}, half_a, camera, 4 spp)"
    where = "SparseFrame(50x40, one of 4x4 pixels at (1, 0)"
    assert repr(make_sparse(frame, 4, (1, 0))) == f"{where}: {content}, camera, 4 spp)"
    result = Result(image, number, number, number > 0.0, {"quality": "fast", "similarity": "ggx"}, 0.25, diffuse=image)
    told = "image, diffuse, quality fast, similarity ggx, 0 bad pixels, 0.25 s"
    assert repr(result) == f"Result(50x40: {told})"


@pytest.mark.parametrize(
    ("shape", "got"),
    [
        ((3, 6, 5), "float32 of shape (3, 6, 5)"),
        ((4, 6, 5), "float32 of shape (4, 6, 5)"),
        ((6, 5, 4), "float32 of shape (6, 5, 4)"),
        ((6, 5), "float32 of shape (6, 5)"),
        ((6, 5, 1), "float32 of shape (6, 5, 1)"),
        ((1, 6, 5), "float32 of shape (1, 6, 5)"),
        ((2, 6, 5, 3), "float32 of shape (2, 6, 5, 3)"),
        ((2, 3, 6, 5), "float32 of shape (2, 3, 6, 5)"),
    ],
)
def test_arrays_of_another_layout_get_advice_that_works(shape: tuple[int, ...], got: str) -> None:
    image = np.ones(shape, np.float32)
    with refuses(InputError, "color", got) as caught:
        Radiance(image)
    told = str(caught.value).partition("pass ")[2].removesuffix(".")
    mended = image[0] if image.ndim == 4 else eval(told, {"image": image, "np": np})
    if mended.shape != (3, 6, 5):
        assert Radiance(mended).shape == (6, 5)


@pytest.mark.parametrize(
    ("name", "shape", "refused"),
    [
        ("depth", (6, 5, 1), ("depth", "float32 of shape (6, 5, 1)")),
        ("depth", (1, 6, 5), ("depth", "float32 of shape (1, 6, 5)")),
        ("motion", (2, 6, 5), ("motion", "float32 of shape (2, 6, 5)")),
        ("motion", (6, 5, 3), ("motion", "float32 of shape (6, 5, 3)")),
    ],
)
def test_guides_of_another_layout_get_advice_too(name: str, shape: tuple[int, ...], refused: tuple[str, ...]) -> None:
    with refuses(InputError, *refused):
        GBuffer(**{name: np.ones(shape, np.float32)})


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.int32])
def test_pictures_are_no_radiance(kind: type) -> None:
    picture = np.full((6, 5, 3), 200, kind)
    with refuses(InputError, "color"):
        Radiance(picture)
    # Guides may be counted: kinds of lobes, materials.
    assert GBuffer(lobe_kind=picture[..., 0]).lobe_kind is not None


def make_writeable() -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.ones((4, 5, 3), np.float32)


@pytest.mark.parametrize(
    "keep",
    [
        lambda image: Radiance(image).color,
        lambda image: GBuffer(normal=image).normal,
        lambda image: RadianceLayer("coat", "coat", make_writeable(), parts={"sun": image}).parts["sun"],
        lambda image: Frame(Radiance(make_writeable()), also={"sun": image}).also["sun"],
    ],
)
def test_what_was_checked_cannot_be_changed(keep: Any) -> None:
    image = make_writeable()
    looked_at = image.view()
    looked_at.flags.writeable = False
    buffer = bytearray(make_writeable().tobytes())
    over_a_buffer = np.frombuffer(buffer, np.float32).reshape(4, 5, 3)
    over_a_buffer.flags.writeable = False
    kept = [keep(image), keep(looked_at), keep(over_a_buffer)]
    image[:] = np.nan
    buffer[:] = b"\xff" * len(buffer)
    for each in kept:
        np.testing.assert_array_equal(each, 1.0)
        with pytest.raises(ValueError, match="read-only"):
            each[0] = 0.0


def test_images_that_nobody_can_change_are_not_copied() -> None:
    image = make_writeable()
    image.flags.writeable = False
    over_bytes = np.frombuffer(image.tobytes(), np.float32).reshape(image.shape)
    of_the_library = make_read_only(color=make_writeable()[:2])["color"]
    for each in (image, over_bytes, of_the_library):
        frame = Frame(Radiance(each))
        assert np.shares_memory(frame.with_changes(spp=4).radiance.color, each)


def test_files_are_read_without_a_second_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = make_writeable()
    frame = Frame(Radiance(image, diffuse=image, specular=image), GBuffer(normal=image, depth=image[..., 0]))
    write_frame(tmp_path / "a.exr", frame)
    name = "lobewise.records.images._is_writeable"
    monkeypatch.setattr(name, lambda array: array.flags.writeable and pytest.fail("a copy"))
    read_frame(tmp_path / "a.exr")
