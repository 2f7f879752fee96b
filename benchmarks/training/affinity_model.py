"""The network that gives every pixel the numbers of the affinity filter, and the filtering of a frame by them.

A small U-Net reads noisy light and guides. For each layer of the light and each step from tap to tap it gives a pixel
features, a centre weight, a source weight and an exponent of the lobes; see `lobewise.filters.affinity`.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from benchmarks.training.affinity_batches import Batch
from benchmarks.training.affinity_layer import Maps, filter_maps


class GuideSet(Enum):
    """What is known of a frame beside its noisy light."""

    ALL = "all"
    """Light told apart by lobe, halves of the samples, albedos, normals, roughness, lobes and what these hit."""
    UNSPLIT = "unsplit"
    """All guides, but one image of all light."""
    PASSES = "passes"
    """What other renderers write: light told apart, albedos, normals, depth, roughness and the lobes that follow."""
    PLAIN = "plain"
    """Color, albedo, normal and depth."""
    COLOR = "color"
    """Nothing."""

    @property
    def is_split(self) -> bool:
        """Whether light is told apart by lobe."""
        return self in (GuideSet.ALL, GuideSet.PASSES)

    @property
    def has_surfaces(self) -> bool:
        """Whether roughness and lobes are known."""
        return self not in (GuideSet.PLAIN, GuideSet.COLOR)

    @property
    def has_hits(self) -> bool:
        """Whether it is known what lobes hit, and how halves of the samples differ."""
        return self in (GuideSet.ALL, GuideSet.UNSPLIT)


STEPS = (1, 2, 4, 8, 16)
"""Pixels from tap to tap, of the passes over a layer of light one after the other."""
REST_STEPS = (1, 2)
"""Likewise of light that no surface scattered, such as lamps in view: what is left of its noise is at edges."""
FEATURES = 8
NUMBERS = FEATURES + 3
"""That the network gives a pixel for one pass."""
UNITS = (24, 32, 48, 64)
"""Channels of the U-Net from the whole image to an eighth of its size."""
LEAK = 0.1
DIFFUSE_ALBEDO_FLOOR, SPECULAR_ALBEDO_FLOOR, ALBEDO_FLOOR = 0.02, 0.01, 0.05
"""Light is divided by at least this: the albedos' noise is larger where they are read without samples' means."""
MAX_LOG_DEPTH = 4.0
NORMAL_SCALE, DEPTH_SCALE, LOBE_SCALE = 0.22, 0.6, 0.37
"""Factors of the fixed vectors, so that an exponent of 1 is about right; the network gives a finer one."""
MIN_EXPONENT, MAX_EXPONENT = -9.0, 3.0
"""Natural logarithms."""
START_CENTRE, MAX_CENTRE = 2.0, 8.0
"""Natural logarithms of the centre weight, untrained and at most: the filter must be able to do nothing."""
MIN_WEIGHT = 1e-4


class Layer(NamedTuple):
    """Light that is filtered by one weight.

    Parameters
    ----------
    light : tensor, (batch, 3, rows, columns)
        Over ``albedo``.
    albedo : tensor, (batch, 3, rows, columns)
        What the filtered light is multiplied by.
    vectors : tensor, (batch, 4, rows, columns), or None
        Fixed vectors whose squared distances the exponents count: lobes, or place and normal.
    """

    light: Tensor
    albedo: Tensor
    vectors: Tensor | None


class Prepared(NamedTuple):
    """What the network reads of a frame, (batch, `INPUTS`, rows, columns), and what its numbers filter."""

    inputs: Tensor
    layers: list[Layer]
    rest: Tensor | None
    """What is in no layer."""


INPUTS = 40


def prepare(batch: Batch, guides: GuideSet, *, lobes: bool = True, halves: bool = True) -> Prepared:
    """Return what the network reads with a set of guides, without lobes or halves on request."""
    images = batch.images
    color, depth, zeros = images["color"], images["depth"], torch.zeros_like(images["color"])
    is_lit = guides is not GuideSet.COLOR
    normal = (images["mean_normal"] if guides.has_surfaces else images["normal"]) * float(is_lit)
    log_depth = _find_log_depth(depth, batch.depth) * float(is_lit)
    place = torch.cat([NORMAL_SCALE * normal, DEPTH_SCALE * log_depth], dim=1)
    layers, tints = _divide_light(images, guides)
    vectors = [place, _scale_lobes(images)][: len(layers)]
    layers = [each._replace(vectors=own if lobes else None) for each, own in zip(layers, vectors, strict=True)]
    rest = color - images["diffuse"] - images["specular"] if guides.is_split else None
    scale = 1.0 / (batch.brightness.view(-1, 1, 1, 1) + 1e-4)
    halves_known = batch.halves.view(-1, 1, 1, 1) * float(halves and guides.has_hits)
    one = torch.ones_like(depth)

    def compress(light: Tensor) -> Tensor:
        return torch.log1p((scale * light).clamp_min(0.0))

    surfaces, hits, lobed = float(guides.has_surfaces), float(guides.has_hits), float(guides.has_surfaces and lobes)
    planes = [
        compress(layers[0].light),
        compress(layers[1].light) if guides.is_split else zeros,
        compress(color),
        *tints,
        normal,
        log_depth,
        *(surfaces * images[name] for name in ("alpha_u", "alpha_v")),
        lobed * images["lobe_sharpness"] / 8.0,
        lobed * images["lobe_axis"],
        *(hits * images[name] for name in ("hit_albedo", "hit_normal", "hit_inverse")),
        *(halves_known * compress(difference) for difference in _find_differences(images, layers)),
        *(float(known) * one for known in (guides.is_split, guides.has_surfaces, guides.has_hits, is_lit)),
        halves_known * one,
        torch.log2(batch.spp).view(-1, 1, 1, 1) / 4.0 * one,
    ]
    return Prepared(torch.cat(planes, dim=1), layers, rest)


def _divide_light(images: dict[str, Tensor], guides: GuideSet) -> tuple[list[Layer], list[Tensor]]:
    """Return the layers of the light without vectors, and the two albedos that the network reads."""
    color, zeros = images["color"], torch.zeros_like(images["color"])
    first, second = images["mean_diffuse_albedo"], images["mean_specular_albedo"]
    if guides is GuideSet.COLOR:
        return [Layer(color, torch.ones_like(color), None)], [zeros, zeros]
    if guides is GuideSet.PLAIN:
        albedo = (images["diffuse_albedo"] + images["specular_albedo"]).clamp(0.0, 1.0)
        tint = albedo.clamp_min(ALBEDO_FLOOR)
        return [Layer(color / tint, tint, None)], [albedo, zeros]
    if guides is GuideSet.UNSPLIT:
        tint = (first + second).clamp_min(ALBEDO_FLOOR)
        return [Layer(color / tint, tint, None)], [first, second]
    tints = first.clamp_min(DIFFUSE_ALBEDO_FLOOR), second.clamp_min(SPECULAR_ALBEDO_FLOOR)
    lights = images["diffuse"], images["specular"]
    return [Layer(light / tint, tint, None) for light, tint in zip(lights, tints, strict=True)], [first, second]


def _scale_lobes(images: dict[str, Tensor]) -> Tensor:
    """Return lobes as vectors: their squared distance grows with the sharpness and with that of the axes."""
    sharpness = images["lobe_sharpness"]
    return LOBE_SCALE * torch.cat([torch.exp2(0.5 * (sharpness - 1.0)) * images["lobe_axis"], sharpness], dim=1)


def _find_log_depth(depth: Tensor, mean: Tensor) -> Tensor:
    """Return the logarithm of the depth over its mean; pixels without a surface are far away."""
    found = torch.log(depth.clamp_min(1e-6) / mean.view(-1, 1, 1, 1)).clamp(-MAX_LOG_DEPTH, MAX_LOG_DEPTH)
    return torch.where(depth > 0.0, found, torch.full_like(found, MAX_LOG_DEPTH))


def _find_differences(images: dict[str, Tensor], layers: list[Layer]) -> list[Tensor]:
    """Return half the difference of the halves of each layer over its albedo, two of (batch, 1, rows, columns).

    Halves of light that is not told apart are known as sums alone; then the second is 0.
    """
    first, second = (images[f"{name}_a"] - images[f"{name}_b"] for name in ("diffuse", "specular"))
    changes = [first, second] if len(layers) > 1 else [first + second]
    found = [
        0.5 * (change / own.albedo).abs().mean(dim=1, keepdim=True) for change, own in zip(changes, layers, strict=True)
    ]
    return [*found, *[torch.zeros_like(found[0])] * (2 - len(found))]


class AffinityNetwork(nn.Module):
    """The network and its filter.

    Parameters
    ----------
    lobes, halves : bool
        Whether weights compare fixed vectors, lobes among them, and whether the network reads how halves differ.
    units : tuple of int
        See `UNITS`.
    """

    def __init__(self, *, lobes: bool = True, halves: bool = True, units: tuple[int, int, int, int] = UNITS) -> None:
        super().__init__()
        self.lobes, self.halves = lobes, halves
        whole, half, quarter, eighth = units

        def convolve(before: int, after: int) -> nn.Conv2d:
            layer = nn.Conv2d(before, after, 3, padding=1)
            nn.init.kaiming_normal_(layer.weight, a=LEAK)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]  # there is a bias
            return layer

        self.down = nn.ModuleList(
            nn.ModuleList([convolve(before, after), convolve(after, after)])
            for before, after in ((INPUTS, whole), (whole, half), (half, quarter))
        )
        self.middle = convolve(quarter, eighth)
        self.up = nn.ModuleList(
            [convolve(eighth + quarter, quarter), convolve(quarter + half, half), convolve(half + whole, whole)]
        )
        self.last = convolve(whole, whole)
        self.numbers = nn.Conv2d(whole, NUMBERS * (2 * len(STEPS) + len(REST_STEPS)), 1)
        # Features of an untrained network are near each other.
        nn.init.kaiming_normal_(self.numbers.weight, a=LEAK)
        with torch.no_grad():
            self.numbers.weight.mul_(0.25)
            nn.init.zeros_(self.numbers.bias)  # type: ignore[arg-type]  # there is a bias

    def find_numbers(self, inputs: Tensor) -> Tensor:
        """Return the numbers of every pixel, all passes one after the other."""

        def activate(tensor: Tensor) -> Tensor:
            return functional.leaky_relu(tensor, LEAK)

        found, seen = inputs, []
        for first, second in self.down:  # type: ignore[misc]  # a list of two layers
            found = activate(second(activate(first(found))))
            seen.append(found)
            found = functional.max_pool2d(found, 2)
        found = activate(self.middle(found))
        for layer in self.up:
            larger = functional.interpolate(found, scale_factor=2, mode="nearest")
            found = activate(layer(torch.cat([larger, seen.pop()], dim=1)))
        numbers: Tensor = self.numbers(activate(self.last(found)))
        return numbers

    def forward(self, batch: Batch, guides: GuideSet) -> Tensor:
        """Return the filtered frames, (batch, 3, rows, columns)."""
        prepared = prepare(batch, guides, lobes=self.lobes, halves=self.halves)
        passes = list(self.find_numbers(prepared.inputs).split(NUMBERS, dim=1))
        image = torch.zeros_like(prepared.layers[0].light)
        for number, layer in enumerate(prepared.layers):
            own = passes[number * len(STEPS) : (number + 1) * len(STEPS)]
            image = image + layer.albedo * _filter_light(layer.light, layer.vectors, own, STEPS)
        if prepared.rest is not None:
            image = image + _filter_light(prepared.rest, None, passes[2 * len(STEPS) :], REST_STEPS)
        return image


def _filter_light(light: Tensor, vectors: Tensor | None, passes: list[Tensor], steps: tuple[int, ...]) -> Tensor:
    """Return light filtered by one pass after the other."""
    for numbers, step in zip(passes, steps, strict=True):
        features, centre, source, exponent = numbers.split([FEATURES, 1, 1, 1], dim=1)
        maps = Maps(
            light,
            features,
            torch.exp((centre + START_CENTRE).clamp(-MAX_CENTRE, MAX_CENTRE)),
            torch.sigmoid(source + 1.0) + MIN_WEIGHT,
            vectors,
            None if vectors is None else torch.exp((2.0 * exponent - 1.0).clamp(MIN_EXPONENT, MAX_EXPONENT)),
        )
        light = filter_maps(maps, step)
    return light
