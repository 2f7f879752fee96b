"""Calls of the filter kernels to time, and the paper's times."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from lobewise import engine
from lobewise.features import Feature
from lobewise.filters.cross_filter import FilterOutput, run_filter
from lobewise.filters.forms import ATROUS_LEVELS
from lobewise.frame import Frame

Calls = dict[str, Callable[[], Any]]

PAPER_SIZE = 1024
PAPER_RADII = (8, 16)
PAPER_MILLISECONDS = {
    8: {"normal": 2.43, "sg": 3.29, "sg_mixture, 3 lobes": 15.2, "asg": 17.7},
    16: {"normal": 4.56, "sg": 6.03, "sg_mixture, 3 lobes": 27.6, "asg": 30.8},
}
"""Times by radius and similarity. Source: Tokuyoshi 2015, slide "Denoising Performance": AMD Radeon HD 6990, images of
`PAPER_SIZE` x `PAPER_SIZE` pixels."""


def count_taps(form: str, radius: int) -> int:
    """Return the taps per pixel, all passes together."""
    side = 2 * radius + 1
    return {"full": side * side, "separable": 2 * side, "atrous": 25 * ATROUS_LEVELS}[form]


def make_kernel_calls(
    frame: Frame, features: dict[str, list[Feature]], radius: int, form: str, device: str = "cpu"
) -> Calls:
    """Return functions that filter one image with each list of features; Open Image Denoise also gets one image."""

    def run(chosen: list[Feature]) -> FilterOutput:
        with engine.on(device):
            return run_filter(frame.radiance.color, np.ones(frame.shape, dtype=bool), chosen, form=form, radius=radius)

    return {name: partial(run, chosen) for name, chosen in features.items()}
