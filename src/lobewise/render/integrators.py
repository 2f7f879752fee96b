"""Whose light a frame holds: that of the paths of this package, or that of the scene's own integrator.

A scene file says how its light is to be computed, and only some of Mitsuba's integrators estimate what the path tracer
of this package does. Of those the light is told apart by lobe, which filters like. All others (participating media,
emitters that hide, light traced from the lamps) render their light themselves, through a copy of the sensor with a box
filter, so that pixels are independent; guides are those of the first surface all the same.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise.errors import InputError, require_choice, require_integer
from lobewise.render.bridge import dr, mi
from lobewise.render.camera import get_sensor, has_lens
from lobewise.render.materials.bsdfs import list_nested
from lobewise.render.variant import VARIANTS

INTEGRATORS = ("auto", "paths", "scene")
"""What can be asked for."""
DEPTH = 8
"""Longest path of scenes without an integrator."""
DEEPEST = 1 << 16

PATHS = ("PathIntegrator", "PRBIntegrator", "BasicPRBIntegrator", "PathProjectiveIntegrator")
"""Integrators whose light is that of paths."""
VOLUMES = ("VolumetricPathIntegrator", "VolpathMisIntegratorImpl", "PRBVolpathIntegrator")
"""Those whose light is that of paths where there are no media, and no surfaces that light passes unnoticed."""
DIRECT = ("DirectIntegrator", "DirectProjectiveIntegrator")
"""Those of paths of two vertices."""
DIRECT_DEPTH = 2
PLUGINS = {
    "PathIntegrator": "path",
    "VolumetricPathIntegrator": "volpath",
    "VolpathMisIntegratorImpl": "volpathmis",
    "DirectIntegrator": "direct",
    "ParticleTracerIntegrator": "ptracer",
    "PRBIntegrator": "prb",
    "PRBVolpathIntegrator": "prbvolpath",
    "AOVIntegrator": "aov",
    "MomentIntegrator": "moment",
    "DepthIntegrator": "depth",
}
"""Names in scene files, by class."""


@dataclass(frozen=True)
class Light:
    """Whose light a frame holds.

    Parameters
    ----------
    max_depth : int
        Longest of this package's paths, in vertices after the camera.
    own : mitsuba.Integrator or None
        The scene's, where it renders the light.
    lens : bool
        Whether it comes through a lens of some width, which paths and guides of one ray know nothing of.
    told : str
        That in a sentence; empty where there is nothing to tell.
    """

    max_depth: int
    own: Any = None
    lens: bool = False
    told: str = ""


def check_scene(scene: Any) -> None:
    """Raise InputError unless this is a scene of a variant that is rendered."""
    variant = mi.variant()
    if variant not in VARIANTS.values() or not isinstance(scene, mi.Scene):
        expected = "a mitsuba.Scene of the variant " + " or ".join(VARIANTS.values())
        got = f"a {type(scene).__name__} under the variant {variant}"
        action = "call load_mitsuba() first, then load the scene: colours are rendered as RGB, without polarisation"
        raise InputError("scene", expected=expected, got=got, action=action)


def plan_light(scene: Any, integrator: str = "auto", max_depth: int | None = None) -> Light:
    """Return whose light a frame of a scene shall hold.

    Parameters
    ----------
    scene : mitsuba.Scene
        Its integrator and its first sensor count.
    integrator : {"auto", "paths", "scene"}
        "paths" are those of this package, "scene" is the scene's own integrator, and "auto" takes paths where they
        estimate the same light.
    max_depth : int, optional
        Longest path; by default that of the scene's integrator.

    Raises
    ------
    InputError
        If the scene is of another variant, its integrator makes no image of light, there is none, or a depth is given
        for it.
    """
    check_scene(scene)
    require_choice("integrator", integrator, INTEGRATORS)
    if max_depth is not None:
        require_integer("max_depth", max_depth, 1, DEEPEST)
    own = scene.integrator()
    if has_lens(scene):
        return _plan_lens(own, integrator, max_depth)
    if own is None:
        if integrator == "scene":
            action = "add one to the scene, or leave the choice out"
            raise InputError("integrator", expected="one in the scene", got="none", action=action)
        return Light(max_depth or DEPTH, told=_tell_media(scene))
    depth = None if integrator == "scene" else _find_depth(scene, own)
    if integrator == "paths" or depth is not None:
        other = f"Light by paths as asked for, which is not that of the scene's own {name_integrator(own)}."
        return Light(max_depth or depth or DEPTH, told=other if depth is None else _tell_media(scene))
    _require_light(own)
    _refuse_depth(own, max_depth)
    return Light(
        DEPTH,
        own,
        told=f"Light by the scene's own integrator, {name_integrator(own)}: one image, not told apart by lobe.",
    )


def _plan_lens(own: Any, integrator: str, max_depth: int | None) -> Light:
    """Return the light of a scene that is seen through a lens."""
    if integrator == "paths":
        action = "leave the choice out, or use a perspective sensor"
        raise InputError("integrator", expected="'scene' or 'auto', for a lens", got="'paths'", action=action)
    if own is None:
        depth = DEPTH if max_depth is None else max_depth
        own = mi.load_dict({"type": "path", "max_depth": depth})
    else:
        _refuse_depth(own, max_depth)
    _require_light(own)
    whose = name_integrator(own)
    told = f"Light through the lens by {whose}: one image, not told apart by lobe; guides are means over the lens."
    return Light(DEPTH, own, lens=True, told=told)


def _refuse_depth(own: Any, max_depth: int | None) -> None:
    """Raise InputError if a depth is given for an integrator that has its own."""
    if max_depth is not None:
        raise InputError(
            "max_depth",
            expected=f"none, as the scene's own integrator, {name_integrator(own)}, renders the light",
            got=str(max_depth),
            action="change it in the scene, or ask for integrator 'paths'",
        )


def require_paths(scene: Any, what: str, integrator: str = "auto", max_depth: int | None = None) -> Light:
    """Return the light of ``what``, which only paths give.

    Raises
    ------
    InputError
        If they are not those of the scene's integrator, or as `plan_light`.
    """
    light = plan_light(scene, integrator, max_depth)
    if light.own is not None:
        seen = " through a lens" if light.lens else ""
        raise InputError(
            "integrator",
            expected=f"one whose light paths give, for {what}",
            got=name_integrator(light.own) + seen,
            action="render whole frames of all light, or ask for integrator 'paths', whose light is another",
        )
    return light


def name_integrator(integrator: Any) -> str:
    """Return the name of an integrator as scene files have it."""
    kind = _get_class(integrator)
    return repr(PLUGINS.get(kind, kind))


def _get_class(integrator: Any) -> str:
    python = type(integrator).__module__.partition(".")[0] != "mitsuba" or "python" in type(integrator).__module__
    return type(integrator).__name__ if python else str(integrator.class_name())


def _find_depth(scene: Any, integrator: Any) -> int | None:
    """Return the longest of the paths that estimate an integrator's light; None where paths do not."""
    kind = _get_class(integrator)
    text = str(integrator)
    if kind == "AOVIntegrator":
        nested = _list_nested_text(text)
        if len(nested) != 1 or not nested[0].startswith("PathIntegrator") or not _shows_emitters(integrator):
            return None
        return _read_depth(nested[0])
    if getattr(integrator, "hide_emitters", True):
        return None
    if kind in DIRECT:
        counts = re.findall(r"(?:emitter|bsdf)_samples = (\d+)", text)
        return None if "0" in counts else DIRECT_DEPTH
    if kind in PATHS or (kind in VOLUMES and not _has_volumes(scene)):
        depth = getattr(integrator, "max_depth", None)
        return _read_depth(text) if depth is None else _bound(int(depth))
    return None


