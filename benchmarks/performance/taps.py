"""Error over time of ways to take taps: the forms there are, and what might reach the same error in less time.

Four scenes, both layers of the recipe ``fast`` with ``ggx``, references of 512 samples per pixel. Beside the forms:

- *sparse*: as many taps on a spiral within a radius, turned from row to row, so that the loads of a vector stay dense;
- *two levels*: blocks of two by two pixels averaged, filtered with half the radius, and brought to every pixel by what
  it has in common with them; only the kernels are timed, not the averaging, which is in its favour;
- *adaptive*: the full square as far as it holds 99 % of the weight of any pixel in a tile of the schedule; its error is
  that of the square and its time that of the square for as many taps, both in its favour.

The references take some three minutes on two cores.

    python -m benchmarks.performance.taps --cache ~/.cache/lobewise-taps -o benchmarks/results/taps.json
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from benchmarks.common import RESULTS, describe_machine, fetch_frame, fetch_image, write_json
from lobewise.backend import expressions
from lobewise.backend.buffers import Buffer, take_mask
from lobewise.backend.jit import Kernel, Scheduled, get_kernel
from lobewise.backend.signature import Signature
from lobewise.bench.timing import time_best
from lobewise.denoising import resolve_settings
from lobewise.denoising.layers import Layer, make_layers
from lobewise.features import Feature, ScreenFeature
from lobewise.features.arrays import declare_features, declare_scalars, give_features, give_scalars
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.cross_pass import ALBEDO_FLOOR, COLORS, WEIGHT, demodulate
from lobewise.filters.history.accumulation import SampleGrid
from lobewise.filters.planes import Columns, make_guide_planes, make_image
from lobewise.filters.scheduling import STRIP_ROWS, count_lanes, fill_planes, fill_rows
from lobewise.filters.weigh import make_stage
from lobewise.frame import FloatArray, Frame
from lobewise.metrics import rel_mse
from lobewise.render import load_scene, render_frame, render_reference
from lobewise.settings import DenoiseSettings

SCENES = ("showroom", "brushed", "parlour", "sparks")
SAMPLES = (4, 16)
SIZE = 384
REFERENCE_SPP = 512
FORMS = (("full", 4), ("full", 8), ("separable", 4), ("separable", 8), ("separable", 16), ("atrous", 8))
SPARSE = ((32, 8), (64, 8), (64, 16))
"""Taps and radius."""
TURNS = 4
TILE = (8, 128)
"""Rows and columns of a tile of the schedule."""
RADII = (0, 1, 2, 3, 4, 6)
KEPT = 0.99
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

Scheme = Callable[[Layer], FloatArray]


def make_pattern(count: int, radius: int) -> NDArray[np.int32]:
    """Return offsets (turn, across or down, tap) of a spiral about the pixel itself."""
    k = np.arange(count)
    pattern = np.empty((TURNS, 2, count), np.int32)
    for turn in range(TURNS):
        angle = k * GOLDEN_ANGLE + turn * (2.0 * math.pi / TURNS)
        reach = np.where(k == 0, 0.0, radius * np.sqrt((k + 0.5) / count))
        pattern[turn] = np.rint([reach * np.cos(angle), reach * np.sin(angle)])
    return pattern


def make_sparse(count: int, radius: int, features: Sequence[Feature], target: hl.Target) -> Scheduled:
    """Return the scheduled kernel of ``count`` taps within ``radius``, from the parts of the full one."""
    x, y, c, k = (hl.Var(name) for name in "xyck")
    signature, size = Signature("sparse"), ("height", "width")
    source, albedo = (signature.image(name, *size, COLORS) for name in ("source", "albedo"))
    mask = signature.image("mask", *size, type=hl.UInt(8))
    arrays, scalars = declare_features(signature, "tap", features, *size), declare_scalars(signature, features)
    pattern = signature.image("pattern", TURNS, 2, count, type=hl.Int(32))
    signature.output("image", *size, COLORS)
    lanes = count_lanes(target)
    rows = Columns(mask.width(), hl.i32(radius), lanes)

    def take(at: tuple[hl.Expr, hl.Expr], usable: hl.Expr) -> hl.Expr:
        radiance, good = demodulate(source, albedo, at, hl.f32(ALBEDO_FLOOR))
        return hl.select(good & usable, hl.mux(c, [*radiance, hl.f32(1.0)]), hl.f32(0.0))

    image = make_image("image", mask, rows, take)
    side = make_guide_planes("tap", mask, features, scalars, arrays=arrays, rows=rows)
    stages: list[hl.Func] = []
    stage = make_stage(stages, (x, y, k))

    def compute_offset(tap: hl.Expr) -> list[hl.Expr]:
        return [hl.clamp(pattern[tap, axis, y % TURNS], -radius, radius) for axis in range(2)]

    across, down = compute_offset(k)
    exponent: hl.Expr = hl.f32(0.0)
    for feature, layout, own in zip(features, side.layouts, scalars, strict=True):
        i, j = side.read(layout, x, y), side.read(layout, x + across, y + down)
        exponent = exponent + feature.log2_similarity(i, j, own, (hl.f32(across), hl.f32(down)), stage)
    log_weight = hl.Func("log_weight")
    log_weight[x, y, k] = exponent
    stages.append(log_weight)
    taps = hl.RDom([(0, count)], "taps")
    there = compute_offset(taps.x)
    sums = hl.Func("sums")
    sums[x, y] = hl.Tuple([hl.f32(0.0)] * (WEIGHT + 1))
    weight = expressions.exp2(log_weight[x, y, taps.x])
    sums[x, y] = hl.Tuple([sums[x, y][n] + weight * image[x + there[0], n, y + there[1]] for n in range(WEIGHT + 1)])
    tints = [hl.select(expressions.is_bad(albedo[n, x, y]), hl.f32(0.0), albedo[n, x, y]) for n in range(3)]
    total = sums[x, y][WEIGHT]
    mean = [sums[x, y][n] / total * tints[n] for n in range(3)]
    out = hl.Func("out")
    out[c, x, y] = hl.select((mask[x, y] != 0) & (total > hl.f32(0.0)), hl.mux(c, mean), hl.f32(0.0))

    tail = hl.TailStrategy.GuardWithIf
    ys, yt, xv, xw = (hl.Var(name) for name in ("ys", "yt", "xv", "xw"))
    out.bound(c, 0, 3).reorder(c, x, y).unroll(c).output_buffer().dim(1).set_stride(3)
    out.split(y, ys, yt, STRIP_ROWS, tail).split(x, xv, xw, lanes, tail).reorder(c, xw, xv, yt, ys)
    out.vectorize(xw).parallel(ys).never_partition_all()
    sums.compute_at(out, xv).vectorize(x, lanes)
    sums.update().reorder(x, taps.x).vectorize(x, lanes)
    for func in stages:
        func.compute_at(out, xv).vectorize(x, lanes).bound(k, 0, count)
    fill_rows(image.compute_at(out, ys), WEIGHT + 1, rows)
    fill_planes(side, rows, (out, ys))
    return Scheduled([out], signature)


def run_sparse(count: int, radius: int, layer: Layer) -> FloatArray:
    """Filter a layer with ``count`` taps within ``radius``."""
    names = tuple(type(feature).__name__ for feature in layer.features)
    kernel: Kernel = get_kernel(
        "cpu", (make_sparse, count, radius, names), partial(make_sparse, count, radius, layer.features)
    )
    out = np.empty_like(layer.radiance)
    assert layer.albedo is not None
    images = {
        "source": np.ascontiguousarray(layer.radiance, np.float32),
        "albedo": np.ascontiguousarray(layer.albedo, np.float32),
        "mask": take_mask(layer.mask),
        **give_features("tap", layer.features, layer.mask.shape),
        "pattern": make_pattern(count, radius),
        "image": out,
    }
    kernel(**{name: Buffer(image) for name, image in images.items()}, **give_scalars(layer.features))
    return out


def take_every_second(layer: Layer) -> Layer:
    """Return the layer in half the resolution: light averaged over blocks, guides of their first pixels."""
    assert layer.albedo is not None
    good = layer.mask & (layer.albedo > ALBEDO_FLOOR).all(-1)
    light = np.where(good[..., None], layer.radiance / np.maximum(layer.albedo, ALBEDO_FLOOR), 0.0)
    height, width = good.shape

    def add(image: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(image.reshape(height // 2, 2, width // 2, 2, -1).sum((1, 3)))

    mean = add(light) / np.maximum(add(good[..., None]), 1)
    features = []
    for feature in layer.features:
        changes: dict[str, Any] = {}
        for name, value in vars(feature).items():
            if isinstance(value, np.ndarray) and value.shape[:2] == good.shape:
                changes[name] = np.ascontiguousarray(value[::2, ::2])
        if isinstance(feature, ScreenFeature):
            changes["sigma"] = 0.5 * feature.sigma
        features.append(replace(feature, **changes))
    return Layer(np.asarray(mean, np.float32), None, layer.mask[::2, ::2] & good[::2, ::2], tuple(features))


@dataclass
class TwoLevels:
    """The two kernels of two levels; what is not timed is done beforehand."""

    layer: Layer
    radius: int

    def __post_init__(self) -> None:
        self.coarse = take_every_second(self.layer)
        self.grid = SampleGrid(self.layer.mask, self.layer.features, scale=2)

    def run(self) -> FloatArray:
        coarse = self.coarse
        low = run_filter(coarse.radiance, coarse.mask, coarse.features, form="separable", radius=self.radius // 2)
        albedo = self.layer.albedo
        assert albedo is not None
        return np.asarray(self.grid.accumulate(low.image, radius=1).image) * albedo


def run_form(form: str, radius: int, layer: Layer) -> FloatArray:
    """Filter a layer with a form of `lobewise.filters.forms`."""
    return run_filter(layer.radiance, layer.mask, layer.features, form=form, radius=radius, albedo=layer.albedo).image


def compute_adaptive_share(layers: Sequence[Layer], radius: int) -> float:
    """Return the share of the square's taps that hold `KEPT` of the weight of every pixel of a tile."""
    shares = []
    for layer in layers:
        supports = [
            run_filter(layer.radiance, layer.mask, layer.features, form="full", radius=reach).weight_sum
            for reach in (*RADII, radius)
        ]
        enough = np.stack([support >= KEPT * supports[-1] for support in supports])
        need = np.array([*RADII, radius])[np.argmax(enough, axis=0)]
        tiles = [
            need[row : row + TILE[0], column : column + TILE[1]].max()
            for row in range(0, need.shape[0], TILE[0])
            for column in range(0, need.shape[1], TILE[1])
        ]
        shares.append(np.mean((2.0 * np.array(tiles) + 1.0) ** 2) / (2.0 * radius + 1.0) ** 2)
    return float(np.mean(shares))


