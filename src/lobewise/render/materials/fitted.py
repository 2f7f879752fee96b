"""Lobes for BSDFs without a formula, fitted to their values.

Fits are cached, so that the next frame of a scene need not fit again. Many BSDF objects do not describe themselves, so
the key of the cache is a digest of some hundred values. A fit holds arrays, never the BSDF object: Dr.Jit compiles
every BSDF that is alive into every kernel.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.fitting.arrays import Array, make_view
from lobewise.fitting.fit import Evaluate, fit_lobes, measure_reflection
from lobewise.fitting.nodes import Nodes, make_upper_nodes
from lobewise.fitting.table import get_albedo, get_equivalent_alphas, order_lobes
from lobewise.lobes.vectors import LUMINANCE
from lobewise.records.frame import FloatArray, LobeKind
from lobewise.records.lobe_table import LobeTable
from lobewise.render.materials.probe import (
    Parts,
    Samples,
    are_same,
    digest_bsdf,
    evaluate_bsdf,
    is_positional,
    list_parts,
    make_evaluate,
    repeat_place,
    sample_bsdf,
)
from lobewise.render.materials.texture_nodes import TextureNodes, make_tables, probe_texture
from lobewise.render.materials.tints import compute_tints

LOBES = 3
"""Lobes per view. A mixture has room for these and a diffuse lobe."""

MAX_BRUSHED_NODES = 4
"""Largest number of nodes of a texture whose lobes are anisotropic. The fit of one takes three times as long."""

AZIMUTHS = 8
"""Number of azimuths of an anisotropic material's views, a multiple of 4."""

MIN_COSINE = 0.05
"""Smallest n.v of the views. Views have equal steps of the square root of n.v."""

# Number of n.v of the views, and of samples per view, for isotropic (True) and anisotropic materials.
_VIEW_COUNTS = {True: 12, False: 6}
_SAMPLE_COUNTS = {True: 4096, False: 1024}
OPACITY = 8
"""Column of `Fit.rows` that holds the opacity."""
ALPHA, SPECULAR, SPREAD, TINT = slice(0, 2), slice(2, 5), slice(5, 8), slice(9, 11)
"""The other columns of `Fit.rows`."""
_COLUMNS = 11
# Azimuths at which values are compared, radians: in no simple ratio to a full turn.
_TURNS = (0.7, 1.9, 3.3)
# Ratio of the axes of a lobe seen from above. Below it the lobe counts as round.
_MIN_ELONGATION = 1.1
# Share of the strongest colour below which a place has too little of a colour to compare it.
_MIN_COLOR = 0.01
# Number of fits in the cache.
_MAX_FITS = 64


@dataclass(frozen=True)
class Fit:
    """The lobes that were fitted to a BSDF."""

    parts: Parts
    kind: LobeKind
    """GGX for a smooth specular lobe, DELTA for only mirrors and clear sheets, or NONE."""
    tables: tuple[LobeTable, ...]
    """Lobes of the smooth specular part, if there is one: those of the nodes, then those between them, as far as there
    are places on the texture."""
    turn: float
    """Angle from the BSDF's tangent to the table's tangent, radians. The tangent of an anisotropic table lies along the
    longer axis of the lobe seen from above."""
    rows: FloatArray
    """Values (V, P, 11) for n.v in equal steps of its square root and azimuths of the viewer in equal steps: alpha
    along and across the tangent (isotropic materials: in and across the plane of incidence), specular albedo, diffuse
    albedo over the diffuse value for light along the normal, opacity, weights of `lobewise.render.materials.tints`."""
    places: TextureNodes | None = None
    """The nodes of the texture, if the lobes change their shape over it. ``turn`` and ``rows`` are then those of the
    first node, and rows hold specular albedos over `TextureNodes.level`."""
    nodes: tuple[Fit, ...] = ()
    """The lobes of each node. Their rows have the same shape."""
    numbers: NDArray[np.uint32] | None = None
    """For each edge and step along it the index of the nearest table; see `make_tables`."""

    @property
    def is_isotropic(self) -> bool:
        """Whether the rows do not depend on the azimuth."""
        return int(self.rows.shape[1]) == 1

    @property
    def can_be_transparent(self) -> bool:
        """Whether a ray may pass through unchanged."""
        return any(bool(fit.rows[..., OPACITY].min() < 1.0) for fit in self.nodes or (self,))


_fits: OrderedDict[str, Fit] = OrderedDict()


