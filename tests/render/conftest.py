"""Scenes that the rendering tests share."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import pytest

from lobewise.records.frame import Frame, GBuffer
from tests.render.items import make_camera, make_lamp, make_square, rgb


@pytest.fixture(scope="session")
def make_furnace(mi: Any) -> Callable[..., Any]:
    """Return a function that makes the scene of a square of a material, seen at an angle under a white sky."""

    def make(bsdf: dict[str, Any], *, cos_view: float = 0.8, behind: bool = False) -> Any:
        sine = (1.0 - cos_view**2) ** 0.5
        side = -1.0 if behind else 1.0
        return mi.load_dict(
            {
                "type": "scene",
                "sensor": make_camera(mi, [10.0 * sine, 0.0, 10.0 * cos_view * side], fov=0.5),
                "square": {"type": "rectangle", "bsdf": bsdf},
                "sky": {"type": "constant"},
            }
        )

    return make


@pytest.fixture(scope="session")
def furnace(make_furnace: Callable[..., Any]) -> Callable[..., Frame]:
    """Return a function that renders such a scene; the radiance of a lobe is its directional albedo."""
    from lobewise.render import render_frame

    def render(bsdf: dict[str, Any], *, spp: int = 512, **view: Any) -> Frame:
        return render_frame(make_furnace(bsdf, **view), spp=spp, seed=5)

    return render


@pytest.fixture(scope="session")
def guide(make_furnace: Callable[..., Any]) -> Callable[..., GBuffer]:
    """Return a function that finds the guides of such a scene that come from pixel centres, without tracing paths."""
    from lobewise.render import get_camera
    from lobewise.render.gbuffer import trace_guides
    from lobewise.render.images import to_image
    from lobewise.render.materials.bsdfs import read_scene_materials

    def find(bsdf: dict[str, Any], **view: Any) -> GBuffer:
        scene = make_furnace(bsdf, **view)
        guides = trace_guides(scene, read_scene_materials(scene), get_camera(scene), pixels=(0, 64), size=(8, 8))
        images = {name: to_image(value) for name, value in guides.items() if name in GBuffer.__dataclass_fields__}
        return GBuffer(**{name: image.reshape(8, 8, *image.shape[1:]) for name, image in images.items()})

    return find


@pytest.fixture(scope="session")
def make_box_scene(mi: Any) -> Callable[..., Any]:
    """Return a function that makes a small lit room around given items: two walls, a floor, a lamp."""

    def make(items: dict[str, Any], *, size: int = 24) -> Any:
        transform = mi.ScalarTransform4f
        gray = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": rgb(0.6, 0.5, 0.4)}}
        above = transform().translate([0.5, 3, 1]).rotate([1, 0, 0], 90).scale(0.9)
        return mi.load_dict(
            {
                "type": "scene",
                "sensor": make_camera(mi, [0, 1.5, 4], [0, 0.6, 0], size=(size, size), fov=45.0),
                "floor": make_square(transform().rotate([1, 0, 0], -90).scale(3), bsdf=gray),
                "wall": make_square(transform().translate([0, 2, -2]).scale(3), bsdf=gray),
                "lamp": make_lamp(above, rgb(5.0, 6.0, 7.0)),
                **items,
            }
        )

    return make


@pytest.fixture(scope="session")
def built_in_frames(mi: Any) -> Callable[[str], Frame]:
    """Return a function that renders a built-in scene, 24x24 at 256 samples, once.

    Frames are kept and scenes are not: Dr.Jit compiles every BSDF that lives into every kernel.
    """
    from lobewise.render import load_scene, render_frame

    return lru_cache(lambda name: render_frame(load_scene(name, width=24), spp=256, seed=3))
