"""What is compared on a renderer's frames: every method by its name."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import lobewise
from benchmarks.foreign.files import Renderer
from benchmarks.foreign.judging import Judge
from benchmarks.quality.methods import NORMAL_EXPONENTS, SCREEN_SIGMAS
from lobewise.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.peers import denoise_oidn


@dataclass(frozen=True)
class Shot:
    """A noisy file, read as often as it is needed."""

    renderer: Renderer
    path: Path

    @cached_property
    def frame(self) -> Frame:
        """All that lobewise finds in the file."""
        return lobewise.read_frame(self.path, light_passes=False)

    @cached_property
    def alone(self) -> Frame:
        """What it finds in a file that has nothing but color, albedo and normal."""
        with tempfile.TemporaryDirectory() as folder:
            return lobewise.read_frame(self.renderer.keep_alone(self.path, Path(folder)), light_passes=False)

    @cached_property
    def peer(self) -> Frame:
        """Color with the guides that the renderer itself hands to Open Image Denoise."""
        albedo, normal = (self.renderer.read_guide(self.path, index) for index in (0, 1))
        return Frame(Radiance(self.frame.radiance.color), GBuffer(normal=normal, diffuse_albedo=albedo))


METHODS: dict[str, Callable[[Shot], FloatArray]] = {
    "noisy": lambda shot: shot.frame.radiance.color,
    "balanced, color, albedo and normal alone": lambda shot: lobewise.denoise(shot.alone, quality="balanced").image,
    "fast": lambda shot: lobewise.denoise(shot.frame, quality="fast").image,
    "balanced": lambda shot: lobewise.denoise(shot.frame, quality="balanced").image,
    "high": lambda shot: lobewise.denoise(shot.frame, quality="high").image,
    "oidn": lambda shot: denoise_oidn(shot.peer)[0],
}
"""Every method without parameters. "oidn" is Open Image Denoise as Blender calls it: with its own passes for denoising,
albedo and normal, each filtered first ("accurate" prefiltering), then told that they are clean."""

HALVES = {"balanced, both renders": "balanced", "high, both renders": "high"}
"""Methods that take two seeds as halves of twice the samples, by name, and their quality."""
TUNED = "normal-aware"
BASE, PEER = "balanced, color, albedo and normal alone", "oidn"


def run_halves(first: Shot, second: Shot, quality: str) -> FloatArray:
    """Return what is made of two renders with different seeds."""
    frame = lobewise.read_frame(first.path, half=second.path, light_passes=False)
    return lobewise.denoise(frame, quality=quality).image


def run_tuned(shot: Shot, exponent: float, sigma: float) -> FloatArray:
    """Return what a filter of normals alone makes of all that is in the file."""
    settings = {"normal_exponent": exponent, "screen_sigma": sigma}
    return lobewise.denoise(shot.frame, similarity="normal", quality="fast", **settings).image


def tune(shot: Shot, judge: Judge) -> tuple[float, float]:
    """Return the exponent and sigma with the least error on a frame: more than a user, who has no reference, can do."""
    grid = itertools.product(NORMAL_EXPONENTS, SCREEN_SIGMAS)
    return min(grid, key=lambda pair: judge.measure(run_tuned(shot, *pair))[0])
