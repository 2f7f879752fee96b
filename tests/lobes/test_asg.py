"""The similarity of anisotropic spherical Gaussians against quadrature, planar Gaussians, limits and laws."""

from functools import cache

import numpy as np
import pytest

from .oracles import asg, tangent
from .quadrature import draw_pairs, lobe_stretch, measure_similarity, normalize, rms, sphere_grid, stack_lobes, unpack
from .tolerances import ROUNDING

Z = np.array([0.0, 0.0, 1.0])
PAIRS = 80


def make_tangent(axis, helper):
    """Return a unit vector across ``axis``, by ``helper`` where the two are not parallel."""
    across = np.cross(axis, helper)
    fallback = np.cross(axis, np.roll(axis, 1) * np.array([1.0, -1.0, 1.0]) + np.array([0.1, 0.7, -0.3]))
    return normalize(np.where(np.linalg.norm(across, axis=-1, keepdims=True) > 1e-2, across, fallback))


def draw_planar_pairs(count, low, high, *, apart=1.3, ratio=4.0, size=3.0, anywhere=False, seed=0):
    """Return two stacks of ``count`` planar Gaussians, as `TangentLobe`: random pairs of anisotropic lobes.

    The smaller ASG sharpness of the first is log-uniform in [``low``, ``high``]; the larger up to ``ratio`` times it,
    the other lobe up to ``size`` times sharper, with any twist. The axes are up to ``apart`` widths of the first apart,
    or any angle with ``anywhere``.
    """
    rng = np.random.default_rng(seed)
    small = np.exp(rng.uniform(np.log(low), np.log(high), count))
    other = small * size ** rng.random(count)
    large, other_large = small * ratio ** rng.random(count), other * ratio ** rng.random(count)
    axis_i = normalize(rng.normal(size=(count, 3)))
    x = make_tangent(axis_i, rng.normal(size=(count, 3)))
    y = np.cross(axis_i, x)
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.0, apart, count)
    step = (radius * np.cos(angle) / np.sqrt(large))[:, None] * x + (radius * np.sin(angle) / np.sqrt(small))[
        :, None
    ] * y
    length = np.linalg.norm(step, axis=-1, keepdims=True)
    far = rng.uniform(0.0, np.pi, (count, 1)) if anywhere else length
    axis_j = np.cos(far) * axis_i + np.sin(far) * step / length
    x_j = make_tangent(axis_j, rng.normal(size=(count, 3)))
    stacks = []
    for axis, across, sharpness_x, sharpness_y in ((axis_i, x, large, small), (axis_j, x_j, other_large, other)):
        along = np.cross(axis, across)
        full = (0.5 / sharpness_x)[:, None, None] * across[:, :, None] * across[:, None, :]
        full = full + (0.5 / sharpness_y)[:, None, None] * along[:, :, None] * along[:, None, :]
        six = full.reshape(count, 9)[:, [0, 1, 2, 4, 5, 8]]
        stacks.append(tangent.TangentLobe(axis, six, 0.25 / (sharpness_x * sharpness_y)))
    return stacks


def to_asg(planar):
    return asg.asg_from_covariance(*planar)


def evaluate_by_definition(direction, planar):
    """``max(w.z, 0) exp(-w^T A w)`` with A by the pseudo-inverse of the covariance."""
    precision = 0.5 * np.linalg.pinv(unpack(planar.covariance), hermitian=True, rcond=1e-9)
    exponent = np.einsum("...k,kl,...l->...", direction, precision, direction)
    return np.maximum(direction @ planar.axis, 0.0) * np.exp(-exponent)


def measure_integral(a, b, radial=60, angular=64):
    """Return the integral of the product of two planar Gaussians' ASGs by quadrature."""
    axis, stretch = lobe_stretch([a, b])
    grid, weights = sphere_grid(axis, 2.0, radial, angular, stretch / (1.0 + np.linalg.norm(stretch)))
    return np.sum(evaluate_by_definition(grid, a) * evaluate_by_definition(grid, b) * weights)


@cache
def measured_pairs(low, high, kind):
    """Return (lobes i, lobes j, true similarities) of one population."""
    options = {"near": {}, "wide": {"apart": 2.5, "ratio": 10.0, "size": 6.0}, "anywhere": {"anywhere": True}}
    stack_i, stack_j = draw_planar_pairs(PAIRS, low, high, seed=7, **options[kind])
    similarity = []
    for k in range(PAIRS):
        i, j = (tangent.TangentLobe(*(part[k] for part in stack)) for stack in (stack_i, stack_j))
        similarity.append(measure_integral(i, j) / np.sqrt(measure_integral(i, i) * measure_integral(j, j)))
    return to_asg(stack_i), to_asg(stack_j), np.array(similarity)


