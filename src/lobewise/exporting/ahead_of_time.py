"""The same kernels compiled ahead of time, for any machine that Halide knows: one C function for a whole filter.

The passes of a form are chained inside the function, and its constants are what a person would set (standard
deviations, pixel angle, exponent) instead of what the inner loop wants. Unlike the kernels of this process it checks
its buffers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import halide as hl
import numpy as np

from lobewise.backend.pointwise import Grid, Vector, _schedule
from lobewise.backend.targets import parse_target, refuse_target
from lobewise.errors import InputError, describe_problem, require_choice
from lobewise.features.base import LOG2_E, Feature, NormalFeature, PositionFeature, ScreenFeature
from lobewise.features.covariance import GGX_UNIT, AsgFeature, GgxFeature
from lobewise.features.lobe import DiffuseFeature, SgFeature
from lobewise.features.sg_mixture import SgMixtureFeature
from lobewise.filters.cross_pass import PassInputs, PassKey, describe_structure, make_pass
from lobewise.filters.forms import FORMS, can_pair, list_passes
from lobewise.filters.planes import begin_at_zero
from lobewise.filters.schedules.cpu import count_lanes, schedule_pass
from lobewise.frame import FloatArray
from lobewise.guides.lobe_fields import _define_lobes
from lobewise.lobe_table import MAX_LOBES
from lobewise.lobes.mixture import GGX_MIXTURES, MIN_SHARPNESS

SIMILARITIES = ("normal", "diffuse", "sg", "sg_mixture", "asg", "ggx")
LARGEST_RADIUS = 64
OUTPUT_CHANNELS = 5
"""Red, green, blue, weight sum, effective samples."""
SMALLEST_NUMBER = 1e-9
"""What constants must be at least."""


@dataclass(frozen=True)
class FilterPlan:
    """What is compiled.

    Parameters
    ----------
    similarity : {"normal", "diffuse", "sg", "sg_mixture", "asg", "ggx"}
        What makes two pixels similar, besides their places.
    form : {"full", "separable", "atrous"}
        See `lobewise.filters.cross_filter.run_filter`.
    radius : int
        Kernel radius, pixels, 0 to 64; "atrous" does not use it.
    lobes : int
        With "sg_mixture": spherical Gaussians per pixel, 2 to 4.
    albedo : bool
        Whether the radiance is divided by an albedo on the way in and multiplied by it on the way out.
    anisotropic : bool
        With "asg" and "ggx": whether lobes are made from two roughnesses and a tangent instead of one roughness.

    Raises
    ------
    InputError
        If one of them is out of range.
    """

    similarity: str = "ggx"
    form: str = "separable"
    radius: int = 8
    lobes: int = 3
    albedo: bool = True
    anisotropic: bool = False

    def __post_init__(self) -> None:
        require_choice("similarity", self.similarity, SIMILARITIES)
        require_choice("form", self.form, FORMS)
        _require_integer("radius", self.radius, 0, LARGEST_RADIUS, "8 is usual")
        _require_integer("lobes", self.lobes, 2, MAX_LOBES, "3 stand for GGX within 1 %, and one is similarity 'sg'")
        if self.anisotropic and self.similarity not in ("asg", "ggx"):
            raise InputError(
                describe_problem(
                    "anisotropic lobes",
                    expected="similarity 'asg' or 'ggx'",
                    got=repr(self.similarity),
                    action="choose one of them, or leave it out",
                )
            )

    @property
    def makes_lobes(self) -> bool:
        """Whether there is a second function, which makes the lobes from normal, roughness and position."""
        return self.similarity not in ("normal", "diffuse")


def _require_integer(what: str, value: Any, least: int, most: int, action: str) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise InputError(
            describe_problem(what, expected=f"an integer from {least} to {most}", got=repr(value), action=action)
        )


@dataclass(frozen=True)
class Argument:
    """An argument of a compiled function."""

    name: str
    role: str
    """"input", "output" or "number" (a float)."""
    channels: int = 1
    planar: bool = False
    """Whether it is an image without an axis for channels, (width, height)."""
    type: str = "float32"


@dataclass(frozen=True)
class _Part:
    """A feature with the names of its arrays and constants, and what its parameters are in terms of the latter."""

    feature: Feature
    arrays: tuple[str, ...]
    numbers: tuple[str, ...]
    scale: Callable[..., hl.Expr]
    """Of a function that makes constants of the right type, and the numbers."""

    def make_scalar(self, params: Mapping[str, hl.Expr], exact: bool) -> hl.Expr:
        """Return the parameter of the feature; ``exact``, it is rounded once, as `Feature.get_parameters` is."""
        kind = hl.Float(64) if exact else hl.Float(32)
        literal = hl.f64 if exact else hl.f32
        return hl.cast(hl.Float(32), self.scale(literal, *(hl.cast(kind, params[name]) for name in self.numbers)))


def _blank(*channels: int) -> FloatArray:
    return np.zeros((1, 1, *channels), np.float32)


def _list_parts(plan: FilterPlan) -> list[_Part]:
    """Return the features of a plan; their arrays tell numbers of channels alone."""
    x, z, n = _blank(), _blank(3), _blank(plan.lobes)
    covariance = ("axis", "covariance", "determinant")
    of_lobes = {
        "normal": _Part(NormalFeature(z, 1.0), ("normal",), ("normal_exponent",), lambda real, e: e * real(LOG2_E)),
        "diffuse": _Part(DiffuseFeature(z, 1.0), ("normal",), ("beta",), lambda real, beta: beta),
        "sg": _Part(SgFeature(z, x, 1.0), ("axis", "sharpness"), ("beta",), lambda real, beta: beta),
        "sg_mixture": _Part(
            SgMixtureFeature(z, n, n, 1.0), ("axis", "sharpness", "amplitude"), ("beta",), lambda real, beta: beta
        ),
        "asg": _Part(AsgFeature(z, _blank(6), x, 1.0), covariance, ("beta",), lambda real, beta: beta),
        "ggx": _Part(GgxFeature(z, _blank(6), x, 1.0), covariance, ("beta",), lambda real, beta: beta * real(GGX_UNIT)),
    }
    screen = _Part(ScreenFeature(1.0), (), ("screen_sigma",), lambda real, sigma: real(0.5 * LOG2_E) / (sigma * sigma))
    position = _Part(
        PositionFeature(z, x, pixel_angle=1.0, sigma=1.0),
        ("position", "depth"),
        ("position_sigma", "pixel_angle"),
        lambda real, sigma, angle: real(math.sqrt(0.5 * LOG2_E)) / (sigma * angle),
    )
    return [*([] if plan.form == "atrous" else [screen]), position, of_lobes[plan.similarity]]


def list_filter_arguments(plan: FilterPlan) -> list[Argument]:
    """Return the arguments of the filter, in order."""
    images = [Argument("radiance", "input", 3)]
    images += [Argument("albedo", "input", 3)] if plan.albedo else []
    images += [Argument("mask", "input", planar=True, type="uint8")]
    numbers = []
    for part in _list_parts(plan):
        for name, array in zip(part.arrays, part.feature.get_arrays(), strict=True):
            channels = 1 if array.ndim == 2 else array.shape[2]
            images.append(Argument(name, "input", channels, planar=array.ndim == 2))
        numbers += [Argument(name, "number") for name in part.numbers]
    return [*images, *numbers, Argument("output", "output", OUTPUT_CHANNELS)]


def list_lobe_arguments(plan: FilterPlan) -> list[Argument]:
    """Return the arguments of the function that makes lobes, in order; none where there is no such function."""
    if not plan.makes_lobes:
        return []
    alphas = ("alpha_u", "alpha_v") if plan.anisotropic else ("alpha",)
    inputs = [Argument("normal", "input", 3), Argument("position", "input", 3), Argument("depth", "input", planar=True)]
    inputs += [Argument(name, "input", planar=True) for name in alphas]
    inputs += [Argument("tangent", "input", 3)] if plan.anisotropic else []
    numbers = [Argument(name, "number") for name in ("eye_x", "eye_y", "eye_z", "tau")]
    lobes = {
        "sg": [Argument("sharpness", "output", planar=True)],
        "sg_mixture": [Argument(name, "output", plan.lobes) for name in ("sharpness", "amplitude")],
    }.get(plan.similarity, [Argument("covariance", "output", 6), Argument("determinant", "output", planar=True)])
    mask = Argument("mask", "output", planar=True, type="uint8")
    return [*inputs, *numbers, mask, Argument("axis", "output", 3), *lobes]


@contextmanager
def _refusing(target: str) -> Iterator[None]:
    """Tell in one sentence what the compiler has against a target."""
    try:
        yield
    except hl.HalideError as problem:
        reason = re.sub(r"\s+", " ", str(problem).removeprefix("Error: ")).strip().rstrip(".!")
        raise refuse_target(target, reason[:1].lower() + reason[1:200]) from problem


def compile_filter(plan: FilterPlan, target: str, *, name: str, library: Path, header: Path) -> None:
    """Compile a filter into a static library, Halide's runtime included, with a C header.

    Parameters
    ----------
    plan : FilterPlan
        What to compile.
    target : str
        See `lobewise.backend.targets.parse_target`.
    name : str
        Name of the function.
    library, header : Path
        The files to write.

    Raises
    ------
    InputError, DeviceError
        If the target is none, or Halide cannot compile the kernel for it.
    """
    chosen = parse_target(target)
    outputs = {hl.OutputFileType.static_library: str(library), hl.OutputFileType.c_header: str(header)}
    with _refusing(target):
        out, params = _define_filter(plan, chosen)
        hl.Pipeline(out).compile_to(outputs, params, name, chosen)


def compile_lobes(plan: FilterPlan, target: str, *, name: str, library: Path, header: Path) -> None:
    """Compile what makes the lobes of a filter into an object file without runtime; see `compile_filter`.

    Its floats keep their order and their NaN, as in `lobewise.backend.pointwise`; a filter need not, and one file has
    one way. It runs on the processor whatever the target.
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
    """Parameters by the names of arguments, each as large as the mask."""

    mask: hl.ImageParam
    params: dict[str, Any] = field(default_factory=dict)

    def add(self, argument: Argument) -> None:
        """Make the parameter of an argument."""
        if argument.role == "number":
            number = hl.Param(hl.Float(32), argument.name)
            if not argument.name.startswith("eye"):
                number.set_min_value(hl.f32(SMALLEST_NUMBER))
            self.params[argument.name] = number
            return
        param = hl.ImageParam(_get_type(argument), 2 if argument.planar else 3, argument.name)
        begin_at_zero(param)
        constrain(param, argument, self.mask)
        self.params[argument.name] = param


