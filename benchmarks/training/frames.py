"""What all programs for training share: half floats, the folder for files, which scenes are kept aside."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import ROOT

Half = NDArray[np.float16]

LARGEST_VALUE = 60000.0
"""Stored values are clipped to plus and minus this number: half floats end at 65504."""

VALIDATION_EVERY = 5
"""One seed of so many is kept aside from training."""


def make_half(image: NDArray[np.floating]) -> Half:
    """Return an image as it is stored: clipped to `LARGEST_VALUE`, with 0 where it is not finite."""
    values = np.where(np.isfinite(image), image, 0.0)
    return np.clip(values, -LARGEST_VALUE, LARGEST_VALUE).astype(np.float16)


def make_parser(words: str | None, *, count: int, size: int) -> argparse.ArgumentParser:
    """Return the options of what makes frames: where they are kept, how many and how large they are."""
    parser = argparse.ArgumentParser(description=words, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for the files, outside the repository")
    parser.add_argument("--count", type=int, default=count, help="how many scenes or frames")
    parser.add_argument("--size", type=int, default=size, help="pixels a side")
    return parser


def open_cache(parser: argparse.ArgumentParser, path: Path) -> Path:
    """Return the folder of the option --cache, made if it is not there; inside the repository the program ends."""
    folder = path.expanduser().resolve()
    if folder.is_relative_to(ROOT):
        parser.error("--cache must lie outside the repository")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def is_validation(seed: int) -> bool:
    """Return whether the frames of a scene are kept aside from training."""
    return seed % VALIDATION_EVERY == 0
