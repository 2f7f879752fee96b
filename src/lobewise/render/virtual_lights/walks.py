"""What the walks have in common that show virtual lights: the state beyond mirrors, and the choice of lights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lobewise.render.bridge import dr, mi, starts_as
from lobewise.render.materials.bsdfs import Material
from lobewise.render.tracing.light_sampling import Scattering, Vertex, make_eye, meet_emitter
from lobewise.render.tracing.points import Points
from lobewise.render.tracing.rays import invert_distance

# Roberts 2018, "The unreasonable effectiveness of quasirandom sequences": 1/g, 1/g^2 of the plastic number and 1/g of
# the golden one, as parts of 2^32: products that wrap around are fractions.
_STEP_X, _STEP_Y, _STEP_FRAME = 3242174889, 2447445414, 2654435769


@dataclass
class Walk:
    """State of the loop that follows mirrors and refractions (Dr.Jit arrays; a PyTree)."""

    active: Any
    ray: Any
    rng: Any
    start: Any = starts_as("Bool", True)
    throughput: Any = starts_as("Color3f", 1)
    depth: Any = starts_as("UInt32")
    bounces: Any = starts_as("UInt32")
    last: Vertex = field(default_factory=make_eye)
    diffuse: Any = starts_as("Color3f")
    specular: Any = starts_as("Color3f")
    looks: Any = starts_as("Bool")
    hit_count: Any = starts_as("Float")
    hit_inverse: Any = starts_as("Float")

    def meet(self, scene: Any, points: Points) -> tuple[Any, Any]:
        """Return the next surface, and the light of an emitter there unless it is direct; count what mirrors see."""
        later = ~self.start
        si = dr.select(self.start, points.si, scene.ray_intersect(self.ray, later))
        self.hit_count += dr.select(self.looks, 1.0, 0.0)
        self.hit_inverse += invert_distance(si, self.looks & si.is_valid())
        emitted, weight = meet_emitter(scene, si, self.last, later & (self.bounces >= 2))
        return si, emitted * weight

    def go_on(self, scattering: Scattering) -> None:
        """Continue along the sampled direction."""
        is_null = scattering.is_null
        self.looks = self.active & (self.bounces == 0) & ~is_null & scattering.is_delta
        self.ray = scattering.ray
        self.throughput *= scattering.factor
        self.depth += 1
        self.bounces += dr.select(is_null, mi.UInt32(0), 1)
        self.last = scattering.vertex
        self.start = mi.Bool(False)


class Walker:
    """The light of virtual lights at pixels, and of what surfaces with ``followed`` flags show.

    ``numbers`` holds opaque numbers (UInt32): ``max_depth`` and ``width`` of the image.
    """

    def __init__(
        self, scene: Any, materials: dict[int, Material], lighting: Any, numbers: Mapping[str, Any], *followed: Any
    ) -> None:
        self._scene = scene
        self._materials = materials
        self._lighting = lighting
        self._numbers = numbers
        self._follows = any(
            mi.has_flag(node.bsdf.flags(), flag)
            for material in materials.values()
            for node in material
            for flag in followed
        )

    @property
    def state(self) -> Any:
        """Arrays that the walk reads beside the scene (a PyTree)."""
        return self._lighting.state


def choose_place(pixel: Any, width: Any, count: Any, seed: Any) -> Any:
    """Return a number below ``count`` (UInt32), far apart for neighbouring pixels and for successive seeds.

    ``pixel`` is the row-major number of pixels of an image of this ``width``.
    """
    return dr.mul_hi(pixel % width * _STEP_X + pixel // width * _STEP_Y + seed * _STEP_FRAME, count)