def _get_type(argument: Argument) -> hl.Type:
    return hl.UInt(8) if argument.type == "uint8" else hl.Float(32)


def constrain(image: Any, argument: Argument, like: hl.ImageParam) -> None:
    """Have the compiled function check that an image is as large as another, whose rows are its last two axes."""
    first = int(not argument.planar)
    if first and argument.name != "radiance":
        # A radiance may have a fourth channel that nobody reads, and lie in textures of four.
        image.dim(0).set_bounds(0, argument.channels)
        image.dim(1).set_stride(argument.channels)
    size = like.dimensions() - 2
    for axis in range(2):
        image.dim(first + axis).set_bounds(0, like.dim(size + axis).extent())


def _define_filter(plan: FilterPlan, target: hl.Target) -> tuple[hl.Func, list[Any]]:
    """Return the scheduled output and the inputs of a filter."""
    arguments = list_filter_arguments(plan)
    mask = hl.ImageParam(hl.UInt(8), 2, "mask")
    begin_at_zero(mask)
    inputs = _Inputs(mask, {"mask": mask})
    for argument in arguments:
        if argument.role != "output" and argument.name != "mask":
            inputs.add(argument)
    params = inputs.params
    parts = _list_parts(plan)
    features = [part.feature for part in parts]
    structure = tuple(describe_structure(feature) for feature in features)
    source: Any = params["radiance"]
    unused = hl.ImageParam(hl.Float(32), 3, "unused")
    passes = list_passes(plan.form, plan.radius)
    for number, (taps, reach, step) in enumerate(passes):
        first, last = number == 0, number == len(passes) - 1
        given = PassInputs(
            source=source,
            albedo=params.get("albedo") or unused,
            mask=mask,
            arrays=[params[array] for part in parts for array in part.arrays],
            step=hl.i32(step),
            # Few graphics processors have doubles; there a last digit may differ.
            scalars=[[part.make_scalar(params, exact=not target.has_gpu_feature())] for part in parts],
            strictness=unused,
        )
        key = PassKey(
            taps,
            reach,
            structure,
            first,
            last,
            demodulate=plan.albedo and first,
            modulate=plan.albedo and last,
            paired=not target.has_gpu_feature() and can_pair(taps, reach),
        )
        funcs = make_pass(key, features, given, lanes=count_lanes(target))
        if not last:
            funcs.out.compute_root()
        schedule_pass(funcs, target)
        source = funcs.out
    constrain(source.output_buffer(), arguments[-1], mask)
    return source, [params[argument.name] for argument in arguments if argument.role != "output"]


