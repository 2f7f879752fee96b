"""The passes of the chains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lobewise.exporting.shaders.images import list_sums
from lobewise.exporting.shaders.library import copy_template
from lobewise.exporting.shaders.passes import Image, Lifetime, Pass
from lobewise.filters.forms import ATROUS_RADIUS, Taps, list_passes

_LIGHT = {"diffuse": "light that surfaces scatter diffusely", "specular": "light that surfaces reflect"}
_GUIDES = ("points", "normals", "axes", "spreads")


def list_layer_guides(layer: str) -> dict[str, str]:
    """Return the guides that a layer's pixels are compared by, as bindings."""
    return {name: name for name in (_GUIDES if layer == "specular" else _GUIDES[:2])}


OWN_FOOTPRINT = (
    "spot.w * constants.pixel_angle * (1.0 + "
    "lobewise_find_own_motion(pixel, spot.xyz, load(motion, pixel).xy) / constants.plane_sigma)"
)
"""Width of a pixel on its surface, wider where the surface moved by itself."""


def make_guides_pass(footprint: str, more: Sequence[str] = ()) -> Pass:
    """Return the pass that makes lobes."""
    return Pass(
        name="guides",
        comment="Makes what the other passes compare pixels by: place, normal and the lobe of the specular reflection.",
        body="guides.shader",
        parts={"footprint": footprint},
        reads={name: name for name in ("surface", "place", *more)},
        writes={name: name for name in _GUIDES},
    )


@dataclass(frozen=True)
class _Taps:
    """How the text of a filter pass differs by its taps: its name, its comment, its body and what fills it in."""

    name: str
    over: str
    body: str
    parts: dict[str, str]


def _describe_taps(taps: Taps, step: int) -> _Taps:
    if taps is Taps.SQUARE:
        screen = "lobewise_compare_screen(vec2(float(u), float(v)), constants.screen_sigma)"
        parts = {"reach": "constants.radius", "spread": "ivec2(u, v)", "screen": screen}
        return _Taps("square", "all pixels around", "square.shader", parts)
    if taps is Taps.ATROUS:
        spread = "ivec2(u, v)" if step == 1 else f"{step} * ivec2(u, v)"
        screen = "lobewise_find_profile(u) + lobewise_find_profile(v)"
        parts = {"reach": str(ATROUS_RADIUS), "spread": spread, "screen": screen}
        return _Taps(f"step_{step}", f"5 x 5 pixels, {step} apart", "square.shader", parts)
    name, parts = ("row", {"step": "k, 0"}) if taps is Taps.HORIZONTAL else ("column", {"step": "0, k"})
    return _Taps(name, f"a {name}", "line.shader", parts)


def make_filter_passes(layer: str, form: str, power: str, **more: str) -> tuple[list[Pass], list[Image]]:
    """Return the filter passes of a layer and the images between them.

    Parameters
    ----------
    layer : {"diffuse", "specular"}
    form : str
        One of `lobewise.settings.FORMS`.
    power : str
        Expression of the power to which a pixel raises its weights.
    **more
        Further images that the expression reads, by their names in the shader.
    """
    passes: list[Pass] = []
    images: list[Image] = []
    read, source = "lobewise_read_radiance", {"radiance": layer, "albedo": f"{layer}_albedo"}
    for taps, _, step in list_passes(form, 0):
        told = _describe_taps(taps, step)
        after = f"{layer}_{told.name}"
        images += list_sums(after, f"{layer} light, summed over {told.over}", Lifetime.FRAME)
        passes.append(
            Pass(
                name=after,
                comment=f"Sums similar pixels over {told.over}: {_LIGHT[layer]}.\n"
                "weight = place on the screen * place in the scene * overlap of the lobes",
                body=told.body,
                parts={**told.parts, "power": power, "read": read},
                libraries=[layer],
                reads={**list_layer_guides(layer), **source, **more},
                writes={"added_light": f"{after}_light", "added_more": f"{after}_more"},
            )
        )
        read, source = "lobewise_read_sums", {"sums_light": f"{after}_light", "sums_more": f"{after}_more"}
    return passes, images


def make_reflections_pass() -> Pass:
    """Return the pass that finds where reflections were in the frame before."""
    return Pass(
        name="reflections",
        comment="Finds where each pixel's reflection was in the frame before: at its virtual image behind the mirror.",
        body="reflections.shader",
        reads={name: name for name in ("surface", "place", "hits")},
        writes={"reflections": "reflections"},
    )


