"""Compile the filter kernels ahead of time, for any target of Halide: one C function for a whole filter.

The function chains the passes of a form. Its numbers are settings (standard deviations, pixel angle, exponent), from
which it computes the factors of the inner loop. Unlike the kernels of this process it checks its buffers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, schedule_rows
from lobewise.exporting.arguments import Argument
from lobewise.exporting.plan import FilterPlan, Term, define_guides
from lobewise.exporting.targets import parse_target, refuse_target
from lobewise.features import Feature
from lobewise.features.base import describe_structure
from lobewise.filters.cross_pass import PassInputs, PassKey, Reads, Writes, chain_passes, make_pass
from lobewise.filters.forms import list_passes
from lobewise.filters.planes import begin_at_zero

MIN_NUMBER = 1e-9
"""Smallest value that the compiled function accepts for a number, other than a coordinate of the camera."""


@contextmanager
def _refusing(target: str) -> Iterator[None]:
    """Raise DeviceError with the compiler's reason where it cannot compile for a target."""
    try:
        yield
    except hl.HalideError as problem:
        reason = re.sub(r"\s+", " ", str(problem).removeprefix("Error: ")).strip().rstrip(".!")
        raise refuse_target(target, reason[:1].lower() + reason[1:200]) from problem


def compile_filter(plan: FilterPlan, target: str, *, name: str, library: Path, header: Path) -> None:
    """Compile a filter into a static library, Halide's runtime included, with a C header.

    ``target`` is a name for `lobewise.exporting.targets.parse_target`, ``name`` is the function's name in C, and
    ``library`` and ``header`` are the files to write.

    Raises InputError if the target is unknown, and DeviceError if Halide cannot compile the kernel for it.
    """
    chosen = parse_target(target)
    outputs = {hl.OutputFileType.static_library: str(library), hl.OutputFileType.c_header: str(header)}
    with _refusing(target):
        out, params = _define_filter(plan, chosen)
        hl.Pipeline(out).compile_to(outputs, params, name, chosen)


def compile_lobes(plan: FilterPlan, target: str, *, name: str, library: Path, header: Path) -> None:
    """Compile the function that makes lobes into an object file without runtime; see `compile_filter`.

    It has a file of its own because it needs strict floats, as in `lobewise.backend.pointwise`: the compiler must
    neither reorder operations nor assume that there is no NaN. It runs on the processor, whatever the target.
    """
    chosen = parse_target(target)
    for feature in ("StrictFloat", "NoRuntime"):
        chosen = chosen.with_feature(getattr(hl.TargetFeature, feature))
    outputs = {hl.OutputFileType.object: str(library), hl.OutputFileType.c_header: str(header)}
    with _refusing(target):
        outs, params = _define_lobe_images(plan, chosen)
        hl.Pipeline(outs).compile_to(outputs, params, name, chosen)


@dataclass
class _Inputs:
    """Halide's parameters of a function. All images have the size of the image ``like``."""

    like: hl.ImageParam
    params: dict[str, Any] = field(default_factory=dict)
    """By the names of arguments."""

    @classmethod
    def make(cls, arguments: Sequence[Argument], like: str) -> _Inputs:
        """Return the parameters of a function."""
        given = {argument.name: argument for argument in arguments if argument.role != "output"}
        inputs = cls(_make_image(given[like]))
        for name, argument in given.items():
            inputs.params[name] = inputs.like if name == like else inputs._make(argument)
        return inputs

    def _make(self, argument: Argument) -> Any:
        if argument.role == "number":
            number = hl.Param(hl.Float(32), argument.name)
            if not argument.name.startswith("eye"):
                number.set_min_value(hl.f32(MIN_NUMBER))
            return number
        image = _make_image(argument)
        self.constrain(image, argument)
        return image

    def constrain(self, image: Any, argument: Argument) -> None:
        """Let the compiled function check the size of an image; width and height are its last two axes."""
        if argument.name != "radiance":
            # A radiance may come as RGBA: its fourth channel is ignored.
            _constrain_channels(image, argument)
        first, size = int(not argument.planar), self.like.dimensions() - 2
        for axis in range(2):
            image.dim(first + axis).set_bounds(0, self.like.dim(size + axis).extent())


