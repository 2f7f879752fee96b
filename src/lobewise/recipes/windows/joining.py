"""Join the samples of a frame with those of the frames before and after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lobewise.denoising.also import keep_sum
from lobewise.denoising.bad_pixels import mark_good
from lobewise.filters.windows.weighing import compare_pilots, estimate_relative_bias, estimate_variance
from lobewise.recipes.windows.gathering import Neighbour, Shown
from lobewise.recipes.windows.layers import (
    MIN_DIVIDING_ALBEDO,
    PILOT,
    RADIANCE,
    LayerImages,
    multiply,
    put_back,
)
from lobewise.recipes.windows.places import compute_places
from lobewise.recipes.windows.shots import Shot
from lobewise.records.frame import FloatArray, Frame

MIN_SHARE_FOUND = 0.4
"""Share of the surface pixels that another frame must show; below it there is a cut between the frames."""
FOUND_AGREEMENT = 0.1
"""Agreement above which a pixel counts as shown."""
PILOT_NOISE = 0.2
"""Squared difference of two pilots without bias, over the variance of the samples that they were made of."""
MAX_STANDARD_DEVIATIONS = 4.0
"""Samples of another frame that are brighter than the denoised light by more standard deviations are fireflies."""
MAX_ALBEDO_RATIO = np.float32(2.0)
"""Largest ratio of a joined albedo to the frame's own."""
BIAS_FACTOR = 3.0
"""Weight of the bias beside the noise. The frames of a window share their bias, so it does not fall as they are joined,
and a denoiser does not remove it."""


@dataclass(frozen=True)
class JoinedFrame:
    """A frame with the samples of its neighbours in time.

    Parameters
    ----------
    frame : Frame
        With less noise; everything else is as before.
    frames : array, shape (height, width)
        Effective number of frames that were joined at each pixel, >= 1: the variance of the frame over that of the
        joined frame.
    albedo : array, shape (height, width, 3), or None
        The albedo of all light, the mean over the frames.
    shown : dict of int to Shown
        Where the neighbours that took part show its surfaces, by their numbers relative to the frame.
    repeated : tuple of int
        The neighbours that repeat the noise of the frame, and are not used.
    """

    frame: Frame
    frames: FloatArray
    albedo: FloatArray | None
    shown: dict[int, Shown]
    repeated: tuple[int, ...] = ()


def join_frames(shots: Mapping[int, Shot], index: int) -> JoinedFrame:
    """Return a frame with the samples of all shots that show its surfaces.

    Parameters
    ----------
    shots : mapping of int to Shot
        Consecutive frames by number.
    index : int
        Number of the frame.
    """
    shot = shots[index]
    near = list_neighbours(shots, index)
    repeated = tuple(number - index for number, each in near.items() if each.repeats)
    near = {number: each for number, each in near.items() if not each.repeats}
    own = list(shot.layers.values())
    if not near:
        return JoinedFrame(shot.frame, np.ones(shot.frame.shape, np.float32), shot.whole_albedo, {}, repeated)
    named = {number: shots[number].layers for number in near}
    joined = [_join_layer(shot, layer, near, named) for layer in own]
    joined_layers = [each.layer for each in joined]
    shares = {layer.name: each.share for layer, each in zip(own, joined, strict=True)}
    frame = put_back(shot.frame, own, joined_layers, shares)
    effective = count_frames(joined)
    changes: dict[str, Any] = {}
    if frame.spp is not None:
        changes["spp"] = max(round(frame.spp * float(np.median(effective))), frame.spp)
    if frame.also:
        changes["also"] = _join_also(shot, shots, near, joined, frame)
    return JoinedFrame(
        frame.with_changes(**changes),
        effective,
        join_albedo(shot, shots, near),
        {number - index: each.shown for number, each in near.items()},
        repeated,
    )


