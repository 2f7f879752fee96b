"""Visibility rays to virtual lights."""

from __future__ import annotations

from typing import Any

from lobewise.render.bridge import dr, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.tracing.points import MAX_LAYERS


class Visibility:
    """Visibility between surfaces and places of a scene."""

    def __init__(self, scene: Any, materials: dict[int, Material]) -> None:
        self._scene = scene
        self._is_clear = not any(material.can_be_transparent for material in materials.values())

    def see(self, si: Any, place: Any, active: Any) -> Any:
        """Return the visibility of a place (Color3f): 0 or 1, or in between behind masked surfaces."""
        ray = si.spawn_ray_to(place)
        if self._is_clear:
            return mi.Color3f(dr.select(active & ~self._scene.ray_test(ray, active), 1.0, 0.0))

        def pass_through(ray: Any, through: Any, layers: Any) -> tuple[Any, Any, Any]:
            hit = self._scene.ray_intersect(ray)
            met = hit.is_valid()
            passed = hit.bsdf().eval_null_transmission(hit, met)
            through *= dr.select(met, passed, 1.0)
            onward = hit.spawn_ray_to(place)
            layers = dr.select(met & (dr.max(through) > 0), layers - 1, 0)
            # A light behind `MAX_LAYERS` layers counts as hidden.
            through = dr.select(met & (layers == 0), 0.0, through)
            return onward, through, layers

        start = (ray, mi.Color3f(dr.select(active, 1.0, 0.0)), dr.select(active, mi.UInt32(MAX_LAYERS), 0))
        return dr.while_loop(start, lambda *state: state[2] > 0, pass_through, label="visibility")[1]
