"""The numbers of a pipeline: what its user sets, what the camera gives, and what follows from both.

The formulas are those of `lobewise.denoising.automatic` and `lobewise.guides`. Given a `Number` they return a `Number`,
so that the pipeline computes them for every frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from lobewise.denoising.automatic import (
    AUTO_SIGMA,
    BETA_DIFFUSE,
    BETA_SPECULAR,
    GUIDED_TAU,
    choose_beta,
    choose_screen_sigma,
    choose_tau,
    expect_noise,
)
from lobewise.engine.numbers import Number, choose_given, choose_larger, compute_hypotenuse
from lobewise.guides.lobe_fields import NORMAL_ERROR
from lobewise.recipes.temporal.recipe import weigh_own
from lobewise.records.camera import Camera
from lobewise.settings import DenoiseSettings, Knob, TemporalSettings, list_knobs


class Setting(NamedTuple):
    """A number that the user of a pipeline may set."""

    name: str
    """Its name in C."""
    default: float
    """Its value unless it is set; 0 where the pipeline chooses."""
    text: str
    may_be_zero: bool = False
    most: float = 1e15


def declare(knob: Knob, name: str = "") -> Setting:
    """Return a setting of the library as a number of a pipeline."""
    is_chosen, has_end = "auto" in knob.choices, knob.high < math.inf
    text = knob.meaning + ("; 0 for automatic" if is_chosen else "")
    default = 0.0 if is_chosen else knob.default
    return Setting(name or knob.name, default, text, is_chosen or has_end, *([knob.high] if has_end else []))


_FILTER, _HISTORY = list_knobs(DenoiseSettings), list_knobs(TemporalSettings)
SPATIAL = (
    Setting("samples_per_pixel", 4.0, "Samples of a pixel (of a shaded pixel); what is automatic follows them"),
    *(
        declare(_FILTER[name])
        for name in ("beta", "diffuse_beta", "screen_sigma", "position_sigma", "tau", "normal_exponent")
    ),
)
OVER_TIME = (
    declare(_HISTORY["memory"]),
    declare(_HISTORY["beta"], "history_beta"),
    *(declare(_HISTORY[name]) for name in ("plane_sigma", "strictness", "cut_share")),
)


@dataclass
class Constants:
    """The numbers of a pipeline. Derived ones are computed once for every frame, in the order of `derived`.

    Parameters
    ----------
    scale : int
        Pixels from one shaded pixel to the next.
    radius : int
        Radius of the kernel, pixels or samples.
    guided : bool
        Whether the passes are guided by the noise; other values are automatic then.
    camera : Camera
        Camera of the example values, and that of the frame before it.
    size : (int, int)
        Height and width of the example values.
    spp : float
        Samples per pixel of the example values.
    """

    scale: int
    radius: int
    guided: bool
    camera: Camera = field(default_factory=lambda: Camera((0.5, 1.0, 3.0), (0.1, -0.2, -1.0), (0.0, 1.0, 0.0), 0.9))
    size: tuple[int, int] = (64, 96)
    spp: float = 4.0
    derived: dict[str, Number] = field(default_factory=dict)

    def get(self, name: str) -> Number:
        """Return a number that the user sets."""
        (setting,) = (candidate for candidate in SPATIAL + OVER_TIME if candidate.name == name)
        value = self.spp if name == "samples_per_pixel" else setting.default
        return Number(value, f"p->settings.{name}")

    def derive(self, name: str, number: float) -> Number:
        """Return a number that is computed once for a frame."""
        assert isinstance(number, Number), name
        self.derived.setdefault(name, number)
        return Number(float(number), f"p->numbers.{name}", is_single=number.is_single)

    def get_vector(self, name: str, *, before: bool = False) -> list[Number]:
        """Return a vector of the camera: "eye", "forward", or a number of `get_ray_numbers`, `get_projection_numbers`.

        Parameters
        ----------
        name : str
        before : bool
            Whether it is that of the frame before.
        """
        values = {"eye": self.camera.position, "forward": self.camera.forward}
        values |= self.camera.get_ray_numbers(self.size) | self.camera.get_projection_numbers(self.size)
        view = "p->view_before" if before else "p->view"
        return [Number(float(value), f"{view}.{name}[{k}]") for k, value in enumerate(np.atleast_1d(values[name]))]

    @property
    def pixel_angle(self) -> Number:
        """Angle of a pixel, radians."""
        return Number(self.camera.get_pixel_angle(self.size[0]), "p->view.pixel_angle")

    @property
    def pixel_tau(self) -> Number:
        """Band-limit of lobes that a pixel asks for; see `lobewise.guides.lobe_fields.default_tau`."""
        return self.derive("pixel_tau", compute_hypotenuse(self.pixel_angle, 2.0 * NORMAL_ERROR))

    @property
    def beta(self) -> Number:
        """Exponent of the similarity of specular lobes."""
        return self.derive("beta", choose_given(self.get("beta"), self._choose_beta(BETA_SPECULAR)))

    @property
    def diffuse_beta(self) -> Number:
        """Exponent of the similarity of diffuse lobes."""
        return self.derive("diffuse_beta", choose_given(self.get("diffuse_beta"), self._choose_beta(BETA_DIFFUSE)))

    def _choose_beta(self, guided: float) -> float:
        if self.guided:
            return guided
        chosen = choose_beta(self.get("samples_per_pixel"))
        return chosen if self.scale == 1 else chosen * (1.0 / self.scale**2) ** -0.15

    @property
    def screen_sigma(self) -> Number:
        """Standard deviation of the distance on the screen, pixels."""
        return self.derive("screen_sigma", choose_given(self.get("screen_sigma"), self.automatic_sigma))

    @property
    def automatic_sigma(self) -> float:
        """What `screen_sigma` is unless the user sets it."""
        if self.guided:
            return AUTO_SIGMA * max(self.radius, 1) / 8.0
        spp = (1.0 / self.scale**2) * self.get("samples_per_pixel")
        return choose_screen_sigma(spp, self.radius * self.scale)

    @property
    def tau(self) -> Number:
        """Band-limit of the lobes that are compared within a frame, radians."""
        automatic: float
        if self.guided:
            automatic = choose_larger(GUIDED_TAU, self.pixel_tau)
        else:
            automatic = choose_larger(self.scale * choose_tau(self.get("samples_per_pixel"), 0.0), self.pixel_tau)
        return self.derive("tau", choose_given(self.get("tau"), automatic))

    @property
    def own_weight(self) -> Number:
        """Weight of a pixel's own sample; see `lobewise.recipes.temporal.recipe.compute_own_weight`."""
        return self.derive("own", weigh_own(expect_noise(self.get("samples_per_pixel"))))


def list_settings(*, history: bool) -> Sequence[Setting]:
    """Return the numbers that the user of a pipeline may set."""
    return SPATIAL + OVER_TIME if history else SPATIAL
