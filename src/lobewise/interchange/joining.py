"""Add to an imported frame: noisy opacity, further noisy passes, or a second render as half of the samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from lobewise.errors import InputError, require_choice
from lobewise.interchange.channels import COLOR, Pass, list_passes
from lobewise.interchange.checks.renders import compare_noise, measure_moved, measure_relit
from lobewise.interchange.imported import ImageReader, Imported
from lobewise.interchange.importing.leftovers import list_further, list_light_groups, list_names, take_noisy_alpha
from lobewise.interchange.lighting import PartOutput, is_smooth, name_pass
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.radiance import MAX_EXCESS_SHARE, measure_excess

MAX_ALPHA_SPP = 64
"""Most samples per pixel with which the opacity of a file is denoised. Renderers spread the samples of a pixel evenly,
so that its opacity has less noise than its light, and fine leaves lose more than they gain."""

MAX_ALIKE = 2.0
"""Largest ratio of the samples of two renders that count alike. The mean of 1 and 2 samples has 9/8 of the noise that
weights by samples leave, and both halves of the samples are worth more than that."""


def add_also(imported: Imported, patterns: Sequence[str], read: ImageReader) -> Imported:
    """Return a frame with the passes that match ``patterns`` added to their layers, or to the image.

    Raises
    ------
    InputError
        If no unused pass matches a pattern, or the file uses lobewise's own names, which have no further passes.
    """
    if imported.map.is_own:
        raise InputError(
            "--also",
            expected="a file of another renderer",
            got="a file with lobewise's own channel names",
            action="leave --also out",
        )
    used = {channel for one in imported.outputs.values() for channel in one.target.channels}
    used |= {channel for one in imported.map.roles.values() for channel in one.channels}
    notes: list[str] = []
    for pattern in patterns:
        chosen = [(one, _pick_noisy(one)) for one in imported.map.beside if one.matches(pattern)]
        taken = [(one, channels) for one, channels in chosen if channels and not used.intersection(channels)]
        planes = [Found(one, channels).label for one, channels in taken if len(channels) == 1]
        if not taken and any(one.path in imported.frame.also for one, _ in chosen):
            continue  # a light group
        if not taken and any(one.matches(pattern) for one in list_passes(imported.container)):
            notes.append(f"No pass of {imported.map.selection.label or 'the picture'} matches --also {pattern}.")
        elif not taken:
            raise InputError(
                f"--also {pattern}",
                expected="passes of three channels or of one that are not used yet",
                got="no such pass",
                action="see lobewise inspect",
            )
        read.expect_images(Found(one, channels) for one, channels in taken)
        for one, channels in taken:
            found = Found(one, channels)
            imported = _add_image(imported, found, read)
            if len(channels) == 3:
                notes.append(f"{found.label} is {_describe_filter(_look_up_owner(imported, one)[0])}.")
        if planes:
            more = f" and {len(planes) - 1} more single channels are" if len(planes) > 1 else " is"
            notes.append(f"{planes[0]}{more} filtered by the weights of the image.")
    return replace(imported, notes=(*imported.notes, *notes))


def add_light_groups(imported: Imported, read: ImageReader) -> Imported:
    """Return a frame with the light groups of its file added to their layers, or to the image.

    Images with names of light groups that hold more light than the image or layer, or no noise, are none, and stay.
    """
    owned: dict[str | None, list[tuple[str, Found]]] = {}
    listed = list_light_groups(imported)
    read.expect_images(found for _, found in listed)
    for name, found in listed:
        owned.setdefault(_look_up_owner(imported, found.source)[0], []).append((name, found))
    notes = list(imported.notes)
    for owner, groups in owned.items():
        added = reduce(lambda so_far, group: _add_image(so_far, group[1], read), groups, imported)
        frame = added.frame
        if owner is None:
            whole, images = frame.radiance.color, [frame.also[found.source.path] for _, found in groups]
        else:
            (layer,) = (one for one in frame.layers if one.name == owner)
            whole, images = layer.radiance, [layer.parts[found.source.path] for _, found in groups]
        is_noisy = not all(map(is_smooth, images))
        if is_noisy and measure_excess(whole, np.sum(images, axis=0, dtype=np.float32)) <= MAX_EXCESS_SHARE:
            imported = added
            (words,) = list_names("light group", [name for name, _ in groups])
            each = "each " if len(groups) > 1 else ""
            notes.append(f"{words.capitalize()}: {each}{_describe_filter(owner)}.")
    return replace(imported, notes=tuple(notes))


def add_further(imported: Imported, read: ImageReader) -> Imported:
    """Return a frame with the noisy passes that its preset names, such as that of a shadow catcher."""
    for found in list_further(imported):
        image = read(found)
        if not np.array_equal(image, np.broadcast_to(image[:1, :1], image.shape)):
            note = f"{found.label} is {_describe_filter(None)}."
            imported = replace(_add_image(imported, found, read), notes=(*imported.notes, note))
    return imported


def _add_image(imported: Imported, found: Found, read: ImageReader) -> Imported:
    """Return a frame with a pass added to its layer, or to the image, and the channels that receive the result."""
    image, path = read(found), found.source.path
    # What a single channel holds is no part of a layer.
    owner, albedo = (None, None) if image.ndim == 2 else _look_up_owner(imported, found.source)
    if owner is None:
        frame = imported.frame.with_changes(also={**imported.frame.also, path: image})
        return replace(imported, frame=frame, outputs={**imported.outputs, path: PartOutput(found)})
    factor = None if albedo is None else read(albedo)
    light = image if factor is None else image * factor
    layers = [
        replace(layer, parts={**layer.parts, path: light}) if layer.name == owner else layer
        for layer in imported.frame.layers
    ]
    outputs = {**imported.outputs, f"{owner}/{path}": PartOutput(found, factor)}
    return replace(imported, frame=imported.frame.with_changes(layers=tuple(layers)), outputs=outputs)


def _describe_filter(owner: str | None) -> str:
    return "denoised by itself" if owner is None else f"filtered like the layer {owner}"


def add_noisy_alpha(imported: Imported, channels: ChannelMap, read: ImageReader) -> Imported:
    """Return a frame with the opacity of its file, if `take_noisy_alpha` returns one and the samples are few."""
    noisy = take_noisy_alpha(channels, read)
    if noisy is None:
        return imported
    found, alpha = noisy
    told, spp = f"{found.label} is a fraction in whole areas", imported.frame.spp
    if spp is not None and spp > MAX_ALPHA_SPP:
        return replace(imported, notes=(*imported.notes, f"{told}, and stays: {spp} samples leave little noise in it."))
    return replace(
        imported,
        frame=imported.frame.with_changes(alpha=alpha),
        outputs={**imported.outputs, "alpha": PartOutput(found)},
        notes=(*imported.notes, f"{told}, and is denoised by itself."),
    )


def _pick_noisy(one: Pass) -> tuple[str, ...] | None:
    """Return the three colours of a pass, or the one channel beside alpha that it has; None for any other number."""
    values = [name for letter, name in one.channels.items() if letter != "a"] or list(one.channels.values())
    return one.pick(COLOR) or (tuple(values) if len(values) == 1 else None)


def _look_up_owner(imported: Imported, one: Pass) -> tuple[str | None, Found | None]:
    """Return the layer of a pass and the albedo that divides its light. The layer is None for a pass of the image.

    The layer is the one with the longest pass name that begins the name of this pass.
    """
    names = {layer.name for layer in imported.frame.layers}
    last, best = name_pass(one.path), ""
    owner: tuple[str | None, Found | None] = None, None
    for mapped in imported.map.layers:
        for light in mapped.light:
            word = name_pass(light.source.path)
            if mapped.rule.name in names and last.lower().startswith(word.lower()) and len(word) > len(best):
                owner, best = (mapped.rule.name, mapped.albedo if mapped.rule.times_albedo else None), word
    return owner


def join_halves(first: Imported, second: Imported) -> Imported:
    """Return the mean of two renders with different seeds.

    Renders with about as much noise count alike, and each becomes one half of the samples. Otherwise each counts by its
    samples, or by its noise where the files do not tell their samples. The halves are then those that both files have,
    if any, and the guides are those of the render with less noise.

    Passes that only one of them has are left out, and stay noisy in the file.

    Raises
    ------
    InputError
        If the renders differ in size, passes, preset or in the surfaces that they show, or are the same image.
    """
    a, b = first.frame, second.frame
    _require_one_frame(a, b)
    require_choice("--half, preset", second.preset, [first.preset])
    ratio, told = _measure_samples(a, b)
    is_alike = 1.0 / MAX_ALIKE <= ratio <= MAX_ALIKE
    share = 0.5 if is_alike else ratio / (1.0 + ratio)
    note = "Two renders were joined as halves of the samples."
    if not is_alike:
        note = f"The second render has {told}, and counts for {100.0 * share:.2g} % of the light."

    def mix(one: FloatArray | None, other: FloatArray | None) -> FloatArray | None:
        if one is None or other is None:
            return None
        return (
            np.float32(0.5) * (one + other) if is_alike else np.float32(1.0 - share) * one + np.float32(share) * other
        )

    def mix_all(images: Mapping[str, FloatArray], others: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return {name: mix(images[name], others[name]) for name in images if name in others}  # type: ignore[misc]

    def mix_light(one: Radiance | None, other: Radiance | None) -> Radiance | None:
        if one is None or other is None or one.names != other.names:
            return None
        return Radiance(**{name: mix(getattr(one, name), getattr(other, name)) for name in one.names})  # type: ignore[arg-type]

    layers = []
    for one, other in zip(a.layers, b.layers, strict=True):
        halves = (one.radiance, other.radiance)
        if not is_alike:
            halves = mix(one.half_a, other.half_a), mix(one.half_b, other.half_b)  # type: ignore[assignment]
        albedo = one.albedo if other.albedo is None else mix(one.albedo, other.albedo)
        light, parts = mix(one.radiance, other.radiance), mix_all(one.parts, other.parts)
        layers.append(type(one)(one.name, one.lobe, light, albedo, *halves, parts))  # type: ignore[arg-type]
    frame = (b if share > 0.5 else a).with_changes(
        radiance=mix_light(a.radiance, b.radiance),
        half_a=a.radiance if is_alike else mix_light(a.half_a, b.half_a),
        half_b=b.radiance if is_alike else mix_light(a.half_b, b.half_b),
        variance=None,
        layers=tuple(layers),
        unscattered=mix_all(a.unscattered, b.unscattered),
        also=mix_all(a.also, b.also),
        alpha=mix(a.alpha, b.alpha),
        spp=None if a.spp is None or b.spp is None else a.spp + b.spp,
        notes=a.notes,
    )
    known = {one.what for one in first.findings}
    further = tuple(one for one in second.findings if one.what not in known)
    notes = [f"The second render: {one.sentence}" for one in further]
    return replace(
        first,
        frame=frame,
        notes=(*first.notes, note, *notes),
        findings=(*first.findings, *further),
        lacks=(),
        flips={},
    )


def _require_one_frame(a: Frame, b: Frame) -> None:
    """Raise InputError unless two renders show the same frame with other noise."""
    names = ([layer.name for layer in a.layers], [layer.name for layer in b.layers])
    if a.shape != b.shape:
        size, got = (f"{one.width}x{one.height} pixels" for one in (a, b))
        expected = f"the same frame rendered again, {size}"
        raise InputError("--half", expected=expected, got=got, action="render both alike, with another seed")
    if names[0] != names[1] or set(a.unscattered) != set(b.unscattered) or a.radiance.names != b.radiance.names:
        raise InputError(
            "--half",
            expected="the same frame rendered again: the same size and passes",
            got=f"{b!r} beside {a!r}",
            action="render both alike, with another seed",
        )
    if np.array_equal(a.radiance.color, b.radiance.color):
        raise InputError(
            "--half",
            expected="a second image with other noise",
            got="the same image",
            action="render it with another seed",
        )
    moved, guides = measure_moved(a.gbuffer, b.gbuffer)
    if moved:
        raise InputError(
            "--half",
            expected="the same frame rendered again, with another seed",
            got=f"other surfaces in {100.0 * moved:.2g} % of the pixels, by the {guides}",
            action="give the file of the same frame and camera",
        )
    relit = measure_relit(a.radiance.color, b.radiance.color)
    if relit:
        raise InputError(
            "--half",
            expected="the same frame rendered again, with another seed",
            got=f"other light than noise explains, in {100.0 * relit:.2g} % of the pixels",
            action="give the file of the same frame and settings",
        )


def _measure_samples(a: Frame, b: Frame) -> tuple[float, str]:
    """Return the samples of the second render over those of the first, by their noise if not told, and how in words."""
    if a.spp is not None and b.spp is not None:
        return b.spp / a.spp, f"{b.spp:g} samples per pixel beside {a.spp:g}"
    ratio = compare_noise(a, b)
    return ratio, f"{1.0 / ratio:.2g} times the noise of the first (variance)"
