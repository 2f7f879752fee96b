"""Each wrong convention, made on purpose, is found and mended; right files raise nothing."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from renderers import REAL, WRITERS, Written, make_scene, name, write

import lobewise
from benchmarks.common import SHOWROOM, SHOWROOM_REFERENCE
from lobewise.interchange import describe_file, import_file
from lobewise.interchange.checks.normals import Guess, make_bases, turn_normals
from lobewise.interchange.imported import Imported
from lobewise.interchange.reading import import_planes
from lobewise.interchange.showing import read_image
from lobewise.metrics import rel_mse
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
Channels = dict[str, np.ndarray]


@cache
def read_showroom() -> tuple[Frame, FloatArray]:
    """Return the repository's frame and its reference."""
    return lobewise.read_frame(SHOWROOM), read_image(SHOWROOM_REFERENCE)


def get_camera() -> Camera:
    return read_showroom()[0].camera


def write_showroom(*leave: str) -> Channels:
    """Return the repository's frame as Arnold's channels, without some of its passes."""
    frame = read_showroom()[0]
    guides = frame.gbuffer
    position = get_camera().make_positions(guides.depth)
    channels = name("", frame.radiance.color) | {"Z": guides.depth}
    passes = {
        "N": guides.normal, "P": position, "diffuse_albedo": guides.diffuse_albedo,
        "specular_albedo": guides.specular_albedo, "diffuse": frame.radiance.diffuse,
        "specular": frame.radiance.specular,
    }  # fmt: skip
    for head, image in passes.items():
        channels |= name(head, image, "XYZ" if head in "NP" else "RGB")
    channels |= name("specular_roughness", np.sqrt(guides.alpha_u), "R")
    return {key: plane for key, plane in channels.items() if key.partition(".")[0] not in leave}


def take_every_other(channels: Channels) -> Channels:
    """Return every other row and column of a frame, for tests that read many."""
    return {key: np.ascontiguousarray(plane[::2, ::2]) for key, plane in channels.items()}


def get(channels: Channels, head: str) -> np.ndarray:
    """Return a pass (height, width, 3)."""
    return np.stack([channels[f"{head}.{letter}"] for letter in ("XYZ" if head in "NP" else "RGB")], axis=-1)


def put(channels: Channels, head: str, image: np.ndarray) -> Channels:
    """Return channels with a pass replaced."""
    return channels | name(head, image, "XYZ" if head in "NP" else "RGB")


def change(head: str, function: Callable[[np.ndarray], np.ndarray]) -> Callable[[Channels], Channels]:
    return lambda channels: put(channels, head, function(get(channels, head)))


def change_depth(function: Callable[[np.ndarray], np.ndarray]) -> Callable[[Channels], Channels]:
    return lambda channels: channels | {"Z": function(channels["Z"])}


