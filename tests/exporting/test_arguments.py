"""The formulas of READMEs are those by which `lobewise.denoise` chooses its numbers."""

from __future__ import annotations

import math
import re

import pytest

from lobewise.denoising.automatic import choose_beta, choose_screen_sigma, choose_tau
from lobewise.exporting.arguments import list_arguments


def evaluate(recipe: str, **values: float) -> float:
    """Return the value of a formula such as ``2.5 spp^(1/3), from 1 to 64``."""
    formula, _, ends = recipe.partition(", from " if ", from " in recipe else ", at least ")
    low, _, high = ends.partition(" to ")

    def compute(text: str) -> float:
        spelled = re.sub(r"(?<=\d) (?=[a-z(])", " * ", text.replace("^", "**"))
        return float(eval(spelled, {"sqrt": math.sqrt, "min": min, **values}))

    return min(max(compute(formula), compute(low)), compute(high) if high else math.inf)


@pytest.mark.parametrize("spp", [1, 4, 7, 64, 4096, 100000])
def test_recipes_are_those_of_python(spp: int) -> None:
    radius, pixel_angle = 8, 3e-3
    pixel_tau = math.hypot(pixel_angle, 0.002)
    chosen = {
        "beta": choose_beta(spp),
        "screen_sigma": choose_screen_sigma(spp, radius),
        "tau": choose_tau(spp, pixel_tau),
    }
    for name, value in chosen.items():
        (argument,) = list_arguments(name)
        assert evaluate(argument.recipe, spp=spp, radius=radius, pixel_angle=pixel_angle) == pytest.approx(value)
