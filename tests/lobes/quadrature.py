"""Integrals over the sphere for the tests: polar grids that adapt to the lobe, and random pairs of reflection lobes.

The grid's shape only places nodes; what is integrated is always the full BRDF times cosine, and grids of other sizes
and shapes must give the same (see test_quadrature.py).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from hypothesis import strategies as st

from lobewise.fitting import ggx

from .oracles import brdf, tangent


def normalize(a):
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


components = st.floats(-1.0, 1.0)
directions = (
    st.tuples(components, components, components).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1).map(normalize)
)
"""Any unit vectors, as hypothesis draws them."""


def rms(error):
    return float(np.sqrt(np.mean(np.square(error))))


def unpack(six):
    """Return the full matrices of six components."""
    return six[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*six.shape[:-1], 3, 3)


def make_frame(axis):
    """Return two unit vectors perpendicular to ``axis`` (3,) and to each other."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = normalize(np.cross(helper, axis))
    return x, np.cross(axis, x)


def rotate(axis, angle):
    """Return the rotation matrix about a unit ``axis`` (Rodrigues)."""
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


@cache
def gauss(count):
    """Return Gauss-Legendre (nodes, weights) on [0, 1]; kept, because finding them costs more than using them."""
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * (x + 1.0), 0.5 * w


def sphere_grid(axis, width=1.0, radial=200, angular=128, stretch=None):
    """Return (directions (N, 3), weights (N,)) over the whole sphere, dense within ``width`` radians of ``axis``.

    Stereographic polar coordinates around the axis, ``r = width t / (1 - t)``: Gauss-Legendre nodes in t, equal steps
    in the angle. ``stretch`` (3, 3), a linear map of the plane across the axis, makes the rings ellipses.
    """
    t, wt = gauss(radial)
    phi = 2.0 * np.pi * (np.arange(angular) + 0.5) / angular
    r = width * t / (1.0 - t)
    dr = width / (1.0 - t) ** 2
    x, y = make_frame(axis)
    u = r[:, None, None] * (np.cos(phi)[None, :, None] * x + np.sin(phi)[None, :, None] * y)
    jacobian = (wt * dr * r)[:, None] * np.full(angular, 2.0 * np.pi / angular)
    if stretch is not None:
        u = u @ stretch.T
        columns = np.stack([stretch @ x, stretch @ y])
        jacobian = jacobian * np.sqrt(np.linalg.det(columns @ columns.T))
    quarter = 0.25 * np.sum(u * u, axis=-1)
    directions = ((1.0 - quarter)[..., None] * axis + u) / (1.0 + quarter)[..., None]
    weights = jacobian / (1.0 + quarter) ** 2
    return directions.reshape(-1, 3), weights.reshape(-1)


@dataclass(frozen=True)
class Surface:
    """One shading point: world frame (rows: tangent, bitangent, normal), view direction, roughness, kind of normals."""

    frame: np.ndarray
    view: np.ndarray
    alpha_u: float
    alpha_v: float
    kind: str = "ggx"

    @property
    def local_view(self):
        return self.frame @ self.view

    def evaluate(self, direction):
        """BRDF times cosine in world directions (N, 3)."""
        light = direction @ self.frame.T
        function = ggx.ggx_brdf if self.kind == "ggx" else brdf.beckmann_brdf
        return function(self.local_view, light, self.alpha_u, self.alpha_v) * np.maximum(light[:, 2], 0.0)

    def lobe(self, gaussian=False):
        """The covariance lobe that is on trial."""
        return tangent.make_tangent_lobe(
            self.view,
            self.frame[2],
            self.alpha_u,
            self.alpha_v,
            self.frame[0],
            gaussian=gaussian,
            beckmann=self.kind == "beckmann",
        )


def lobe_stretch(lobes):
    """Return (axis, stretch) of a grid that covers the given lobes: a square root of their mean covariance."""
    axis = normalize(sum(lobe.axis for lobe in lobes))
    matrix = sum(unpack(lobe.covariance) for lobe in lobes) / len(lobes)
    across = np.eye(3) - np.outer(axis, axis)
    values, vectors = np.linalg.eigh(across @ matrix @ across)
    root = vectors @ np.diag(np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return axis, root


def measure_similarity(i, j, radial=80, angular=96):
    """Return the true similarity of two surfaces' lobes: three integrals of the product, one grid each."""

    def integrate(a, b):
        axis, stretch = lobe_stretch([a.lobe(), b.lobe()])
        directions, weights = sphere_grid(axis, 2.0, radial, angular, stretch)
        return np.sum(a.evaluate(directions) * b.evaluate(directions) * weights)

    return integrate(i, j) / np.sqrt(integrate(i, i) * integrate(j, j))


def draw_pairs(count, *, anisotropy="none", kind="ggx", wide=False, seed=0):
    """Return ``count`` random pairs of neighbouring surfaces.

    Geometric-mean alpha 0.03 to 0.75 (log-uniform); in 60 % of the pairs another roughness (log-normal ratio, sigma
    0.35); n.v 0.12 to 1; normals tilted by up to 0.9 alpha, views shifted by up to 0.4 alpha.
    ``anisotropy``: "none"; "one", the alphas of both in one ratio of up to 4, the frames twisted against each other by
    0.2 rad (sigma); "two", the same with two unrelated ratios and 0.3 rad.
    ``wide``: alpha 0.01 to 1 and n.v 0.02 to 1, three in ten log-uniform, instead.
    """
    rng = np.random.default_rng(seed)
    twist_sigma = {"none": 0.0, "one": 0.2, "two": 0.3}[anisotropy]
    pairs = []
    while len(pairs) < count:
        alpha = np.exp(rng.uniform(*np.log((0.01, 1.0) if wide else (0.03, 0.75))))
        other = alpha * np.exp(0.35 * rng.normal()) if rng.random() < 0.6 else alpha
        ratios = np.exp(rng.uniform(-np.log(4.0), np.log(4.0), 2)) ** (anisotropy != "none")
        ratios[1] = ratios[1] if anisotropy == "two" else ratios[0]
        alphas = np.array([alpha, other])[:, None] * ratios[:, None] ** np.array([0.5, -0.5])
        grazing = 0.02 if wide else 0.12
        cosine = np.exp(rng.uniform(np.log(grazing), 0.0)) if wide and rng.random() < 0.3 else rng.uniform(grazing, 1.0)
        phi = rng.uniform(0.0, 2.0 * np.pi)
        view = np.append(np.sqrt(1.0 - cosine**2) * np.array([np.cos(phi), np.sin(phi)]), cosine)
        tilt_axis = np.append(normalize(rng.normal(size=2)), 0.0)
        twist = rotate(np.array([0.0, 0.0, 1.0]), twist_sigma * rng.normal())
        frame_j = (rotate(tilt_axis, 0.9 * alpha * rng.random()) @ twist).T
        shift = rng.normal(size=3)
        view_j = normalize(view + 0.4 * alpha * rng.random() * normalize(shift - view * (shift @ view)))
        if alphas.max() < (1.0 if wide else 0.95) and frame_j[2] @ view_j > 0.8 * grazing:
            pairs.append((Surface(np.eye(3), view, *alphas[0], kind), Surface(frame_j, view_j, *alphas[1], kind)))
    return pairs


def stack_lobes(surfaces, gaussian=False):
    """Return one TangentLobe that holds the lobes of all ``surfaces``."""
    lobes = [surface.lobe(gaussian) for surface in surfaces]
    return tangent.TangentLobe(*(np.stack([lobe[k] for lobe in lobes]) for k in range(3)))
