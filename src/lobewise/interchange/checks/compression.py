"""Check of the damage by lossy compression in a foreign frame: light below 0, and moved surfaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lobewise.interchange.checks.finding import Finding, list_names
from lobewise.interchange.mapping import ChannelMap, Found, Key
from lobewise.io.exr.container import Channel, Part
from lobewise.records.frame import FloatArray

LOSSY_DWA_NAMES = ("R", "G", "B", "Y", "RY", "BY")
"""Last words of the channels that DWAA and DWAB compress with loss. They store all other channels exactly. The case of
letters counts. Of positions and normals only the y component is among them. Source: OpenEXR's
src/lib/OpenEXRCore/internal_dwa_classifier.h."""
MAX_UNDERSHOOT = 0.01
"""Largest distance of light below 0 that compression explains: DWA rounds the 2.2th root of dark values to some
hundredths."""
LIGHT = ("color", "diffuse", "specular", "albedo", "diffuse_albedo", "specular_albedo")
"""Roles whose values are never below 0."""
SURFACES = ("normal", "position", "depth", "roughness")
"""Roles that describe surfaces. Their errors by compression are reported, not corrected."""


def is_lossy(part: Part, channel: Channel) -> bool:
    """Return whether the compression of a part damages a channel. PXR24 does not: it keeps 15 bits of mantissa."""
    if part.compression in ("dwaa", "dwab"):
        return channel.pixel_type != "uint" and channel.name.rpartition(".")[2] in LOSSY_DWA_NAMES
    return part.compression in ("b44", "b44a") and channel.pixel_type == "half"


def check_compression(
    channels: ChannelMap, read: Callable[[Found], FloatArray]
) -> tuple[dict[Key, FloatArray], list[Finding]]:
    """Return images of light whose values just below 0 were set to 0, and findings on lossy compression.

    Parameters
    ----------
    channels : ChannelMap
        The images of the file.
    read : callable
        Returns an image of the file.
    """
    lossy = {
        (part.index, channel.name): part.compression
        for part in {one.source.part.index: one.source.part for one in _list_images(channels)}.values()
        for channel in part.channels
        if is_lossy(part, channel)
    }
    if not lossy:
        return {}, []

    def is_changed(found: Found) -> bool:
        return any((found.source.part.index, name) in lossy for name in found.channels)

    kinds = " and ".join(sorted(set(lossy.values())))
    findings = []
    altered = [
        channels.roles[role].label
        for role in ("color", *SURFACES)
        if role in channels.roles and is_changed(channels.roles[role])
    ]
    if altered:
        note = (
            f"Compression with loss ({kinds}) altered {list_names(altered)}, so that surfaces lie a little off: save "
            "the multilayer file with ZIP."
        )
        findings.append(Finding("compressed with loss", note, mended=False))
    light = [channels.roles[role] for role in LIGHT if role in channels.roles]
    light += [one for layer in channels.layers for one in (*layer.light, layer.albedo) if one is not None]
    changed: dict[Key, FloatArray] = {}
    dark, lowest = np.zeros((1, 1), np.bool_), 0.0
    for found in filter(is_changed, light):
        image = changed[found.key] if found.key in changed else read(found)
        below_zero = (image < 0.0) & (image > -MAX_UNDERSHOOT)
        if below_zero.any():
            lowest = min(lowest, float(image.min(where=below_zero, initial=0.0)))
            changed[found.key] = np.where(below_zero, np.float32(0.0), image)
            dark = np.asarray(dark | below_zero.any(axis=-1))
    if dark.any():
        note = (
            f"Compression with loss ({kinds}) left light or albedos below 0 (down to {lowest:.2g}) at "
            f"{np.count_nonzero(dark)} pixels: they count as 0."
        )
        findings.append(Finding("light below 0 by compression", note, mended=True))
    return changed, findings


def _list_images(channels: ChannelMap) -> list[Found]:
    layers = [one for layer in channels.layers for one in (*layer.light, layer.albedo) if one is not None]
    return [*channels.roles.values(), *layers]