def list_neighbours(shots: Mapping[int, Shot], index: int) -> dict[int, Neighbour]:
    """Return the other frames that continue a frame, by number; none behind a cut."""
    shot = shots[index]
    neighbours: dict[int, Neighbour] = {}
    for step in (-1, 1):
        number = index + step
        while number in shots and shots[number].frame.shape == shot.frame.shape:
            places = compute_places(shots, index, number)
            if places is None:
                break
            # The similarity follows the guides: frames with other guides cannot be compared.
            others = shots[number].features
            if not all(kind in others and own.fits(others[kind]) for kind, own in shot.features.items()):
                break
            neighbour = Neighbour(shot, shots[number], places)
            surface = shot.features["rest"].mask
            shown = neighbour.surface_agreement[surface] > FOUND_AGREEMENT
            if surface.any() and np.mean(shown) < MIN_SHARE_FOUND:
                break
            neighbours[number] = neighbour
            number += step
    return dict(sorted(neighbours.items()))


def join_albedo(shot: Shot, shots: Mapping[int, Shot], near: Mapping[int, Neighbour]) -> FloatArray | None:
    """Return the albedo of all light of a frame joined with those of its neighbours, (height, width, 3), in [0, 1].

    At edges of textures the albedo of one frame has the noise of the pixel's samples. None where a frame has none.
    """
    own = shot.whole_albedo
    if own is None:
        return None
    total, weight = own, np.ones(own.shape[:2], np.float32)
    for number, neighbour in near.items():
        if (other := shots[number].whole_albedo) is not None:
            values, agreement = neighbour.shown.gather(other)
            total = total + values * agreement[..., None]
            weight = weight + agreement
    small = np.float32(MIN_DIVIDING_ALBEDO)
    mean = np.clip(total / weight[..., None], own / MAX_ALBEDO_RATIO - small, own * MAX_ALBEDO_RATIO + small)
    return np.asarray(np.clip(mean, np.float32(0.0), np.float32(1.0)))


@dataclass(frozen=True)
class _Joined:
    """A layer after joining, the weight of every neighbour, the variance of its samples, and the factor of it."""

    layer: LayerImages
    weights: Mapping[int, FloatArray]
    variance: FloatArray
    share: FloatArray


def _join_layer(
    shot: Shot,
    layer: LayerImages,
    near: Mapping[int, Neighbour],
    named: Mapping[int, Mapping[str, LayerImages]],
) -> _Joined:
    others = {number: layers[layer.name] for number, layers in named.items() if layer.name in layers}
    slots = [slot for slot in layer.images if all(slot in other.images for other in others.values())]
    good = mark_good(layer.images[RADIANCE])
    own = {slot: np.where(good[..., None], layer.even[slot], np.float32(0.0)) for slot in slots}
    weight = good.astype(np.float32)
    totals = {slot: image * weight[..., None] for slot, image in own.items() if slot != PILOT}
    squares, weights = weight.copy(), {}
    noise = estimate_variance(own[RADIANCE], own[PILOT])
    for number, other in others.items():
        images, agreement = near[number].gather_layer(other, slots)
        images = _bound(images, noise)
        bias = estimate_relative_bias(own[RADIANCE], images[RADIANCE], np.where(good, agreement, np.float32(0.0)))
        # Beside a black frame another one has an infinite bias, and no weight.
        with np.errstate(over="ignore"):
            seen = compare_pilots(own[PILOT], images[PILOT], agreement) / noise - np.float32(PILOT_NOISE)
            bias = np.maximum(bias, seen)
            weight_there = weights[number] = agreement / (np.float32(1.0) + np.float32(BIAS_FACTOR) * bias)
        totals = {slot: total + images[slot] * weight_there[..., None] for slot, total in totals.items()}
        squares = squares + weight_there * weight_there
    total = good + sum(weights.values(), np.zeros_like(weight))
    known = total > 0.0
    albedo = layer.albedo
    inverse = np.divide(np.float32(1.0), total, out=np.zeros_like(weight), where=known)[..., None]
    joined = {}
    for slot, summed in totals.items():
        mean = summed * inverse
        joined[slot] = np.where(known[..., None], multiply(mean, albedo), layer.images[slot])
    share = np.divide(squares, total * total, out=np.ones_like(weight), where=known)
    scale = np.float32(1.0) if albedo is None else np.mean(albedo, axis=-1)
    return _Joined(replace(layer, images=joined), weights, noise * scale * scale, share)