def _define_lobe_images(plan: FilterPlan, target: hl.Target) -> tuple[list[hl.Func], list[Any]]:
    """Return the scheduled outputs and the inputs of what makes the lobes of a filter."""
    arguments = list_lobe_arguments(plan)
    like = hl.ImageParam(hl.Float(32), 3, "normal")
    inputs = _Inputs(like, {"normal": like})
    begin_at_zero(like)
    like.dim(0).set_bounds(0, 3)
    like.dim(1).set_stride(3)
    given = [argument for argument in arguments if argument.role != "output"]
    for argument in given[1:]:
        inputs.add(argument)
    params = inputs.params
    images = {
        {"alpha": "alpha_u"}.get(argument.name, argument.name): (params[argument.name], argument.channels)
        for argument in given
        if argument.role == "input"
    }
    noise = params["tau"] * params["tau"]
    grid = Grid(images, {"eye": [params[f"eye_{axis}"] for axis in "xyz"], "noise": [noise]}, narrow=False)
    if plan.similarity == "sg_mixture":
        outputs = define_mixture(grid, plan.lobes)
    else:
        outputs = _define_lobes(grid, plan.similarity, False)
    written = [argument for argument in arguments if argument.role == "output"]
    outs = _schedule(grid, outputs, target.natural_vector_size(hl.Float(32)))
    for out, argument in zip(outs, written, strict=True):
        constrain(out.output_buffer(), argument, like)
    return outs, [params[argument.name] for argument in given]


