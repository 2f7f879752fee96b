"""Chooses who renders the light of a frame: the path tracer of this package, or the scene's own integrator.

A scene file names its integrator. If this package's path tracer estimates the same light, it renders the frame, because
it splits light by lobe, which helps filters. All other integrators (participating media, hidden emitters, light traced
from the lamps) render their light themselves, through a copy of the sensor with a box filter, so that pixels are
independent. The guides describe the first surface in both cases.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lobewise.errors import InputError, require_choice, require_integer
from lobewise.render.bridge import dr, mi
from lobewise.render.camera import get_sensor, has_lens, is_flat
from lobewise.render.materials.bsdfs import list_nested, list_shapes, tell_attributes
from lobewise.render.variant import VARIANTS

INTEGRATORS = ("auto", "paths", "scene")
"""Choices of the user."""
LIGHTS = {"all": 0, "indirect": 2}
"""Smallest number of scatterings of the light, by the user's choice."""
DEPTH = 8
"""Longest path in scenes without an integrator, vertices after the camera."""
MAX_DEPTH = 1 << 16
"""Longest path that a user can ask for, vertices after the camera."""

PATHS = ("PathIntegrator", "PRBIntegrator", "BasicPRBIntegrator", "PathProjectiveIntegrator")
"""Integrators that estimate the light of paths."""
VOLUMES = ("VolumetricPathIntegrator", "VolpathMisIntegratorImpl", "PRBVolpathIntegrator")
"""Integrators that estimate the light of paths if the scene has neither media nor null surfaces."""
DIRECT = ("DirectIntegrator", "DirectProjectiveIntegrator")
"""Integrators that estimate the light of paths of `DIRECT_DEPTH` vertices."""
HIDING = ("PathIntegrator", "VolumetricPathIntegrator", "DirectIntegrator")
"""Integrators whose light paths estimate also where emitters are hidden. Behind null surfaces only the first of them
hides emitters as paths do."""
DIRECT_DEPTH = 2
TOLD_OF_FLAT = "The sensor is orthographic: in the camera of the frame a pinhole far away stands for it."
_TWINS = {
    "PRBIntegrator": "path",
    "BasicPRBIntegrator": "path",
    "PathProjectiveIntegrator": "path",
    "PRBVolpathIntegrator": "volpath",
}
"""Names of the integrators in C++ that estimate the light of Mitsuba's integrators in Python."""
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
"""Names of integrators in scene files, by class name."""


@dataclass(frozen=True)
class Light:
    """How the light of a frame is rendered."""

    max_depth: int
    """Longest path of this package's path tracer, vertices after the camera."""
    own: Any = None
    """The scene's own ``mitsuba.Integrator`` if it renders the light, otherwise None."""
    lens: bool = False
    """Whether the light comes through a wide lens, through which paths and guides of a single ray cannot look."""
    sentence: str = ""
    """Sentence for the user about the light; empty if there is nothing to say."""


def check_scene(scene: Any) -> None:
    """Raise InputError unless this is a Mitsuba scene of a supported variant."""
    variant = mi.variant()
    if variant not in VARIANTS.values() or not isinstance(scene, mi.Scene):
        expected = "a mitsuba.Scene of the variant " + " or ".join(VARIANTS.values())
        got = f"a {type(scene).__name__} under the variant {variant}"
        action = "call load_mitsuba() first, then load the scene: colours are rendered as RGB, without polarisation"
        raise InputError("scene", expected=expected, got=got, action=action)


def plan_light(scene: Any, integrator: str = "auto", max_depth: int | None = None) -> Light:
    """Return how the light of a scene is rendered.

    Parameters
    ----------
    scene : mitsuba.Scene
        Its integrator and its sensor are read.
    integrator : {"auto", "paths", "scene"}
        "paths" is the path tracer of this package and "scene" is the scene's own integrator. "auto" chooses paths if
        they estimate the light of the scene's own integrator.
    max_depth : int, optional
        Longest path, vertices after the camera; by default that of the scene's integrator.

    Raises
    ------
    InputError
        If the variant of the scene is not supported, or the scene's own integrator shall render the light but is
        missing, makes no image of light, or gets a ``max_depth``.
    """
    check_scene(scene)
    require_choice("integrator", integrator, INTEGRATORS)
    if max_depth is not None:
        require_integer("max_depth", max_depth, 1, MAX_DEPTH)
    light = _choose_light(scene, integrator, max_depth)
    return replace(light, sentence=f"{light.sentence} {TOLD_OF_FLAT}".strip()) if is_flat(scene) else light


