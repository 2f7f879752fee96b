"""The columns of the bench: what a user can do with a frame, by name."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

import lobewise
from benchmarks.foreign.judging import Judge
from benchmarks.quality.methods import NORMAL_EXPONENTS, SCREEN_SIGMAS
from benchmarks.users.guides import sum_albedos
from lobewise.peers import denoise_oidn, has_oidn
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import QUALITY_NAMES

Tuning = Mapping[str, Mapping[str, float]]
"""By sample count, normal exponent and screen sigma of "normal-aware"."""


@dataclass(frozen=True)
class Shot:
    """A noisy frame with one set of guides.

    Parameters
    ----------
    frame : Frame
    peer : Frame
        What Open Image Denoise is given of the same guides: other renderers' frames, those that they hand to it.
    guides : str
    spp : int
        Which the frame of a file without it does not tell.
    """

    frame: Frame
    peer: Frame
    guides: str
    spp: int


def run_normal(frame: Frame, settings: Mapping[str, float]) -> FloatArray:
    """Return what a filter of normals alone makes of a frame."""
    return lobewise.denoise(frame, similarity="normal", quality="fast", **settings).image


def _run_tuned(shot: Shot, tuning: Tuning) -> FloatArray:
    nearest = min(tuning, key=lambda spp: abs(math.log(int(spp) / shot.spp)))
    return run_normal(shot.frame, tuning[nearest])


def _run_quality(name: str) -> Callable[[Shot, Tuning], FloatArray]:
    return lambda shot, _: lobewise.denoise(shot.frame, quality=name).image


def run_oidn(shot: Shot, _: Tuning) -> FloatArray:
    """Return what Open Image Denoise makes at its best: guides through its own filter for them, then called clean."""
    return run_oidn_alone(shot, _) if shot.guides == "color" else denoise_oidn(shot.peer)[0]


def run_oidn_alone(shot: Shot, _: Tuning) -> FloatArray:
    """Return what it makes of the color alone."""
    return call_oidn(shot.peer.radiance.color)


def run_oidn_plainly(shot: Shot, _: Tuning) -> FloatArray:
    """Return what most people get of it: albedo and normal as they come, said to be noisy."""
    guides = shot.peer.gbuffer
    if shot.guides == "color":
        return run_oidn_alone(shot, _)
    normal = guides.mean_normal if guides.mean_normal is not None else guides.normal
    return call_oidn(shot.peer.radiance.color, sum_albedos(shot.peer), normal)


def call_oidn(color: FloatArray, albedo: FloatArray | None = None, normal: FloatArray | None = None) -> FloatArray:
    """Return an image denoised by Open Image Denoise's default network. It takes normals with an albedo alone."""
    from pyoidn.denoise import denoise

    if albedo is None and normal is not None:
        albedo = np.ones_like(color)
    guides = [None if image is None else np.array(image, dtype=np.float32) for image in (albedo, normal)]
    return np.asarray(denoise(np.array(color, dtype=np.float32), *guides, hdr=True, quality="high"), dtype=np.float32)


METHODS: dict[str, Callable[[Shot, Tuning], FloatArray]] = {
    "noisy": lambda shot, _: shot.frame.radiance.color,
    "normal-aware": _run_tuned,
    **{name: _run_quality(name) for name in (*QUALITY_NAMES, "auto")},
    "oidn, color alone": run_oidn_alone,
    "oidn, as called": run_oidn_plainly,
    "oidn": run_oidn,
}
"""Every method, by the name of its column."""


def list_methods(wanted: Iterable[str] | None = None) -> list[str]:
    """Return those that can run here; what is asked for and cannot, raises SystemExit."""
    names = [name for name in METHODS if has_oidn() or not name.startswith("oidn")]
    unknown = set(wanted or ()) - set(names)
    if unknown:
        raise SystemExit(f"cannot run {', '.join(sorted(unknown))}: expected some of {', '.join(names)}")
    return [name for name in names if wanted is None or name in wanted]


def tune(frames: list[tuple[Frame, Judge]]) -> dict[str, Any]:
    """Return the settings of "normal-aware" with the least geometric mean error: more than a user can find out."""
    best: dict[str, Any] = {}
    for exponent, sigma in itertools.product(NORMAL_EXPONENTS, SCREEN_SIGMAS):
        settings = {"normal_exponent": exponent, "screen_sigma": sigma}
        errors = [judge.measure(run_normal(frame, settings))[0] for frame, judge in frames]
        mean = float(np.exp(np.mean(np.log(np.maximum(errors, 1e-9)))))
        if not best or mean < best["rel_mse"]:
            best = {"rel_mse": mean, "settings": settings}
    return dict(best["settings"])
