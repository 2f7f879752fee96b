"""Items of scenes, as Mitsuba takes them."""

from collections.abc import Sequence
from typing import Any

Items = dict[str, Any]


def rgb(*value: float) -> Items:
    return {"type": "rgb", "value": list(value)}


def make_camera(
    mi: Any,
    origin: Sequence[float],
    target: Sequence[float] = (0, 0, 0),
    *,
    up: Sequence[float] = (0, 1, 0),
    size: tuple[int, int] = (8, 8),
    box: bool = True,
    **more: Any,
) -> Items:
    """Return a pinhole camera at a point; with ``box`` a sample counts in its own pixel alone."""
    film: Items = {"type": "hdrfilm", "width": size[0], "height": size[1]}
    if box:
        film["rfilter"] = {"type": "box"}
    where = mi.ScalarTransform4f().look_at(origin=list(origin), target=list(target), up=list(up))
    return {"type": "perspective", "to_world": where, "film": film, **more}


def make_square(to_world: Any, **more: Any) -> Items:
    """Return a square of two units, moved to its place."""
    return {"type": "rectangle", "to_world": to_world, **more}


def make_lamp(to_world: Any, radiance: Any) -> Items:
    """Return a square that emits light."""
    return make_square(to_world, emitter={"type": "area", "radiance": radiance})