def to_axes(*rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return what turns vectors into components along some axes."""
    return lambda image: image @ np.stack(rows).T


def to_camera(sign: float) -> Callable[[np.ndarray], np.ndarray]:
    camera = get_camera()
    return to_axes(camera.right, camera.up, sign * camera.forward)


def to_rays(normal: np.ndarray) -> np.ndarray:
    """Return normals as V-Ray has them: x right and y up, both across the ray, z against it."""
    camera = get_camera()
    rays = camera.make_ray_directions(normal.shape[1], normal.shape[0])
    right, up = np.cross(rays, camera.up), np.cross(camera.right, rays)
    sides = [side / np.linalg.norm(side, axis=-1, keepdims=True) for side in (right, up)]
    found = np.stack([(normal * side).sum(axis=-1) for side in (*sides, -rays)], axis=-1)
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def turn_some(normal: np.ndarray) -> np.ndarray:
    """Return normals of which those of some surfaces look away: of all that face up."""
    return np.where(normal[..., 2:] > 0.7, -normal, normal)


def get_cosine(depth: np.ndarray) -> np.ndarray:
    camera = get_camera()
    return camera.make_ray_directions(depth.shape[1], depth.shape[0]) @ camera.forward


def stretch(depth: np.ndarray) -> np.ndarray:
    return (depth - depth.min()) / (depth.max() - depth.min()) + 1e-3


def sprinkle(image: np.ndarray, value: float) -> np.ndarray:
    """Return an image that is no number at some pixels far from each other."""
    spoiled = image.copy()
    spoiled.reshape(-1, *image.shape[2:])[100::991] = value
    return spoiled


def spoil_albedo(albedo: np.ndarray) -> np.ndarray:
    """Return an albedo that is beyond its range where it is at one end of it."""
    spoiled = albedo.copy()
    white, black = np.nonzero(albedo.min(axis=-1) > 0.85), np.nonzero(albedo.max(axis=-1) == 0.0)
    spoiled[white[0][:37], white[1][:37]] = 1.4
    spoiled[black[0][:20], black[1][:20]] = -0.25
    return spoiled


def turn_guides(channels: Channels) -> Channels:
    return {key: plane[::-1] if key.partition(".")[0] in GUIDES else plane for key, plane in channels.items()}


GUIDES = ("N", "P", "Z", "diffuse_albedo", "specular_albedo", "specular_roughness")


@dataclass(frozen=True)
class Mistake:
    """A convention that is not the one which the file is taken for."""

    make: Callable[[Channels], Channels]
    finding: str
    leave: tuple[str, ...] = ()
    told: tuple[str, ...] = field(default=())
    """What its sentence must name."""


MISTAKES = {
    "normals in camera space, z away": Mistake(
        change("N", lambda n: to_camera(1.0)(n)), "normals in another space", told=("z is away from the camera",)
    ),
    "normals in camera space, z back": Mistake(
        change("N", lambda n: to_camera(-1.0)(n)), "normals in another space", told=("z is towards the camera",)
    ),
    "normals in camera space, by depth": Mistake(
        change("N", lambda n: to_camera(-1.0)(n)), "normals in another space", leave=("P",)
    ),
    "normals in a space of each ray": Mistake(change("N", to_rays), "normals in another space", told=("its ray",)),
    "normals encoded": Mistake(change("N", lambda n: 0.5 + 0.5 * n), "normals encoded"),
    "normals negated": Mistake(change("N", np.negative), "normals flipped"),
    "some normals negated": Mistake(change("N", turn_some), "normals that look away"),
    "normals with y turned": Mistake(
        change("N", lambda n: n * np.float32([1, -1, 1])), "normals with turned axes", told=("y is -y",)
    ),
    "normals with z turned": Mistake(
        change("N", lambda n: n * np.float32([1, 1, -1])), "normals with turned axes", told=("z is -z",)
    ),
    "normals with y up": Mistake(
        change("N", lambda n: n[..., [0, 2, 1]] * np.float32([1, 1, -1])), "normals with turned axes"
    ),
    "normals not of unit length": Mistake(change("N", lambda n: 3.0 * n), "normals not of unit length"),
    "depth along the axis": Mistake(
        change_depth(lambda z: z * get_cosine(z)), "depth of another meaning", told=("along the camera's axis",)
    ),
    "depth along the axis, by normals": Mistake(
        change_depth(lambda z: z * get_cosine(z)), "depth of another meaning", leave=("P",)
    ),
    "depth in another unit": Mistake(change_depth(lambda z: 0.01 * z), "depth of another meaning", told=("times 100",)),
    "depth from 0 to 1": Mistake(change_depth(stretch), "depth of another meaning"),
    "depth from 0 to 1, by normals": Mistake(change_depth(stretch), "depth of another meaning", leave=("P",)),
    "depth inverted": Mistake(change_depth(lambda z: 1.0 - 0.9 * stretch(z)), "depth of another meaning", leave=("P",)),
    "reciprocal of depth": Mistake(change_depth(lambda z: 0.1 / z), "depth of another meaning"),
    "reciprocal of depth, by normals": Mistake(change_depth(lambda z: 0.1 / z), "depth of another meaning", ("P",)),
    "depth of something else": Mistake(
        change_depth(lambda z: 3.0 + np.cos(np.arange(z.size, dtype=np.float32)).reshape(z.shape)),
        "depth of something else",
    ),
    "all guides upside down": Mistake(
        turn_guides,
        "guides flipped", told=("N.X/Y/Z", "P.X/Y/Z", "diffuse_albedo.R/G/B", "upside down"),
    ),
    "positions upside down": Mistake(
        change("P", lambda p: p[::-1]), "guides flipped", told=("P.X/Y/Z lies upside down",)
    ),
    "depth turned by half a turn": Mistake(
        change_depth(lambda z: z[::-1, ::-1]), "guides flipped", told=("Z lies turned by half a turn",)
    ),
    "albedo upside down": Mistake(
        change("diffuse_albedo", lambda a: a[::-1]), "guides flipped", told=("diffuse_albedo.R/G/B lies upside down",)
    ),
    "normals mirrored left to right": Mistake(
        change("N", lambda n: n[:, ::-1]), "guides flipped", told=("N.X/Y/Z lies mirrored",)
    ),
    "albedo above 1 and below 0": Mistake(
        change("diffuse_albedo", spoil_albedo), "albedo out of range", told=("above 1 at 37 pix", "below 0 at 20 pix")
    ),
    "no numbers among normals": Mistake(
        change("N", lambda n: sprinkle(n, np.nan)), "guides without numbers", told=("at 265 pixels: 265 were filled",)
    ),
    "no numbers among albedos": Mistake(
        change("diffuse_albedo", lambda a: sprinkle(a, np.inf)), "guides without numbers"
    ),
    "no numbers among positions": Mistake(change("P", lambda p: sprinkle(p, np.nan)), "guides without numbers"),
    "no numbers among depths": Mistake(change_depth(lambda z: sprinkle(z, np.nan)), "guides without numbers"),
}  # fmt: skip


def import_channels(channels: Channels, folder: Path, *, camera: Camera | None = None, samples: int = 2) -> Imported:
    path = folder / "frame.exr"
    write(path, Written("arnold", channels, {"arnold/AA_samples": samples}), packed=False)
    return import_file(path, camera=camera)


def compute_error(found: Imported) -> float:
    """Return the error of the frame, filtered by its guides alone, of which nothing else then covers a mistake."""
    result = lobewise.denoise(found.frame, quality="fast")
    return rel_mse(result.image, read_showroom()[1])


def choose_camera(leave: tuple[str, ...]) -> Camera | None:
    """Return the camera that is given where no positions tell it."""
    return get_camera() if "P" in leave else None


@pytest.fixture(scope="module")
def right_errors(tmp_path_factory: pytest.TempPathFactory) -> Callable[[tuple[str, ...]], float]:
    """Return what tells the error of the right frame that lacks some passes."""

    @cache
    def find(leave: tuple[str, ...]) -> float:
        found = import_channels(write_showroom(*leave), tmp_path_factory.mktemp("right"), camera=choose_camera(leave))
        assert found.findings == ()
        return compute_error(found)

    return find


@pytest.mark.sampled("normals in camera space, z away")
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found_and_mended(
    mistake: str, right_errors: Callable[[tuple[str, ...]], float], tmp_path: Path
) -> None:
    made = MISTAKES[mistake]
    channels = made.make(write_showroom(*made.leave))
    found = import_channels(channels, tmp_path, camera=choose_camera(made.leave))
    assert [one.what for one in found.findings] == [made.finding], found.notes
    (finding,) = found.findings
    assert finding.mended
    assert finding.sentence in found.notes
    for words in made.told:
        assert words in finding.sentence
    assert compute_error(found) <= 1.05 * right_errors(made.leave)


@pytest.mark.parametrize(("turned", "is_told"), [((2,), False), ((1, 2, 3), True)], ids=["one frame", "all frames"])
def test_a_sequence_decides_once_how_its_guides_lie(
    turned: tuple[int, ...], is_told: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one noisy frame a guide may explain the image better by chance when it is turned over."""
    monkeypatch.chdir(tmp_path)
    for number in (1, 2, 3):
        made = MISTAKES["albedo upside down"].make if number in turned else dict
        import_channels(made(take_every_other(write_showroom())), tmp_path)
        (tmp_path / "frame.exr").rename(f"in.{number}.exr")
    assert import_file("in.2.exr").flips == {"diffuse_albedo": "upside down"}
    remarks: list[str] = []
    lobewise.denoise_files("in.#.exr", "out.#.exr", quality="fast", remark=remarks.append)
    assert any("upside down" in remark for remark in remarks) == is_told


def move(channels: Channels, far: float) -> Channels:
    """Return a frame whose world lies elsewhere, positions in 16 bits."""
    moved = get(channels, "P") + np.float32([far, far, 0.0])
    return put(channels, "P", moved.astype(np.float16).astype(np.float32))


def move_camera(far: float) -> Camera:
    camera = get_camera()
    return replace(camera, position=camera.position + np.array([far, far, 0.0]))


@pytest.mark.sampled("1000.0")
@pytest.mark.parametrize("far", [100.0, 1000.0])
def test_coarse_positions_are_made_of_depth(
    far: float, right_errors: Callable[[tuple[str, ...]], float], tmp_path: Path
) -> None:
    found = import_channels(move(write_showroom(), far), tmp_path, camera=move_camera(far))
    assert [(one.what, one.mended) for one in found.findings] == [("positions coarse", True)]
    assert "16-bit" in found.findings[0].sentence
    assert found.frame.gbuffer.position is None
    assert found.frame.is_placed
    assert compute_error(found) <= 1.05 * right_errors(())


def test_coarse_positions_are_told_where_there_is_no_depth(tmp_path: Path) -> None:
    found = import_channels(move(write_showroom("Z"), 100.0), tmp_path, camera=move_camera(100.0))
    assert [(one.what, one.mended) for one in found.findings] == [("positions coarse", False)]
    assert import_channels(move(write_showroom("Z"), 0.0), tmp_path).findings == ()


@pytest.mark.parametrize(
    ("far", "words"), [(1e3, "are 3.3 times as far apart as"), (6e4, "so wide that most neighbouring pixels have the")]
)
def test_how_coarse_positions_are_is_told_in_words(far: float, words: str) -> None:
    scene = make_scene()
    position = (scene.position + far).astype(np.float16).astype(np.float32)
    planes = name("", scene.color) | name("P", position, "XYZ")
    (told,) = (one.sentence for one in import_planes(planes).findings if one.what == "positions coarse")
    assert words in told
    assert "000" not in told


def spread(image: np.ndarray, deviation: float = 0.5) -> np.ndarray:
    """Return an image as a Gaussian pixel filter of some width would spread its samples."""
    kernel = np.exp(-(np.arange(-2, 3) ** 2) / (2.0 * deviation**2))
    for axis in (0, 1):
        edges = [(2, 2) if axis == k else (0, 0) for k in range(3)]
        padded = np.pad(image, edges, mode="edge")
        image = sum(
            share * np.take(padded, range(k, k + image.shape[axis]), axis)
            for k, share in enumerate(kernel / kernel.sum())
        )
    return image


def import_with_shared_noise(channels: Channels, folder: Path) -> Imported:
    color = np.stack([channels[letter] for letter in "RGB"], axis=-1)
    channels |= name("", spread(color))
    for head in ("diffuse", "specular"):
        channels = change(head, spread)(channels)
    return import_channels(channels, folder)


def test_noise_that_pixels_share_is_found(tmp_path: Path) -> None:
    found = import_with_shared_noise(write_showroom(), tmp_path)
    assert [(one.what, one.mended) for one in found.findings] == [("noise shared by pixels", True)]
    assert found.frame.noise_is_shared


@pytest.mark.nightly
def test_shared_noise_costs_little_where_it_is_known(tmp_path: Path) -> None:
    right = import_channels(write_showroom(), tmp_path)
    found = import_with_shared_noise(write_showroom(), tmp_path)
    reference = read_showroom()[1]
    error = rel_mse(lobewise.denoise(right.frame, quality="balanced").image, reference)
    mended, trusting = (
        rel_mse(lobewise.denoise(frame, quality="balanced").image, spread(reference))
        for frame in (found.frame, found.frame.with_changes(noise_is_shared=False))
    )
    assert mended <= 1.05 * error < trusting


@pytest.mark.sampled("fast")
@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_an_image_that_is_denoised_already_is_told(quality: str, tmp_path: Path) -> None:
    channels = write_showroom("diffuse", "specular")
    clean = lobewise.denoise(read_showroom()[0], quality=quality).image
    found = import_channels(channels | name("", clean), tmp_path)
    assert [(one.what, one.mended) for one in found.findings] == [("denoised already", False)]


@pytest.mark.nightly
def test_what_is_found_of_a_second_render_is_told(tmp_path: Path) -> None:
    paths = [tmp_path / "first.exr", tmp_path / "second.exr"]
    channels = write_showroom("diffuse", "specular")
    clean = lobewise.denoise(read_showroom()[0], quality="fast").image
    for path, image in zip(paths, (channels, channels | name("", clean)), strict=True):
        write(path, Written("arnold", image, {"arnold/AA_samples": 2}), packed=False)
    found = import_file(paths[0], half=paths[1])
    assert [one.what for one in found.findings] == ["denoised already"]
    assert any(note.startswith("The second render: ") for note in found.notes)


def test_a_long_render_is_not_taken_for_denoised(tmp_path: Path) -> None:
    channels = write_showroom("diffuse", "specular") | name("", read_showroom()[1])
    assert import_channels(channels, tmp_path, samples=64).findings == ()


def change_channel(source: Path, target: Path, word: str, function: Callable[[np.ndarray], np.ndarray]) -> None:
    """Write a copy of a file in which every channel whose name has a word is changed."""
    parts = []
    with OpenEXR.File(str(source), separate_channels=True) as file:
        for part in file.parts:
            header = {key: value for key, value in part.header.items() if key not in ("channels", "chunkCount")}
            channels = {
                key: OpenEXR.Channel(np.array(function(one.pixels) if word in key else one.pixels))
                for key, one in part.channels.items()
            }
            parts.append(OpenEXR.Part(header, channels, part.name()))
        OpenEXR.File(parts).write(str(target))


@pytest.mark.parametrize(
    ("meaning", "function"), [("microfacet alpha", np.square), ("glossiness", lambda roughness: 1.0 - roughness)]
)
def test_roughness_of_another_meaning_is_found_by_the_mean_over_lobes(
    meaning: str, function: Callable[[np.ndarray], np.ndarray], tmp_path: Path
) -> None:
    source, target = FOREIGN / "blender_5.2_multipart.exr", tmp_path / "frame.exr"
    change_channel(source, target, "ViewLayer.Roughness", function)
    right, found = import_file(source).frame.gbuffer.alpha_u, import_file(target)
    assert [(one.what, one.mended) for one in found.findings] == [("roughness of another meaning", True)]
    assert meaning in found.findings[0].sentence
    np.testing.assert_allclose(found.frame.gbuffer.alpha_u, right, atol=1e-5)


def test_roughness_in_percent_is_told(tmp_path: Path) -> None:
    channels = write_showroom()
    channels["specular_roughness.R"] = 100.0 * channels["specular_roughness.R"]
    findings = import_channels(channels, tmp_path).findings
    assert [(one.what, one.mended) for one in findings] == [("not a roughness", False)]


def test_what_is_assumed_of_a_roughness_is_named_with_the_option(tmp_path: Path) -> None:
    path = tmp_path / "frame.exr"
    frame = read_showroom()[0]
    channels = name("", frame.radiance.color) | name("roughness", frame.gbuffer.alpha_u, "R")
    write(path, Written("generic", channels, {}))
    assumed = import_file(path)
    (note,) = (note for note in assumed.notes if "perceptual" in note)
    option = note.partition("--map roughness=")[2].partition(" ")[0]
    mapped = import_file(path, mapping={"roughness": option})
    np.testing.assert_allclose(mapped.frame.gbuffer.alpha_u, frame.gbuffer.alpha_u)
    np.testing.assert_allclose(assumed.frame.gbuffer.alpha_u, frame.gbuffer.alpha_u**2, rtol=1e-6)
    assert not any("perceptual" in note for note in mapped.notes)


def bump(normal: np.ndarray, size: float) -> np.ndarray:
    """Return unit normals that differ from pixel to pixel."""
    noise = np.random.default_rng(5).normal(size=normal.shape)
    bumped = normal + size * noise * (normal != 0.0).any(axis=-1, keepdims=True)
    return bumped / np.maximum(np.linalg.norm(bumped, axis=-1, keepdims=True), 1e-9)


@pytest.mark.sampled("0.5")
@pytest.mark.parametrize("size", [0.2, 0.5])
def test_bumps_are_right(size: float, tmp_path: Path) -> None:
    assert import_channels(change("N", lambda n: bump(n, size))(write_showroom()), tmp_path).findings == ()


@pytest.mark.nightly
def test_bumps_hide_no_mistake(tmp_path: Path) -> None:
    right = import_channels(change("N", lambda n: bump(n, 0.2))(write_showroom()), tmp_path)
    turned = import_channels(change("N", lambda n: to_camera(-1.0)(bump(n, 0.2)))(write_showroom()), tmp_path)
    assert [one.what for one in turned.findings] == ["normals in another space"]
    np.testing.assert_allclose(turned.frame.gbuffer.normal, right.frame.gbuffer.normal, atol=1e-3)


def test_normals_that_fit_no_surface_are_told_and_left(tmp_path: Path) -> None:
    strewn = np.random.default_rng(5).normal(size=(512, 512, 3)).astype(np.float32)
    strewn /= np.linalg.norm(strewn, axis=-1, keepdims=True)
    found = import_channels(change("N", lambda n: strewn)(write_showroom()), tmp_path)
    assert [(one.what, one.mended) for one in found.findings] == [("normals of no known space", False)]
    np.testing.assert_allclose(found.frame.gbuffer.normal, strewn, atol=1e-6)


@pytest.mark.sampled("leave2", "leave4")
@pytest.mark.parametrize("leave", [("N",), ("P", "N"), ("Z",), ("diffuse_albedo", "specular_albedo"), ("P", "Z")])
def test_right_files_with_fewer_guides_raise_nothing(leave: tuple[str, ...], tmp_path: Path) -> None:
    assert import_channels(write_showroom(*leave), tmp_path, camera=get_camera()).findings == ()


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 3), (9, 13), (24, 24), (1, 100), (48, 1), (33, 64)])
def test_frames_of_any_size_are_checked(shape: tuple[int, int]) -> None:
    part = slice(100, 100 + shape[0]), slice(200, 200 + shape[1])
    planes = {key: np.ascontiguousarray(plane[part]) for key, plane in write_showroom().items()}
    for camera in (None, get_camera()):
        assert import_planes(planes, preset="arnold", camera=camera).frame.shape == shape


