"""Surfaces that receive light of clusters, and surfaces on which virtual lights lie, as lobes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise.lobes.albedo import ggx_directional_albedo
from lobewise.lobes.clusters import MIN_VARIANCE, multiply_covariance
from lobewise.lobes.covariance import CovarianceLobe, make_covariance_lobe
from lobewise.lobes.directions import compute_tangent, face_viewer
from lobewise.lobes.vectors import cross
from lobewise.records.frame import LobeKind
from lobewise.render.bridge import DRJIT, dr, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_surface
from lobewise.render.materials.surface import Surface
from lobewise.render.virtual_lights.clusters import Lights
from lobewise.render.virtual_lights.light_paths import LightSet

MAX_FOLLOWED_ALPHA = 0.25
"""Alpha below which rays show what a lobe reflects within its reach."""

REACH = 1.5
"""Reach of a lobe over the distance at which the Gaussian of a cluster looks as wide as the lobe."""
MIN_WHITE_ALBEDO = 0.2
"""Smallest albedo of a white lobe: that of GGX of alpha 1 is 0.3."""


@dataclass
class Receiver:
    """A surface that receives light (Dr.Jit arrays; a PyTree).

    ``diffuse`` is an albedo, and ``specular`` the reflectance of the lobe. ``basis`` holds two unit vectors across
    ``axis``, in which ``lobe`` is the covariance xx, xy, yy. ``reach`` is the distance, in scene units, up to which
    rays show what the lobe reflects: there the Gaussian of a cluster looks as wide as the lobe. It is 0 for wide lobes,
    and infinite for mirrors.
    """

    position: Any
    normal: Any
    diffuse: Any
    specular: Any
    axis: Any
    basis: tuple[Any, Any]
    lobe: Any
    beckmann: Any
    reach: Any


def weigh_distance(distance: Any, reach: Any) -> Any:
    """Return which part of the light that a lobe gets from a distance clusters show; rays show the rest.

    The part rises from 0 at half the reach of the lobe to 1 at its reach.
    """
    return dr.select(reach > 0, dr.clip(2.0 * distance / reach - 1.0, 0.0, 1.0), 1.0)


def lets_through(bsdf: Any) -> Any:
    """Return whether surfaces are rough glass, of which neither receivers nor lights know the refracted lobe."""
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.GlossyTransmission)


def make_receiver(si: Any, surface: Surface, bsdf: Any, width: Any) -> Receiver:
    """Return a hit as a receiver of light of clusters whose Gaussians have a standard deviation ``width``."""
    normal, lobe = _compute_lobe(surface, si.to_world(si.wi), gaussian=False)
    beckmann = surface.lobe_kind == float(LobeKind.BECKMANN)
    axis = mi.Vector3f(*lobe.axis)
    basis = mi.coordinate_system(axis)
    first, second = (mi.Vector3f(*multiply_covariance(lobe.covariance, split(side))) for side in basis)
    covariance = mi.Vector3f(dr.dot(basis[0], first), dr.dot(basis[1], first), dr.dot(basis[1], second))
    through = lets_through(bsdf)
    # Lobes of albedo 1 lose as much at the horizon as surfaces lose by masking, within some per cent.
    mean_alpha = dr.minimum(dr.sqrt(0.5 * (dr.square(surface.alpha_u) + dr.square(surface.alpha_v))), 1.0)
    mean_alpha *= dr.select(beckmann, 0.5, 1.0)
    white = ggx_directional_albedo(dr.abs(dr.dot(normal, si.to_world(si.wi))), mean_alpha, 1.0)
    only_rays = through | (surface.lobe_kind == float(LobeKind.DELTA))
    reach = dr.select(only_rays, dr.inf, (REACH * width) * dr.rsqrt(dr.sqrt(lobe.determinant)))
    followed = through | (surface.alpha_u * surface.alpha_v < MAX_FOLLOWED_ALPHA**2)
    followed &= surface.lobe_kind != float(LobeKind.NONE)
    return Receiver(
        position=mi.Point3f(si.p),
        normal=normal,
        diffuse=mi.Color3f(surface.diffuse_albedo),
        specular=mi.Color3f(dr.select(only_rays, 0.0, surface.specular_albedo / dr.maximum(white, MIN_WHITE_ALBEDO))),
        axis=axis,
        basis=basis,
        lobe=covariance,
        beckmann=beckmann,
        reach=dr.select(followed, reach, 0.0),
    )


def read_lights(materials: dict[int, Material], lights: LightSet) -> Lights:
    """Return what clusters need of a set of lights: flux and directions of what their surfaces scatter."""
    surface = dispatch_surface(materials, lights.bsdf, lights.si, mi.Bool(True))
    normal, lobe = _compute_lobe(surface, lights.si.to_world(lights.incoming), gaussian=True)
    # No light can lie on a mirror, and light that passes through a surface leaves on its other side.
    no_lobe = (
        lets_through(lights.bsdf)
        | (surface.lobe_kind == float(LobeKind.NONE))
        | (surface.lobe_kind == float(LobeKind.DELTA))
    )

    def take(value: Any) -> Any:
        # The one dark light of an empty set lies nowhere.
        return np.nan_to_num(np.array(value, dtype=np.float64).T, posinf=0.0, neginf=0.0)

    return Lights(
        position=take(mi.Point3f(lights.si.p)),
        normal=take(normal),
        axis=take(mi.Vector3f(*lobe.axis)),
        sharpness=take(dr.rsqrt(mi.Float(lobe.determinant))),
        diffuse=take(mi.Color3f(lights.flux * surface.diffuse_albedo)),
        glossy=take(dr.select(no_lobe, 0.0, lights.flux * surface.specular_albedo)),
    )


def _compute_lobe(surface: Surface, view: Any, *, gaussian: bool) -> tuple[Any, CovarianceLobe]:
    """Return the normal on the side of a direction in world space, and the lobe that reflects it."""
    normal, cosine = face_viewer(DRJIT, split(surface.normal), split(view))
    tangent, _ = compute_tangent(DRJIT, split(surface.tangent), normal)
    lobe = make_covariance_lobe(
        DRJIT,
        normal,
        split(view),
        cosine,
        [surface.alpha_u, surface.alpha_v],
        (tangent, cross(normal, tangent)),
        MIN_VARIANCE,
        beckmann=surface.lobe_kind == float(LobeKind.BECKMANN),
        gaussian=gaussian,
    )
    return mi.Vector3f(*normal), lobe


def split(vector: Any) -> list[Any]:
    """Return the components of a 3-vector, for the formulas of `lobewise.lobes`."""
    return [vector.x, vector.y, vector.z]
