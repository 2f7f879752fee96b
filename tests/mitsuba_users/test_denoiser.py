"""`lobewise.mitsuba.Denoiser`: the call of Mitsuba's own denoiser, on tensors, bitmaps and NumPy arrays."""

from typing import Any

import numpy as np
import pytest

import lobewise.mitsuba.denoiser as module
from lobewise.errors import InputError, LobewiseError
from lobewise.metrics import rel_mse
from lobewise.mitsuba import Denoiser
from lobewise.mitsuba.frames import to_camera_space
from lobewise.records.frame import Frame
from tests.mistakes import refuses
from tests.pythons import run_python

SIZE = 64


@pytest.fixture(scope="module")
def scene(mi: Any) -> Any:
    """Return Mitsuba's Cornell box, small, with a box filter."""
    items = mi.cornell_box()
    items["sensor"]["film"] |= {"width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    return mi.load_dict(items)


@pytest.fixture(scope="module")
def reference(mi: Any, scene: Any) -> np.ndarray:
    return np.array(mi.render(scene, spp=1024, seed=99))


@pytest.fixture(scope="module")
def multichannel(mi: Any, scene: Any) -> Any:
    """Return a bitmap with the layers that the integrator ``aov`` writes."""
    return render_layers(mi, scene, "albedo:albedo,normals:sh_normal")


def render_layers(mi: Any, scene: Any, aovs: str, spp: int = 4) -> Any:
    integrator = mi.load_dict({"type": "aov", "aovs": aovs, "integrator": {"type": "path"}})
    mi.render(scene, spp=spp, integrator=integrator)
    return scene.sensors()[0].film().bitmap()


def get_layers(bitmap: Any) -> dict[str, np.ndarray]:
    return {name: np.array(layer) for name, layer in bitmap.split()}


@pytest.mark.nightly
@pytest.mark.mitsuba
def test_the_first_example_of_mitsubas_page_runs(mi: Any, scene: Any, reference: np.ndarray) -> None:
    noisy = mi.render(scene, spp=1)
    denoiser = Denoiser(input_size=noisy.shape[:2], albedo=False, normals=False, temporal=False)
    denoised = denoiser(noisy)
    assert type(denoised) is type(noisy)
    assert denoised.shape == noisy.shape
    assert rel_mse(np.array(denoised), reference) < 0.3 * rel_mse(np.array(noisy), reference)


@pytest.mark.nightly
@pytest.mark.mitsuba
def test_the_second_example_of_mitsubas_page_runs(
    mi: Any, scene: Any, reference: np.ndarray, multichannel: Any
) -> None:
    noisy_multichannel = multichannel
    to_sensor = scene.sensors()[0].world_transform().inverse()
    denoiser = Denoiser(input_size=noisy_multichannel.size(), albedo=True, normals=True, temporal=False)
    denoised = denoiser(noisy_multichannel, albedo_ch="albedo", normals_ch="normals", to_sensor=to_sensor)
    assert isinstance(denoised, mi.Bitmap)
    assert denoised.pixel_format() == dict(noisy_multichannel.split())["<root>"].pixel_format()
    assert denoised.component_format() == mi.Struct.Type.Float32
    assert not denoised.srgb_gamma()
    noisy = get_layers(multichannel)["<root>"]
    assert rel_mse(np.array(denoised), reference) < 0.3 * rel_mse(noisy, reference)
    by_place = denoiser(noisy_multichannel, "albedo", "normals", to_sensor)
    np.testing.assert_array_equal(np.array(by_place), np.array(denoised))


@pytest.mark.mitsuba
def test_tensors_arrays_and_bitmaps_give_the_same_pixels(mi: Any, scene: Any, multichannel: Any) -> None:
    to_sensor = scene.sensors()[0].world_transform().inverse()
    layers = get_layers(multichannel)
    denoiser = Denoiser(multichannel.size(), albedo=True, normals=True)
    bitmap = denoiser(multichannel, albedo_ch="albedo", normals_ch="normals", to_sensor=to_sensor)
    assert "AOVs that lobewise does not use: integrator." in denoiser.notes
    tensors = [mi.TensorXf(layers[name]) for name in ("<root>", "albedo", "normals")]
    tensor = denoiser(tensors[0], albedo=tensors[1], normals=tensors[2], to_sensor=to_sensor)
    matrix = np.array(to_sensor.matrix).reshape(4, 4)
    array = denoiser(layers["<root>"], layers["albedo"], layers["normals"], matrix)
    np.testing.assert_array_equal(np.array(tensor), np.array(bitmap))
    np.testing.assert_array_equal(array, np.array(bitmap))
    assert isinstance(array, np.ndarray)


@pytest.mark.mitsuba
def test_normals_are_turned_into_the_sensors_space(mi: Any, scene: Any, multichannel: Any) -> None:
    from lobewise.render import get_camera

    camera = get_camera(scene)
    world = get_layers(multichannel)["normals"]
    to_sensor = scene.sensors()[0].world_transform().inverse()
    turned = to_camera_space(world, np.array(to_sensor.matrix, dtype=float).reshape(4, 4))
    expected = np.stack([world @ camera.right, world @ camera.up, world @ camera.forward], axis=-1)
    np.testing.assert_allclose(turned, expected, atol=1e-5)
    # Mitsuba's own sensors look along z with x to the left.
    np.testing.assert_allclose(to_camera_space(expected * [-1.0, 1.0, 1.0], None), expected, atol=1e-6)
    stretched = np.diag([1.0, 1.0, 4.0, 1.0])
    np.testing.assert_allclose(to_camera_space(np.ones((1, 1, 3)), stretched)[0, 0], [-1.0, 1.0, 0.25])


@pytest.mark.mitsuba
def test_further_layers_are_found_and_used(mi: Any, scene: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from lobewise.render import get_camera

    seen: list[Frame] = []
    monkeypatch.setattr(module, "denoise_quietly", lambda frame, settings: seen.append(frame) or run(frame, settings))
    run = lobewise_denoise
    aovs = "albedo:albedo,sh_normal:sh_normal,position:position,depth:depth,uv:uv,shape:shape_index"
    bitmap = render_layers(mi, scene, aovs)
    to_sensor = scene.sensors()[0].world_transform().inverse()
    denoiser = Denoiser(bitmap.size(), albedo=True)
    denoiser(bitmap)
    denoiser(bitmap, normals_ch="sh_normal", to_sensor=to_sensor)
    assert any(
        note.startswith("AOVs that lobewise does not use: ") and "uv" in note and "shape" in note
        for note in denoiser.notes
    )
    camera = get_camera(scene)
    for frame in seen:
        np.testing.assert_allclose(frame.camera.position, camera.position, atol=0.02)
        assert frame.gbuffer.depth is not None
        assert frame.gbuffer.diffuse_albedo is not None
    first, second = (frame.gbuffer.normal for frame in seen)
    assert first is not None
    assert second is not None
    # The world's normals, whether they come as such or by way of the sensor; the camera that was found is off a little.
    np.testing.assert_allclose(first, second, atol=0.02)


def lobewise_denoise(frame: Frame, settings: Any) -> Any:
    import lobewise

    return lobewise.denoise(frame, settings)


def make_images(seed: int = 3, channels: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a noisy image of two walls in a corner, its truth and its normals in the sensor's space."""
    rng = np.random.default_rng(seed)
    truth = np.where(np.arange(40)[None, :, None] < 20, 0.2, 0.7) * np.ones((32, 40, channels))
    noisy = truth * rng.gamma(4.0, 0.25, (32, 40, 1))
    normals = np.where(np.arange(40)[None, :, None] < 20, [0.6, 0.0, -0.8], [-0.6, 0.0, -0.8]) * np.ones((32, 1, 1))
    return noisy.astype(np.float32), truth, normals.astype(np.float32)


def test_numpy_arrays_need_no_mitsuba() -> None:
    code = """
import sys, numpy as np
import lobewise.mitsuba
noisy = np.random.default_rng(0).random((24, 32, 3), dtype=np.float32)
clean = lobewise.mitsuba.Denoiser((32, 24))(noisy)
assert clean.shape == noisy.shape and clean.std() < 0.5 * noisy.std()
print(sorted({"mitsuba", "drjit"} & set(sys.modules)))
"""
    assert run_python("-c", code) == "[]\n"


def test_normals_keep_an_edge_that_light_alone_does_not() -> None:
    noisy, truth, normals = make_images()
    denoiser = Denoiser((40, 32), quality="fast")
    alone, guided = denoiser(noisy), denoiser(noisy, normals=normals)
    assert rel_mse(guided, truth) < 0.3 * rel_mse(alone, truth)


def test_alpha_is_copied_or_denoised() -> None:
    noisy, _, normals = make_images()
    rng = np.random.default_rng(1)
    alpha = (rng.random((32, 40, 1)) < 0.5).astype(np.float32)
    image = np.concatenate([noisy, alpha], axis=-1)
    copied = Denoiser((40, 32))(image, normals=normals)
    np.testing.assert_array_equal(copied[..., 3:], alpha)
    clean = Denoiser((40, 32), denoise_alpha=True)(image, normals=normals)
    np.testing.assert_array_equal(clean[..., :3], copied[..., :3])
    assert abs(clean[..., 3].mean() - 0.5) < 0.05
    assert clean[..., 3].std() < 0.2


def test_monochrome_images_stay_monochrome() -> None:
    noisy, truth, normals = make_images(channels=1)
    clean = Denoiser((40, 32))(noisy, normals=normals)
    assert clean.shape == noisy.shape
    assert rel_mse(np.repeat(clean, 3, -1), np.repeat(truth, 3, -1)) < 0.2 * rel_mse(
        np.repeat(noisy, 3, -1), np.repeat(truth, 3, -1)
    )


def test_a_lamp_does_not_spoil_what_is_around_it() -> None:
    noisy, _, normals = make_images()
    noisy[4:10, 4:10] = 30.0
    for quality in ("fast", "balanced"):
        denoiser = Denoiser((40, 32), quality=quality)
        clean = denoiser(noisy, normals=normals)
        np.testing.assert_array_equal(clean[4:10, 4:10], noisy[4:10, 4:10])
        assert clean[14:, :18].max() < 0.6
        assert any("lamps" in note for note in denoiser.notes)


def test_pixels_that_are_no_light_are_refilled_and_told() -> None:
    noisy, _, normals = make_images()
    noisy[5, 5] = np.nan
    denoiser = Denoiser((40, 32))
    assert np.isfinite(denoiser(noisy, normals=normals)).all()
    assert any(note.startswith("1 pixels were NaN") for note in denoiser.notes)


def run_sequence(direction: float, *, frames: int = 8, shift: int = 2) -> float:
    """Return the error of the last of some frames whose picture moves to the right, with the flow in a direction."""
    width, height = 64, 32
    denoiser = Denoiser((width, height), temporal=True)
    flow = np.zeros((height, width, 2), np.float32)
    flow[..., 0] = direction * shift
    previous = None
    columns = np.arange(width)
    for number in range(frames):
        phase = columns - number * shift
        truth = (1.0 + 0.8 * np.sin(phase * 1.1))[None, :, None] * np.ones((height, 1, 3))
        tilt = 0.5 * np.sin(phase * 1.1)
        normals = np.stack([tilt, 0.0 * tilt, -np.sqrt(1.0 - tilt**2)], axis=-1)[None] * np.ones((height, 1, 1))
        noisy = truth * np.random.default_rng(number).gamma(2.0, 0.5, (height, width, 1))
        noisy = noisy.astype(np.float32)
        previous = denoiser(
            noisy,
            normals=normals.astype(np.float32),
            flow=flow,
            previous_denoised=noisy if previous is None else previous,
        )
    inner = np.s_[:, 16:-16]
    return rel_mse(previous[inner], truth[inner])


def test_flow_leads_from_the_frame_before_to_this_one() -> None:
    right, wrong = run_sequence(1.0), run_sequence(-1.0)
    assert right < 0.7 * wrong


def test_a_history_begins_with_the_noisy_image_and_goes_on_with_the_last_one() -> None:
    noisy, truth, normals = make_images()
    denoiser = Denoiser((40, 32), temporal=True)
    flow = np.zeros((32, 40, 2), np.float32)
    clean = denoiser(noisy, normals=normals, flow=flow, previous_denoised=noisy)
    first = clean
    for seed in range(4, 10):
        # As it would come back from a file of 16-bit floats.
        previous = clean.astype(np.float16).astype(np.float32)
        clean = denoiser(make_images(seed)[0], normals=normals, flow=flow, previous_denoised=previous)
    assert rel_mse(clean, truth) < 0.5 * rel_mse(first, truth)
    with refuses(InputError, "previous_denoised"):
        denoiser(noisy, normals=normals, flow=flow, previous_denoised=0.5 * clean)
    anew = denoiser(noisy, normals=normals, flow=flow, previous_denoised=noisy)
    np.testing.assert_array_equal(anew, first)


def test_mistakes_are_told_in_one_sentence() -> None:
    noisy, _, normals = make_images()
    denoiser = Denoiser((40, 32))
    flow = np.zeros((32, 40, 2), np.float32)
    cases: list[tuple[str, Any]] = [
        ("input_size", lambda: Denoiser((40, 32, 3))),
        ("quality", lambda: Denoiser((40, 32), quality="hihg")),
        ("noisy", lambda: Denoiser((32, 40))(noisy)),
        ("noisy", lambda: Denoiser((8, 8))(noisy)),
        ("noisy", lambda: denoiser(np.zeros((32, 40, 5)))),
        ("noisy", lambda: denoiser("frame.exr")),
        ("normals", lambda: denoiser(noisy, normals=normals[..., :2])),
        ("albedo", lambda: Denoiser((40, 32), albedo=True)(noisy)),
        ("normals", lambda: Denoiser((40, 32), normals=True)(noisy)),
        ("to_sensor", lambda: denoiser(noisy, normals=normals, to_sensor=np.zeros((4, 4)))),
        ("temporal", lambda: denoiser(noisy, flow=flow)),
        ("flow", lambda: Denoiser((40, 32), temporal=True)(noisy)),
        ("noisy", lambda: denoiser(noisy, albedo_ch="albedo")),
    ]
    for what, call in cases:
        with refuses(LobewiseError, what):
            call()


@pytest.mark.mitsuba
def test_mistakes_with_bitmaps_are_told(mi: Any, multichannel: Any) -> None:
    denoiser = Denoiser(multichannel.size())
    with refuses(InputError, "albedo_ch"):
        denoiser(multichannel, albedo_ch="albeddo")
    with refuses(InputError, "albedo"):
        denoiser(multichannel, albedo=mi.TensorXf(np.zeros((SIZE, SIZE, 3))))
    shown = mi.Bitmap(np.zeros((SIZE, SIZE, 3), np.uint8))
    with refuses(InputError, "noisy", "uint8, gamma corrected"):
        denoiser(shown)


VARIANTS = """
import numpy as np, mitsuba as mi, lobewise.mitsuba
from lobewise.render.variant import locate_llvm
import os
os.environ["DRJIT_LIBLLVM_PATH"] = locate_llvm()
mi.set_variant({variant!r})
film = {{"type": "hdrfilm", "width": 20, "height": 12, "pixel_format": {format!r}, "rfilter": {{"type": "box"}}}}
scene = mi.load_dict({{
    "type": "scene", "integrator": {{"type": "path"}}, "sensor": {{"type": "perspective", "film": film}},
    "ball": {{"type": "sphere", "center": [0, 0, 3]}}, "sky": {{"type": "constant"}},
    "lamp": {{"type": "point", "position": [4, 5, -3], "intensity": 60.0}},
}})
noisy = mi.render(scene, spp=2)
clean = lobewise.mitsuba.Denoiser((20, 12))(noisy)
assert type(clean) is type(noisy) and clean.shape == noisy.shape, (clean.shape, noisy.shape)
a, b = np.array(noisy), np.array(clean)
assert np.isfinite(b).all() and abs(b.mean() / a.mean() - 1.0) < 0.1 and not np.array_equal(a, b)
print(clean.shape[2])
"""


@pytest.mark.sampled("scalar_rgb-rgba-4")
@pytest.mark.mitsuba
@pytest.mark.parametrize(
    ("variant", "format_", "channels"),
    [("scalar_rgb", "rgba", 4), ("llvm_ad_mono", "luminance", 1), ("llvm_ad_spectral", "rgb", 3)],
)
def test_every_variant(mi: Any, variant: str, format_: str, channels: int) -> None:
    assert run_python("-c", VARIANTS.format(variant=variant, format=format_)) == f"{channels}\n"