@pytest.mark.sampled("0", "17")
@pytest.mark.parametrize("seed", range(30))
def test_spoiled_guides_are_read_all_the_same(seed: int) -> None:
    """Values that are none, all alike, huge, tiny, or at random: in any of the passes."""
    rng = np.random.default_rng(seed)
    values = np.float32([np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40, 0.0, 1.0, -1.0, 65504.0])
    whole = {key: np.array(plane[::4, ::4]) for key, plane in write_showroom().items()}
    for head in sorted({key.partition(".")[0] for key in whole}):
        kind, value = rng.integers(0, 5), rng.choice(values)
        for key in (key for key in whole if key.partition(".")[0] == head):
            plane = whole[key]
            if kind == 1:
                plane[:] = value
            elif kind == 2:
                plane[rng.random(plane.shape) < 0.3] = value
            elif kind == 3:
                plane[:] = rng.normal(size=plane.shape) * 10.0 ** rng.integers(-10, 10)
            elif kind == 4:
                plane[:, :60] = value
    found = import_planes(whole, preset="arnold", camera=get_camera() if seed % 2 else None)
    guides = found.frame.gbuffer
    # Passes of zeros are left out.
    assert guides.normal is None or np.isfinite(guides.normal).all()
    for image in (guides.alpha_u, guides.diffuse_albedo, guides.specular_albedo):
        assert image is None or ((image >= 0.0) & (image <= 1.0)).all()