def make_reproject_pass(layer: str) -> Pass:
    """Return the pass that finds a layer's history."""
    guides = list_layer_guides(layer)
    where = "at its place in the frame before"
    part = ""
    if layer == "specular":
        guides["reflections"] = "reflections"
        where = "at the places of its surface and of its reflection in the frame before"
        part = copy_template("reflection.part")
    return Pass(
        name=f"{layer}_reproject",
        comment=f"Finds the history of every pixel {where}: {_LIGHT[layer]}.\n"
        "The history counts as far as surface and lobe are alike.",
        body="reproject.shader",
        parts={"reflection": part},
        libraries=[layer],
        reads={
            "motion": "motion",
            **guides,
            **{f"{name}_before": f"{name}_before" for name in guides},
            **{f"past_{part}": f"{layer}_kept_{part}_before" for part in ("light", "more")},
        },
        writes={f"history_{part}": f"{layer}_history_{part}" for part in ("light", "more")},
    )


def make_trust_pass(layer: str, screen: str, parts: dict[str, str], extent: tuple[str, str]) -> Pass:
    """Return the pass that compares the samples of a layer with its history."""
    return Pass(
        name=f"{layer}_trust",
        comment=f"Tells how far the samples of this frame confirm the history: {_LIGHT[layer]}.\n"
        "The mean difference around a pixel is compared with its standard error, colour by colour.",
        body="trust.shader",
        parts={"screen": screen, "columns": extent[0], "rows": extent[1], **parts},
        libraries=[layer],
        reads={
            **list_layer_guides(layer),
            "radiance": layer,
            "albedo": f"{layer}_albedo",
            "history_light": f"{layer}_history_light",
        },
        writes={"trust": f"{layer}_trust"},
        extent=extent,
    )


def make_narrow_pass(layer: str, screen: str) -> Pass:
    """Return the pass that computes the trust of every pixel, and how narrow its kernel is."""
    return Pass(
        name=f"{layer}_narrow",
        comment=f"Averages the trust around every pixel, and narrows its kernel as its history grows: {_LIGHT[layer]}.",
        body="narrow.shader",
        parts={"screen": screen},
        libraries=[layer],
        reads={
            **list_layer_guides(layer),
            "trust": f"{layer}_trust",
            "history_more": f"{layer}_history_more",
        },
        writes={"narrowing": f"{layer}_narrowing"},
    )


def make_accumulate_pass(layer: str, sums: str) -> Pass:
    """Return the pass that adds the filtered frame to the history."""
    guides = list_layer_guides(layer)
    needed = ("normals", "axes") if "axes" in guides else ("normals",)
    return Pass(
        name=f"{layer}_accumulate",
        comment=f"Adds the filtered frame and the pixel's own sample to the history: {_LIGHT[layer]}.",
        body="accumulate.shader",
        libraries=[layer],
        reads={
            **{name: name for name in needed},
            "radiance": layer,
            "albedo": f"{layer}_albedo",
            **{f"history_{part}": f"{layer}_history_{part}" for part in ("light", "more")},
            "narrowing": f"{layer}_narrowing",
            **{f"sums_{part}": f"{sums}_{part}" for part in ("light", "more")},
        },
        writes={f"kept_{part}": f"{layer}_kept_{part}" for part in ("light", "more")},
    )


def make_upsample_pass(layer: str) -> Pass:
    """Return the pass that brings samples to all pixels and adds them to the history."""
    return Pass(
        name=f"{layer}_upsample",
        comment=f"Brings one sample of every block to all pixels and adds it to the history: {_LIGHT[layer]}.\n"
        "The weight of a sample is the similarity of the pixel and of the shaded pixel.",
        body="upsample.shader",
        libraries=[layer, "sparse"],
        reads={
            **list_layer_guides(layer),
            "radiance": layer,
            "albedo": f"{layer}_albedo",
            **{f"history_{part}": f"{layer}_history_{part}" for part in ("light", "more")},
            "trust": f"{layer}_trust",
        },
        writes={f"kept_{part}": f"{layer}_kept_{part}" for part in ("light", "more")},
    )


def make_composite_pass(sums: dict[str, str], *, has_noisy: bool) -> Pass:
    """Return the last pass; ``sums`` names the image of each layer's sums."""
    noisy = {f"{layer}_noisy": layer for layer in sums} if has_noisy else {}
    black = "vec3(0.0, 0.0, 0.0)"
    parts = {f"{layer}_noisy": f"load({layer}_noisy, pixel).xyz" if has_noisy else black for layer in sums}
    return Pass(
        name="composite",
        comment="Divides the sums of both layers by their weights, multiplies by the albedos and adds the emission.",
        body="composite.shader",
        parts=parts,
        reads={
            **{f"{layer}_sums": image for layer, image in sums.items()},
            **{f"{layer}_albedo": f"{layer}_albedo" for layer in sums},
            **noisy,
            "emission": "emission",
        },
        writes={"image": "image"},
    )
