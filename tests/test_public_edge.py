"""Public functions answer arguments of a wrong shape or type with a sentence, never with an error from inside."""

import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
import lobewise.interchange
import lobewise.io
import lobewise.metrics
from lobewise.errors import LobewiseError
from tests.streaming.frames import make_scene

SHAPE = (6, 7)
WRONG: dict[str, Any] = {
    "None": None,
    "text": "x",
    "number": 3.5,
    "not a number": float("nan"),
    "huge": 10**400,
    "truth value": True,
    "list": [1, "a"],
    "dictionary": {"a": 1},
    "object": object(),
    "no pixels": np.zeros((0, 0, 3), np.float32),
    "one axis": np.zeros(3, np.float32),
    "five axes": np.zeros((1, 2, 3, 4, 5), np.float32),
    "texts": np.array([["a", "b"]]),
    "objects": np.array([[None, 1]], dtype=object),
    "complex": np.zeros((6, 7, 3), np.complex64),
    "bytes": b"\xff\0",
    "path with a NUL": "a\0b.exr",
}


def make_arguments(folder: Path) -> dict[Callable[..., Any], dict[str, Any]]:
    """Return honest arguments of every public function and class, by their names."""
    frame = make_scene(SHAPE)
    path, other = folder / "a.exr", folder / "b.exr"
    lobewise.io.write_frame(path, frame)
    camera = {"position": (0.0, 0.0, 1.0), "forward": (0.0, 0.0, -1.0), "up": (0.0, 1.0, 0.0), "fov_y": 0.5}
    result = lobewise.denoise(frame, quality="fast", radius=2)
    color = frame.radiance.color
    sparse = lobewise.SparseFrame(lobewise.Radiance(color[::2, ::2]), frame.gbuffer, scale=2, camera=frame.camera)
    sparse_path = folder / "sparse.exr"
    lobewise.write_sparse_frame(sparse_path, sparse)
    return {
        lobewise.Camera: camera,
        lobewise.Radiance: {"color": color, "diffuse": color},
        lobewise.GBuffer: {"normal": frame.gbuffer.normal, "depth": frame.gbuffer.depth},
        lobewise.Frame: {"radiance": frame.radiance, "gbuffer": frame.gbuffer, "camera": frame.camera, "spp": 4},
        lobewise.SparseFrame: {"radiance": sparse.radiance, "gbuffer": sparse.gbuffer, "scale": 2, "place": (0, 0)},
        lobewise.denoise: {"frame": frame, "quality": "fast", "radius": 2, "beta": 3.0, "similarity": "ggx"},
        lobewise.denoise_oidn: {"frame": frame, "quality": "fast", "guides": "mean"},
        lobewise.upsample: {"frame": sparse, "radius": 2, "progress": lambda _: None},
        lobewise.TemporalFilter: {"radius": 2, "memory": 0.9},
        lobewise.WindowFilter: {"reach": 2, "quality": "fast"},
        lobewise.read_frame: {"path": path},
        lobewise.make_sparse: {"frame": frame, "scale": 2, "place": (0, 0)},
        lobewise.write_sparse_frame: {"path": other, "frame": sparse},
        lobewise.read_sparse_frame: {"path": sparse_path},
        lobewise.write_result: {"path": other, "result": result, "source": path},
        lobewise.denoise_file: {"source": path, "output": other, "quality": "fast", "radius": 2, "rows": 3},
        lobewise.denoise_files: {
            "source": path,
            "output": other,
            "quality": "fast",
            "radius": 2,
            "bands": 3,
            "numbers": None,
            "progress": None,
            "window": 0,
            "half": None,
            "camera": None,
            "preset": None,
            "mapping": {},
            "also": (),
            "materials": (),
            "suffix": "",
            "request": None,
        },
        lobewise.io.write_frame: {"path": other, "frame": frame, "compression": "zip"},
        lobewise.io.read_frame: {"path": path},
        lobewise.interchange.read_image: {"path": path},
        lobewise.io.write_image: {"path": other, "image": color},
        lobewise.interchange.describe_file: {"path": path},
        lobewise.metrics.mse: {"image": color, "reference": color},
        lobewise.metrics.rel_mse: {"image": color, "reference": color},
        lobewise.metrics.evaluate: {"image": color, "reference": color},
    }


def list_calls(folder: Path) -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    """Yield every call with one wrong argument, with its name."""
    for function, honest in make_arguments(folder).items():
        for name in honest:
            for what, value in WRONG.items():
                yield f"{function.__name__}({name}={what})", function, {**honest, name: value}


def test_wrong_arguments_get_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    failed = []
    for told, function, arguments in list_calls(tmp_path):
        try:
            function(**arguments)
        except LobewiseError as problem:
            if "\n" in str(problem) or not problem.expected:
                failed.append(f"{told}: {problem}")
        except Exception as problem:
            failed.append(f"{told}: {type(problem).__name__}: {problem}")
    assert not failed, f"{len(failed)} calls:\n" + "\n".join(failed)


@pytest.mark.parametrize("method", ["add", "set_state"])
def test_methods_of_a_filter_with_history(method: str) -> None:
    for value in WRONG.values():
        filtering = lobewise.TemporalFilter()
        with pytest.raises(LobewiseError) as caught:
            getattr(filtering, method)(value)
        assert caught.value.expected
        assert filtering.history_length is None


@pytest.mark.parametrize("method", ["join", "denoise"])
def test_methods_of_a_filter_of_windows(method: str, tmp_path: Path) -> None:
    frame = make_arguments(tmp_path)[lobewise.denoise]["frame"]
    for value in WRONG.values():
        for arguments in ((value, 0), ([value], 0), ([frame], value)):
            with pytest.raises(LobewiseError) as caught:
                getattr(lobewise.WindowFilter(1), method)(*arguments)
            assert caught.value.expected


def test_everything_public_is_tried(tmp_path: Path) -> None:
    """A function that becomes public gets honest arguments here, or a reason why not."""
    known = {each.__name__ for each in make_arguments(tmp_path)}
    elsewhere = {
        "RadianceLayer": "checked as GBuffer is",
        "LobeTable": "tests/test_lobe_table.py",
        "Result": "made by lobewise",
        "Progress": "made by lobewise",
        "ProgressBar": "tests/display/test_progress.py",
        "Rays": "tests/denoising/test_rays.py",
        "DenoisedFile": "made by lobewise",
        "FileRequest": "checked by denoise_files",
        "FileResult": "made by lobewise",
        "SequenceReport": "made by lobewise",
        "Feature": "a protocol",
        "DenoiseSettings": "tests/test_settings.py",
        "TemporalSettings": "tests/test_settings.py",
        "recompute": "tests/denoising/test_adaptive.py",
        "limit_call": "tests/test_limits.py",
        "find_unsupported": "tests/denoising/test_adaptive.py",
    }
    public = [getattr(lobewise, name) for name in lobewise.__all__]
    names = {each.__name__ for each in public if inspect.isfunction(each) or inspect.isclass(each)}
    names -= {each.__name__ for each in public if inspect.isclass(each) and issubclass(each, (Exception, int))}
    assert names - known - set(elsewhere) == set()
