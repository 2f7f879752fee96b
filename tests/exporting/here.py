"""An engine that runs the calls of a recorded recipe at once, in this process: what is recorded is what is run.

`Here` stands where `lobewise.engine.recorder.Kernels` records the call of a kernel, `HereGraph` where
`lobewise.engine.graph.Graph` names images. Functions of the driver are those of the library that the driver repeats.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import halide as hl
import numpy as np

from lobewise import engine
from lobewise.backend.jit import Kernel, get_kernel, run_kernel
from lobewise.backend.signature import list_axis_lengths
from lobewise.denoising.automatic import estimate_spp
from lobewise.engine.graph import Graph, GraphImage, write_length
from lobewise.engine.numbers import Condition, Number
from lobewise.engine.recorder import Recorder
from lobewise.exporting.pipeline.constants import Constants
from lobewise.exporting.pipeline.frame import Features, PipelineGuides, no_features
from lobewise.exporting.pipeline.recording import record_frame
from lobewise.exporting.pipeline.sample import collect_images
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray
from lobewise.records.sparse_frame import AnyFrame, SparseFrame

_NAME = re.compile(r"p->[\w>.\[\]-]+")


class _Single:
    """The cast to single precision in an expression of C."""

    def __matmul__(self, value: float) -> float:
        return float(np.float32(value))


C_NAMES = {"F": _Single(), "fmax": max, "fmin": min, "sqrt": math.sqrt, "pow": math.pow, "hypot": math.hypot}
"""What expressions of C name."""


@dataclass(frozen=True, eq=False)
class Held(GraphImage):
    """An image that has values."""

    array: Any = None

    @property
    def values(self) -> Any:
        """The array, cut to the planes of the shape: an image may be the first planes of another."""
        count = self.shape[0]
        return self.array[:count] if isinstance(count, int) else self.array

    def take_plane(self, number: int) -> Held:
        name, array = f"{self.name}_plane{number}", self.array[number]
        return replace(self, name=name, shape=self.shape[1:], whole=self, plane=number, array=array)


@dataclass
class HereGraph(Graph):
    """The images of a recipe with their arrays, and the numbers that functions of the driver write."""

    arrays: Mapping[str, FloatArray] = field(default_factory=dict)
    sizes: Mapping[str, int] = field(default_factory=dict)
    place: tuple[int, int] = (0, 0)
    past: Mapping[str, FloatArray] = field(default_factory=dict)
    known: dict[str, float] = field(default_factory=dict)
    remembered: dict[str, FloatArray] = field(default_factory=dict)
    is_on: bool = True

    def hold_new(self, name: str, shape: Sequence[Any], type: str = "float32", value: float = 0.0) -> Held:
        """Return an image of one value."""
        array = np.full([self.find_length(write_length(axis)) for axis in shape], value, type)
        return Held(self.name(name), tuple(shape), type, array=array)

    def give(self, name: str, *shape: Any, text: str, unit: str = "", type: str = "float32") -> GraphImage:
        if name not in self.inputs:
            array = np.ascontiguousarray(self.arrays[name], type)
            self.inputs[name] = Held(self.name(name), shape, type, "given", text, unit, array=array)
        return self.inputs[name]

    def make(self, name: str, *shape: Any, type: str = "float32") -> GraphImage:
        return self.hold_new(name, shape, type)

    def make_flat(self, name: str, value: float, *shape: Any) -> GraphImage:
        return self.flats.setdefault(name, self.hold_new(name, shape, value=value))

    def take(self, name: str, *shape: Any, text: str, unit: str = "") -> GraphImage:
        return self.results.setdefault(name, self.hold_new(name, shape))

    def hold(self, name: str, values: np.ndarray) -> GraphImage:
        return Held(self.name(name), values.shape, array=np.ascontiguousarray(values, np.float32))

    def keep(self, name: str, *shape: Any, type: str = "float32") -> tuple[GraphImage, GraphImage]:
        now, before = self.hold_new(name, shape, type), self.hold_new(f"{name}_before", shape, type)
        if name in self.past:
            before.array[...] = self.past[name]
        self.remembered[name] = now.array
        return now, before

    @contextmanager
    def only_when(self, condition: str) -> Iterator[None]:
        before, name = self.is_on, condition.removeprefix("!")
        outer, self.when = self.when, condition
        value = self.known.get(name, 1.0) != 0.0
        self.is_on = before and value != condition.startswith("!")
        try:
            yield
        finally:
            self.is_on, self.when = before, outer

    def find(self, value: Any) -> float:
        """Return the value of an argument: what the driver computed, or what the recipe computed in Python."""
        code = getattr(value, "code", value)
        names = _NAME.findall(code) if isinstance(code, str) else []
        if not any(name in self.known for name in names):
            return float(value)
        text = _NAME.sub(lambda found: repr(self.known[found[0]]), code)
        return float(eval(text.replace("(double)", "").replace("(float)", "F@"), {"__builtins__": {}}, C_NAMES))

    def find_length(self, code: str) -> int:
        """Return the value of an expression of C of whole numbers."""
        known = {f"p->{name}": length for name, length in self.sizes.items()}
        known |= dict(zip(("p->frame->row", "p->frame->column"), self.place, strict=True))
        text = _NAME.sub(lambda found: str(known[found[0]]), code).replace("/", "//")
        return int(eval(text, {"__builtins__": {}}))

    def run(
        self,
        function: str,
        images: Sequence[GraphImage],
        numbers: Sequence[str],
        text: str,
        writes: Sequence[GraphImage] = (),
    ) -> None:
        if self.is_on:
            FUNCTIONS[function](self, [image.values for image in images], numbers)  # type: ignore[attr-defined]


def _pick_samples(graph: HereGraph, images: Sequence[np.ndarray], numbers: Sequence[str]) -> None:
    (row, column), scale = graph.place, graph.sizes["height"] // graph.sizes["rows"]
    axes = (slice(row, None, scale), slice(column, None, scale))
    images[1][...] = images[0][(slice(None), *axes) if numbers[2] == "1" else axes]


FUNCTIONS: Mapping[str, Callable[[HereGraph, Sequence[np.ndarray], Sequence[str]], Any]] = {
    "clear_image": lambda graph, images, numbers: images[0].fill(0),
    "copy_image": lambda graph, images, numbers: np.copyto(images[1], images[0]),
    "find_box": lambda graph, images, numbers: None,
    "pick_samples": _pick_samples,
}
"""What the functions of the driver do."""


class Here(Recorder):
    """The kernels of a recipe; a call runs at once."""

    def get(self, key: Any, make: Any, *, strict: bool = False) -> Any:
        return get_kernel("cpu", key, make, strict=strict)

    def total(self, measure: Any, images: Any, numbers: Any, name: str, count: int) -> Any:
        graph = self.graph
        assert isinstance(graph, HereGraph)
        code = f"p->{name or measure.__name__}"
        if graph.is_on:
            arrays = [image.values for image in images]
            arrays = [array.view(bool) if array.dtype == np.uint8 else array for array in arrays]
            found = np.atleast_1d(measure(*arrays, *numbers))
            graph.known |= {code if count == 1 else f"{code}[{k}]": float(value) for k, value in enumerate(found)}
        if count == 1:
            return Number(graph.known.get(code, 0.0), code)
        codes = [f"{code}[{k}]" for k in range(count)]
        return [Number(graph.known.get(each, 0.0), each, is_single=True) for each in codes]

    def by_value(self, run: Callable[[Any], Any], image: Any) -> Any:
        flat = image.values.reshape(len(image.values), -1)
        result = super().by_value(lambda values: run(replace(values, array=flat)), image)
        return replace(result, array=result.array.reshape(image.values.shape))

    def compare(self, first: Any, sign: str, second: Any) -> Condition:
        condition, values = super().compare(first, sign, second), [self.graph.find(each) for each in (first, second)]
        self.graph.known[condition] = float(values[0] > values[1] if sign == ">" else values[0] >= values[1])
        return condition

    def both(self, first: Condition, second: Condition) -> Condition:
        condition, known = super().both(first, second), self.graph.known
        known[condition] = known[first] * known[second]
        return condition

    def call(
        self,
        kernel: Any,
        arguments: Mapping[str, Any],
        *,
        sizes: Mapping[str, Any] | None = None,
        names: Mapping[str, str] | None = None,
        into: Mapping[str, GraphImage] | None = None,
        text: str,
    ) -> dict[str, GraphImage]:
        graph = self.graph
        assert isinstance(graph, HereGraph)
        assert isinstance(kernel, Kernel)
        wanted = {each.name: each for each in kernel.parameters}
        given = {name: value for name, value in arguments.items() if name in wanted and value is not None}
        images = {name: value for name, value in given.items() if isinstance(value, GraphImage)}
        outputs: dict[str, GraphImage] = dict(into or {})
        axes = list_axis_lengths(kernel.parameters, images)
        axes |= sizes or {}
        shapes = {each.name: tuple(axes.get(axis, axis) for axis in each.axes) for each in kernel.outputs}
        if not graph.is_on:
            made = {each.name: graph.hold_new(each.name, shapes[each.name], each.type) for each in kernel.outputs}
            return {**made, **outputs}
        numbers: dict[str, float] = {}
        for name, value in given.items():
            if name not in images:
                is_length = isinstance(value, str) and value.startswith(("p->", "(")) and wanted[name].type == "int32"
                numbers[name] = graph.find_length(value) if is_length else graph.find(value)
                numbers[name] = int(numbers[name]) if wanted[name].type == "int32" else numbers[name]
        arrays = {name: image.values for name, image in images.items()}  # type: ignore[attr-defined]
        lengths = {axis: graph.find_length(write_length(length)) for axis, length in (sizes or {}).items()}
        found = run_kernel(kernel, "cpu", arrays, lengths, **numbers)
        for each in kernel.outputs:
            if each.name in outputs:
                outputs[each.name].array[...] = found[each.name]  # type: ignore[attr-defined]
            else:
                name = graph.name((names or {}).get(each.name, each.name))
                outputs[each.name] = Held(name, shapes[each.name], each.type, array=np.asarray(found[each.name]))
        return outputs


class Numbers(Constants):
    """The numbers of a frame whose camera moved."""

    before: Camera | None = None

    def get_vector(self, name: str, *, before: bool = False) -> list[Number]:
        camera = self.before if before and self.before is not None else self.camera
        values = {"eye": camera.position, "forward": camera.forward}
        values |= camera.get_ray_numbers(self.size) | camera.get_projection_numbers(self.size)
        return [Number(float(value), "x") for value in np.atleast_1d(values[name])]


@dataclass
class Recorded:
    """A recipe that an engine runs, frame by frame.

    Parameters
    ----------
    settings : PipelineSettings
    features : callable
        More features of every layer.
    """

    settings: PipelineSettings
    features: Features = no_features
    past: Mapping[str, FloatArray] = field(default_factory=dict)
    camera: Camera | None = None

    def run(self, frame: AnyFrame, emission: FloatArray | None = None) -> FloatArray:
        """Return the image that the recorded recipe makes of a frame; ``emission`` as of `collect_images`."""
        settings, (height, width) = self.settings, frame.gbuffer.shape or frame.shape
        numbers = Numbers(
            settings.upsample, settings.radius, settings.is_guided, camera=frame.require_camera("a recipe")
        )
        numbers.size, numbers.spp, numbers.before = (height, width), estimate_spp(frame), self.camera
        rows, columns = frame.radiance.color.shape[:2]
        sizes = {"height": height, "width": width, "rows": rows, "columns": columns, "band": height}
        sizes |= {"height_before": height, "width_before": width}
        place = frame.place if isinstance(frame, SparseFrame) else (0, 0)
        graph = HereGraph(stage="guides", sizes=sizes, place=place, past=self.past)
        graph.known["p->has_past"] = float(self.camera is not None)
        wanted = Graph()
        wanted.inputs = dict.fromkeys(self.list_inputs())  # type: ignore[arg-type]
        graph.arrays = collect_images(wanted, frame, emission)
        here = Here(graph, hl.get_host_target(), "x")
        with engine.use(here):
            record_frame(PipelineGuides(settings, graph, here, numbers, self.features))
        self.past, self.camera = graph.remembered, frame.camera
        image = graph.results["image"]
        assert isinstance(image, Held)
        return np.asarray(image.array)

    def list_inputs(self) -> list[str]:
        """Return the names of the images that the recipe is given, as the export records them."""
        from lobewise.exporting.pipeline.recording import make_pipeline

        return list(make_pipeline(self.settings, features=self.features).graph.inputs)
