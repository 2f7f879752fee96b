"""How training scenes are rendered: samples per pixel, brightness, references, threads."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.training.kinds import SALT
from lobewise.peers import denoise_oidn
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.radiance import Radiance
from lobewise.render import load_mitsuba

FEW, MANY = (1, 2, 4, 8, 16), (32, 64)
"""Samples per pixel that a frame may have."""
SHARE_OF_MANY = 0.35
"""How often a scene has one frame of `MANY`: its reference takes four times as long."""

REFERENCE_SPP, LONG_REFERENCE_SPP = 128, 512
MANY_SPP = 16
"""Frames of more samples than this need the long reference."""

MEDIAN_RADIANCE = (0.08, 0.8)
"""Bounds of the median radiance to which a scene's light is scaled."""
LEAST_MEDIAN = 0.15
"""Smallest median that counts, as a share of the brightness that a tenth of the pixels exceed: in a dark room with one
lit corner the corner would become too bright."""


def draw_samples(seed: int) -> tuple[int, ...]:
    """Return the samples per pixel of the frames of a scene, two or three numbers, ascending."""
    generator = np.random.default_rng([SALT, seed, 1])
    count = int(generator.integers(2, 4))
    many = [int(generator.choice(MANY))] if generator.random() < SHARE_OF_MANY else []
    few = generator.choice(FEW, count - len(many), replace=False)
    return tuple(sorted([*many, *(int(each) for each in few)]))


def choose_reference_spp(samples: Sequence[int]) -> int:
    """Return the samples per pixel of the reference beside frames of ``samples``."""
    return LONG_REFERENCE_SPP if max(samples) > MANY_SPP else REFERENCE_SPP


def choose_exposure(seed: int, color: FloatArray) -> float:
    """Return what all light of a scene is multiplied by, so that its median is what the seed draws."""
    low, high = np.log(MEDIAN_RADIANCE)
    wanted = float(np.exp(np.random.default_rng([SALT, seed, 2]).uniform(low, high)))
    brightness = color.mean(axis=-1)
    found = max(float(np.median(brightness)), LEAST_MEDIAN * float(np.percentile(brightness, 90)), 1e-6)
    # Few digits: the last bits of a render may differ from machine to machine.
    return float(f"{wanted / found:.3g}")


def _scale(radiance: Radiance | None, factor: float) -> Radiance | None:
    if radiance is None:
        return None
    names = ("color", "diffuse", "specular")
    return Radiance(**{name: np.float32(factor) * getattr(radiance, name) for name in names})


def expose(frame: Frame, factor: float) -> Frame:
    """Return a frame with all its light multiplied by a factor, without variance."""
    radiance, half_a, half_b = (_scale(each, factor) for each in (frame.radiance, frame.half_a, frame.half_b))
    assert radiance is not None
    emission = frame.gbuffer.mean_emission
    guides = frame.gbuffer if emission is None else replace(frame.gbuffer, mean_emission=np.float32(factor) * emission)
    return replace(frame, radiance=radiance, half_a=half_a, half_b=half_b, variance=None, gbuffer=guides)


def clean_reference(color: FloatArray, guides: Frame) -> FloatArray:
    """Return a reference without the rest of its noise; ``guides`` is any frame of the same view."""
    return denoise_oidn(replace(guides, radiance=Radiance(color=color), half_a=None, half_b=None))[0]


def limit_threads(threads: int) -> Any:
    """Limit every library that computes here to so many threads, and return Mitsuba. Comes before any rendering."""
    os.environ |= {"OIDN_NUM_THREADS": str(threads), "OIDN_SET_AFFINITY": "0", "HL_NUM_THREADS": str(threads)}
    mi = load_mitsuba("cpu")
    import drjit as dr

    dr.set_thread_count(threads)
    return mi