def fit_bsdf(bsdf: Any, extent: float = 1.0) -> Fit:
    """Return the lobes fitted to a BSDF. BSDFs with equal values are fitted once.

    The BSDF is evaluated at uv = (0.5, 0.5), and at the nodes of `probe_texture` if textures change the shape of lobes.
    ``extent`` is the largest coordinate of hits, for BSDFs that depend on the position. UnsupportedBsdfError if the
    BSDF cannot be evaluated or sampled; MissingDependencyError without SciPy.
    """
    key = digest_bsdf(bsdf)
    # Objects that move change the extent: round it, so that the fit is kept.
    extent = 2.0 ** math.ceil(math.log2(extent))
    if is_positional(bsdf, extent):
        key = f"{key} {extent}"
    if key not in _fits:
        _fits[key] = _make_fit(bsdf, extent)
        if len(_fits) > _MAX_FITS:
            _fits.popitem(last=False)
    _fits.move_to_end(key)
    fit, name = _fits[key], str(bsdf.id())
    count = len(fit.tables)
    names = [name if fit.places is None else f"{name} {k} of {count}".strip() for k in range(1, count + 1)]
    return replace(fit, tables=tuple(replace(one, name=name) for one, name in zip(fit.tables, names, strict=True)))


def make_specular_evaluate(
    bsdf: Any, parts: Parts, *, turn: float = 0.0, place: Array | None = None
) -> Evaluate | None:
    """Return the smooth specular part as a function to fit, or None if there is none.

    It is the glossy reflection. For a BSDF that only transmits it is the transmission, mirrored at the surface.
    It is that of one ``place`` (2 or 5,).
    """
    if parts.glossy:
        for through in (False, True):
            evaluate = make_evaluate(bsdf, parts.glossy_lobes, through=through, turn=turn, place=place)
            if any(_integrate(evaluate, cosine) > 0.0 for cosine in (1.0, 0.5, 0.2)):
                return evaluate
    return None


def is_isotropic(evaluate: Evaluate) -> bool:
    """Return whether a reflection stays the same, within 2 % in the mean square, when the surface is turned."""
    return all(_is_same_turned(evaluate, 0.0, turn) for turn in _TURNS)


def make_views(isotropic: bool) -> Array:
    """Return the ascending n.v of the views: equal steps of the square root, denser where lobes change faster."""
    return np.asarray(np.linspace(math.sqrt(MIN_COSINE), 1.0, _VIEW_COUNTS[isotropic]) ** 2)


def make_azimuths() -> Array:
    """Return the azimuths of the views of an anisotropic material, radians."""
    return np.arange(AZIMUTHS) * (2.0 * math.pi / AZIMUTHS)


def list_fitted_views(evaluate: Evaluate, cosines: Array) -> Array:
    """Return the n.v up to the highest view that sees a reflection: from above, velvet may be black."""
    seen = [_integrate(evaluate, float(cosine)) > 0.0 for cosine in cosines]
    return np.asarray(cosines[: len(seen) - seen[::-1].index(True)])


def _make_fit(bsdf: Any, extent: float = 1.0) -> Fit:
    parts = list_parts(bsdf, extent)
    places = probe_texture(bsdf, parts, extent) if parts.textured and parts.glossy else None
    if places is None:
        return _fit_place(bsdf, parts)
    # Lobes can be interpolated if all places have the same views.
    shapes = (make_specular_evaluate(bsdf, parts, place=place) for place in places.place)
    isotropic = all(evaluate is None or is_isotropic(evaluate) for evaluate in shapes)
    if not isotropic and len(places.place) > MAX_BRUSHED_NODES:
        places = probe_texture(bsdf, parts, extent, most=MAX_BRUSHED_NODES)
        assert places is not None
    fits = tuple(
        _fit_place(bsdf, parts, place, isotropic=isotropic, level=level)
        for place, level in zip(places.place, places.level, strict=True)
    )
    if not all(fit.tables for fit in fits):
        return fits[0]
    tables, numbers = make_tables(places, [fit.tables[0] for fit in fits])
    return replace(fits[0], places=places, nodes=fits, tables=tables, numbers=numbers)


