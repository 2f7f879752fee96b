"""The diffuse share of a reflection, light that passes unscattered, and calls of the materials of many hits at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lobewise.render.bridge import dr, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.fitted import OPACITY
from lobewise.render.materials.probe import make_context
from lobewise.render.materials.surface import (
    Surface,
    describe_material,
    enter_perturbed,
    enter_twosided,
    make_world_frame,
    read_color,
    read_number,
)


def _divide(part: Any, total: Any) -> Any:
    return dr.select(total > 0, dr.clip(part / total, 0.0, 1.0), 0.0)


def evaluate_principled_diffuse(material: Material, si: Any, wo: Any, active: Any) -> Any:
    """Return diffuse, retro-reflection, fake subsurface and sheen of the principled BSDF, times the cosine.

    Mitsuba's plugin ignores the lobes that its context asks for, so its diffuse part is evaluated here.

    Source: Burley 2012, section 5.3, and 2015, "Extending the Disney BRDF", section 4 (flatness).
    """
    cos_i, cos_o = dr.abs(si.wi.z), dr.abs(wo.z)
    half = dr.normalize(si.wi + wo)
    cos_d = dr.abs(dr.dot(half, wo))
    base = read_color(material, "base_color", si, active)
    opaque = 1.0 - read_number(material, "metallic", si, active)
    weight = opaque * (1.0 - read_number(material, "spec_trans", si, active))
    roughness = read_number(material, "roughness", si, active)
    flatness = read_number(material, "flatness", si, active)

    def schlick(cosine: Any) -> Any:
        rest = dr.clip(1.0 - cosine, 0.0, 1.0)
        return dr.square(dr.square(rest)) * rest

    f_i, f_o = schlick(cos_i), schlick(cos_o)
    retro = 2.0 * roughness * dr.square(cos_d)
    plain = (1.0 - 0.5 * f_i) * (1.0 - 0.5 * f_o) + retro * (f_o + f_i + f_o * f_i * (retro - 1.0))
    flat = dr.lerp(1.0, 0.5 * retro, f_o) * dr.lerp(1.0, 0.5 * retro, f_i)
    flat = 1.25 * (flat * (dr.rcp(cos_o + cos_i) - 0.5) + 0.5)
    value = base * (weight * cos_o * dr.inv_pi * dr.lerp(plain, flat, flatness))

    luminance = mi.luminance(base)
    hue = dr.select(luminance > 0, base / luminance, 1.0)
    sheen = read_number(material, "sheen", si, active) * opaque * schlick(cos_d) * cos_o
    value += dr.lerp(mi.Color3f(1), hue, read_number(material, "sheen_tint", si, active)) * sheen
    return dr.select((si.wi.z > 0) & (wo.z > 0), value, 0.0)


def compute_diffuse_share(material: Material, si: Any, wo: Any, active: Any) -> Any:
    """Return the diffuse share of ``f(wi, wo)``, per colour, in [0, 1], for smooth (non-delta) lobes.

    ``wo`` is local to ``si``, as in Mitsuba's BSDFs. Nested BSDFs pass shares up, not values, so factors of a wrapper
    for both lobes (opacity, shadow terminator) cancel.
    """
    flags = material.bsdf.flags()
    if not mi.has_flag(flags, mi.BSDFFlags.Diffuse):
        return mi.Color3f(0)
    if not mi.has_flag(flags, mi.BSDFFlags.Glossy):
        return mi.Color3f(1)
    everything = mi.BSDFContext()
    if material.plugin == "principled":
        total = material.bsdf.eval(everything, si, wo, active)
        return _divide(evaluate_principled_diffuse(material, si, wo, active), total)
    if material.without_specular is not None:
        opaque = 1.0 - read_number(material, "spec_trans", si, active)
        part = opaque * material.without_specular.eval(everything, si, wo, active)
        return _divide(part, material.bsdf.eval(everything, si, wo, active))
    if material.fitted is not None and not material.fitted.fit.parts.diffuse:
        return mi.Color3f(0)
    if material.obeys_context:
        part = material.bsdf.eval(make_context(mi.BSDFFlags.Diffuse), si, wo, active)
        return _divide(part, material.bsdf.eval(everything, si, wo, active))
    frame = make_world_frame(si)
    if material.plugin == "twosided":
        inner, _ = enter_twosided(si, frame)
        turned = mi.Vector3f(wo.x, wo.y, dr.mulsign(wo.z, si.wi.z))
        shares = [compute_diffuse_share(child, inner, turned, active) for child in material.nested]
        return dr.select(si.wi.z > 0, shares[0], shares[1])
    if material.plugin in ("normalmap", "bumpmap"):
        inner, _, local = enter_perturbed(material, si, frame, active)
        return compute_diffuse_share(material.nested[0], inner, local.to_local(wo), active)
    if material.plugin == "mask":
        return compute_diffuse_share(material.nested[0], si, wo, active)
    weight = dr.clip(read_number(material, "weight", si, active), 0.0, 1.0)
    first, second = material.nested
    value = first.bsdf.eval(everything, si, wo, active) * (1.0 - weight)
    other = second.bsdf.eval(everything, si, wo, active) * weight
    part = value * compute_diffuse_share(first, si, wo, active) + other * compute_diffuse_share(second, si, wo, active)
    return _divide(part, value + other)


def compute_null_transmission(material: Material, si: Any, active: Any) -> Any:
    """Return the share of light that passes a surface unscattered (Color3f), towards the viewer at ``si.wi``.

    Mitsuba's normal and bump maps answer 0 for what passes the BSDF inside them, so the nested BSDFs are asked. A BSDF
    whose answer is not that of its samples has the share of its samples that passed.
    """
    if not material.can_be_transparent:
        return mi.Color3f(0)
    if material.plugin in ("normalmap", "bumpmap"):
        inner, _, _ = enter_perturbed(material, si, make_world_frame(si), active)
        return compute_null_transmission(material.nested[0], inner, active)
    if material.plugin == "mask":
        opacity = dr.clip(read_number(material, "opacity", si, active), 0.0, 1.0)
        return dr.lerp(mi.Color3f(1), compute_null_transmission(material.nested[0], si, active), opacity)
    if material.plugin == "blendbsdf":
        weight = dr.clip(read_number(material, "weight", si, active), 0.0, 1.0)
        return dr.lerp(*(compute_null_transmission(child, si, active) for child in material.nested), weight)
    if material.fitted is not None and not material.fitted.fit.parts.knows_transmission:
        spot = material.fitted.look_up_spot(material.bsdf, si, active)
        return mi.Color3f(1.0 - material.fitted.look_up(si, active, spot)[OPACITY])
    return mi.Color3f(material.bsdf.eval_null_transmission(si, active))


def _dispatch(
    materials: dict[int, Material], ask: Callable[..., Any], make_nothing: Callable[[], Any], bsdf: Any, *arguments: Any
) -> Any:
    if not materials:
        return make_nothing()  # Dr.Jit refuses a call of nothing

    def visit(self: Any, *arguments: Any) -> Any:
        material = materials.get(self.ptr)
        # Dr.Jit visits every BSDF that is alive, nested ones and those of other scenes included.
        return make_nothing() if material is None else ask(material, *arguments)

    return dr.dispatch(bsdf, visit, *arguments)


def dispatch_surface(materials: dict[int, Material], bsdf: Any, si: Any, active: Any) -> Surface:
    """Return the guides at hits on any of the materials; zeros in inactive lanes."""
    surface: Surface = _dispatch(materials, describe_material, Surface, bsdf, si, active)
    return surface


def dispatch_share(materials: dict[int, Material], bsdf: Any, si: Any, wo: Any, active: Any) -> Any:
    """Return `compute_diffuse_share` at hits on any of the materials."""
    return _dispatch(materials, compute_diffuse_share, lambda: mi.Color3f(0), bsdf, si, wo, active)


def dispatch_transmission(materials: dict[int, Material], bsdf: Any, si: Any, active: Any) -> Any:
    """Return `compute_null_transmission` at hits on any of the materials; zeros in inactive lanes."""
    return _dispatch(materials, compute_null_transmission, lambda: mi.Color3f(0), bsdf, si, active)


def split_scattering(materials: dict[int, Material], bsdf: Any, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
    """Return ``f cos`` of the smooth lobes and its diffuse share, with one visit of each BSDF."""

    def scatter(material: Material, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        value = material.bsdf.eval(mi.BSDFContext(), si, wo, active)
        return mi.Color3f(value), compute_diffuse_share(material, si, wo, active)

    scattered: tuple[Any, Any] = _dispatch(
        materials, scatter, lambda: (mi.Color3f(0), mi.Color3f(0)), bsdf, si, wo, active
    )
    return scattered