def _choose_light(scene: Any, integrator: str, max_depth: int | None) -> Light:
    own = scene.integrator()
    if has_lens(scene):
        return _plan_lens(own, integrator, max_depth)
    if own is None:
        if integrator == "scene":
            action = "add one to the scene, or leave the choice out"
            raise InputError("integrator", expected="one in the scene", got="none", action=action)
        return Light(max_depth or DEPTH, sentence=_tell_media(scene))
    depth = None if integrator == "scene" else _look_up_depth(scene, own)
    if integrator == "paths" or depth is not None:
        other = f"Light by paths, as asked for; the scene's own {name_integrator(own)} would give other light."
        return Light(max_depth or depth or DEPTH, sentence=other if depth is None else _tell_media(scene))
    _require_light(own)
    _refuse_depth(own, max_depth)
    return Light(
        DEPTH,
        own,
        sentence=f"Light by the scene's own integrator, {name_integrator(own)}: one image, not split by lobe.",
    )


def _plan_lens(own: Any, integrator: str, max_depth: int | None) -> Light:
    """Return how the light of a scene is rendered through a lens."""
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
    sentence = f"Light through the lens by {whose}: one image, not split by lobe; guides are means over the lens."
    return Light(DEPTH, own, lens=True, sentence=sentence)


def _refuse_depth(own: Any, max_depth: int | None) -> None:
    """Raise InputError if a depth is given although the scene's own integrator renders the light."""
    if max_depth is not None:
        raise InputError(
            "max_depth",
            expected=f"none, as the scene's own integrator, {name_integrator(own)}, renders the light",
            got=str(max_depth),
            action="change it in the scene, or ask for integrator 'paths'",
        )


def plan_pixels(scene: Any, what: str, integrator: str = "auto", max_depth: int | None = None) -> Light:
    """Return `plan_light` for ``what`` (words for the message), which needs the light of single pixels.

    ``own`` is then an integrator whose ``sample`` gives the light of single rays.

    Raises
    ------
    InputError
        If the integrator that renders the light renders no single rays, or if `plan_light` raises it.
    """
    light = plan_light(scene, integrator, max_depth)
    if light.own is None:
        return light
    own = choose_sampler(light.own)
    if own is None:
        raise InputError(
            "integrator",
            expected=f"one that renders single rays, for {what}",
            got=name_integrator(light.own),
            action="render whole frames, or ask for integrator 'paths', which gives other light",
        )
    return replace(light, own=own)


def name_integrator(integrator: Any) -> str:
    """Return the name of an integrator in scene files, quoted."""
    kind = _get_class(integrator)
    return repr(PLUGINS.get(kind, kind))


def _get_class(integrator: Any) -> str:
    return type(integrator).__name__ if _is_python(integrator) else str(integrator.class_name())


def _is_python(integrator: Any) -> bool:
    module = type(integrator).__module__
    return module.partition(".")[0] != "mitsuba" or "python" in module


def _look_up_depth(scene: Any, integrator: Any) -> int | None:
    """Return the length of the paths that estimate an integrator's light; None if paths do not estimate it."""
    kind = _get_class(integrator)
    text = str(integrator)
    if kind == "AOVIntegrator":
        nested = _list_nested_text(text)
        if len(nested) != 1 or not nested[0].startswith("PathIntegrator") or not _shows_emitters(integrator):
            return None
        return _read_depth(nested[0])
    if getattr(integrator, "hide_emitters", True) and (
        kind not in HIDING or (kind != "PathIntegrator" and _has_volumes(scene))
    ):
        return None
    if kind in DIRECT:
        counts = re.findall(r"(?:emitter|bsdf)_samples = (\d+)", text)
        return None if "0" in counts else DIRECT_DEPTH
    if kind in PATHS or (kind in VOLUMES and not _has_volumes(scene)):
        depth = getattr(integrator, "max_depth", None)
        return _read_depth(text) if depth is None else _bound(int(depth))
    return None


def _read_depth(text: str) -> int | None:
    """Return the depth from the text description of an integrator."""
    match = re.search(r"max_depth = (-?\d+)", text)
    return _bound(int(match[1])) if match else None


def _bound(depth: int) -> int | None:
    if depth == 0:
        return None  # paths without a vertex give a black image
    return MAX_DEPTH if depth < 0 else min(depth, MAX_DEPTH)


def _list_nested_text(text: str) -> list[str]:
    """Return the descriptions of the nested integrators from the description of an integrator."""
    inner = text.partition("integrators = [")[2]
    return re.findall(r"(\w+\[[^\[\]]*\])", inner)


