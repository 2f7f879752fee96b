"""Split the light of an imported image into layers and the rest, and find the albedos."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lobewise.guides.lamps import lift_albedo
from lobewise.guides.squares import compute_square_maximum
from lobewise.interchange.mapping import Found, FoundLayer
from lobewise.interchange.values import clip_share
from lobewise.records.frame import FloatArray, Radiance, RadianceLayer
from lobewise.records.images import MAX_HALF_ROUNDING, make_read_only
from lobewise.records.radiance import MAX_EXCESS_SHARE, compare_light, measure_excess, sum_layers
from lobewise.work.chunks import Chunk, run_chunks

MIN_REST_SHARE = 0.002
"""Share of the image's light. If more than this share is in no pass, the remaining light is examined as a layer."""
MAX_SMOOTH_DIFFERENCE = 0.05
"""Largest relative difference of the median lit pixel from the mean of its neighbours in an image without noise."""
SMOOTH_BLOCK = 8
"""Side of the blocks in which noise is looked for, pixels."""
MAX_GRAINY_LIGHT_SHARE = 0.4
"""Largest share of the light of an image without noise that lies in blocks whose median pixel is not smooth. (Measured:
environments of Cycles up to 0.35, reflections at 16 samples beside a clean background 0.61.)"""
WHITE_SHARE = np.float32(0.1)
"""Share of white that is mixed into an albedo of all lobes. Glossy reflection does not follow this albedo: on a dark
mirror, light divided by the plain albedo would be far brighter than its surroundings. (Mitsuba's Cornell box,
``showroom``, ``kitchen`` and a scene with fog, 4 to 64 samples: the geometric mean of the error is 0.0194 without this
share, 0.0096 with it.)"""
BACKGROUND = "environment"
"""Name of the light of the background in presets."""
MIN_GRAIN = 0.01
"""Smallest median second difference over one pixel of an image with noise, as a share of the pixel."""
MIN_GRAIN_RATIO = 0.7
"""Smallest ratio of the second differences over one pixel to those over two in an image with noise. (Measured:
occlusion at 16 samples 1.04, fire at 16 samples 0.77 and at 256 samples 0.25, textures 0.02 to 0.55.)"""
MIN_PIXELS_AMID_LIGHT = 64
"""Fewest pixels by which noise is told from what a scene shows."""
REST = "rest"
"""Name of the layer of light that is in no pass."""


class Reader(Protocol):
    """Reads images of a file; see `lobewise.interchange.imported.ImageReader`."""

    def __call__(self, found: Found) -> FloatArray:
        """Return an image."""

    def open(self, found: Found) -> Callable[[Chunk], FloatArray]:
        """Return a function that returns a chunk of an image, from any thread."""


@dataclass(frozen=True)
class PartOutput:
    """The channels that receive an image, and what divides it before writing: a layer's albedo, the alpha of a bake.

    ``is_exact`` says that the channels hold light without noise.
    """

    target: Found
    divided_by: FloatArray | None = None
    is_exact: bool = False


@dataclass(frozen=True)
class Light:
    """Layers of a frame, light that no surface scattered, and the channels that receive them.

    The keys of ``outputs`` are the names of layers, of their parts (``layer/part``) and of the unscattered light.
    """

    layers: tuple[RadianceLayer, ...] = ()
    unscattered: Mapping[str, FloatArray] = field(default_factory=dict)
    outputs: Mapping[str, PartOutput] = field(default_factory=dict)