def measure(frame: Frame, reference: FloatArray, seconds: float) -> dict[str, dict[str, float]]:
    """Return error and time of every way on one frame."""
    settings = DenoiseSettings(quality="fast", similarity="ggx", radius=8)
    layers = make_layers(frame, resolve_settings(frame, settings))
    wide = make_layers(frame, resolve_settings(frame, replace(settings, radius=16)))
    given = {8: layers, 16: wide}
    rest = frame.radiance.color - sum(layer.radiance for layer in layers)
    ways: dict[str, tuple[Sequence[Layer], Scheme]] = {}
    for form, radius in FORMS:
        ways[f"{form}, radius {radius}"] = given.get(radius, layers), partial(run_form, form, radius)
    for count, radius in SPARSE:
        ways[f"sparse, {count} taps, radius {radius}"] = given[radius], partial(run_sparse, count, radius)
    calls: dict[str, Callable[[], list[FloatArray]]] = {
        name: (lambda chosen=chosen, run=run: [run(layer) for layer in chosen]) for name, (chosen, run) in ways.items()
    }
    levels = [TwoLevels(layer, 8) for layer in layers]
    calls["two levels, radius 8"] = lambda: [level.run() for level in levels]
    best = time_best(calls, seconds)
    rows = {}
    for name, call in calls.items():
        chosen = ways[name][0] if name in ways else layers
        parts = [
            np.where(layer.mask[..., None] & (image > 0.0).any(-1, keepdims=True), image, layer.radiance)
            for layer, image in zip(chosen, call(), strict=True)
        ]
        rows[name] = {"milliseconds": 1e3 * best[name], "rel_mse": rel_mse(sum(parts) + rest, reference)}
    square = rows["full, radius 8"]
    share = compute_adaptive_share(layers, 8)
    rows["adaptive, up to radius 8"] = {
        "milliseconds": square["milliseconds"] * share,
        "rel_mse": square["rel_mse"],
    }
    return rows


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder of the rendered frames")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "taps.json")
    parser.add_argument("--seconds", type=float, default=4.0, help="least time per frame")
    arguments = parser.parse_args()
    rows = []
    for scene in SCENES:

        def render(spp: int, scene: str = scene) -> Frame:
            return render_frame(load_scene(scene, width=SIZE, height=SIZE), spp=spp, seed=1)

        def render_clean(scene: str = scene) -> Frame:
            return render_reference(load_scene(scene, width=SIZE, height=SIZE), spp=REFERENCE_SPP, seed=1000)

        reference = fetch_image(arguments.cache / f"{scene}-reference-{REFERENCE_SPP}.exr", render_clean)
        for spp in SAMPLES:
            frame = fetch_frame(arguments.cache / f"{scene}-{spp}.exr", partial(render, spp))
            for name, row in measure(frame, reference, arguments.seconds).items():
                rows.append({"scene": scene, "spp": spp, "way": name, **row})
                print(f"{scene:9} {spp:3} spp  {name:28} {row['milliseconds']:8.2f} ms  {row['rel_mse']:.5f}")
    write_json(
        arguments.output,
        {"what": __doc__.split("\n")[0], "machine": describe_machine(), "size": SIZE, "rows": rows},
    )


if __name__ == "__main__":
    main()
