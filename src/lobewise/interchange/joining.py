"""Add to an imported frame: noisy opacity, further noisy passes, or a second render as half of the samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lobewise.errors import InputError, require_choice
from lobewise.frame import FloatArray, Radiance
from lobewise.interchange.channels import COLOR, Pass, list_passes
from lobewise.interchange.imported import ImageReader, Imported
from lobewise.interchange.importing.leftovers import take_noisy_alpha
from lobewise.interchange.lighting import PartOutput, name_pass
from lobewise.interchange.mapping import ChannelMap, Found

MAX_ALPHA_SPP = 64
"""Most samples per pixel with which the opacity of a file is denoised. Renderers spread the samples of a pixel evenly,
so that its opacity has less noise than its light, and fine leaves lose more than they gain."""


def add_also(imported: Imported, patterns: Sequence[str], read: ImageReader) -> Imported:
    """Return a frame with the passes that match ``patterns`` added to their layers, or to the image.

    Raises
    ------
    InputError
        If no unused pass matches a pattern, or the file uses lobewise's own names, which have no further passes.
    """
    if imported.map is None:
        raise InputError(
            "--also",
            expected="a file of another renderer",
            got="a file with lobewise's own channel names",
            action="leave --also out",
        )
    used = {channel for one in imported.outputs.values() for channel in one.target.channels}
    used |= {channel for one in imported.map.roles.values() for channel in one.channels}
    layers = {layer.name: layer for layer in imported.frame.layers}
    whole, outputs, notes = dict(imported.frame.also), dict(imported.outputs), list(imported.notes)
    for pattern in patterns:
        chosen = [(one, _pick_noisy(one)) for one in imported.map.beside if one.matches(pattern)]
        taken = [(one, channels) for one, channels in chosen if channels and not used.intersection(channels)]
        planes = [Found(one, channels).label for one, channels in taken if len(channels) == 1]
        if not taken and any(one.matches(pattern) for one in list_passes(imported.container)):
            notes.append(f"No pass of {imported.map.selection.label or 'the picture'} matches --also {pattern}.")
        elif not taken:
            raise InputError(
                f"--also {pattern}",
                expected="passes of three channels or of one that are not used yet",
                got="no such pass",
                action="see lobewise inspect",
            )
        for one, channels in taken:
            image, found_one = read(Found(one, channels)), Found(one, channels)
            # What a single channel holds is no part of a layer.
            owner, albedo = (None, None) if image.ndim == 2 else _look_up_owner(imported, one)
            if owner is None:
                name, divided = one.path, "the image"
                whole[name] = image
            else:
                name, divided = f"{owner}/{one.path}", f"the layer {owner}"
                factor = None if albedo is None else read(albedo)
                radiance = image if factor is None else image * factor
                layers[owner] = replace(layers[owner], parts={**layers[owner].parts, one.path: radiance})
                outputs[name] = PartOutput(found_one, factor)
            outputs.setdefault(name, PartOutput(found_one))
            if image.ndim == 3:
                notes.append(f"{found_one.label} is filtered like {divided}.")
        if planes:
            more = f" and {len(planes) - 1} more single channels are" if len(planes) > 1 else " is"
            notes.append(f"{planes[0]}{more} filtered by the weights of the image.")
    frame = imported.frame.with_changes(layers=tuple(layers.values()), also=whole)
    return replace(imported, frame=frame, outputs=outputs, notes=tuple(notes))


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
    assert imported.map is not None
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
    """Return the mean of two renders with different seeds. Each render becomes one half of the samples.

    Raises
    ------
    InputError
        If the renders differ in size, passes, samples or preset, or are the same image.
    """
    a, b = first.frame, second.frame
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
    if a.spp is not None and b.spp is not None and a.spp != b.spp:
        raise InputError("--half", expected=f"{a.spp} samples per pixel", got=str(b.spp), action="render both alike")
    require_choice("--half, preset", second.preset, [first.preset])

    def mix(one: FloatArray | None, other: FloatArray | None) -> FloatArray | None:
        return None if one is None or other is None else np.float32(0.5) * (one + other)

    layers = []
    for one, other in zip(a.layers, b.layers, strict=True):
        parts = {name: np.float32(0.5) * (image + other.parts[name]) for name, image in one.parts.items()}
        albedo = one.albedo if other.albedo is None else mix(one.albedo, other.albedo)
        radiance = np.float32(0.5) * (one.radiance + other.radiance)
        layers.append(type(one)(one.name, one.lobe, radiance, albedo, one.radiance, other.radiance, parts))
    also = {name: np.float32(0.5) * (image + b.also[name]) for name, image in a.also.items()}
    emitted = {name: np.float32(0.5) * (image + b.unscattered[name]) for name, image in a.unscattered.items()}
    whole = {name: mix(getattr(a.radiance, name), getattr(b.radiance, name)) for name in a.radiance.names}
    frame = a.with_changes(
        radiance=Radiance(**whole),  # type: ignore[arg-type]
        half_a=a.radiance,
        half_b=b.radiance,
        layers=tuple(layers),
        unscattered=emitted,
        also=also,
        alpha=mix(a.alpha, b.alpha),
        spp=None if a.spp is None else 2 * a.spp,
    )
    known = {one.what for one in first.findings}
    further = tuple(one for one in second.findings if one.what not in known)
    notes = [f"The second render: {one.sentence}" for one in further]
    return Imported(
        frame,
        first.container,
        first.map,
        (*first.notes, "Two renders were joined as halves of the samples.", *notes),
        first.outputs,
        (*first.findings, *further),
        first.shown,
    )
