"""Light of single pixels by Mitsuba's own integrators: participating media, hidden emitters, light through a lens.

The integrator follows rays of the scene's sensor. So it renders any pixels, through their centres or over their areas,
where Mitsuba's own call renders only whole films.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.records.frame import FloatArray
from lobewise.render.bridge import dr, mi
from lobewise.render.camera import get_image_size, get_sensor
from lobewise.render.tracing.points import Indirect, Points
from lobewise.render.tracing.rays import make_ray

LAUNCH_SAMPLES = 1 << 20
"""Samples per launch of the integrator."""


@dataclass(frozen=True)
class OwnSamples:
    """Means and noise of the samples of some pixels.

    ``color`` is (count, 3), linear. ``variance`` is that of the mean, of the same shape; None for a single sample.
    """

    color: FloatArray
    variance: FloatArray | None


def sample_own(
    scene: Any,
    integrator: Any,
    pixel: Any,
    *,
    samples: int,
    seed: int,
    centred: bool = False,
    advance: Callable[[int], None] | None = None,
) -> OwnSamples:
    """Return the light of some pixels by an integrator of Mitsuba.

    Parameters
    ----------
    scene : mitsuba.Scene
    integrator : mitsuba.SamplingIntegrator
    pixel : mitsuba.UInt32
        Row-major numbers of the pixels.
    samples : int
        Samples per pixel, >= 1.
    seed : int
        The same seed, for the same list of pixels, gives the same bits.
    centred : bool
        Whether rays pass through the centres of pixels instead of their areas. A lens is sampled in both cases.
    advance : callable, optional
        Called with the number of samples after each launch.
    """
    count = dr.width(pixel)
    total, squares = np.zeros((count, 3)), np.zeros((count, 3))
    for begin in range(0, count, LAUNCH_SAMPLES):
        width = min(LAUNCH_SAMPLES, count - begin)
        part = dr.gather(mi.UInt32, pixel, dr.arange(mi.UInt32, width) + dr.opaque(mi.UInt32, begin))
        most = max(1, LAUNCH_SAMPLES // width)
        for start in range(0, samples, most):
            rounds = min(most, samples - start)
            launch = int(np.random.SeedSequence([seed, begin, start]).generate_state(1)[0])
            light = _launch(scene, integrator, part, rounds, launch, centred)
            total[begin : begin + width] += light.sum(axis=0)
            squares[begin : begin + width] += np.square(light).sum(axis=0)
            if advance is not None:
                advance(width * rounds)
    mean = total / samples
    spread = np.maximum(squares / samples - np.square(mean), 0.0) / max(samples - 1, 1)
    return OwnSamples(mean.astype(np.float32), spread.astype(np.float32) if samples > 1 else None)


def _launch(scene: Any, integrator: Any, pixel: Any, rounds: int, seed: int, centred: bool) -> NDArray[np.float64]:
    """Return samples of pixels, (rounds, pixels, 3)."""
    sensor, count = get_sensor(scene), dr.width(pixel)
    sampler = mi.load_dict({"type": "independent"})
    # A seed that is not opaque would be compiled into the kernel.
    sampler.seed(dr.opaque(mi.UInt32, seed), count * rounds)
    lanes = dr.gather(mi.UInt32, pixel, dr.arange(mi.UInt32, count * rounds) % dr.opaque(mi.UInt32, count))
    width, height = (dr.opaque(mi.UInt32, length) for length in get_image_size(scene))
    place = mi.Point2f(0.5) if centred else sampler.next_2d()
    # The integrator hides lamps by itself, and media in front of them are seen.
    ray = make_ray(scene, lanes, (width, height), place, sampler.next_2d(), hides=False)
    with dr.suspend_grad():
        sampled = integrator.sample(scene, sampler, mi.RayDifferential3f(ray), sensor.get_medium())[0]
        light = np.array(dr.zeros(mi.Color3f, count * rounds) + mi.Color3f(sampled), dtype=np.float64)
    return light.T.reshape(rounds, count, 3)


class OwnLight:
    """All light of a scene by its own integrator, as a method of the interactive chain.

    The chain then shades no direct light. A sample is as noisy as a path, and direct light is not stratified.
    """

    name = "paths"
    worth = 1.0
    state = None
    is_whole = True
    """Whether the light includes emitted and direct light."""

    def __init__(self, scene: Any, integrator: Any) -> None:
        self._scene = scene
        self._integrator = integrator

    def get_band_limit(self, points: Points, samples: int) -> float:
        """Return 0, because directions are sampled by the lobes; see `IndirectMethod`."""
        return 0.0

    def shade(self, points: Points, *, samples: Any, seed: Any) -> Indirect:
        """Return all light at points as ``diffuse``; see `IndirectMethod`."""
        color = self.sample(points.pixel, int(samples), int(seed))
        light = mi.Color3f(np.ascontiguousarray(color.T))
        return Indirect(light, dr.zeros(mi.Color3f, len(color)), dr.zeros(mi.Float, len(color)))

    def sample(self, pixel: Any, samples: int, seed: int) -> FloatArray:
        """Return all light, (count, 3), that reaches the centres of pixels. ``pixel`` holds their row-major numbers."""
        return sample_own(self._scene, self._integrator, pixel, samples=samples, seed=seed, centred=True).color