def take_layers(color: FloatArray, layer_passes: Sequence[FoundLayer], read: Reader) -> tuple[Light, list[str]]:
    """Return the layers if they add up to the image, else none, and notes about light that does not fit.

    Parameters
    ----------
    color : array, shape (height, width, 3)
        The image.
    layer_passes : sequence of FoundLayer
        The layers of the file.
    read : Reader
        Reads images of the file.
    """
    layers: list[RadianceLayer] = []
    outputs: dict[str, PartOutput] = {}
    known = np.zeros_like(color)
    for one_layer in (one for one in layer_passes if one.rule.lobe != "exact"):
        layer, places = _take_layer(one_layer, read, known)
        if layer is not None:
            layers.append(layer)
            outputs |= places
    if not layers:
        return Light(), []
    unscattered: dict[str, FloatArray] = {}
    notes = []
    # Fog lets some of the samples through to the background, which then has their noise.
    is_foggy = any(layer.lobe == "volume" for layer in layers)
    exact = [(layer, one) for layer in layer_passes if layer.rule.lobe == "exact" for one in layer.light]
    excess = measure_excess(color, known)
    for one_layer, one in exact:
        image = read(one)
        if not image.any():
            continue
        sum_so_far = known.copy()
        _add_finite(sum_so_far, image)
        # A pass may hold the background although the image has a transparent one: then it is no part of the image.
        before, excess = excess, measure_excess(color, sum_so_far)
        if excess > max(MAX_EXCESS_SHARE, 2.0 * before):
            excess = before
            notes.append(
                f"{one.label} holds more light than the image has beside the layers: it is not used as its part."
            )
            continue
        known = sum_so_far
        name = _name_exact(one_layer, one)
        is_noisy = name == BACKGROUND and is_foggy and not is_smooth(image)
        outputs[name] = PartOutput(one, is_exact=not is_noisy)
        if is_noisy:
            layers.append(RadianceLayer(name, "volume", image))
        else:
            unscattered[name] = image
    rest, sum_notes, is_sum = _check_sum(layers, color, known, excess)
    if not is_sum:
        return Light(), sum_notes
    return Light((*layers, *rest), unscattered, outputs), [*notes, *sum_notes]


def _take_layer(
    layer_pass: FoundLayer, read: Reader, known: FloatArray
) -> tuple[RadianceLayer | None, dict[str, PartOutput]]:
    """Return a layer, None if it is black, and the channels that receive it. Add its finite light to ``known``."""
    layer, outputs = _make_layer(layer_pass, read, known)
    return (layer, outputs) if layer.radiance.any() else (None, {})


def take_known_layers(
    color: FloatArray, layer_passes: Sequence[FoundLayer], read: Reader, names: Collection[str]
) -> Light:
    """Return the layers and the exact light of some rows of an image, of which the whole has those of ``names``."""
    there = {name.partition("/")[0] for name in names}
    known = [one for one in layer_passes if one.rule.name in there]
    layers = [_make_layer(one, read, np.zeros_like(color))[0] for one in known if one.rule.lobe != "exact"]
    exact = [(_name_exact(one, light), light) for one in known if one.rule.lobe == "exact" for light in one.light]
    return Light(tuple(layers), {name: read(light) for name, light in exact if name in names})


def _name_exact(layer: FoundLayer, one: Found) -> str:
    """Return the name of one pass of light that no surface scattered."""
    return layer.rule.name if len(layer.light) == 1 else f"{layer.rule.name}/{name_pass(one.source.path)}"


def _make_layer(layer_pass: FoundLayer, read: Reader, known: FloatArray) -> tuple[RadianceLayer, dict[str, PartOutput]]:
    """Return a layer, and the channels that receive it. Add its finite light to ``known``."""
    albedo = read(layer_pass.albedo) if layer_pass.albedo else None
    factor = albedo if layer_pass.rule.times_albedo else None
    parts, total = _sum_passes(layer_pass.light, read, factor, known.shape)
    _add_finite(known, total)
    names = [name_pass(one.source.path) for one in layer_pass.light]
    named = make_read_only(**dict(zip(names, parts, strict=True))) if len(parts) > 1 else {}
    shares = albedo
    if albedo is not None and not (albedo.min() >= 0.0 and albedo.max() <= 1.0):
        shares = np.clip(albedo, 0.0, 1.0)
    if shares is not None and factor is None:
        shares = lift_albedo(shares)
    keys = [f"{layer_pass.rule.name}/{name}" for name in names] if named else [layer_pass.rule.name]
    outputs = {key: PartOutput(one, factor) for key, one in zip(keys, layer_pass.light, strict=True)}
    make_read_only(total=total, shares=shares)
    return RadianceLayer(layer_pass.rule.name, layer_pass.rule.lobe, total, shares, parts=named), outputs


def name_pass(path: str) -> str:
    """Return the last word of a pass's path."""
    return path.rpartition(".")[2]


