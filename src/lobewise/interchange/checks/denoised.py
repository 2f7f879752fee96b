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
BEGINS = f"Lobewise has denoised this file (attribute {DENOISED!r})"


def check_mark(container: Container, channels: ChannelMap) -> tuple[ChannelMap, list[Finding]]:
    """Return what to read of another renderer's file that lobewise may have denoised, and what was found.

    Where the renderer had denoised its image, the noisy one is still there after lobewise. It is filtered as a whole,
    for the light that made it up is not there noisy.
    """
    replaced = read_replaced(container)
    if not replaced:
        return channels, []

    def is_result(found: Found) -> bool:
        return bool(replaced.get(found.source.part.index, frozenset()).intersection(found.channels))

    color = channels.roles["color"]
    if is_result(color):
        told = f"{BEGINS}: give the noisy render, or say by --map color=... which image is noisy."
        return channels, [Finding(MARKED, told, mended=False)]
    light = {name: one for name, one in channels.roles.items() if name in ("diffuse", "specular")}
    layers = [one for layer in channels.layers for one in layer.light]
    if not any(map(is_result, (*light.values(), *layers))):
        return channels, []
    told = (
        f"{BEGINS}, but not {color.label}: that is filtered as a whole, as the light that makes it up is denoised; "
        "the noisy render gives a better result."
    )
    roles = {name: one for name, one in channels.roles.items() if name not in light}
    return replace(channels, layers=(), roles=roles), [Finding(MARKED, told, mended=True)]


def check_own_mark(container: Container) -> tuple[Finding, ...]:
    """Return what was found of a file in lobewise's own names: that its image is a result."""
    replaced = (read_replaced(container) or {}).get(require_beauty(container).index, frozenset())
    told = f"{BEGINS}: give the noisy render."
    return (Finding(MARKED, told, mended=False),) if replaced.intersection(BEAUTY.channels) else ()