def _make_image(argument: Argument) -> hl.ImageParam:
    kind = hl.UInt(8) if argument.type == "uint8" else hl.Float(32)
    image = hl.ImageParam(kind, 2 if argument.planar else 3, argument.name)
    begin_at_zero(image)
    return image


def _constrain_channels(image: Any, argument: Argument) -> None:
    if not argument.planar:
        image.dim(0).set_bounds(0, argument.channels)
        image.dim(1).set_stride(argument.channels)


def _make_scalar(term: Term, feature: Feature, params: dict[str, Any], target: hl.Target) -> hl.Expr:
    """Return the parameter of a feature as an expression of the function's numbers.

    The parameter of ``feature`` is its value where every number is 1. The expression is computed in double precision
    and rounded once, as in `Feature.get_parameters`. Graphics processors compute it in single precision, because few
    have doubles, so that the last digit may differ.
    """
    literal, kind = (hl.f32, hl.Float(32)) if target.has_gpu_feature() else (hl.f64, hl.Float(64))
    (unit,) = feature.get_parameters()
    factors = {1: [literal(unit)], -1: []}
    for name, power in term.powers.items():
        factors[1 if power > 0 else -1] += [hl.cast(kind, params[name])] * abs(power)
    above, below = (math.prod(each[1:], start=each[0]) if each else None for each in factors.values())
    return hl.cast(hl.Float(32), above if below is None else above / below)


def _define_filter(plan: FilterPlan, target: hl.Target) -> tuple[hl.Func, list[Any]]:
    """Return the scheduled output and the inputs of a filter."""
    arguments = plan.filter_arguments
    inputs = _Inputs.make(arguments, "mask")
    params, terms, features = inputs.params, plan.terms, plan.make_blank_features()
    structure = tuple(describe_structure(feature) for feature in features)
    scalars = [[_make_scalar(*each, params, target)] for each in zip(terms, features, strict=True)]
    source: Any = params["radiance"]
    passes = list_passes(plan.form, plan.radius)
    reads = Reads.DEMODULATED if plan.albedo else Reads.RADIANCE
    whole = PassKey(passes[0][0], structure, reads, Writes.PIXELS, modulate=plan.albedo)
    keys = chain_passes(whole, [taps for taps, _, _ in passes], mirror=not target.has_gpu_feature())
    for key, (_, radius, step) in zip(keys, passes, strict=True):
        given = PassInputs(
            source=source,
            albedo=params.get("albedo"),
            mask=inputs.like,
            arrays=[params[name] for term in terms for name in term.arrays],
            radius=hl.i32(radius),
            step=hl.i32(step),
            scalars=scalars,
        )
        (source,) = make_pass(key, features, target, given).out
        if key.writes is Writes.SUMS:
            source.compute_root()
    inputs.constrain(source.output_buffer(), arguments[-1])
    return source, list(params.values())


def _define_lobe_images(plan: FilterPlan, target: hl.Target) -> tuple[list[hl.Func], list[Any]]:
    """Return the scheduled outputs and the inputs of the function that makes lobes."""
    arguments = plan.lobe_arguments
    inputs = _Inputs.make(arguments, "normal")
    params = inputs.params
    _constrain_channels(inputs.like, arguments[0])
    images = {
        {"alpha": "alpha_u"}.get(each.name, each.name): (params[each.name], max(each.channels, 1))
        for each in arguments
        if each.role == "input"
    }
    noise = params["tau"] * params["tau"]
    grid = Grid(images, {"eye": [params[f"eye_{axis}"] for axis in "xyz"], "noise": [noise]}, narrow=False)
    outs = schedule_rows(
        grid, define_guides(grid, plan.similarity, plan.lobes), target.natural_vector_size(hl.Float(32))
    )
    written = [argument for argument in arguments if argument.role == "output"]
    for out, argument in zip(outs, written, strict=True):
        inputs.constrain(out.output_buffer(), argument)
    return outs, list(params.values())