def test_covariance_of_a_planar_gaussian_gives_its_shape(rng):
    planar, _ = draw_planar_pairs(20, 0.5, 1e3, seed=3)
    lobe = to_asg(planar)
    for k in range(20):
        inverse = np.linalg.pinv(unpack(planar.covariance[k]), hermitian=True, rcond=1e-9)
        np.testing.assert_allclose(unpack(lobe.precision[k]), 0.5 * inverse, atol=1e-10 * np.abs(inverse).max())
    np.testing.assert_allclose(lobe.determinant, 0.25 / planar.determinant, rtol=ROUNDING)


def test_sharp_lobes_are_planar_gaussians():
    stack_i, stack_j = draw_planar_pairs(200, 1e5, 1e6, seed=4, apart=2.0)
    middle = normalize(stack_i.axis + stack_j.axis)
    x = make_tangent(middle, np.roll(middle, 1, axis=-1))
    basis = np.stack([x, np.cross(middle, x)], axis=1)
    plane = basis @ unpack(stack_i.covariance + stack_j.covariance) @ np.swapaxes(basis, 1, 2)
    apart = basis @ (stack_j.axis - stack_i.axis)[..., None]
    square = np.sum(apart * np.linalg.solve(plane, apart), axis=(1, 2))
    roots = (stack_i.determinant * stack_j.determinant) ** 0.25
    planar = 2.0 * roots / np.sqrt(np.linalg.det(plane)) * np.exp(-0.5 * square)
    np.testing.assert_allclose(asg.asg_approx_similarity(to_asg(stack_i), to_asg(stack_j)), planar, atol=2e-5)


# smallest sharpness from, to; RMSE of S that the theory page states: near, wide, anywhere
ACCURACY = [
    (1.0, 2.0, (0.0095, 0.016, 0.013)),
    (2.0, 5.0, (0.0036, 0.0075, 0.009)),
    (5.0, 10.0, (0.0016, 0.003, 0.004)),
    (10.0, 100.0, (0.0006, 0.001, 0.002)),
]


@pytest.mark.nightly
@pytest.mark.parametrize("row", ACCURACY, ids=lambda row: f"{row[0]:g}-{row[1]:g}")
@pytest.mark.parametrize("kind", ["near", "wide", "anywhere"])
def test_similarity_against_quadrature(row, kind):
    low, high, bounds = row
    i, j, truth = measured_pairs(low, high, kind)
    value = asg.asg_approx_similarity(i, j)
    assert ((value >= 0.0) & (value <= 1.0)).all()
    assert rms(value - truth) < bounds[["near", "wide", "anywhere"].index(kind)]
    np.testing.assert_allclose(asg.asg_approx_similarity(j, i), value, rtol=1e-9)
    np.testing.assert_allclose(asg.asg_approx_similarity(i, i), 1.0, atol=1e-9)


def test_quadrature_of_pairs_has_converged():
    stack_i, stack_j = draw_planar_pairs(PAIRS, 1.0, 2.0, seed=7)
    *_, truth = measured_pairs(1.0, 2.0, "near")
    for k in range(3):
        i, j = (tangent.TangentLobe(*(part[k] for part in stack)) for stack in (stack_i, stack_j))
        parts = [measure_integral(a, b, 160, 192) for a, b in ((i, j), (i, i), (j, j))]
        assert truth[k] == pytest.approx(parts[0] / np.sqrt(parts[1] * parts[2]), abs=1e-3)


def test_lobes_that_face_away_from_each_other_are_unlike():
    # their exponents are the same function: only the cosines tell them apart
    for sharpness in (3.0, 50.0, 1e4):
        precision = sharpness * np.array([1.0, 0.0, 0.0, 3.0, 0.0, 0.0])
        i, j = (asg.AsgLobe(axis, precision, np.array(3.0 * sharpness**2)) for axis in (Z, -Z))
        assert asg.asg_approx_similarity(i, j) < 0.01


@pytest.mark.parametrize(("anisotropy", "bound"), [("none", 0.021), ("one", 0.03)])
def test_lobes_of_surfaces_against_the_whole_brdf(anisotropy, bound):
    pairs = draw_pairs(PAIRS, anisotropy=anisotropy, seed=2)
    truth = np.array([measure_similarity(*pair, 60, 64) for pair in pairs])
    lobes = [to_asg(stack_lobes(side, gaussian=True)) for side in zip(*pairs, strict=True)]
    assert rms(asg.asg_approx_similarity(*lobes) - truth) < bound