def _sum_passes(
    passes: Sequence[Found], read: Reader, factor: FloatArray | None, shape: tuple[int, ...]
) -> tuple[list[FloatArray], FloatArray]:
    """Return the passes times ``factor``, each of the same shape, and their sum."""
    parts = [read(one) if factor is None else np.empty(shape, np.float32) for one in passes]
    total = parts[0] if len(parts) == 1 else np.empty(shape, np.float32)
    # Decode before the threads start: they would decode one part several times.
    opened = [] if factor is None else [read.open(one) for one in passes]

    def add(chunk: Chunk) -> None:
        # Set this inside the worker: NumPy keeps error settings per thread.
        with np.errstate(invalid="ignore", over="ignore"):
            if factor is not None:
                for part, take in zip(parts, opened, strict=True):
                    np.multiply(take(chunk), factor[chunk], out=part[chunk])
            if len(parts) > 1:
                total[chunk] = reduce(np.add, [part[chunk] for part in parts])

    run_chunks(add, *shape[:2])
    return parts, total


def _add_finite(known: FloatArray, image: FloatArray) -> None:
    """Add the finite values of an image to ``known``."""

    def add(chunk: Chunk) -> None:
        with np.errstate(over="ignore"):
            np.add(known[chunk], image[chunk], out=known[chunk], where=np.isfinite(image[chunk]))

    run_chunks(add, known.shape[0], known.shape[1])


def _check_sum(
    layers: Sequence[RadianceLayer], color: FloatArray, known: FloatArray, excess: float
) -> tuple[list[RadianceLayer], list[str], bool]:
    """Return a layer of the noisy light that is in no pass, notes, and whether the layers add up to the image.

    ``known`` is the light of all passes, and ``excess`` its `measure_excess`.
    """
    rest, sums = np.empty_like(color), []

    def compare(chunk: Chunk) -> None:
        light, apart = compare_light(color[chunk], known[chunk])
        # Subtract the rounding errors of 16-bit floats, so that they do not count as light.
        rest[chunk] = np.maximum(apart - np.float32(MAX_HALF_ROUNDING) * np.abs(light), np.float32(0.0))
        sums.append((float(light.sum(dtype=np.float64)), float(rest[chunk].sum(dtype=np.float64))))

    run_chunks(compare, *color.shape[:2])
    # The order of the threads must not change the sums.
    total, left = (math.fsum(each) for each in zip(*sums, strict=True))
    if not total > 0.0:
        return [], ["The image holds no light."], False
    if excess > MAX_EXCESS_SHARE:
        names = ", ".join(layer.name for layer in layers)
        note = (
            f"The layers ({names}) hold {100.0 * excess:.1f} % more light than the image, so they are not its "
            "parts: it is filtered as a whole (is it denoised already, or tone mapped?)."
        )
        return [], [note], False
    share = left / total
    if not share > MIN_REST_SHARE:
        return [], [], True
    is_exact = is_smooth(rest)
    fate = "without noise, so it is not filtered" if is_exact else "noisy, so it is filtered as a layer of its own"
    note = f"{100.0 * share:.1f} % of the light is in none of the layers; it is {fate}."
    return [] if is_exact else [RadianceLayer(REST, "glossy", rest)], [note], True


def is_smooth(image: FloatArray) -> bool:
    """Return whether an image is free of noise, in most pixels and where its light is.

    A pixel is smooth if it differs from the mean of its neighbours by less than `MAX_SMOOTH_DIFFERENCE`. The median lit
    pixel must be smooth, and so must the median pixel of the blocks that hold most of the light: a clean background may
    fill half of a noisy image, and the edges of a lamp fill no block.
    """
    gray = image.mean(axis=-1)
    if min(gray.shape) < 3:
        return True
    inner = gray[1:-1, 1:-1]
    around = 0.25 * (gray[:-2, 1:-1] + gray[2:, 1:-1] + gray[1:-1, :-2] + gray[1:-1, 2:])
    lit = inner > 0.0
    if not lit.any():
        return True
    apart = np.zeros_like(inner)
    np.divide(np.abs(inner - around), np.maximum(inner, around), out=apart, where=lit)
    if not np.median(apart[lit]) < MAX_SMOOTH_DIFFERENCE:
        return False
    grainy = 2.0 * _sum_blocks(apart >= MAX_SMOOTH_DIFFERENCE) >= np.maximum(_sum_blocks(lit), SMOOTH_BLOCK**2 / 2)
    light = _sum_blocks(np.where(lit, inner, np.float32(0.0)))
    return float(light[grainy].sum()) <= MAX_GRAINY_LIGHT_SHARE * float(light.sum())