def _read_depth(text: str) -> int | None:
    """Return the depth that the description of an integrator tells."""
    found = re.search(r"max_depth = (-?\d+)", text)
    return _bound(int(found[1])) if found else None


def _bound(depth: int) -> int | None:
    if depth == 0:
        return None  # paths of no vertex: an image without light, which is nobody's wish here
    return DEEPEST if depth < 0 else min(depth, DEEPEST)


def _list_nested_text(text: str) -> list[str]:
    """Return the descriptions of the integrators inside one that describes itself so."""
    inner = text.partition("integrators = [")[2]
    return re.findall(r"(\w+\[[^\[\]]*\])", inner)


def _shows_emitters(integrator: Any) -> bool:
    """Return whether a sky is seen through an integrator, which does not tell of those inside it."""
    film = {"type": "hdrfilm", "width": 1, "height": 1, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    sky = mi.load_dict({"type": "scene", "sky": {"type": "constant", "radiance": 1.0}})
    sensor = mi.load_dict({"type": "perspective", "film": film})
    with dr.suspend_grad():
        image = np.array(integrator.render(sky, sensor, seed=0, spp=1))
    return bool(image[0, 0, :3].min() > 0.5)


def _has_media(scene: Any) -> bool:
    if scene.sensors() and get_sensor(scene).get_medium() is not None:
        return True
    return any(shape.is_medium_transition() for shape in scene.shapes())


def _tell_media(scene: Any) -> str:
    """Return a remark on media that nobody renders; empty without any."""
    if not _has_media(scene):
        return ""
    own = scene.integrator()
    whose = "paths do" if own is None else f"the scene's integrator, {name_integrator(own)}, does"
    return f"There are participating media, which {whose} not see: 'volpath' in the scene would."


def tell_unseen(scene: Any) -> str:
    """Return what paths from the centres of pixels, the light of a preview, do not show; empty where nothing is missed.

    That is light of another integrator of the scene's, participating media, and the width of a lens.
    """
    own = scene.integrator()
    other = own is not None and _find_depth(scene, own) is None
    missed = ["participating media"] * _has_media(scene) + ["the width of the lens"] * has_lens(scene)
    if not missed and not other:
        return ""
    whose = f", not by the scene's own {name_integrator(own)}" if other else ""
    without = f", without {' and '.join(missed)}" if missed else ""
    return f"The pictures show light by paths{whose}{without}."


def _has_volumes(scene: Any) -> bool:
    """Return whether there are media, or surfaces that light passes without being scattered."""
    if _has_media(scene):
        return True
    for shape in scene.shapes():
        for bsdf in list_nested(shape.bsdf()) if shape.bsdf() is not None else ():
            if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null):
                return True
    return False


def _require_light(integrator: Any) -> None:
    """Raise InputError if an integrator makes no image of light."""
    kind = _get_class(integrator)
    empty = kind == "AOVIntegrator" and not _list_nested_text(str(integrator))
    if kind == "DepthIntegrator" or empty:
        raise InputError(
            "integrator",
            expected="one that makes an image of light",
            got=f"{name_integrator(integrator)}{' without one inside' if empty else ''}",
            action="put another into the scene, or ask for integrator 'paths'",
        )