def test_guides_that_are_the_same_everywhere_tell_nothing(tmp_path: Path) -> None:
    channels = write_showroom("P", "Z")
    for head in ("N", "diffuse_albedo", "specular_albedo"):
        channels = change(head, lambda image: np.broadcast_to(np.float32([0.0, 0.0, 1.0]), image.shape))(channels)
    assert import_channels(channels, tmp_path).findings == ()
    black = {key: np.zeros_like(plane) for key, plane in channels.items()}
    assert import_channels(black, tmp_path).findings == ()


RIGHT = ("blender_4.5_seed1.exr", "blender_4.5_seed2.exr", "blender_5.2_multipart.exr", "luxcore/RGB.exr")


@pytest.mark.parametrize("file", RIGHT)
def test_rendered_files_raise_nothing(file: str) -> None:
    assert import_file(FOREIGN / file).findings == ()


@pytest.mark.real_exr
@pytest.mark.parametrize("file", REAL)
def test_real_files_raise_nothing(file: str, exr_folder: Path) -> None:
    assert import_file(exr_folder / file).findings == ()


@pytest.mark.real_exr
def test_real_normals_in_a_space_of_each_ray_are_those_of_flat_walls(exr_folder: Path) -> None:
    """A box of V-Ray 3.60, whose walls look outwards: x is to the left, z along the ray, against it."""
    path = exr_folder / "vray_cornellBox_CryptoWildcard.0001.exr"
    camera = import_file(path).frame.camera
    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = [file.channels()[f"normals.{letter}"].pixels for letter in "XYZ"]
    raw = np.stack(planes, axis=-1).astype(np.float32)
    axes = np.diag(np.float32([-1.0, 1.0, -1.0]))
    basis = make_bases(camera, None, camera.make_ray_directions(raw.shape[1], raw.shape[0]))

    def measure(space: str) -> float:
        """Return the share of the pixels whose normal is along an axis of the box, to a fifth of a degree."""
        turned = turn_normals(raw, Guess(space, axes), basis[space])
        return float((np.abs(turned).max(axis=-1) > np.cos(np.deg2rad(0.2))).mean())

    assert measure("ray") > 0.8
    assert measure("camera") < 0.1