def _fit_place(
    bsdf: Any, parts: Parts, place: Array | None = None, *, isotropic: bool | None = None, level: Array | None = None
) -> Fit:
    """Return the lobes at one place of the texture, by default its centre.

    ``isotropic`` tells whether the views have azimuths; by default the lobes decide. ``level`` (3,) is the one by which
    specular albedos are divided.
    """
    evaluate = make_specular_evaluate(bsdf, parts, place=place)
    if isotropic is None:
        isotropic = evaluate is None or is_isotropic(evaluate)
    turn = 0.0 if evaluate is None or isotropic else _compute_long_axis(evaluate)
    cosines, azimuths = make_views(isotropic), np.zeros(1) if isotropic else make_azimuths()
    rows = np.zeros((cosines.size, azimuths.size, _COLUMNS))
    table = None
    if evaluate is not None:
        evaluate = make_specular_evaluate(bsdf, parts, turn=turn, place=place)
        assert evaluate is not None
        table = _fit_table(evaluate, cosines, None if isotropic else azimuths)
        rows[..., ALPHA] = _compute_alphas(table, cosines, azimuths)
        rows[..., SPECULAR] = get_albedo(table, cosines[:, None], azimuths)
    views = make_view(cosines[:, None], azimuths + turn).reshape(-1, 3)
    _complete_albedos(rows, bsdf, parts, views, _SAMPLE_COUNTS[isotropic], place)
    if level is not None:
        # A colour that is missing at this place has the ratio of the luminance.
        ratio = (rows[..., SPECULAR] @ LUMINANCE)[..., None] / float(level @ LUMINANCE)
        is_lit = level > _MIN_COLOR * level.max()
        rows[..., SPECULAR] = np.where(is_lit, rows[..., SPECULAR] / np.where(is_lit, level, 1.0), ratio)
    elif parts.textured and parts.glossy:
        tints = compute_tints(bsdf, parts, views) / np.maximum(rows[..., OPACITY].reshape(-1, 1), 1e-6)
        rows[..., TINT] = tints.reshape(*rows.shape[:2], -1)
    kind = LobeKind.GGX if table is not None else LobeKind.DELTA if parts.delta else LobeKind.NONE
    return Fit(parts, kind, () if table is None else (table,), turn, rows.astype(np.float32))