def is_grainy(image: FloatArray) -> bool:
    """Return whether most pixels of an image, (height, width, 3) or (height, width), differ from others by noise.

    Noise of each pixel by itself makes second differences over one pixel as large as those over two. What a scene shows
    makes smaller ones. Only pixels amid light count: the edge of a lamp tells nothing.

    Source: Immerkaer 1996, "Fast Noise Variance Estimation": the second difference in x of that in y.
    """
    gray = image.mean(axis=-1) if image.ndim == 3 else image
    with np.errstate(invalid="ignore", over="ignore"):
        differences = [_take_second_difference(_take_second_difference(gray, step).T, step).T for step in (1, 2)]
        is_dark = ~(gray > 0.0) | ~np.isfinite(gray)
        inside = (slice(2, -2), slice(2, -2))
        amid = compute_square_maximum(is_dark.astype(np.float32), 2)[inside] == 0.0
        if np.count_nonzero(amid) < MIN_PIXELS_AMID_LIGHT:
            return False
        light = gray[inside][amid]
        fine, coarse = (float(np.median(np.abs(each[inside][amid]) / light)) for each in differences)
    return fine > MIN_GRAIN and fine > MIN_GRAIN_RATIO * coarse


def _take_second_difference(plane: FloatArray, step: int) -> FloatArray:
    """Return the second difference of rows ``step`` apart, scaled to the noise of a pixel; rows at the border wrap."""
    above, below = (np.roll(plane, sign * step, axis=0) for sign in (1, -1))
    return np.asarray((2.0 * plane - above - below) / np.float32(6.0**0.5))


def _sum_blocks(plane: NDArray[Any]) -> FloatArray:
    """Return the sums of a plane over blocks of `SMOOTH_BLOCK` pixels a side."""
    height, width = (SMOOTH_BLOCK * (-(-size // SMOOTH_BLOCK)) for size in plane.shape)
    whole = np.zeros((height, width), np.float32)
    whole[: plane.shape[0], : plane.shape[1]] = plane
    blocks = whole.reshape(height // SMOOTH_BLOCK, SMOOTH_BLOCK, width // SMOOTH_BLOCK, SMOOTH_BLOCK)
    return np.asarray(blocks.sum(axis=(1, 3)))


def lend_albedo(layers: Sequence[RadianceLayer], albedo: FloatArray) -> tuple[RadianceLayer, ...]:
    """Return the layers. If no layer has an albedo, give the albedo of all light to the diffuse layers."""
    if any(layer.albedo is not None for layer in layers):
        return tuple(layers)
    lifted = lift_albedo(clip_share(albedo))
    return tuple(replace(layer, albedo=lifted) if layer.is_diffuse else layer for layer in layers)


def make_radiance(color: FloatArray, images: Mapping[str, FloatArray], light: Light) -> Radiance:
    """Return the radiance, split into diffuse and specular light by the layers if there are any, else by the passes."""
    if not light.layers:
        return Radiance(color, images.get("diffuse"), images.get("specular"))
    nothing = np.zeros_like(color)
    diffuse, specular = (sum_layers(light.layers, "radiance", diffuse=kind) for kind in (True, False))
    return Radiance(color, nothing if diffuse is None else diffuse, nothing if specular is None else specular)


def sum_albedos(layers: Sequence[RadianceLayer], *, diffuse: bool) -> FloatArray | None:
    """Return the summed albedo of the diffuse or specular layers, at most 1; None if a layer has no albedo."""
    albedos = [layer.albedo for layer in layers if layer.is_diffuse == diffuse and layer.name != REST]
    if not albedos or any(albedo is None for albedo in albedos):
        return None
    total = np.empty_like(albedos[0])

    def add(chunk: Chunk) -> None:
        total[chunk] = clip_share(reduce(np.add, [albedo[chunk] for albedo in albedos if albedo is not None]))

    run_chunks(add, *total.shape[:2])
    return total


def take_albedos(
    images: Mapping[str, FloatArray], layers: Sequence[RadianceLayer]
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return the diffuse and specular albedo from passes, else from the layers, else from the albedo of all light."""
    diffuse, specular = (images.get(f"{kind}_albedo") for kind in ("diffuse", "specular"))
    diffuse = sum_albedos(layers, diffuse=True) if diffuse is None else clip_share(diffuse)
    specular = sum_albedos(layers, diffuse=False) if specular is None else clip_share(specular)
    lone = images.get("albedo")
    if diffuse is None and specular is None and not layers and lone is not None:
        return WHITE_SHARE + np.float32(1.0 - WHITE_SHARE) * clip_share(lone), None
    return diffuse, specular
