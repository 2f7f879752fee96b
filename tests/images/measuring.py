"""The figures of one image: errors, energy, the light of every pass, sums of passes, pixels that stand alone."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.users.alone import count_alone
from lobewise.metrics import make_error_map, rel_mse
from lobewise.records.frame import FloatArray, Frame, Result
from tests.images.frames import (
    View,
    denoise_view,
    join_views,
    list_clean_light,
    list_noisy_light,
    list_sums,
    read_views,
)

FIGURES = Path(__file__).parent / "figures.json"
SHARE_WORST = 0.001
"""Share of the pixels that "trimmed" leaves out."""
BLOCK = 8
"""Width and height of the blocks of pixels that light is summed over, pixels."""
MIN_SHARE_OF_IMAGE = 0.001
"""Least light of a pass, over that of the image, that a difference is relative to."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Bound:
    """How far a figure may be from the committed one: the sum of a share of it and of a constant."""

    share: float = 0.0
    constant: float = 0.0


BOUNDS: Mapping[str, Bound] = {
    "error": Bound(share=0.005),
    "trimmed": Bound(share=0.005),
    "energy": Bound(constant=0.0005),
    "light": Bound(share=0.01, constant=0.0005),
    "sum": Bound(constant=1e-5),
    "bright": Bound(),
    "dark": Bound(),
}
"""By the first word of a figure's name. Another number of threads changes no figure. Kernels without AVX2 and fused
multiplications change errors by 2e-5 of themselves, energy and light by 1e-6, sums by 1e-8."""
MAX_MEAN_CHANGE = 0.001
"""Largest relative change of the geometric mean of all frames' errors."""
PEER_FACTOR = 4.0
"""By which the bounds of "auto" are wider: another version of Open Image Denoise makes another image."""


@dataclass(frozen=True)
class Measured:
    """Figures by name, and what pictures show."""

    figures: Mapping[str, float]
    pictures: Mapping[str, FloatArray]


@cache
def measure_case(name: str, quality: str) -> Measured:
    """Denoise a frame, both eyes of it, and measure it."""
    views = read_views(name)
    results = [denoise_view(view.noisy, quality) for view in views]
    image = join_views([each.image for each in results])
    reference = join_views([view.reference.radiance.color for view in views])
    figures = measure_image(image, reference)
    for view, result in zip(views, results, strict=True):
        for key, value in measure_passes(view, result).items():
            figures[key] = max(value, figures.get(key, 0.0))
    pictures = {"noisy": join_views([view.shown for view in views]), "result": image, "reference": reference}
    return Measured({key: round_figure(value) for key, value in figures.items()}, pictures)


def round_figure(value: float) -> float:
    """Return a figure with the digits that are committed."""
    return float(f"{value:.5g}")


def measure_image(image: FloatArray, reference: FloatArray) -> dict[str, float]:
    """Return the figures of the whole image."""
    assert np.isfinite(image).all()
    worst = np.sort(make_error_map(image, reference), axis=None)
    kept = worst[: worst.size - max(1, round(SHARE_WORST * worst.size))]
    figures = {"error": rel_mse(image, reference), "trimmed": float(kept.mean())}
    sums = image.sum(axis=(0, 1), dtype=np.float64), reference.sum(axis=(0, 1), dtype=np.float64)
    figures |= {f"energy {letter}": float(a / b) for letter, a, b in zip("RGB", *sums, strict=True)}
    return figures | count_alone(image, reference)


def measure_passes(view: View, result: Result) -> dict[str, float]:
    """Return how far the light of every pass has moved, and how far passes are from their sums."""
    frame = view.noisy
    if not isinstance(frame, Frame):
        return {}
    noisy, clean = list_noisy_light(frame), list_clean_light(result, frame)
    known = list_noisy_light(view.reference)
    total = sum_blocks(frame.radiance.color).sum()
    found = {}
    for name, image in clean.items():
        before = sum_blocks(known.get(name, noisy[name]))
        least = MIN_SHARE_OF_IMAGE * abs(total)
        found[f"light {name}"] = np.abs(sum_blocks(image) - before).sum() / max(np.abs(before).sum(), least)
    for name, parts in list_sums(frame, clean).items():
        apart = compute_rest(result.image, clean, name, parts) - compute_rest(frame.radiance.color, noisy, name, parts)
        finite = apart[np.isfinite(apart)]
        found[f"sum {name or 'image'}"] = float(np.abs(finite).sum() / np.abs(result.image).sum())
    return found


def compute_rest(
    image: FloatArray, light: Mapping[str, FloatArray], name: str, parts: list[str]
) -> NDArray[np.float64]:
    """Return what light, or the image where ``name`` is no light, has beside its parts."""
    with np.errstate(invalid="ignore"):
        return np.subtract(light.get(name, image), sum(light[part] for part in parts), dtype=np.float64)


def sum_blocks(image: FloatArray) -> NDArray[np.float64]:
    """Return the light of every block of pixels, without pixels that are not finite."""
    light = np.where(np.isfinite(image).all(axis=-1, keepdims=True), image, 0.0).astype(np.float64)
    rows, columns = (np.arange(0, length, BLOCK) for length in image.shape[:2])
    sums: NDArray[np.float64] = np.add.reduceat(np.add.reduceat(light, rows, axis=0), columns, axis=1)
    return sums


def read_figures() -> dict[str, dict[str, dict[str, float]]]:
    """Return the committed figures by frame and quality."""
    figures: dict[str, dict[str, dict[str, float]]] = json.loads(FIGURES.read_text())
    return figures


def compare_figures(now: Mapping[str, float], committed: Mapping[str, float], quality: str) -> list[str]:
    """Return one sentence for each figure that moved beyond its bound."""
    told = [f"{name!r} is new" for name in sorted(now.keys() - committed.keys())]
    told += [f"{name!r} is gone" for name in sorted(committed.keys() - now.keys())]
    for name in sorted(now.keys() & committed.keys()):
        bound = BOUNDS[name.partition(" ")[0]]
        span = widen_bound(bound.share * abs(committed[name]) + bound.constant, quality)
        if abs(now[name] - committed[name]) > span:
            verb = "rose" if now[name] > committed[name] else "fell"
            told.append(f"{name!r} {verb} from {committed[name]:g} to {now[name]:g} (bound: by {span:.2g})")
    return told


def widen_bound(bound: float, quality: str) -> float:
    """Return the bound of a quality."""
    return bound * (PEER_FACTOR if quality == "auto" else 1.0)