def _fit_table(evaluate: Evaluate, cosines: Array, azimuths: Array | None) -> LobeTable:
    """Return the table of round lobes, which the filters compare.

    Most anisotropic reflections look the same after half a turn. Then only half of the azimuths are fitted.
    """
    cosines = list_fitted_views(evaluate, cosines)
    if azimuths is None:
        return fit_lobes(evaluate, lobes=LOBES, kind="sg", cosines=cosines)
    repeats = 2 if all(_is_same_turned(evaluate, turn, turn + math.pi) for turn in _TURNS) else 1
    part = fit_lobes(evaluate, lobes=LOBES, kind="sg", cosines=cosines, azimuths=azimuths[: AZIMUTHS // repeats])
    names = ("axis", "sharpness", "twist", "amplitude", "alpha", "albedo", "cosine_l2")
    whole: dict[str, Any] = {name: np.concatenate([getattr(part, name)] * repeats, axis=1) for name in names}
    return order_lobes(replace(part, azimuth=azimuths.astype(np.float32), **whole))


def _compute_alphas(table: LobeTable, cosines: Array, azimuths: Array) -> Array:
    """Return alphas (V, P, 2) along and across the tangent, or in and across the plane of incidence if isotropic."""
    alpha = get_equivalent_alphas(table, cosines[:, None], azimuths)
    if table.is_isotropic:
        return alpha
    # The table's alphas are along and across the plane of incidence. If the plane lies along or across the tangent,
    # they are the alphas of the tangent as well, or swapped. Views in between take the means of these.
    quarter = AZIMUTHS // 4
    aligned = np.log(alpha[:, ::quarter])
    aligned[:, 1::2] = aligned[:, 1::2, ::-1]
    share = (np.arange(quarter) / quarter)[:, None]
    following = np.roll(aligned, -1, axis=1)
    between = aligned[:, :, None] * (1.0 - share) + following[:, :, None] * share
    return np.asarray(np.exp(between.reshape(alpha.shape)))


def _complete_albedos(
    rows: Array, bsdf: Any, parts: Parts, views: Array, count: int, place: Array | None = None
) -> None:
    """Add to the rows the albedos of transmission and of mirrors, the opacity and the diffuse spread."""
    flat = rows.reshape(-1, _COLUMNS)
    samples = sample_bsdf(bsdf, views, count, place=repeat_place(place, len(views)))
    opacity = 1.0 - samples.null.mean(axis=1)
    beyond = samples.delta | (samples.light[..., 2] < 0.0)
    specular = np.where((beyond & ~samples.null)[..., None], samples.weight, 0.0)
    specular *= 1.0 - _compute_diffuse_shares(bsdf, parts, views, samples, place)
    flat[:, SPECULAR] += specular.mean(axis=1)
    # Samples that pass through add to no albedo: divide by the share of the others.
    flat[:, SPECULAR] /= np.maximum(opacity, 1e-6)[:, None]
    flat[:, SPECULAR] = np.clip(flat[:, SPECULAR], 0.0, 1.0)
    flat[:, OPACITY] = opacity
    if parts.diffuse:
        flat[:, SPREAD] = compute_spreads(bsdf, parts.diffuse_lobes, views, place)


def _compute_diffuse_shares(bsdf: Any, parts: Parts, views: Array, samples: Samples, place: Array | None) -> Array:
    """Return the diffuse share of each sample, shape (V, N, 3); 0 for mirrors."""
    smooth = ~samples.delta[..., None]
    if not (parts.diffuse and parts.glossy):
        return np.where(smooth, float(parts.diffuse), 0.0)
    view, light = np.repeat(views, samples.light.shape[1], axis=0), samples.light.reshape(-1, 3)
    places = repeat_place(place, len(view))
    whole = evaluate_bsdf(bsdf, view, light, place=places)
    part = evaluate_bsdf(bsdf, view, light, parts.diffuse_lobes, place=places)
    share = np.divide(part, whole, out=np.zeros_like(whole), where=whole > 0.0).reshape(samples.weight.shape)
    return np.asarray(np.where(smooth, np.clip(share, 0.0, 1.0), 0.0))


def compute_spreads(
    bsdf: Any, lobes: Any, views: Array, place: Array | None = None, steps: tuple[int, int] = (64, 32)
) -> Array:
    """Return the diffuse albedo of each view over the value for light along the normal, shape (V, 3).

    The value is multiplied again at each hit, so that textures are seen. If it is 0 at the place, the ratio
    is that of Lambert's law. Both hemispheres are integrated by the midpoint rule, in so many steps of equal projected
    area and of equal azimuth.
    """
    square, turn = ((np.arange(count) + 0.5) / count for count in steps)
    above = make_view(np.sqrt(1.0 - square)[:, None], 2.0 * math.pi * turn).reshape(-1, 3)
    light = np.concatenate([above, above * [1.0, 1.0, -1.0], [[0.0, 0.0, 1.0]]])
    places = repeat_place(place, len(views) * len(light))
    values = evaluate_bsdf(bsdf, np.repeat(views, len(light), axis=0), np.tile(light, (len(views), 1)),
                           lobes, place=places).reshape(len(views), len(light), 3)  # fmt: skip
    values = np.where(np.isfinite(values), values, 0.0)
    albedo, upward = math.pi / len(above) * values[:, :-1].sum(axis=1), values[:, -1]
    return np.asarray(np.divide(albedo, upward, out=np.full_like(albedo, math.pi), where=upward > 0.0))


def _compute_long_axis(evaluate: Evaluate) -> float:
    """Return the azimuth of the longer axis of the lobe seen from above, in [0, pi); 0 for a round lobe."""
    target, nodes = _sample(evaluate, 1.0, angular=64)
    half = nodes.light[:, :2] / np.sqrt(2.0 + 2.0 * nodes.light[:, 2:])
    # The square suppresses the tails. Near the normal, solid angles of lights and of half vectors are proportional.
    share = nodes.weight * target**2
    covariance = (half * share[:, None]).T @ half / max(float(share.sum()), 1e-300)
    values, vectors = np.linalg.eigh(covariance)
    if not values[1] > _MIN_ELONGATION**2 * values[0]:
        return 0.0
    return math.atan2(vectors[1, 1], vectors[0, 1]) % math.pi


def _sample(evaluate: Evaluate, cosine: float, azimuth: float = 0.0, angular: int = 32) -> tuple[Array, Nodes]:
    """Return luminances of BRDF times cosine at nodes above the horizon; 0 for what was not measured."""
    nodes = make_upper_nodes(cosine, azimuth, angular)
    values = measure_reflection(evaluate, make_view(cosine, azimuth), nodes.light) @ np.asarray(LUMINANCE)
    return np.nan_to_num(values) * nodes.light[:, 2], nodes


def _is_same_turned(evaluate: Evaluate, one: float, two: float) -> bool:
    for cosine in (1.0, 0.75, 0.4):
        (first, nodes), (second, _) = (_sample(evaluate, cosine, azimuth) for azimuth in (one, two))
        root = np.sqrt(nodes.weight)
        if not are_same(root * first, root * second):
            return False
    return True


def _integrate(evaluate: Evaluate, cosine: float) -> float:
    values, nodes = _sample(evaluate, cosine)
    return float(values @ nodes.weight)
