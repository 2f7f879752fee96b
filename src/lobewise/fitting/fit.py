"""Fits lobes to measured reflection: for each view the sum of a few lobes that is nearest in least squares.

The filters compare two reflection lobes by their product integral. So a fit minimises squared differences, integrated
over the whole sphere, of luminance of BRDF times cosine. Below the horizon the target is 0; this half counts too,
because a lobe may reach there. Non-linear least squares search for the shapes. The amplitudes follow from each trial of
shapes by non-negative least squares (variable projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError, MissingDependencyError, require_choice, require_integer
from lobewise.fitting.arrays import Array, make_turn, make_view
from lobewise.fitting.fit_shapes import LobeFamily
from lobewise.fitting.ggx import ggx_brdf
from lobewise.fitting.nodes import Nodes, make_nodes
from lobewise.fitting.table import order_lobes
from lobewise.lobes.vectors import LUMINANCE
from lobewise.records.lobe_table import KINDS, LobeTable
from lobewise.settings import MAX_LOBES

Evaluate = Callable[[Array, Array], Any]
"""``evaluate(view, light)`` returns the BRDF in 1/sr, shape (n, 3) or (n,), for local unit vectors of shape (n, 3)."""
COSINES = tuple(float((math.sqrt(0.05) + (1.0 - math.sqrt(0.05)) * i / 19.0) ** 2) for i in range(20))
"""n.v of the 20 default views, 0.05 to 1: equally spaced in the square root, denser where lobes change faster."""
# Range of the logarithm of alpha. The nodes do not resolve sharper lobes.
_LOG_ALPHA_RANGE = (math.log(0.003), 0.0)
# Error, as a squared sine, by which a cold start must beat a start from the neighbour's lobes. This keeps lobes
# continuous over the views.
_MIN_GAIN_OF_COLD_START = 2e-4
# Step of the finite differences for the derivatives by the shapes.
_DERIVATIVE_STEP = 1e-6
# Norm over the nodes below which a lobe of amplitude 1 lies between the nodes.
_MIN_LOBE_NORM = 1e-6


def fit_lobes(
    evaluate: Evaluate,
    *,
    lobes: int = 3,
    kind: str = "asg",
    cosines: ArrayLike = COSINES,
    azimuths: ArrayLike | None = None,
    progress: Callable[[int, int], None] | None = None,
    name: str = "",
) -> LobeTable:
    """Return the lobes of a material, fitted view by view from normal incidence to grazing.

    Parameters
    ----------
    evaluate : callable
        See `Evaluate`; x of the local frame is the tangent, z the normal. A negative or non-finite value counts as not
        measured and has no weight in the fit. All lights are above the horizon.
    lobes : int
        Number of lobes per view, 1 to 4.
    kind : {"sg", "asg"}
        Spherical Gaussians or anisotropic ones.
    cosines : array_like, shape (V,)
        n.v of the views, ascending, in (0, 1].
    azimuths : array_like, shape (P,), optional
        Azimuths of the views for an anisotropic material, radians, ascending, in [0, 2 pi). By default the material
        is isotropic and its lobes lie in the plane of incidence.
    progress : callable, optional
        Called with the number of finished views and the number of all views.
    name : str
        Name of the material.

    Returns
    -------
    LobeTable
        Its `alpha` belongs to the GGX lobe that is nearest to the data of each view, in the same least squares. The
        fitted lobes complete the albedo in directions that were not measured. A view takes the lobes of its neighbour,
        turned, with `cosine_l2` 0, if it has no data, or if more than half of the squared energy of the neighbour's
        lobes falls on directions that were not measured.

    Raises
    ------
    InputError
        If an argument is out of range, ``evaluate`` returns a wrong shape, or the first view reflects nothing.
    MissingDependencyError
        If SciPy is not installed.
    """
    require_choice("kind", kind, KINDS)
    lobes = require_integer("lobes", lobes, 1, MAX_LOBES)
    grid = _check_grid("cosines", cosines, "numbers above 0 and at most 1", lambda c: (c > 0.0) & (c <= 1.0))
    turns = np.zeros(1)
    if azimuths is not None:
        turns = _check_grid("azimuths", azimuths, "angles from 0 to below 2 pi", lambda a: (a >= 0) & (a < 2 * math.pi))
    _require_scipy()
    family = LobeFamily(kind, flat=azimuths is None)
    fits = _fit_views(evaluate, family, lobes, grid, turns, progress)

    def collect(field: str) -> Array:
        return np.stack([[getattr(fits[v, p], field) for p in range(turns.size)] for v in range(grid.size)])

    axis, sharpness, twist = family.to_frames(collect("shapes"))
    table = LobeTable(
        name=name,
        kind=kind,
        cosine=np.asarray(grid, dtype=np.float32),
        azimuth=np.asarray(turns, dtype=np.float32),
        axis=axis,
        sharpness=sharpness,
        twist=twist,
        **{field: collect(field) for field in ("amplitude", "alpha", "albedo", "cosine_l2")},
    )
    return order_lobes(table)


def _fit_views(
    evaluate: Evaluate,
    family: LobeFamily,
    lobes: int,
    grid: Array,
    turns: Array,
    progress: Callable[[int, int], None] | None,
) -> dict[tuple[int, int], _Found]:
    """Return the lobes of every view, by its indices into the cosines and the azimuths."""
    views, columns = grid.size, turns.size
    fits: dict[tuple[int, int], _Found] = {}
    samples: dict[tuple[int, int], _Data] = {}

    def report(done: int) -> None:
        if progress is not None:
            progress(done, 2 * views * columns)

    # Fit down to grazing, then back up: better lobes found on the way down then reach the views above.
    for v in range(views - 1, -1, -1):
        nodes = make_nodes(float(grid[v]), angular=64 if family.flat else 96)
        for p, azimuth in enumerate(turns):
            samples[v, p] = _sample(evaluate, float(grid[v]), float(azimuth), nodes)
            neighbour = fits.get((v + 1, p))
            if neighbour is None and p > 0:
                # Seen from above, all azimuths show the same lobes, turned.
                last = fits[v, p - 1]
                neighbour = replace(last, shapes=family.turn(last.shapes, float(azimuth - turns[p - 1])))
            fits[v, p] = _fit_view(samples[v, p], family, lobes, neighbour)
            report((views - 1 - v) * columns + p + 1)
    for v in range(1, views):
        for p in range(columns):
            fits[v, p] = _refit_view(samples[v, p], family, fits[v, p], fits[v - 1, p])
            report((views + v) * columns + p + 1)
    return fits


@dataclass(frozen=True)
class _Data:
    """The reflection of one view, sampled at its nodes."""

    cosine: float
    """n.v of the view."""
    albedo: Array
    """Directional albedo over the measured directions, linear RGB."""
    missing: NDArray[np.bool_]
    """Whether a node lies above the horizon and was not measured."""
    nodes: Nodes
    root: Array
    """Square root of the solid angle of each node; 0 if it was not measured."""
    target: Array
    """Luminance of BRDF times cosine, times ``root``, at each node."""


@dataclass(frozen=True)
class _Found:
    """The lobes of one view at n.v = ``cosine``."""

    cosine: float
    shapes: Array
    amplitude: Array
    alpha: Array
    albedo: Array
    cosine_l2: float


def measure_reflection(evaluate: Evaluate, view: Array, light: Array) -> Array:
    """Return the BRDF, 1/sr, seen from one direction (3,), for lights (n, 3); shape (n, 3), NaN if not measured."""
    values: Array = np.asarray(evaluate(np.tile(view, (len(light), 1)), light), dtype=np.float64)
    if values.shape not in (light.shape, light.shape[:1]):
        expected = f"an array of shape {light.shape} or {light.shape[:1]}"
        got = f"shape {values.shape}"
        raise InputError("evaluate", expected=expected, got=got, action="return three numbers or one per direction")
    values = np.broadcast_to(values.reshape(len(light), -1), light.shape)
    good = (np.isfinite(values) & (values >= 0.0)).all(axis=1, keepdims=True)
    return np.where(good, values, np.nan)


def _sample(evaluate: Evaluate, cosine: float, azimuth: float, nodes: Nodes) -> _Data:
    """Evaluate the material at the nodes above the horizon."""
    above = nodes.light[:, 2] > 0.0
    light = nodes.light[above] @ make_turn(azimuth)
    values = measure_reflection(evaluate, make_view(cosine, azimuth), light)
    reflected = np.zeros_like(nodes.light)
    reflected[above] = np.nan_to_num(values) * light[:, 2:]
    missing = np.zeros(above.shape, dtype=bool)
    missing[above] = np.isnan(values[:, 0])
    root = np.where(missing, 0.0, np.sqrt(nodes.weight))
    return _Data(cosine, nodes.weight @ reflected, missing, nodes, root, root * (reflected @ LUMINANCE))


def _fit_view(data: _Data, family: LobeFamily, lobes: int, neighbour: _Found | None) -> _Found:
    """Return the lobes of one view. The search from the neighbour's lobes wins unless a cold start is much better."""
    if neighbour is None:
        if not data.target.any():
            expected = "values above 0"
            action = "leave out the cosines without data"
            raise InputError(f"reflection at n.v = {data.cosine:g}", expected=expected, got="none", action=action)
        start = None
    else:
        start = family.move(neighbour.shapes, neighbour.cosine, data.cosine)
        if not (data.target.any() and _is_seen(data, family, start, neighbour.amplitude)):
            return replace(neighbour, cosine=data.cosine, shapes=start, cosine_l2=0.0)
    alpha = _fit_ggx(data, None if neighbour is None else neighbour.alpha)
    ellipse = np.eye(2) if family.flat else _measure_half_vectors(data)
    best = _search_lobes(data, family, family.make_start(data.cosine, alpha, ellipse, lobes))
    if start is not None:
        warm = _search_lobes(data, family, start)
        best = warm if warm.error <= best.error + _MIN_GAIN_OF_COLD_START else _match(data, family, best, start)
    return _finish(data, family, best, alpha)


