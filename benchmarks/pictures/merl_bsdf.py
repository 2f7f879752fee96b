"""A Mitsuba BSDF of a material in MERL's layout, and the scene that shows three of them.

Mitsuba has no such plugin. This one is written as a user would: looked up in a 3D texture, sampled by a mixture of
cosine and GGX half vectors. The renderer of lobewise knows no formula for it, so it fits lobes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from lobewise.fitting.ggx import ggx_brdf
from lobewise.fitting.merl import MerlBrdf
from lobewise.render import load_mitsuba
from lobewise.render.loading import build_scene
from lobewise.scenes import parts
from tests.fitting.merl_tables import make_merl

DIFFUSE_SHARE = 0.35
"""How many samples follow the cosine."""


def make_hazy_metal(view: Any, light: Any) -> Any:
    """Return a sharp and a wide lobe on one warm metal, as polished bronze has them."""
    lobe = 0.45 * ggx_brdf(view, light, 0.06) + 0.55 * ggx_brdf(view, light, 0.32)
    return np.stack([0.95 * lobe, 0.72 * lobe, 0.45 * lobe], axis=-1)


def make_lacquer(view: Any, light: Any) -> Any:
    """Return a clear coat over a coloured ground: a sharp lobe by Fresnel, a satin one, and a diffuse one."""
    coat = ggx_brdf(view, light, 0.05, f0=0.05)
    ground = 0.15 * ggx_brdf(view, light, 0.4)
    return np.stack([coat + tint * ground + paint for tint, paint in ((0.9, 0.10), (0.3, 0.015), (0.3, 0.02))], axis=-1)


def make_satin(view: Any, light: Any) -> Any:
    """Return one wide lobe and a diffuse one, as satin paint has them."""
    lobe = 0.35 * ggx_brdf(view, light, 0.22)
    return np.stack([lobe + paint for paint in (0.02, 0.06, 0.12)], axis=-1)


@lru_cache
def make_materials() -> tuple[MerlBrdf, ...]:
    """Return the three materials, tabulated."""
    return tuple(
        make_merl(function, name=name)
        for name, function in (("hazy-bronze", make_hazy_metal), ("lacquer", make_lacquer), ("satin", make_satin))
    )


@lru_cache
def make_bsdf_type() -> Any:
    """Return the class of the BSDF; its base exists only once a variant is set."""
    mi = load_mitsuba()
    import drjit as dr

    class MerlBsdf(mi.BSDF):  # type: ignore[misc]
        def __init__(self, material: MerlBrdf, alpha: float) -> None:
            super().__init__(mi.Properties())
            self.m_flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components = [self.m_flags]
            values = np.maximum(material.samples[..., :3], 0.0)
            self.table = mi.Texture3f(mi.TensorXf(np.ascontiguousarray(values)), wrap_mode=dr.WrapMode.Clamp)
            self.normals = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)

        def look_up(self, wi: Any, wo: Any) -> Any:
            half = dr.normalize(wi + wo)
            theta_h = dr.safe_acos(half.z)
            cos_d = dr.clip(dr.dot(half, wo), -1.0, 1.0)
            # Azimuth of the light about the half vector, from the plane of the half vector and the normal.
            s = dr.normalize(mi.Vector3f(0, 0, 1) - half * half.z + mi.Vector3f(1e-9, 0, 0))
            t = dr.cross(half, s)
            phi = dr.atan2(dr.dot(t, wo), -dr.dot(s, wo))
            phi = dr.select(phi < 0, phi + dr.pi, phi)
            return self.table.eval(
                mi.Point3f(
                    phi * (1.0 / dr.pi),
                    dr.safe_acos(cos_d) * (2.0 / dr.pi),
                    dr.sqrt(theta_h * (2.0 / dr.pi)),
                )
            )

        def eval(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            above = active & (si.wi.z > 0) & (wo.z > 0)
            red, green, blue = self.look_up(si.wi, wo)
            return dr.select(above, mi.Color3f(red, green, blue) * wo.z, 0.0)

        def pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            above = active & (si.wi.z > 0) & (wo.z > 0)
            half = dr.normalize(si.wi + wo)
            glossy = self.normals.pdf(si.wi, half) / (4.0 * dr.maximum(dr.dot(wo, half), 1e-6))
            cosine = wo.z * dr.inv_pi
            return dr.select(above, DIFFUSE_SHARE * cosine + (1.0 - DIFFUSE_SHARE) * glossy, 0.0)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def sample(self, context: Any, si: Any, choice: Any, point: Any, active: Any = True) -> Any:
            half, _ = self.normals.sample(si.wi, point)
            glossy = mi.reflect(si.wi, half)
            wo = dr.select(choice < DIFFUSE_SHARE, mi.warp.square_to_cosine_hemisphere(point), glossy)
            made = mi.BSDFSample3f()
            made.wo = wo
            made.pdf = self.pdf(context, si, wo, active)
            made.eta = 1.0
            made.sampled_component = mi.UInt32(0)
            made.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            good = active & (made.pdf > 0)
            return made, dr.select(good, self.eval(context, si, wo, active) / made.pdf, 0.0)

        def traverse(self, callback: Any) -> None:
            pass

        def to_string(self) -> str:
            return "MerlBsdf[]"

    return MerlBsdf


def make_scene(materials: tuple[MerlBrdf, ...], size: int) -> Any:
    """Return three balls of three materials on a floor of the first and the second in checks."""
    kind = make_bsdf_type()
    alphas = (0.12, 0.1, 0.22)
    bsdfs = [kind(materials[number % len(materials)], alphas[number % len(alphas)]) for number in range(3)]
    balls = {f"ball{number}": parts.sphere((1.7 * (number - 1), 0.8, 0.0), 0.8, bsdfs[number]) for number in range(3)}
    plates = {
        f"plate{number}": parts.rectangle(
            (1.4 * (number % 4) - 2.1, 0.0, 1.2 - 1.4 * (number // 4)),
            (1.4 * (number % 4) - 2.1, 1.0, 1.2 - 1.4 * (number // 4)),
            (0.7, 0.7),
            bsdfs[(number + number // 4) % 3],
        )
        for number in range(12)
    }
    checks = parts.checkerboard((0.9, 0.9, 0.85), (0.08, 0.09, 0.35), (8, 4))
    return build_scene(
        {
            "type": "scene",
            "sensor": parts.camera((0.0, 2.3, 5.6), (0.0, 0.55, 0.0), 42.0, size, size),
            "integrator": {"type": "path", "max_depth": 6},
            "wall": parts.rectangle((0, 2, -3), (0, 2, 0), (4, 2), parts.diffuse(checks)),
            "front": parts.rectangle((0, 2, 7), (0, 2, 0), (4, 2), parts.diffuse((0.4, 0.4, 0.42))),
            "left": parts.rectangle((-4, 2, 2), (0, 2, 2), (5, 2), parts.diffuse((0.7, 0.3, 0.1))),
            "right": parts.rectangle((4, 2, 2), (0, 2, 2), (5, 2), parts.diffuse((0.1, 0.35, 0.6))),
            "lamp": parts.light((0, 4.0, 1.0), (0, 0, 1.0), (1.6, 0.8), (11.0, 10.5, 9.8)),
            "post": parts.box((-0.85, 0.35, 1.0), (0.1, 0.35, 0.1), parts.diffuse((0.9, 0.6, 0.05)), 30),
            **balls,
            **plates,
        }
    )