@pytest.mark.sampled("box-found0")
@pytest.mark.parametrize(("pixel_filter", "found"), [("box", []), ("gaussian", ["noise shared by pixels"])])
def test_mitsuba_spreads_samples_by_its_filters(mi: Any, pixel_filter: str, found: list[str], tmp_path: Path) -> None:
    scene = mi.cornell_box()
    scene["sensor"]["film"] |= {"width": 160, "height": 160, "rfilter": {"type": pixel_filter}}
    aovs = "albedo:albedo,sh_normal:sh_normal,position:position,depth:depth"
    scene["integrator"] = {"type": "aov", "aovs": aovs, "image": {"type": "path", "max_depth": 6}}
    loaded = mi.load_dict(scene)
    mi.render(loaded, spp=32, seed=3)
    path = tmp_path / "frame.exr"
    loaded.sensors()[0].film().bitmap().write(str(path))
    assert [one.what for one in import_file(path).findings] == found


@pytest.mark.sampled(
    *(f"{renderer}-float" for renderer in ("cycles", "arnold", "vray", "renderman", "karma")),
    *(f"{renderer}-half" for renderer in ("redshift", "corona", "pbrt", "luxcore", "mitsuba")),
)
@pytest.mark.parametrize("layout", ["float", "half"])
@pytest.mark.parametrize("renderer", WRITERS)
def test_right_files_of_every_renderer_raise_nothing(renderer: str, layout: str, tmp_path: Path) -> None:
    path = tmp_path / "frame.exr"
    written = WRITERS[renderer](make_scene())
    if layout == "half":
        written.channels = {key: np.minimum(plane, 65504.0) for key, plane in written.channels.items()}
    write(path, written, half=layout == "half")
    found = import_file(path)
    assert found.findings == ()
    assert dict(found.map.refused) == {}


def test_what_was_found_is_told_by_inspect(tmp_path: Path) -> None:
    path = tmp_path / "frame.exr"
    channels = change("N", np.negative)(write_showroom())
    write(path, Written("arnold", channels, {"arnold/AA_samples": 2}), packed=False)
    told = describe_file(path)
    assert any("look away from the camera" in note for note in told.notes)
