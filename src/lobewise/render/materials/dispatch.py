"""What is asked of the BSDFs at hits, whichever of a scene's materials each hit lies on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lobewise.render.bridge import dr, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.split import find_diffuse_share
from lobewise.render.materials.surface import Surface, describe_material


def _dispatch(
    materials: dict[int, Material], ask: Callable[..., Any], make_nothing: Callable[[], Any], bsdf: Any, *arguments: Any
) -> Any:
    def visit(self: Any, *arguments: Any) -> Any:
        material = materials.get(self.ptr)
        # Dr.Jit visits every BSDF that lives, nested ones and those of other scenes included.
        return make_nothing() if material is None else ask(material, *arguments)

    return dr.dispatch(bsdf, visit, *arguments)


def _make_black() -> Any:
    return mi.Color3f(0)


def dispatch_surface(materials: dict[int, Material], bsdf: Any, si: Any, active: Any) -> Surface:
    """Return the guides at hits on any of the materials; lanes that are not active get zeros."""
    surface: Surface = _dispatch(materials, describe_material, Surface, bsdf, si, active)
    return surface


def dispatch_share(materials: dict[int, Material], bsdf: Any, si: Any, wo: Any, active: Any) -> Any:
    """Return `find_diffuse_share` at hits on any of the materials."""
    return _dispatch(materials, find_diffuse_share, _make_black, bsdf, si, wo, active)


def split_scattering(materials: dict[int, Material], bsdf: Any, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
    """Return ``f cos`` of the smooth lobes and which share of it is diffuse; one visit of each BSDF for both."""

    def scatter(material: Material, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
        value = material.bsdf.eval(mi.BSDFContext(), si, wo, active)
        return mi.Color3f(value), find_diffuse_share(material, si, wo, active)

    found: tuple[Any, Any] = _dispatch(materials, scatter, lambda: (_make_black(), _make_black()), bsdf, si, wo, active)
    return found