def _refit_view(data: _Data, family: LobeFamily, first: _Found, neighbour: _Found) -> _Found:
    """Return the lobes of one view, searched again from the lobes of the view below it."""
    if not (data.target.any() and neighbour.cosine_l2 > 0.0):
        return first
    start = family.move(neighbour.shapes, neighbour.cosine, data.cosine)
    warm = _search_lobes(data, family, start)
    if warm.error <= 1.0 - first.cosine_l2**2 + _MIN_GAIN_OF_COLD_START:
        return _finish(data, family, warm, first.alpha)
    return first


def _is_seen(data: _Data, family: LobeFamily, rows: Array, amplitude: Array) -> bool:
    """Return whether most of the squared energy of these lobes goes into measured directions."""
    above = data.nodes.light[:, 2] > 0.0
    light, weight = data.nodes.light[above], data.nodes.weight[above]
    energy = weight * sum(a * family.evaluate(row, light) for a, row in zip(amplitude, rows, strict=True)) ** 2
    return bool(np.sum(energy[~data.missing[above]]) > 0.5 * np.sum(energy))


def _search_lobes(data: _Data, family: LobeFamily, start: Array) -> _Trial:
    return _search(data, lambda row: family.evaluate(row, data.nodes.light), start, family.low, family.high)


def _match(data: _Data, family: LobeFamily, trial: _Trial, neighbour: Array) -> _Trial:
    """Return ``trial`` with its lobes ordered, and their x and y named, like the neighbour's lobes."""
    ours, theirs = (
        np.stack([data.root * family.evaluate(row, data.nodes.light) for row in rows])
        for rows in (trial.shapes, neighbour)
    )
    sizes = np.linalg.norm(theirs, axis=1)[:, None] * np.linalg.norm(ours, axis=1)
    overlap = (theirs @ ours.T) / np.maximum(sizes, _MIN_LOBE_NORM**2)
    order = max(permutations(range(len(ours))), key=lambda p: float(overlap[range(len(ours)), p].sum()))
    return _Trial(family.align(trial.shapes[list(order)], neighbour), trial.amplitude[list(order)], trial.error)


