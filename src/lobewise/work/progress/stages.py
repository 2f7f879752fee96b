"""The steps of a frame by name: those of the printed plan, and of its progress; and how long each takes."""

from __future__ import annotations

FILTER_ONCE = "filter every layer by its guides"
FILTER_HALVES = "filter both halves of every layer by its passes"
REFINE = "refine the image by the network that weighs neighbours"
TAKE_BACK = "take the noisy image back where the filter removed detail"
SHARE_OUT = "share out the light that bounding took from fireflies"
FILL = "fill bad pixels that no layer reached from their neighbours"
MIX_UNGUIDED = "mix in an image filtered by its color alone where guides are noise"
MIX_PEER = "mix in the image of Open Image Denoise, pixel by pixel"
FILTER_OTHERS = "filter the light passes that belong to the layers by the same weights"

SECONDS_PER_MEGAPIXEL = {
    FILTER_ONCE: 0.15,
    FILTER_HALVES: 0.3,
    REFINE: 0.65,
    TAKE_BACK: 0.5,
    SHARE_OUT: 0.03,
    FILL: 0.03,
    MIX_UNGUIDED: 0.05,
    FILTER_OTHERS: 0.5,
}
"""Time of every step on two threads, that of `FILTER_ONCE` and `FILTER_HALVES` for one layer. It decides the share of a
call that is done. Machine: AMD EPYC, a frame of 626x540 pixels."""


def describe_alone(name: str) -> str:
    """Return the step that denoises an image beside the picture."""
    return f"denoise {name} by itself"
