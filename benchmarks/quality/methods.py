"""What `measure.py` compares: every method by its name, why one is missing, and how the baseline is tuned."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from benchmarks.quality.frames import SAMPLES, Bench
from benchmarks.quality.summary import TRAIN
from lobewise.denoising import denoise
from lobewise.metrics import rel_mse
from lobewise.peers import denoise_oidn, has_oidn
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import DenoiseSettings

NORMAL_EXPONENTS = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0, 4096.0)
SCREEN_SIGMAS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.5, 8.0)
TUNING_SEED = 1

Tuning = dict[str, dict[str, Any]]
"""By sample count, the best settings of "normal-aware"."""
Needs = tuple[str, ...]

_SETTINGS = frozenset(item.name for item in fields(DenoiseSettings))
_FAST: dict[str, Any] = {"quality": "fast"} if "quality" in _SETTINGS else {}
"""What asks for the plain filter, where there is more than that."""


@dataclass(frozen=True)
class Method:
    """A way from noisy frame to image, what settings of `lobewise.denoise` it needs, and whether the peer's library."""

    run: Callable[[Frame, Tuning], FloatArray]
    needs: Needs = ()
    oidn: bool = False

    def describe_obstacle(self) -> str:
        """Return why it cannot run here, empty where it can."""
        missing = [name for name in self.needs if name not in _SETTINGS]
        if missing:
            return "denoise has no setting " + " and no setting ".join(missing)
        if self.oidn and not has_oidn():
            return "Open Image Denoise is not installed"
        return ""


def _run_normal(frame: Frame, tuning: Tuning) -> FloatArray:
    settings = tuning[str(frame.spp)]["settings"]
    return denoise(frame, similarity="normal", **settings, **_FAST).image


def _run_ours(**settings: Any) -> Callable[[Frame, Tuning], FloatArray]:
    return lambda frame, _: denoise(frame, **settings).image


def _run_oidn(**options: Any) -> Callable[[Frame, Tuning], FloatArray]:
    return lambda frame, _: denoise_oidn(frame, **options)[0]


METHODS: dict[str, Method] = {
    "noisy": Method(lambda frame, _: frame.radiance.color),
    "normal-aware": Method(_run_normal),
    "single SG": Method(_run_ours(similarity="sg", **_FAST)),
    "fast": Method(_run_ours(quality="fast"), ("quality",)),
    "balanced": Method(_run_ours(quality="balanced"), ("quality",)),
    "high": Method(_run_ours(quality="high"), ("quality",)),
    "high + oidn": Method(_run_ours(quality="high", with_oidn=True), ("quality", "with_oidn"), oidn=True),
    "oidn": Method(_run_oidn(), oidn=True),
    "oidn, guides as they come": Method(_run_oidn(guides="mean"), oidn=True),
    "oidn balanced": Method(_run_oidn(quality="balanced", guides="mean"), oidn=True),
    "oidn fast": Method(_run_oidn(quality="fast", guides="mean"), oidn=True),
}
"""Every method. "oidn" has the best guides there are, which takes two networks more; the others of it one network."""


def tune(bench: Bench, scenes: tuple[str, ...] = TRAIN, samples: tuple[int, ...] = SAMPLES) -> Tuning:
    """Return for every sample count the settings of "normal-aware" with the least geometric mean error on the scenes.

    The whole grid is tried on one frame of each scene against its reference: that is more than a user can do.
    """
    best: Tuning = {}
    for spp in samples:
        frames = [(bench.fetch(scene, spp, TUNING_SEED), bench.fetch_reference(scene)[0]) for scene in scenes]
        tried = []
        for exponent, sigma in itertools.product(NORMAL_EXPONENTS, SCREEN_SIGMAS):
            settings = {"normal_exponent": exponent, "screen_sigma": sigma}
            candidate: Tuning = {str(spp): {"settings": settings}}
            errors = [rel_mse(_run_normal(frame, candidate), reference) for frame, reference in frames]
            tried.append({"rel_mse": float(np.exp(np.mean(np.log(errors)))), "settings": settings})
        best[str(spp)] = min(tried, key=lambda row: row["rel_mse"])
        print(f"{spp} spp: {best[str(spp)]}", flush=True)
    return best