def _finish(data: _Data, family: LobeFamily, trial: _Trial, alpha: Array) -> _Found:
    """Return the result of a view, with the albedo of unmeasured directions estimated from the lobes."""
    light = data.nodes.light[data.missing]
    model = sum(a * family.evaluate(row, light) for a, row in zip(trial.amplitude, trial.shapes, strict=True))
    unseen = float(np.sum(data.nodes.weight[data.missing] * model))
    albedo = data.albedo * (1.0 + unseen / float(data.albedo @ LUMINANCE))
    return _Found(data.cosine, trial.shapes, trial.amplitude, alpha, albedo, math.sqrt(max(0.0, 1.0 - trial.error)))


def _fit_ggx(data: _Data, neighbour: Array | None) -> Array:
    """Return the alphas (along x, along y) of the GGX lobe that is nearest to the data."""
    view = make_view(data.cosine)

    def evaluate(row: Array) -> Array:
        alpha = np.exp(row)
        return ggx_brdf(view, data.nodes.light, alpha[0], alpha[1]) * np.maximum(data.nodes.light[:, 2], 0.0)

    if neighbour is None:
        trials = np.log([0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.4, 0.6, 0.9])
        columns = [data.root * evaluate(np.full(2, trial)) for trial in trials]
        nearness = [float(column @ data.target / np.linalg.norm(column)) for column in columns]
        start = np.full((1, 2), trials[int(np.argmax(nearness))])
    else:
        start = np.log(neighbour)[None]
    low, high = np.full(2, _LOG_ALPHA_RANGE[0]), np.full(2, _LOG_ALPHA_RANGE[1])
    return np.asarray(np.exp(_search(data, evaluate, start, low, high).shapes[0]))


