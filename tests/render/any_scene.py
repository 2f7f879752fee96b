"""Small scenes, one for every kind of thing that Mitsuba's users put into theirs, as dictionaries for its loader."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from lobewise.render import load_mitsuba
from tests.render.items import Items, make_lamp, make_square, rgb

SIZE = 24

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
    red = {"type": "diffuse", "reflectance": rgb(0.7, 0.2, 0.1)}
    floor = {"type": "diffuse", "reflectance": squares}
    room: Items = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth},
        "sensor": make_sensor(mi),
        "floor": make_square(at().rotate([1, 0, 0], -90).scale(3), bsdf=floor),
        "wall": make_square(at().translate([0, 2, -1.5]).scale(3), bsdf=red),
    }
    if lamp:
        room["sky"] = {"type": "constant", "radiance": 0.2}
        room["lamp"] = make_lamp(at().translate([1, 3.5, 1]).rotate([1, 0, 0], 90).scale(0.7), 6.0)
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
    "pane": lambda _: {"type": "thindielectric", "specular_transmittance": {"type": "rgb", "value": [0.9, 0.3, 0.5]}},
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
    "diffuse, textured": lambda mi: {"type": "diffuse", "reflectance": make_texture(mi, 0.0, 1.0, 3)},
    "spectral diffuse": lambda _: {
        "type": "diffuse",
        "reflectance": {"type": "spectrum", "value": [(400, 0.1), (500, 0.3), (600, 0.8), (700, 0.9)]},
    },
    "mirror": lambda _: {"type": "conductor", "material": "Al"},
    "metal of textured roughness": lambda mi: {
        "type": "roughconductor",
        "material": "Cu",
        "alpha_u": make_texture(mi, 0.05, 0.5),
        "alpha_v": 0.1,
    },
    "plastic": lambda mi: {"type": "plastic", "diffuse_reflectance": make_texture(mi, 0.0, 1.0, 3)},
    "rough plastic": lambda mi: {
        "type": "roughplastic",
        "alpha": 0.15,
        "specular_reflectance": make_texture(mi, 0.3, 1.0, 3),
    },
    "glass": lambda _: {"type": "dielectric"},
    "rough glass": lambda mi: {"type": "roughdielectric", "alpha": make_texture(mi, 0.05, 0.4)},
    "principled": lambda mi: {
        "type": "principled",
        "base_color": make_texture(mi, 0.1, 1.0, 3),
        "roughness": make_texture(mi, 0.1, 0.8),
        "metallic": make_texture(mi, 0.0, 1.0),
        "clearcoat": 0.5,
        "sheen": 0.3,
        "anisotropic": 0.5,
    },
    "principled glass": lambda _: {"type": "principled", "roughness": 0.2, "spec_trans": 0.7, "eta": 1.5},
    "polarised plastic": lambda mi: {
        "type": "pplastic",
        "alpha": 0.1,
        "diffuse_reflectance": make_texture(mi, 0.0, 1.0, 3),
    },
    "polarised plastic under a normal map": lambda mi: {
        "type": "normalmap",
        "normalmap": {**make_texture(mi, 0.4, 0.6, 3), "raw": True},
        "inner": {"type": "pplastic", "alpha": 0.1},
    },
    "principled under a bump map": lambda mi: {
        "type": "bumpmap",
        "texture": make_texture(mi, 0.0, 0.05),
        "scale": 0.3,
        "inner": {"type": "principled", "roughness": 0.2},
    },
    "blend of metal and paint": lambda mi: {
        "type": "blendbsdf",
        "weight": make_texture(mi, 0.0, 1.0),
        "first": {"type": "roughconductor", "alpha": 0.2},
        "second": {"type": "diffuse"},
    },
    "blend of a mirror and wide metal": lambda _: {
        "type": "blendbsdf",
        "weight": 0.9,
        "first": {"type": "conductor", "material": "Al"},
        "second": {"type": "roughconductor", "alpha": 0.5, "material": "Al"},
    },
}
_PLATES |= {
    "thin principled": lambda mi: {
        "type": "principledthin",
        "base_color": make_texture(mi, 0.1, 1.0, 3),
        "roughness": make_texture(mi, 0.1, 0.8),
        "spec_trans": 0.4,
        "diff_trans": 0.6,
        "eta": 1.4,
    },
    "two sides": lambda _: {
        "type": "twosided",
        "front": {"type": "roughplastic", "alpha": 0.1},
        "back": {"type": "diffuse"},
    },
    "mask of two sides of a map of a blend": lambda mi: {
        "type": "mask",
        "opacity": make_texture(mi, 0.4, 1.0),
        "inner": {
            "type": "twosided",
            "inner": {
                "type": "normalmap",
                "normalmap": {**make_texture(mi, 0.4, 0.6, 3), "raw": True},
                "inner": {
                    "type": "blendbsdf",
                    "weight": 0.4,
                    "first": {"type": "principled", "roughness": 0.3},
                    "second": {"type": "roughconductor", "alpha": 0.2},
                },
            },
        },
    },
}
_PAINT = {"type": "roughplastic", "alpha": 0.1}


def _make_sky(mi: Any) -> Items:
    values = np.full((16, 32, 3), 0.2, np.float32)
    values[3:5, 4:8] = 30.0
    return {"type": "envmap", "bitmap": mi.Bitmap(values)}


_LIGHTS: dict[str, Make] = {
    "picture of a sky": _make_sky,
    "sun": lambda _: {"type": "directional", "direction": [-0.3, -1.0, -0.6], "irradiance": 3.0},
    "point light": lambda _: {"type": "point", "position": [1.0, 3.0, 2.0], "intensity": 20.0},
    "spot light": lambda mi: {
        "type": "spot",
        "to_world": mi.ScalarTransform4f().look_at([1, 3, 3], [0, 0.5, 0], [0, 1, 0]),
        "intensity": 40.0,
        "cutoff_angle": 30.0,
    },
    "projector": lambda mi: {
        "type": "projector",
        "to_world": mi.ScalarTransform4f().look_at([1, 3, 3], [0, 0.5, 0], [0, 1, 0]),
        "irradiance": make_texture(mi, 0.0, 1.0, 3),
        "scale": 30.0,
        "fov": 45.0,
    },
    "textured lamp": lambda mi: make_lamp(
        mi.ScalarTransform4f().translate([1, 3.5, 1]).rotate([1, 0, 0], 90).scale(0.7),
        {**make_texture(mi, 0.0, 10.0, 3), "raw": True},
    ),
    "lamp of triangles": lambda mi: {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([1, 2.4, 1]).scale(0.3),
        "emitter": {"type": "area", "radiance": 10.0},
    },
}
_FOG: Items = {"type": "homogeneous", "albedo": 0.8, "sigma_t": 1.5}


def _make_smoke(mi: Any) -> Items:
    where = mi.ScalarTransform4f().translate([-0.7, 0.1, -0.7]).scale(1.4)
    values = np.random.default_rng(5).random((8, 8, 8, 1)).astype(np.float32)
    return {
        "type": "heterogeneous",
        "albedo": 0.7,
        "scale": 3.0,
        "sigma_t": {"type": "gridvolume", "grid": mi.VolumeGrid(values), "to_world": where},
    }


def _make_with_medium(describe: Make, bsdf: Items, integrator: Items, mi: Any) -> Items:
    box = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0.8, 0]).scale(0.7)}
    return make_room(mi, integrator=integrator, object={**box, "bsdf": bsdf, "interior": describe(mi)})


def _make_in_fog(mi: Any) -> Items:
    fog = {"type": "homogeneous", "albedo": 0.8, "sigma_t": 0.08}
    room = make_room(mi, integrator={"type": "volpath"}, fog=fog)
    same = {"type": "ref", "id": "fog"}
    sensor = {**room.pop("sensor"), "medium": same}
    del room["sky"]
    shell = {"type": "sphere", "radius": 8.0, "bsdf": {"type": "null"}, "interior": same}
    return {"type": "scene", "fog": room.pop("fog"), "sensor": sensor, **room, "shell": shell}


def _make_with_sensor(changes: Items, mi: Any) -> Items:
    return make_room(mi, sensor=make_sensor(mi, **changes), object=make_ball(_PAINT))


def make_flat_sensor(mi: Any, **changes: Any) -> Items:
    """Return an orthographic sensor whose view is as high as that of `make_sensor` at the middle of the room."""
    sensor = make_sensor(mi, type="orthographic", **changes)
    del sensor["fov"]
    return {**sensor, "to_world": sensor["to_world"].scale([1.5, 1.5, 1.0])}


def _make_flat(mi: Any) -> Items:
    return make_room(mi, sensor=make_flat_sensor(mi), object=make_ball(_PAINT))


def _make_with_light(describe: Make, mi: Any) -> Items:
    return make_room(mi, lamp=False, object=make_ball(_PAINT), light=describe(mi))


def _make_with_integrator(integrator: Items, mi: Any) -> Items:
    walls = {"type": "sphere", "radius": 6.0, "flip_normals": True, "bsdf": {"type": "diffuse", "reflectance": 0.8}}
    return make_room(mi, integrator=integrator, object=make_ball({"type": "dielectric"}), walls=walls)


def _make_with_lamp_in_view(integrator: Items, mi: Any, pane: Items | None = None) -> Items:
    room = make_room(mi, integrator=integrator, object=make_ball(_PAINT))
    del room["wall"]
    lamp = make_plate(mi, {"type": "diffuse"})
    where = mi.ScalarTransform4f().translate([-0.6, 0.2, 1.5]).scale(0.3)
    room["sign"] = {**lamp, "to_world": where, "emitter": {"type": "area", "radiance": 4.0}}
    return room if pane is None else {**room, "pane": {**make_plate(mi, pane), "to_world": where.translate([0, 0, 1])}}


def _make_with_one_vertex(mi: Any) -> Items:
    lamp = make_ball({"type": "diffuse"}, emitter={"type": "area", "radiance": 2.0})
    return make_room(mi, depth=1, object=lamp)


_NULL = {"type": "null"}
_CROP = {"width": 40, "height": 36, "crop_width": SIZE, "crop_height": SIZE, "crop_offset_x": 12, "crop_offset_y": 4}
SCENES: dict[str, Make] = {
    **{name: partial(_make_with_ball, make) for name, make in _BALLS.items()},
    **{name: partial(_make_with_plate, make) for name, make in _PLATES.items()},
    **{name: partial(_make_with_light, make) for name, make in _LIGHTS.items()},
    "instances": _make_instances,
    "shifted film": partial(_make_with_sensor, {"principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1}),
    "parallel rays": _make_flat,
    "cropped film": partial(_make_with_sensor, {"film": _CROP}),
    "fog": partial(_make_with_medium, lambda _: _FOG, _NULL, {"type": "volpath", "max_depth": 16}),
    "fog for paths": partial(_make_with_medium, lambda _: _FOG, _NULL, {"type": "path", "max_depth": 16}),
    "smoke": partial(_make_with_medium, _make_smoke, _NULL, {"type": "volpathmis", "max_depth": 16}),
    "fog in rough glass": partial(
        _make_with_medium, lambda _: _FOG, {"type": "roughdielectric"}, {"type": "volpath", "max_depth": 16}
    ),
    "camera in fog": _make_in_fog,
    "one vertex": _make_with_one_vertex,
    "three vertices": partial(_make_with_integrator, {"type": "path", "max_depth": 3}),
    "endless paths": partial(_make_with_integrator, {"type": "path", "max_depth": -1}),
    "direct light alone": partial(_make_with_integrator, {"type": "direct"}),
    "hidden lamps": partial(_make_with_lamp_in_view, {"type": "path", "hide_emitters": True}),
    "hidden lamps of volpath": partial(_make_with_lamp_in_view, {"type": "volpath", "hide_emitters": True}),
    "lamps hidden behind nothing": partial(
        _make_with_lamp_in_view, {"type": "volpath", "hide_emitters": True}, pane={"type": "null"}
    ),
}
"""By what a scene shows, a function of the module ``mitsuba`` that describes it."""


def load(name: str) -> Any:
    """Return one of the `SCENES`."""
    mi = load_mitsuba("cpu")
    return mi.load_dict(SCENES[name](mi))
