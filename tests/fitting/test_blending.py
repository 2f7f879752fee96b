"""Lobe tables between two tables."""

from dataclasses import replace

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.fitting.fit import fit_lobes
from lobewise.fitting.ggx import ggx_brdf
from lobewise.fitting.table import blend_tables, evaluate_lobes, evaluate_table
from lobewise.records.lobe_table import LobeTable
from tests.mistakes import refuses

NORMAL = np.array([0.0, 0.0, 1.0])


def make_table(sharpness: list[float], amplitude: list[float], tilt: list[float] | None = None) -> LobeTable:
    """Return a table of one view, whose lobes lean by ``tilt`` radians from the normal."""
    lobes = len(sharpness)
    lean = np.asarray(tilt or [0.1 * k for k in range(lobes)])
    axis = np.stack([-np.sin(lean), 0.0 * lean, np.cos(lean)], axis=-1)
    return LobeTable(
        name="test",
        kind="sg",
        cosine=np.array([0.5]),
        azimuth=np.zeros(1),
        axis=axis[None, None],
        sharpness=np.repeat(sharpness, 2).reshape(1, 1, lobes, 2),
        twist=np.zeros((1, 1, lobes)),
        amplitude=np.asarray(amplitude).reshape(1, 1, lobes),
        alpha=np.full((1, 1, 2), 1.0 / (1.0 + sharpness[0])),
        albedo=np.full((1, 1, 3), 0.5),
        cosine_l2=np.ones((1, 1)),
    )


def integrate(table: LobeTable) -> float:
    """Return the integral of the lobes over the sphere, by the midpoint rule in equal areas."""
    z, turn = (np.arange(4000) + 0.5) / 2000 - 1.0, (np.arange(64) + 0.5) * (2.0 * np.pi / 64)
    sine = np.sqrt(1.0 - z * z)[:, None]
    light = np.stack(np.broadcast_arrays(sine * np.cos(turn), sine * np.sin(turn), z[:, None]), axis=-1)
    view = np.array([np.sqrt(0.75), 0.0, 0.5])
    values = evaluate_lobes(evaluate_table(table, NORMAL, view), light.reshape(-1, 3), "sg")
    return float(values.mean() * 4.0 * np.pi)


def test_the_ends_are_the_tables() -> None:
    one, two = make_table([5.0, 80.0], [1.0, 3.0]), make_table([9.0, 200.0], [2.0, 0.5])
    for share, table in ((0.0, one), (1.0, two)):
        found = blend_tables(one, two, share)
        for name in ("axis", "sharpness", "amplitude", "alpha", "albedo"):
            assert np.allclose(getattr(found, name), getattr(table, name), rtol=1e-5), name


@pytest.mark.parametrize("share", [0.25, 0.6])
def test_the_integral_is_linear(share: float) -> None:
    one, two = make_table([0.8, 20.0], [1.0, 3.0], [0.0, 0.3]), make_table([2.0, 90.0], [2.0, 8.0], [0.1, 0.2])
    expected = (1.0 - share) * integrate(one) + share * integrate(two)
    assert np.isclose(integrate(blend_tables(one, two, share)), expected, rtol=1e-3)


def test_lobes_are_paired_by_width_and_axis() -> None:
    one = make_table([5.0, 80.0], [1.0, 3.0], [0.0, 0.0])
    two = make_table([160.0, 10.0], [6.0, 2.0], [0.0, 0.0])
    assert np.allclose(blend_tables(one, two, 0.5).sharpness[0, 0, :, 0], np.sqrt([50.0, 12800.0]), rtol=1e-5)
    one = make_table([20.0, 20.0], [1.0, 3.0], [0.2, -0.6])
    two = make_table([20.0, 20.0], [6.0, 2.0], [-0.7, 0.1])
    axis = blend_tables(one, two, 0.5).axis[0, 0]
    assert np.allclose(np.arctan2(-axis[:, 0], axis[:, 2]), [0.15, -0.65], atol=1e-4)


def test_an_empty_lobe_takes_the_shape_of_its_partner() -> None:
    one, two = make_table([5.0, 80.0], [1.0, 0.0]), make_table([5.0, 300.0], [1.0, 4.0])
    found = blend_tables(one, two, 0.5)
    assert np.isclose(found.sharpness[0, 0, 1, 0], 300.0)
    assert np.isclose(found.amplitude[0, 0, 1], 2.0)


def test_a_lobe_between_is_near_to_the_lobe_of_the_alpha_between() -> None:
    cosines = [0.3, 0.6, 1.0]

    def fit(alpha: float) -> LobeTable:
        return fit_lobes(lambda view, light: ggx_brdf(view, light, alpha, alpha), kind="sg", lobes=2, cosines=cosines)

    between, true = blend_tables(fit(0.15), fit(0.3), 0.5), fit(float(np.sqrt(0.15 * 0.3)))
    light = np.random.default_rng(1).normal(size=(50000, 3))
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    for cosine in cosines:
        view = np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
        got, want = (evaluate_lobes(evaluate_table(table, NORMAL, view), light, "sg") for table in (between, true))
        assert got @ want / np.linalg.norm(got) / np.linalg.norm(want) > 0.99


def test_tables_must_be_alike() -> None:
    one = make_table([5.0], [1.0])
    with refuses(InputError, "lobe tables", "(1, 1, 1, 3) and (1, 1, 2, 3)"):
        blend_tables(one, make_table([5.0, 6.0], [1.0, 1.0]), 0.5)
    with refuses(InputError, "lobe tables", "(1, 1, 1, 3) and (1, 1, 1, 3)"):
        blend_tables(one, replace(one, cosine=np.array([0.7])), 0.5)
    with refuses(InputError, "kind of lobes"):
        blend_tables(one, replace(one, kind="asg"), 0.5)
