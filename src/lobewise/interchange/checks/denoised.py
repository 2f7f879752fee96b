"""Whether a file carries lobewise's own mark: what would be filtered is a result already."""

from __future__ import annotations

from dataclasses import replace

from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.io.exr.container import Container
from lobewise.io.exr.header import read_replaced
from lobewise.io.exr.layout import require_beauty
from lobewise.io.exr.schema import BEAUTY, DENOISED

MARKED = "denoised by lobewise"
"""What is found where the image, or the light that makes it up, is a result of lobewise."""
LIGHT = ("diffuse", "specular")
BEGINS = f"Lobewise has denoised this file (attribute {DENOISED!r})"


def leave_out_denoised_light(container: Container, channels: ChannelMap) -> ChannelMap:
    """Return the channels without the passes of light, if lobewise has denoised those but not the image.

    Where the renderer had denoised its image, the noisy one is still there after lobewise. It is filtered as a whole,
    because the light that made it up is not there noisy.
    """
    is_image_denoised, is_light_denoised = _find_denoised(container, channels)
    if is_image_denoised or not is_light_denoised:
        return channels
    return replace(channels, layers=(), roles={name: one for name, one in channels.roles.items() if name not in LIGHT})


def check_mark(container: Container, channels: ChannelMap) -> list[Finding]:
    """Return whether lobewise has denoised the image of another renderer's file, or the light that makes it up."""
    is_image_denoised, is_light_denoised = _find_denoised(container, channels)
    if is_image_denoised:
        told = f"{BEGINS}: give the noisy render, or say by --map color=... which image is noisy."
        return [Finding(MARKED, told, mended=False)]
    if not is_light_denoised:
        return []
    told = (
        f"{BEGINS}, but not {channels.roles['color'].label}: that is filtered as a whole, as the light that makes it "
        "up is denoised; the noisy render gives a better result."
    )
    return [Finding(MARKED, told, mended=True)]


def _find_denoised(container: Container, channels: ChannelMap) -> tuple[bool, bool]:
    """Return whether the file's mark lists the image, and whether it lists a pass of its light."""
    replaced = read_replaced(container) or {}

    def is_result(found: Found) -> bool:
        return bool(replaced.get(found.source.part.index, frozenset()).intersection(found.channels))

    light = [channels.roles[name] for name in LIGHT if name in channels.roles]
    layers = [one for layer in channels.layers for one in layer.light]
    return is_result(channels.roles["color"]), any(map(is_result, (*light, *layers)))


def check_own_mark(container: Container) -> tuple[Finding, ...]:
    """Return what was found of a file in lobewise's own names: that its image is a result."""
    replaced = (read_replaced(container) or {}).get(require_beauty(container).index, frozenset())
    told = f"{BEGINS}: give the noisy render."
    return (Finding(MARKED, told, mended=False),) if replaced.intersection(BEAUTY.channels) else ()