def _measure_half_vectors(data: _Data) -> Array:
    """Return the covariance (2, 2) of the half vectors' x and y, weighted by the square of the target.

    The square suppresses the tails. A small multiple of the identity keeps the covariance invertible.
    """
    half = data.nodes.light + make_view(data.cosine)
    half = half[:, :2] / np.linalg.norm(half, axis=1, keepdims=True)
    # Solid angles of half vectors are 4 v.h times smaller than those of lights; v.h varies slowly and is left out.
    share = data.target**2 / np.sum(data.target**2)
    half = half - share @ half
    return np.asarray((half * share[:, None]).T @ half + 1e-9 * np.eye(2))


@dataclass(frozen=True)
class _Trial:
    """Shapes, their best amplitudes, and the squared sine of the angle between their sum and the data."""

    shapes: Array
    amplitude: Array
    error: float


def _search(data: _Data, evaluate: Callable[[Array], Array], start: Array, low: Array, high: Array) -> _Trial:
    """Return the shapes near ``start`` whose non-negative combination is nearest to the target.

    The derivative of the residual is that of the lobes at fixed amplitudes, without the part that a change of the
    amplitudes can make up for (Kaufman 1975).
    """
    from scipy.optimize import least_squares, nnls

    norm = float(np.linalg.norm(data.target))
    target, root = data.target / norm, data.root
    last: list[tuple[bytes, Array, Array]] = []

    def combine(rows: Array) -> tuple[Array, Array, float]:
        """Return (lobes at the nodes, best amplitudes, distance from the target)."""
        columns = np.stack([root * evaluate(row) for row in rows])
        size = np.linalg.norm(columns, axis=1)
        # Give a lobe that lies between the nodes no amplitude.
        scale = np.where(size > _MIN_LOBE_NORM, 1.0 / np.maximum(size, _MIN_LOBE_NORM), 0.0)
        amplitude, distance = nnls((columns * scale[:, None]).T, target)
        return columns, amplitude * scale, float(distance)

    def project(numbers: Array) -> tuple[Array, Array]:
        """Return (derivative, residual), rotated into the space that they span: a few rows instead of thousands."""
        key = numbers.tobytes()
        if not last or last[0][0] != key:
            rows = numbers.reshape(start.shape)
            columns, amplitude, _ = combine(rows)
            system = np.zeros((numbers.size + 1, target.size))
            for k, row in enumerate(rows):
                for j in range(row.size if amplitude[k] > 0.0 else 0):
                    moved = row.copy()
                    moved[j] += _DERIVATIVE_STEP
                    system[k * row.size + j] = (root * evaluate(moved) - columns[k]) * (amplitude[k] / _DERIVATIVE_STEP)
            system[-1] = amplitude @ columns - target
            basis = columns[amplitude > 0.0]
            system[:-1] -= system[:-1] @ basis.T @ np.linalg.pinv(basis @ basis.T, hermitian=True) @ basis
            values, vectors = np.linalg.eigh(system @ system.T)
            short = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
            last[:] = [(key, short[:, :-1], short[:, -1])]
        return last[0][1:]

    bounds = np.tile(low, len(start)), np.tile(high, len(start))
    done = least_squares(
        lambda numbers: project(numbers)[1],
        np.clip(start.ravel(), *bounds),
        lambda numbers: project(numbers)[0],
        bounds,
        x_scale="jac",
        ftol=1e-4,
        xtol=1e-4,
        max_nfev=60,
    )
    shapes = done.x.reshape(start.shape)
    _, amplitude, distance = combine(shapes)
    return _Trial(shapes, norm * amplitude, distance**2)


def _check_grid(
    name: str, value: ArrayLike, words: str, test: Callable[[Array], NDArray[np.bool_]]
) -> NDArray[np.float64]:
    try:
        grid = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        grid = np.empty(0)
    if grid.ndim != 1 or grid.size == 0 or not np.all(test(grid)) or not np.all(np.diff(grid) > 0.0):
        raise InputError(name, expected=f"ascending {words}", got=repr(value), action="correct the list")
    return grid


def _require_scipy() -> None:
    try:
        import scipy.optimize  # noqa: F401 - only to check that it is installed
    except ImportError as problem:
        expected = "the package scipy"
        action = "install it with `pip install 'lobewise[fit]'`"
        raise MissingDependencyError("fitting lobes", expected=expected, got=str(problem), action=action) from problem
