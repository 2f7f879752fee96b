"""The plan of an exported filter: its settings, its features, and the arguments of its two functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise.backend.pointwise import Grid, Vector
from lobewise.exporting.arguments import PLANAR, Argument, list_arguments
from lobewise.exporting.names import ExportSettings
from lobewise.features import (
    AsgFeature,
    DiffuseFeature,
    Feature,
    GgxFeature,
    NormalFeature,
    PositionFeature,
    ScreenFeature,
    SgFeature,
    SgMixtureFeature,
)
from lobewise.guides.lobe_fields import define_lobes
from lobewise.guides.mixture_fields import define_mixture
from lobewise.settings.choices import get_similarity


@dataclass(frozen=True)
class Term:
    """How a feature of an exported filter is made from the arguments of the function."""

    make: Callable[..., Feature]
    """Takes the ``arrays`` and then the numbers of ``powers``."""
    arrays: tuple[str, ...]
    """Names of the arguments that are images."""
    powers: Mapping[str, int]
    """Names of the arguments that are numbers, with exponents: the feature's parameter is proportional to the product
    of the numbers to these powers."""


def _place(position: Any, depth: Any, sigma: float, pixel_angle: float) -> Feature:
    return PositionFeature(position, depth, pixel_angle=pixel_angle, sigma=sigma)


SCREEN = Term(ScreenFeature, (), {"screen_sigma": -2})
POSITION = Term(_place, ("position", "depth"), {"position_sigma": -1, "pixel_angle": -1})
SIMILARITIES = {
    "normal": Term(NormalFeature, ("normal",), {"normal_exponent": 1}),
    "diffuse": Term(DiffuseFeature, ("normal",), {"beta": 1}),
    "sg": Term(SgFeature, ("axis", "sharpness"), {"beta": 1}),
    "sg_mixture": Term(SgMixtureFeature, ("axis", "sharpness", "amplitude"), {"beta": 1}),
    "asg": Term(AsgFeature, ("axis", "covariance", "determinant"), {"beta": 1}),
    "ggx": Term(GgxFeature, ("axis", "covariance", "determinant"), {"beta": 1}),
}


@dataclass(frozen=True)
class FilterPlan(ExportSettings):
    """The settings of an exported filter, with its features and the arguments of its functions."""

    @property
    def makes_lobes(self) -> bool:
        """Whether there is a second function, which makes the lobes from normal, roughness and position."""
        return self.record is not None and self.record.has_lobes

    @property
    def is_mixture(self) -> bool:
        """Whether a lobe is a sum of spherical Gaussians."""
        return self.record is not None and self.record.is_mixture

    @property
    def terms(self) -> list[Term]:
        """The filter's features."""
        return [*([] if self.form == "atrous" else [SCREEN]), POSITION, SIMILARITIES[self.similarity]]

    @property
    def filter_arguments(self) -> list[Argument]:
        """The arguments of the filter, in order."""
        images = ["radiance", *(["albedo"] if self.albedo else []), "mask"]
        images += [name for term in self.terms for name in term.arrays]
        return self._list(*images, *(name for term in self.terms for name in term.powers), "output")

    @property
    def lobe_arguments(self) -> list[Argument]:
        """The arguments of the function that makes lobes, in order; empty where there is no such function."""
        if not self.makes_lobes:
            return []
        alphas = ("alpha_u", "alpha_v", "tangent") if self.anisotropic else ("alpha",)
        inputs = self._list("normal", "position", "depth", *alphas, "eye_x", "eye_y", "eye_z", "tau")
        return [*inputs, *self._list("mask", *SIMILARITIES[self.similarity].arrays, role="output")]

    def make_features(self, arrays: Mapping[str, Any], numbers: Mapping[str, float]) -> list[Feature]:
        """Return the features made of these values, which are keyed by the names of arguments."""
        return [
            term.make(*(arrays[name] for name in term.arrays), *(numbers[name] for name in term.powers))
            for term in self.terms
        ]

    def make_blank_features(self) -> list[Feature]:
        """Return the features made of arrays of one pixel, with the right numbers of channels, and of numbers 1."""
        given = self.filter_arguments
        arrays = {each.name: np.zeros((1, 1, each.channels)[: 2 + (not each.planar)], np.float32) for each in given}
        return self.make_features(arrays, {each.name: 1.0 for each in given})

    def _list(self, *names: str, role: str = "") -> list[Argument]:
        return list_arguments(*names, lobes=self.lobes if self.is_mixture else PLANAR, role=role)


def define_guides(grid: Grid, similarity: str, lobes: int) -> Sequence[Vector]:
    """Return the outputs of the function that makes lobes, in order: the mask, the axis and the shape of the lobe.

    The exported function is compiled from this definition, and the sample is made with it in this process.
    """
    is_mixture = get_similarity(similarity).is_mixture
    if is_mixture:
        return define_mixture(grid, lobes)
    valid, _, _, *lobe = define_lobes(grid, similarity)
    return [valid, *lobe]
