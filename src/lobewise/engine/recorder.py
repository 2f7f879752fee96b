"""The engine that records a recipe: each kernel is defined once, called by names, and compiled for a target."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.compiler import hl
from lobewise.backend.disk import fetch_object
from lobewise.backend.jit import Scheduled, describe_kernel
from lobewise.backend.objects import catch_file, compile_object
from lobewise.backend.pointwise import Definition, PointwiseKey, make_pointwise
from lobewise.backend.signature import Axis, Parameter, list_axis_lengths, list_outputs
from lobewise.engine.graph import Graph, GraphImage, Length, write_length
from lobewise.engine.here import KernelPass
from lobewise.engine.numbers import Condition, Number, write_number


@dataclass(frozen=True)
class CompiledKernel:
    """A kernel of a pipeline.

    Parameters
    ----------
    symbol : str
        Name of the function in C.
    name : str
        Name of the kernel.
    parameters : tuple of Parameter
    target : halide.Target
    make : callable
        Defines the kernel for a target.
    known : str or None
        Text that identifies the kernel's code in all processes, if there is one.
    """

    symbol: str
    name: str
    parameters: tuple[Parameter, ...]
    target: hl.Target
    make: Callable[[hl.Target], Scheduled]
    known: str | None

    def compile(self) -> bytes:
        """Return the object file. Those of 64-bit machines are kept on disk."""

        def write(path: str) -> None:
            funcs = self.make(self.target)
            hl.Pipeline(funcs.out).compile_to_object(path, funcs.signature.arguments, self.symbol, self.target)

        if self.target.bits != 64:
            return catch_file(write)
        known = self.known and f"exported {self.symbol} {self.known}"
        content, _ = fetch_object(known, lambda: (compile_object(write), {}), symbol=self.symbol)
        return content


GRAPHICS = ("CUDA", "Vulkan", "OpenCL", "D3D12Compute", "Metal", "WebGPU")
"""Features of targets that have a graphics processor."""


def make_kernel_target(target: hl.Target, *, strict: bool = False, on_processor: bool = True) -> hl.Target:
    """Return the target of single kernels: without checks of buffers, which the driver makes, and without runtime."""
    for name in GRAPHICS if on_processor else ():
        target = target.without_feature(getattr(hl.TargetFeature, name))
    names = ["NoAsserts", "NoBoundsQuery", "NoRuntime", *(["StrictFloat"] if strict else [])]
    for name in names:
        target = target.with_feature(getattr(hl.TargetFeature, name))
    return target


@dataclass
class Recorder:
    """The engine that records every call: it adds the call to a graph, and defines the kernel for a target.

    Parameters
    ----------
    graph : Graph
    target : halide.Target
    prefix : str
        Beginning of the names of functions.
    on : str
        Where kernels run: "cpu", or a graphics API of the target. What is computed pixel by pixel, or in a box of the
        image, runs on the processor.
    """

    graph: Graph
    target: hl.Target
    prefix: str
    on: str = "cpu"
    compiled: dict[tuple[Hashable, bool, bool], CompiledKernel] = field(default_factory=dict)
    computed: dict[Hashable, tuple[GraphImage, ...]] = field(default_factory=dict)
    """What `pixels` has computed, by definition, images and numbers."""
    picked: dict[str, GraphImage] = field(default_factory=dict)
    """Images at the shaded pixels, by the names of the images of all pixels."""
    state: dict[str, GraphImage] = field(default_factory=dict)
    """What the next frame reads, by name."""
    before: dict[str, GraphImage] = field(default_factory=dict)
    """The same, as the frame before left it."""
    known: dict[str, GraphImage] = field(default_factory=dict)
    """Images whose values are compiled in, by name."""
    totals: dict[str, str] = field(default_factory=dict)
    """Expressions of C of numbers of whole images, by name."""

    @property
    def lanes(self) -> int:
        """Pixels of a vector of the target; 0 for a graphics processor."""
        return int(self.target.natural_vector_size(hl.Float(32))) if self.device == "cpu" else 0

    def get(self, key: Hashable, make: Callable[[hl.Target], Scheduled], *, strict: bool = False) -> CompiledKernel:
        """Return the kernel of a key."""
        place = key, strict, self.device == "cpu"
        if place not in self.compiled:
            target = make_kernel_target(self.target, strict=strict, on_processor=place[2])
            signature = make(target).signature
            known = describe_kernel(key, make)
            described = known and f"{known} {target.to_string()}"
            digest = hashlib.sha256((described or str(len(self.compiled))).encode()).hexdigest()[:10]
            words = "".join(letter if letter.isalnum() else "_" for letter in signature.name)
            symbol = f"{self.prefix}_{words}_{digest}"
            self.compiled[place] = CompiledKernel(
                symbol, signature.name, tuple(signature.parameters), target, make, described
            )
        return self.compiled[place]

    def call(
        self,
        kernel: CompiledKernel,
        arguments: Mapping[str, Any],
        *,
        sizes: Mapping[str, Axis] | None = None,
        names: Mapping[str, str] | None = None,
        into: Mapping[str, GraphImage] | None = None,
        text: str,
    ) -> dict[str, GraphImage]:
        """Add a call; return its output images by parameter.

        Parameters
        ----------
        kernel : CompiledKernel
        arguments : mapping of str to GraphImage, Number, float or str
            By parameter. Those that the kernel does not have are left out.
        sizes : mapping of str to length, optional
            Axes of outputs that no input has.
        names : mapping of str to str, optional
            Names for the output images that the call makes, by parameter.
        into : mapping of str to GraphImage, optional
            Output images that exist.
        text : str
            What the call does.
        """
        declared = {parameter.name for parameter in kernel.parameters}
        passed = {name: value for name, value in arguments.items() if name in declared}
        axes = {**list_axis_lengths(kernel.parameters, passed), **(sizes or {})}
        outputs: dict[str, GraphImage] = dict(into or {})
        for parameter in list_outputs(kernel.parameters):
            if parameter.name not in outputs:
                shape = [axes.get(axis, axis) if isinstance(axis, str) else axis for axis in parameter.axes]
                name = (names or {}).get(parameter.name, f"{kernel.name.replace(' ', '_')}_{parameter.name}")
                outputs[parameter.name] = self.graph.make(name, *shape, type=parameter.type)
        on_device = kernel.target.has_gpu_feature()
        self.graph.call(kernel.symbol, {**passed, **outputs}, kernel.parameters, text, on_device=on_device)
        return outputs

    @property
    def device(self) -> str:
        """Where the next kernel runs."""
        return "cpu" if self.graph.in_box else self.on

    def pixels(
        self,
        define: Definition,
        images: Mapping[str, Any],
        numbers: Mapping[str, Any],
        options: tuple[Hashable, ...],
        names: Sequence[str],
        into: Sequence[GraphImage | None],
        text: str,
    ) -> tuple[GraphImage, ...]:
        """See `lobewise.engine.pixels`. What was computed before of the same images is not computed again."""
        held: dict[str, GraphImage] = {name: image for name, image in images.items() if image is not None}
        vectors = {name: take_vector(value) for name, value in numbers.items()}
        codes = tuple((name, *(each.code for each in vector)) for name, vector in vectors.items())
        same = define, options, tuple((name, image.name) for name, image in held.items()), codes
        changes = any(into) or self.graph.when or self.graph.in_box
        if not changes and same in self.computed:
            return self.computed[same]
        key = PointwiseKey(
            define,
            options,
            tuple((name, image.channels, image.type == "uint8") for name, image in held.items()),
            tuple((name, len(each), not _is_single(each)) for name, each in vectors.items()),
            narrow=False,
        )
        kernel = self.host.get(key, partial(make_pointwise, key), strict=True)
        named = {f"{name}_{k}": value for name, vector in vectors.items() for k, value in enumerate(vector)}
        output_names = {f"out{number}": name for number, name in enumerate(names)}
        written = {f"out{number}": image for number, image in enumerate(into) if image is not None}
        outputs = self.call(kernel, {**held, **named}, names=output_names, into=written, text=text or describe(define))
        results = tuple(outputs[each.name] for each in list_outputs(kernel.parameters))
        if not changes:
            self.computed[same] = results
        return results

    def kernel(
        self,
        key: Hashable,
        make: Callable[[hl.Target], Scheduled],
        images: Mapping[str, GraphImage],
        numbers: Mapping[str, Any],
        names: Mapping[str, str],
        text: str,
        *,
        strict: bool = False,
        sizes: Mapping[str, Axis] | None = None,
        into: GraphImage | None = None,
    ) -> dict[str, GraphImage]:
        """See `lobewise.engine.kernel`."""
        lengths = {name: write_length(value) if isinstance(value, str) else value for name, value in numbers.items()}
        kernel = self.get(key, make, strict=strict)
        return self.call(kernel, {**images, **lengths}, sizes=sizes, names=names, text=text)

    def hold(self, name: str, array: NDArray[np.float32]) -> GraphImage:
        """See `lobewise.engine.hold`."""
        if name not in self.known:
            self.known[name] = self.graph.hold(name, array)
        return self.known[name]

    def halve(self, length: str) -> Length:
        """See `lobewise.engine.halve`."""
        return Length(f"{length}_half", f"(({write_length(length)} + 1) / 2)", 0.5 * getattr(length, "share", 1.0))

    def pad(self, length: str, multiple: int) -> Length:
        """See `lobewise.engine.pad`."""
        code = f"(({write_length(length)} + {multiple - 1}) / {multiple} * {multiple})"
        return Length(f"{length}_by_{multiple}", code, getattr(length, "share", 1.0))

    def planes(
        self,
        key: Hashable,
        make: Callable[[hl.Target], Scheduled],
        images: Mapping[str, GraphImage],
        numbers: Mapping[str, Any],
        name: str,
        keep: str,
        text: str,
        *,
        strict: bool = False,
    ) -> Any:
        """See `lobewise.engine.planes`."""
        kernel, arguments = self.get(key, make, strict=strict), {**images, **numbers}
        outputs, axes = list_outputs(kernel.parameters), list_axis_lengths(kernel.parameters, arguments)
        size = [axes.get(axis, axis) if isinstance(axis, str) else axis for axis in outputs[0].axes]
        if keep:
            self.declare(keep, len(outputs), *size)
        state_planes = self.state[keep].list_planes() if keep else []
        planes: Any = self.state[keep] if keep else None
        if len(state_planes) < len(outputs):
            other_planes = self.graph.make(
                f"{name}_{kernel.name}".replace(" ", "_"), len(outputs) - len(state_planes), *size
            )
            planes = [*state_planes, *other_planes.list_planes()] if state_planes else other_planes
        into = {each.name: planes[number] for number, each in enumerate(outputs)}
        self.call(kernel, arguments, into=into, text=text)
        return planes

    def pick(self, image: GraphImage, scale: int, place: tuple[str, str], *, stacked: bool) -> GraphImage:
        """See `lobewise.engine.pick`."""
        if image.name not in self.picked:
            size = "rows", "columns"
            shape = [image.shape[0], *size] if stacked else [*size, *image.shape[2:]]
            picked = self.graph.make(f"{image.name}_picked", *shape, type=image.type)
            numbers = [*place, str(int(stacked))]
            self.graph.run("pick_samples", [image, picked], numbers, f"{image.name} at shaded pixels", writes=[picked])
            self.picked[image.name] = picked
        return self.picked[image.name]

    def fill(self, name: str, value: float, shape: tuple[Axis, ...]) -> GraphImage:
        """See `lobewise.engine.fill`."""
        return self.graph.make_flat(name, value, *shape)

    def passes(
        self,
        passes: Sequence[KernelPass],
        images: Mapping[str, GraphImage],
        numbers: Mapping[str, Any],
        tiles: object,
        name: str,
    ) -> dict[str, GraphImage]:
        """See `lobewise.engine.passes`."""
        arguments, outputs = {**images, **numbers}, {}
        for number, kernel_pass in enumerate(passes):
            kernel = self.get(kernel_pass.key, kernel_pass.make)
            names = {out: f"{name}_{out}" for out in ("weight_sum", "effective_samples", "moment")}
            names |= {"image": name, "sums": f"{name}_sums{number}"}
            arguments |= {"radius": kernel_pass.radius, "step": kernel_pass.step}
            outputs = self.call(kernel, arguments, names=names, text=kernel_pass.text)
            arguments |= {"source": outputs.get("sums")}
        return outputs

    def total(
        self,
        measure: Callable[..., Any],
        images: Sequence[GraphImage],
        numbers: Sequence[float],
        name: str,
        count: int,
    ) -> Any:
        """See `lobewise.engine.total`."""
        name = name or measure.__name__
        if name not in self.totals:
            self.totals[name] = self.graph.add_real(name, count)
        real = self.totals[name]
        self.graph.run(
            measure.__name__,
            images,
            [*map(write_number, numbers), f"&{real}" if count == 1 else real],
            describe(measure),
        )
        if count == 1:
            return Number(1.0, real)
        return [Number(1.0, f"{real}[{k}]", is_single=True) for k in range(count)]

    def own(self, image: GraphImage) -> GraphImage:
        """See `lobewise.engine.own`."""
        return image

    def in_box(self, mask: GraphImage, reach: int, run: Callable[..., None], images: Sequence[GraphImage]) -> None:
        """See `lobewise.engine.in_box`."""
        self.graph.run("find_box", [mask], [str(reach)], "the box around the pixels of the mask")
        with self.graph.only_in_box():
            run(*images)

    def in_bands(
        self,
        gather: Callable[[dict[str, Any]], dict[str, Any]],
        finish: Callable[[dict[str, Any]], Any],
        images: Mapping[str, GraphImage],
        rows: int,
        reach: int,
    ) -> Any:
        """See `lobewise.engine.in_bands`."""
        return finish(gather(dict(images)))

    def by_value(self, run: Callable[[Any], Any], image: GraphImage) -> GraphImage:
        """See `lobewise.engine.by_value`."""
        height, width, channels = image.shape[0], image.shape[1], image.channels
        share = getattr(width, "share", 1.0) * channels
        length = Length(f"{width}_times_{channels}", f"({write_length(width)} * {channels})", share)
        result: GraphImage = run(replace(image, name=f"{image.name}_values", shape=(height, length), whole=image))
        return replace(result, name=f"{result.name}_pixels", shape=image.shape, whole=result)

    def chain(
        self,
        define: Definition,
        images: Mapping[str, GraphImage],
        numbers: Mapping[str, Any],
        key: Hashable,
        make: Callable[[hl.Target], Scheduled],
        arrays: Mapping[str, NDArray[np.float32]],
        rows: int,
        name: str,
        channels: int,
        texts: tuple[str, str],
    ) -> GraphImage:
        """See `lobewise.engine.chain`."""
        kernel, size = self.host.get(key, make), ("height", "width")
        (out,) = list_outputs(kernel.parameters)
        held = {each: self.graph.hold(f"{out.name}_{each}", array) for each, array in arrays.items()}
        between = self.graph.make(name, "band", size[1], channels)
        result = self.graph.make(out.name, *size, *out.axes[2:], type=out.type)
        with self.graph.only_in_bands():
            self.pixels(define, images, numbers, (), (), [between], texts[0])
            self.call(kernel, {name: between, **held}, into={out.name: result}, text=texts[1])
        return result

    def compare(self, first: float, sign: str, second: float) -> Condition:
        """See `lobewise.engine.compare`."""
        return Condition(f"({write_number(first)} {sign} {write_number(second)})")

    def both(self, first: Condition, second: Condition) -> Condition:
        """See `lobewise.engine.both`."""
        return Condition(f"({first} && {second})")

    def when(self, condition: Condition, run: Callable[[], Any], otherwise: Callable[[], Any] | None) -> Any:
        """See `lobewise.engine.when`."""
        with self.graph.only_when(condition):
            result = run()
        if otherwise is not None:
            with self.graph.only_when(f"!{condition}"):
                otherwise()
        return result

    def declare(self, name: str, *shape: Axis, type: str = "float32") -> GraphImage:
        """Declare what the next frame finds under a name; return what the frame before left there."""
        if name not in self.state:
            self.state[name], self.before[name] = self.graph.keep(name, *shape, type=type)
        return self.before[name]

    def keep(self, name: str, make: Callable[[], GraphImage | None]) -> None:
        """See `lobewise.engine.keep`."""
        image = make()
        if image is None or (name in self.state and image.memory is self.state[name].memory):
            return
        self.declare(name, *image.shape, type=image.type)
        state = self.state[name]
        self.graph.run("copy_image", [image, state], [], "what the next frame reads", writes=[state])

    def clear(self, image: GraphImage) -> None:
        """See `lobewise.engine.clear`."""
        self.graph.run("clear_image", [image], [], "nothing", writes=[image])

    def only(self, condition: Condition, image: GraphImage) -> GraphImage:
        """See `lobewise.engine.only`."""
        with self.graph.only_when(f"!{condition}"):
            self.clear(image)
        return image

    def some(self, image: GraphImage) -> GraphImage:
        """See `lobewise.engine.some`."""
        return image

    @property
    def host(self) -> Recorder:
        """The engine that records calls for the processor."""
        return replace(self, on="cpu")

    def part(self, name: str) -> AbstractContextManager[None]:
        """See `lobewise.engine.part`."""
        return self.graph.part(name)

    def take(self, name: str, shape: Sequence[Axis], text: str, unit: str) -> GraphImage:
        """See `lobewise.engine.take`."""
        return self.graph.take(name, *shape, text=text, unit=unit)


def describe(define: Definition) -> str:
    """Return what a definition computes, by the first sentence of its docstring."""
    first = (define.__doc__ or define.__name__).partition("\n")[0].partition("; see ")[0]
    return first.removeprefix("Return ").removesuffix(".")


def take_vector(value: Any) -> list[Number]:
    """Return the components of a number that a recipe gives to a kernel."""
    if isinstance(value, Number):
        return [value]
    if isinstance(value, (list, tuple)):
        return [each for part in value for each in take_vector(part)]
    vector = np.atleast_1d(np.asarray(value))
    return [Number(float(each), write_number(each), is_single=vector.dtype == np.float32) for each in vector]


def _is_single(vector: Sequence[Number]) -> bool:
    singles = {value.is_single for value in vector}
    assert len(singles) == 1, "the components of a number have one precision"
    return singles == {True}