def _shows_emitters(integrator: Any) -> bool:
    """Return whether an integrator renders a visible sky. Nested integrators do not expose ``hide_emitters``."""
    film = {"type": "hdrfilm", "width": 1, "height": 1, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    sky = mi.load_dict({"type": "scene", "sky": {"type": "constant", "radiance": 1.0}})
    sensor = mi.load_dict({"type": "perspective", "film": film})
    with dr.suspend_grad():
        image = np.array(integrator.render(sky, sensor, seed=0, spp=1))
    return bool(image[0, 0, :3].min() > 0.5)


def _has_media(scene: Any) -> bool:
    if scene.sensors() and get_sensor(scene).get_medium() is not None:
        return True
    return any(shape.is_medium_transition() for shape in list_shapes(scene))


def _tell_media(scene: Any) -> str:
    """Return a remark on participating media that are not rendered; empty without media."""
    if not _has_media(scene):
        return ""
    own = scene.integrator()
    whose = "paths do" if own is None else f"the scene's integrator, {name_integrator(own)}, does"
    return f"There are participating media, which {whose} not render; put 'volpath' into the scene to see them."


def read_path_depth(scene: Any) -> int:
    """Return the longest path, vertices after the camera, of the scene's integrator; `DEPTH` if it has none."""
    own = scene.integrator()
    return (None if own is None else _look_up_depth(scene, own)) or DEPTH


def choose_sampler(integrator: Any) -> Any:
    """Return the integrator whose ``sample`` gives the light of single rays, or None if there is none.

    An integrator that Mitsuba wrote in Python is replaced by the one in C++ that estimates the same light.
    """
    kind = _get_class(integrator)
    if kind in _TWINS:
        same = {name: getattr(integrator, name) for name in ("rr_depth", "hide_emitters")}
        # Mitsuba's Python integrators hold an endless depth as the largest number.
        return mi.load_dict({"type": _TWINS[kind], "max_depth": min(int(integrator.max_depth), MAX_DEPTH), **same})
    plain = isinstance(integrator, mi.SamplingIntegrator) and not _is_python(integrator)
    return integrator if plain else None


def choose_own_light(scene: Any) -> Any:
    """Return the integrator that must render the light of a scene ray by ray, because paths do not estimate it.

    None if paths do, or if the scene's integrator renders no single rays. The width of a lens makes no difference.
    """
    own = scene.integrator()
    if own is None or _look_up_depth(scene, own) is not None or not _makes_light(own):
        return None
    return choose_sampler(own)


def choose_lens_light(scene: Any) -> Any:
    """Return the integrator for the light through a scene's lens, or None if the scene is not seen through a lens."""
    if not has_lens(scene):
        return None
    own = scene.integrator()
    sampled = choose_sampler(own) if own is not None and _makes_light(own) else None
    return mi.load_dict({"type": "path", "max_depth": read_path_depth(scene)}) if sampled is None else sampled


def tell_unseen(scene: Any) -> str:
    """Return a remark on how the pictures of `lobewise.interactive.Session` differ from the scene; empty if not at all.

    They differ by light of integrators that render no single rays, by media that the integrator does not render, and
    by the width of a lens while the camera moves. Lobes may be unknown, see `tell_attributes`.
    """
    own = scene.integrator()
    said = []
    sampled = choose_own_light(scene)
    if sampled is not None:
        said.append(
            f"With the method 'paths' all light is that of the scene's own {name_integrator(own)}; "
            "other methods show light of surfaces alone."
        )
    elif own is not None and _look_up_depth(scene, own) is None:
        said.append(f"The pictures show light by paths, not by the scene's own {name_integrator(own)}.")
    if sampled is None and _has_media(scene):
        said.append(_tell_media(scene))
    if has_lens(scene):
        said.append("The picture is sharp while the camera moves, and is seen through the lens when the camera rests.")
    if is_flat(scene):
        said.append(TOLD_OF_FLAT)
    said.append(tell_attributes(scene))
    return " ".join(filter(None, said))


def _has_volumes(scene: Any) -> bool:
    """Return whether there are media, or null surfaces, through which light passes unscattered."""
    if _has_media(scene):
        return True
    for shape in list_shapes(scene):
        for bsdf in list_nested(shape.bsdf()) if shape.bsdf() is not None else ():
            if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null):
                return True
    return False


def _makes_light(integrator: Any) -> bool:
    kind = _get_class(integrator)
    return kind != "DepthIntegrator" and not (kind == "AOVIntegrator" and not _list_nested_text(str(integrator)))


def _require_light(integrator: Any) -> None:
    """Raise InputError if an integrator makes no image of light."""
    if not _makes_light(integrator):
        empty = _get_class(integrator) == "AOVIntegrator"
        raise InputError(
            "integrator",
            expected="one that makes an image of light",
            got=f"{name_integrator(integrator)}{' without one inside' if empty else ''}",
            action="put another into the scene, or ask for integrator 'paths'",
        )