def _bound(images: dict[str, FloatArray], noise: FloatArray) -> dict[str, FloatArray]:
    """Return the images of another frame with its fireflies bounded: else one firefly shows in all frames of a window.

    ``noise`` is the variance of this frame's samples, which knows nothing of the fireflies of the other frame.
    """
    light = np.mean(images[RADIANCE], axis=-1)
    most = np.mean(images[PILOT], axis=-1) + np.float32(MAX_STANDARD_DEVIATIONS) * np.sqrt(noise)
    share = np.divide(most, light, out=np.ones_like(light), where=light > most)[..., None]
    return {slot: image if slot == PILOT else image * share for slot, image in images.items()}


def count_frames(layers: Sequence[_Joined]) -> FloatArray:
    """Return the variance of the samples of all layers over what joining left of it, (height, width), >= 1."""
    before = np.sum([layer.variance for layer in layers], axis=0)
    after = np.sum([layer.variance * layer.share for layer in layers], axis=0)
    frames = np.divide(before, after, out=np.ones(before.shape, np.float32), where=after > 0.0)
    return np.asarray(frames, np.float32)


def _join_also(
    shot: Shot, shots: Mapping[int, Shot], near: Mapping[int, Neighbour], joined_layers: Sequence[_Joined], frame: Frame
) -> dict[str, FloatArray]:
    """Return the images that belong to the total, joined with the mean weights of the layers.

    Images that summed to the total before still do.
    """
    own = shot.frame
    albedos = {number: _add_albedos(shots[number].layers) for number in near}
    albedo = _add_albedos({each.layer.name: each.layer for each in joined_layers})
    light = [np.mean(each.layer.images[RADIANCE], axis=-1) for each in joined_layers]
    lit = np.maximum(np.sum(light, axis=0), np.float32(1e-12))
    before = LayerImages("also", "rest", _add_albedos(shot.layers), own.also)
    good = np.logical_and.reduce([mark_good(image) for image in own.also.values()])
    total = good.astype(np.float32)
    totals = {name: image * total[..., None] for name, image in before.even.items()}
    for number, neighbour in near.items():
        others = shots[number].frame.also
        if any(name not in others for name in own.also):
            continue
        layer = LayerImages("also", "rest", albedos[number], {name: others[name] for name in own.also})
        images, agreement = neighbour.gather_layer(layer, list(own.also))
        shares = [
            part * each.weights.get(number, np.zeros_like(part))
            for part, each in zip(light, joined_layers, strict=True)
        ]
        weight = np.where(agreement > 0.0, np.sum(shares, axis=0) / lit, np.float32(0.0))
        totals = {name: totals[name] + image * weight[..., None] for name, image in images.items()}
        total = total + weight
    known = total > 0.0
    inverse = np.divide(np.float32(1.0), total, out=np.zeros_like(total), where=known)[..., None]
    joined = {}
    for name, image in own.also.items():
        mean = totals[name] * inverse
        joined[name] = np.where(known[..., None], multiply(mean, albedo), image)
    return keep_sum(joined, own.also, own.radiance.color, frame.radiance.color)


def _add_albedos(layers: Mapping[str, LayerImages]) -> FloatArray | None:
    """Return the sum of the layers' albedos; None if one has none."""
    albedos = [layer.albedo for layer in layers.values() if layer.albedo is not None]
    if len(albedos) < len(layers):
        return None
    return np.asarray(np.sum(albedos, axis=0, dtype=np.float32))