def define_mixture(grid: Grid, lobes: int) -> Sequence[Vector]:
    """Return validity, axis, sharpnesses and amplitudes: `lobewise.lobes.mixture.spread_ggx_mixture`, of albedo 1.

    The variance of the single lobe without its band-limit is the area of the mixture.
    """
    valid, axis, (single,) = _define_lobes(grid, "sg", False)
    (noise,) = grid.get("noise")
    one, tiny = hl.f32(1.0), hl.f32(1e-12)
    area = hl.max(one / single - noise, hl.f32(0.0))
    alpha = hl.clamp(grid.read_one("alpha_u"), hl.f32(0.0), one)
    deficit = one - alpha * alpha
    exponents, weights = GGX_MIXTURES[lobes]
    sharpness, shares = [], []
    for exponent, weight in zip(exponents, weights, strict=True):
        steepness = hl.max(hl.f32(exponent) * deficit, hl.f32(MIN_SHARPNESS) * area)
        sharpness.append(steepness / (area + noise * steepness))
        # Beyond 40 nothing of the sphere is missing.
        decay = hl.exp(-hl.min(hl.f32(2.0) * steepness / hl.max(area, tiny), hl.f32(40.0)))
        shares.append(hl.f32(weight) * (one - decay) / steepness)
    reached = sum(weight / exponent for exponent, weight in zip(exponents, weights, strict=True))
    scale = hl.f32(reached) / sum(shares[1:], shares[0])
    there = valid[0] != 0
    amplitude = []
    for value, share in zip(sharpness, shares, strict=True):
        sphere = hl.f32(2.0 * math.pi) * (one - hl.exp(-hl.min(hl.f32(2.0) * value, hl.f32(40.0)))) / value
        amplitude.append(hl.select(there, share * scale / sphere, hl.f32(0.0)))
    return [valid, axis, [hl.select(there, value, one) for value in sharpness], amplitude]
