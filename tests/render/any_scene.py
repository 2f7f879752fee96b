"""Small scenes, one for every kind of thing that Mitsuba's users put into theirs, as dictionaries for its loader."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from lobewise.render import load_mitsuba

SIZE = 24

Items = dict[str, Any]
Make = Callable[[Any], Items]


def make_texture(mi: Any, low: float, high: float, channels: int = 1) -> Items:
    """Return a texture of 8x8 random values; a single channel holds numbers, three are a colour."""
    values = np.random.default_rng(7).uniform(low, high, (8, 8, channels)).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": channels == 1, "filter_type": "nearest"}


def make_sensor(mi: Any, **changes: Any) -> Items:
    """Return the sensor that looks at the middle of the room."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, **changes.pop("film", {})}
    where = mi.ScalarTransform4f().look_at([0.3, 1.6, 4.0], [0.0, 0.6, 0.0], [0.0, 1.0, 0.0])
    return {"type": "perspective", "fov": 40.0, "to_world": where, "film": film, **changes}


def make_room(mi: Any, *, depth: int = 8, lamp: bool = True, **more: Any) -> Items:
    """Return a floor and a wall under a lamp and a dim sky, with more items."""
    at = mi.ScalarTransform4f
    squares = {"type": "checkerboard", "to_uv": at().scale([4, 4, 1])}
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.1]}}
    room: Items = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth},
        "sensor": make_sensor(mi),
        "floor": {
            "type": "rectangle",
            "to_world": at().rotate([1, 0, 0], -90).scale(3),
            "bsdf": {"type": "diffuse", "reflectance": squares},
        },
        "wall": {"type": "rectangle", "to_world": at().translate([0, 2, -1.5]).scale(3), "bsdf": red},
    }
    if lamp:
        room["sky"] = {"type": "constant", "radiance": 0.2}
        room["lamp"] = {
            "type": "rectangle",
            "to_world": at().translate([1, 3.5, 1]).rotate([1, 0, 0], 90).scale(0.7),
            "emitter": {"type": "area", "radiance": 6.0},
        }
    return {**room, **more}


def make_ball(bsdf: Items, **more: Any) -> Items:
    return {"type": "sphere", "center": [0.0, 0.8, 0.0], "radius": 0.8, "bsdf": bsdf, **more}


def make_plate(mi: Any, bsdf: Items) -> Items:
    where = mi.ScalarTransform4f().translate([0, 0.9, 0.2]).rotate([0, 1, 0], 20).scale(0.8)
    return {"type": "rectangle", "to_world": where, "bsdf": bsdf}


def _make_with_ball(describe: Make, mi: Any) -> Items:
    return make_room(mi, object=make_ball(describe(mi)))


def _make_with_plate(describe: Make, mi: Any) -> Items:
    return make_room(mi, object=make_plate(mi, describe(mi)))


def _make_instances(mi: Any) -> Items:
    at = mi.ScalarTransform4f
    group: Items = {
        "type": "shapegroup",
        "cube": {"type": "cube", "bsdf": {"type": "roughplastic"}},
        "ball": {"type": "sphere", "center": [0, 1.5, 0], "radius": 0.6, "bsdf": {"type": "conductor"}},
    }
    copies = {
        f"copy{k}": {
            "type": "instance",
            "to_world": at().translate([0.8 * k - 0.8, 0.4, 0.2 * k]).rotate([0, 1, 0], 30 * k).scale(0.3),
            "shapegroup": {"type": "ref", "id": "group"},
        }
        for k in range(3)
    }
    return make_room(mi, group=group, **copies)


_HALF = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": 0.6}}
_PLATES: dict[str, Make] = {
    "mask with a texture": lambda mi: {"type": "mask", "opacity": make_texture(mi, 0.0, 1.0), "inner": _HALF},
    "mask of metal": lambda _: {
        "type": "mask",
        "opacity": 0.4,
        "inner": {"type": "twosided", "inner": {"type": "roughconductor", "alpha": 0.1}},
    },
    "pane": lambda _: {
        "type": "thindielectric",
        "specular_transmittance": {"type": "rgb", "value": [0.9, 0.3, 0.5]},
    },
    "pane under a bump map": lambda mi: {
        "type": "bumpmap",
        "texture": make_texture(mi, 0.0, 0.01),
        "inner": {"type": "thindielectric"},
    },
    "blend of nothing and paint": lambda mi: {
        "type": "blendbsdf",
        "weight": make_texture(mi, 0.0, 1.0),
        "first": {"type": "null"},
        "second": _HALF,
    },
}
_BALLS: dict[str, Make] = {
    "null": lambda _: {"type": "null"},
}

SCENES: dict[str, Make] = {
    **{name: partial(_make_with_ball, make) for name, make in _BALLS.items()},
    **{name: partial(_make_with_plate, make) for name, make in _PLATES.items()},
    "instances": _make_instances,
}
"""By what a scene shows, a function of the module ``mitsuba`` that describes it."""


def load(name: str) -> Any:
    """Return one of the `SCENES`."""
    mi = load_mitsuba("cpu")
    return mi.load_dict(SCENES[name](mi))
