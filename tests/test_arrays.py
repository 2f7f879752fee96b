"""Arrays of any library go in, and come out as what they were."""

import importlib
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise import metrics
from lobewise.errors import InputError, LobewiseError
from lobewise.interchange import read_image
from lobewise.io import write_image
from lobewise.peers import has_oidn
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance, Result
from tests.mistakes import refuses
from tests.streaming.frames import make_scene

SHAPE = (12, 14)
CPU, CUDA = 1, 2


class Tensor:
    """What an array is like that offers DLPack alone; ``device`` is DLPack's number of its device."""

    def __init__(self, array: FloatArray, device: int = CPU) -> None:
        self.array, self.device = array, device

    @property
    def shape(self) -> tuple[int, ...]:
        return self.array.shape

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.device, 0

    def __dlpack__(self, **_: Any) -> Any:
        # Without a version, as older libraries do: NumPy then takes every array as read-only.
        return self.array.__dlpack__()


class Movable(Tensor):
    """The same with the method by which PyTorch moves a tensor."""

    def cpu(self) -> Tensor:
        return Tensor(self.array)


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return a module that has tensors."""
    module = ModuleType("others")
    module.from_dlpack = lambda array: Tensor(np.from_dlpack(array))  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "others", module)
    monkeypatch.setattr(Tensor, "__module__", "others.tensors")
    return module


def of(make: Callable[[FloatArray], Any], frame: Any) -> Any:
    """Return a frame whose color is made anew of an array of another library."""
    kept = {name: getattr(frame.radiance, name) for name in frame.radiance.names if name != "color"}
    changed = Radiance(make(np.array(frame.radiance.color)), **kept)
    return frame.with_changes(radiance=changed) if isinstance(frame, Frame) else replace_radiance(frame, changed)


def replace_radiance(frame: Any, radiance: Radiance) -> Any:
    return lobewise.SparseFrame(radiance, frame.gbuffer, scale=frame.scale, place=frame.place, camera=frame.camera)


def make_sparse() -> Any:
    frame = make_scene(SHAPE)
    return lobewise.SparseFrame(
        Radiance(frame.radiance.color[::2, ::2]), frame.gbuffer, scale=2, place=(0, 0), camera=frame.camera
    )


def shade(rows: Any, columns: Any) -> Radiance:
    return Radiance(np.full((len(rows), 1, 3), 0.5, np.float32))


RECIPES: dict[str, tuple[Callable[[], Any], Callable[[Any], Result]]] = {
    "denoise": (lambda: make_scene(SHAPE), lambda frame: lobewise.denoise(frame, quality="fast", radius=2)),
    "upsample": (make_sparse, lambda frame: lobewise.upsample(frame, radius=1)),
    "history": (lambda: make_scene(SHAPE), lambda frame: lobewise.TemporalFilter(radius=2).add(frame)),
    "window": (
        lambda: make_scene(SHAPE),
        lambda frame: lobewise.WindowFilter(1, quality="fast", radius=2).denoise([frame], 0),
    ),
    "recompute": (
        make_sparse,
        lambda frame: lobewise.recompute(lobewise.upsample(frame, radius=1), shade, samples=1.0, budget=1.0),
    ),
}


@pytest.mark.parametrize("name", RECIPES)
def test_what_came_in_comes_out(name: str, library: ModuleType) -> None:
    make, run = RECIPES[name]
    frame = make()
    expected, result = run(frame), run(of(Tensor, frame))
    images = {key: value for key, value in vars(expected).items() if isinstance(value, np.ndarray)}
    assert {"image", "weight_sum", "bad_pixels"} <= set(images)
    for key, image in images.items():
        assert isinstance(getattr(result, key), Tensor), key
        np.testing.assert_array_equal(getattr(result, key).array, image)
    for images_by_name in ("layers", "also"):
        assert all(isinstance(image, Tensor) for image in getattr(result, images_by_name).values())
    assert isinstance(result.convert().image, np.ndarray)


@pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[compare]'")
def test_open_image_denoise_gives_it_back_too(library: ModuleType) -> None:
    frame = make_scene((20, 20))
    image, _ = lobewise.denoise_oidn(frame, quality="fast")
    tensor, _ = lobewise.denoise_oidn(of(Tensor, frame), quality="fast")
    assert isinstance(tensor, Tensor)
    np.testing.assert_array_equal(tensor.array, image)


def test_a_result_of_tensors_is_written_shown_and_measured(library: ModuleType, tmp_path: Path) -> None:
    frame = make_scene(SHAPE)
    lobewise.write_frame(tmp_path / "in.exr", frame)
    result = lobewise.denoise(of(Tensor, frame), quality="fast", radius=2)
    lobewise.write_result(tmp_path / "out.exr", result, source=tmp_path / "in.exr")
    write_image(tmp_path / "image.exr", result.image)
    for name in ("out.exr", "image.exr"):
        np.testing.assert_allclose(read_image(tmp_path / name), result.convert().image, rtol=1e-3)
    assert "14x12" in repr(result)
    assert "data:image" in result._repr_html_()
    assert metrics.mse(result.image, result.convert().image) == 0.0
    assert not lobewise.find_unsupported(result, budget=0.0).any()


def test_a_frame_owns_what_came_through_dlpack() -> None:
    image = np.ones((4, 5, 3), np.float32)
    frame = Frame(Radiance(Tensor(image)), GBuffer(depth=Tensor(image[..., 0].copy())))
    image[:] = np.nan
    np.testing.assert_array_equal(frame.radiance.color, 1.0)
    assert not frame.radiance.color.flags.writeable


def test_results_do_not_open_the_frame_to_writing(library: ModuleType) -> None:
    color = np.array(make_scene(SHAPE).radiance.color)
    frame = Frame(Radiance(Tensor(color), diffuse=color, specular=np.zeros_like(color)))
    result = lobewise.denoise(frame, quality="fast", radius=0)
    for tensor in (result.image, result.diffuse, result.specular):
        tensor.array[:] = np.nan  # type: ignore[attr-defined]
    np.testing.assert_array_equal(frame.radiance.diffuse, color)


def test_the_type_travels_with_a_frame(library: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = of(Tensor, make_scene(SHAPE))
    copy = pickle.loads(pickle.dumps(frame.with_changes(spp=4)))
    assert isinstance(lobewise.denoise(copy, quality="fast", radius=2).image, Tensor)
    # In a process that has not imported the library, such as a worker.
    monkeypatch.delitem(sys.modules, "others")
    assert isinstance(lobewise.denoise(copy, quality="fast", radius=2).image, np.ndarray)


@pytest.mark.parametrize(("kind", "advice"), [(Movable, "x.cpu()"), (Tensor, "numpy.asarray(x)")])
def test_arrays_of_other_devices_are_moved_by_their_owner(kind: type[Tensor], advice: str) -> None:
    image = np.ones((4, 5, 3), np.float32)
    for make in (Radiance, lambda value: GBuffer(normal=value), lambda value: metrics.mse(value, image)):
        with refuses(InputError, got=f"a {kind.__name__} on another device") as problem:
            make(kind(image, CUDA))
        assert problem.value.action.endswith(advice)


def test_memory_that_the_processor_shares_is_read() -> None:
    assert Radiance(Tensor(np.ones((4, 5, 3), np.float32), 1)).shape == (4, 5)


def test_kinds_of_numbers_that_numpy_lacks_get_a_sentence() -> None:
    class Narrow(Tensor):
        def __dlpack__(self, **_: Any) -> Any:
            raise BufferError("bfloat16")

    with refuses(LobewiseError, "color", "a Narrow (bfloat16)"):
        Radiance(Narrow(np.ones((4, 5, 3), np.float32)))


@pytest.mark.parametrize(("name", "make"), [("torch", "from_numpy"), ("jax.numpy", "asarray")])
def test_tensors_of_libraries(name: str, make: str) -> None:
    pytest.importorskip(name)
    library, frame = importlib.import_module(name), make_scene(SHAPE)
    expected = lobewise.denoise(frame, quality="fast", radius=2)
    tensor = getattr(library, make)(np.array(frame.radiance.color))
    result = lobewise.denoise(frame.with_changes(radiance=Radiance(tensor)), quality="fast", radius=2)
    assert type(result.image) is type(tensor)
    assert type(result.bad_pixels) is type(tensor)
    alone = lobewise.denoise(frame.with_changes(radiance=Radiance(frame.radiance.color)), quality="fast", radius=2)
    np.testing.assert_array_equal(np.asarray(result.image), alone.image)
    assert expected.image.shape == tuple(result.image.shape)


@pytest.mark.mitsuba
def test_tensors_of_dr_jit(mi: Any) -> None:
    frame = make_scene(SHAPE)
    tensor = mi.TensorXf(np.array(frame.radiance.color))
    result = lobewise.denoise(Frame(Radiance(tensor)), quality="fast", radius=2)
    alone = lobewise.denoise(Frame(Radiance(frame.radiance.color)), quality="fast", radius=2)
    assert type(result.image) is type(tensor)
    np.testing.assert_array_equal(np.array(result.image), alone.image)
