"""Check of lobewise's own mark in a file: an image with it was denoised already."""

from __future__ import annotations

from dataclasses import replace

from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.io.exr.container import Container
from lobewise.io.exr.header import read_replaced
from lobewise.io.exr.schema import DENOISED

MARKED = "denoised by lobewise"
"""Name of the finding that the image, or the passes of light that add up to it, are results of lobewise."""
LIGHT = ("diffuse", "specular")
"""Roles of the passes of light that add up to the image."""
SAYS_MARK = f"Lobewise has denoised this file (attribute {DENOISED!r})"


def leave_out_denoised_light(container: Container, channels: ChannelMap) -> ChannelMap:
    """Return the channels without the passes of light, if lobewise has denoised the passes but not the image.

    If the renderer had denoised its image, lobewise wrote its result there, and the file still has the noisy image.
    The noisy image is then filtered as a whole, because no noisy passes of light are left.
    """
    is_image_denoised, is_light_denoised = _look_up_denoised(container, channels)
    if is_image_denoised or not is_light_denoised:
        return channels
    return replace(channels, layers=(), roles={name: one for name, one in channels.roles.items() if name not in LIGHT})


def check_mark(container: Container, channels: ChannelMap) -> list[Finding]:
    """Return a finding if lobewise has denoised the image of a file, or its passes of light."""
    is_image_denoised, is_light_denoised = _look_up_denoised(container, channels)
    if is_image_denoised:
        note = f"{SAYS_MARK}: give the noisy render, or say by --map color=... which image is noisy."
        return [Finding(MARKED, note, mended=False)]
    if not is_light_denoised or channels.is_own:
        return []
    note = (
        f"{SAYS_MARK}, but not {channels.roles['color'].label}: the image is filtered as a whole, because its "
        "passes of light are denoised already; the noisy render gives a better result."
    )
    return [Finding(MARKED, note, mended=True)]


def _look_up_denoised(container: Container, channels: ChannelMap) -> tuple[bool, bool]:
    """Return whether the file's mark lists the image, and whether it lists a pass of its light."""
    replaced = read_replaced(container) or {}

    def is_result(found: Found) -> bool:
        return bool(replaced.get(found.source.part.index, frozenset()).intersection(found.channels))

    light = [channels.roles[name] for name in LIGHT if name in channels.roles]
    layers = [one for layer in channels.layers for one in layer.light]
    return is_result(channels.roles["color"]), any(map(is_result, (*light, *layers)))
