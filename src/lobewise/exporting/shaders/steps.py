"""The passes of the chains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lobewise.exporting.shaders.declarations import copy_template
from lobewise.exporting.shaders.images import list_sums
from lobewise.exporting.shaders.passes import Image, Lifetime, Pass
from lobewise.filters.forms import ATROUS_RADIUS, Taps, list_form_passes


@dataclass(frozen=True)
class Layer:
    """Light that is filtered apart.

    Parameters
    ----------
    name : str
    light : str
        What it is, for comments.
    libraries : sequence of str
        The shader functions that compare its pixels.
    guides : sequence of str
        The images that they read.
    is_reflected : bool
        Whether its history is also looked for at the place of the reflection.
    """

    name: str
    light: str
    libraries: Sequence[str]
    guides: Sequence[str]
    is_reflected: bool = False

    def bind_guides(self) -> dict[str, str]:
        """Return the guides as bindings."""
        return {name: name for name in self.guides}


@dataclass(frozen=True)
class Lobes:
    """A kind of specular lobes: the images that hold it, and the templates that make and compare it."""

    guides: Sequence[str]
    functions: str
    part: str
    none: str = ""
    """What the pass that makes lobes also stores for a pixel without one."""

    @property
    def layers(self) -> tuple[Layer, Layer]:
        """The layers of light."""
        reflected = "light that surfaces reflect"
        return (
            Layer("diffuse", "light that surfaces scatter diffusely", ("diffuse",), ("points", "normals")),
            Layer("specular", reflected, (self.functions, "specular"), self.guides, is_reflected=True),
        )


LOBES = {
    "ggx": Lobes(
        ("points", "normals", "axes", "spreads"),
        "lobes_ggx",
        "lobe_ggx.part",
        "        store(spreads, pixel, vec4(0.0, 0.0, 0.0, 1.0));\n",
    ),
    "sg": Lobes(("points", "normals", "axes"), "lobes_sg", "lobe_sg.part"),
}
"""The kinds of lobes that chains have, by similarity."""

OWN_FOOTPRINT = (
    "spot.w * constants.pixel_angle * (1.0 + "
    "lobewise_find_own_motion(pixel, spot.xyz, load(motion, pixel).xy) / constants.plane_sigma)"
)
"""Width of a pixel on its surface, wider where the surface moved by itself."""


def make_guides_pass(lobes: Lobes, footprint: str, more: Sequence[str] = ()) -> Pass:
    """Return the pass that makes lobes."""
    return Pass(
        name="guides",
        comment="Makes what the other passes compare pixels by: place, normal and the lobe of the specular reflection.",
        body="guides.shader",
        parts={"footprint": footprint, "lobe": copy_template(lobes.part), "none": lobes.none},
        reads={name: name for name in ("surface", "place", *more)},
        writes={name: name for name in lobes.guides},
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


def make_filter_passes(layer: Layer, form: str, power: str, **more: str) -> tuple[list[Pass], list[Image]]:
    """Return the filter passes of a layer and the images between them.

    Parameters
    ----------
    layer : Layer
    form : str
        One of `lobewise.settings.FORM_NAMES`.
    power : str
        Expression of the power to which a pixel raises its weights.
    **more
        Further images that the expression reads, by their names in the shader.
    """
    passes: list[Pass] = []
    images: list[Image] = []
    read, source = "lobewise_read_radiance", {"radiance": layer.name, "albedo": f"{layer.name}_albedo"}
    for taps, _, step in list_form_passes(form, 0):
        described = _describe_taps(taps, step)
        after = f"{layer.name}_{described.name}"
        images += list_sums(after, f"{layer.name} light, summed over {described.over}", Lifetime.FRAME)
        passes.append(
            Pass(
                name=after,
                comment=f"Sums similar pixels over {described.over}: {layer.light}.\n"
                "weight = place on the screen * place in the scene * overlap of the lobes",
                body=described.body,
                parts={**described.parts, "power": power, "read": read},
                libraries=layer.libraries,
                reads={**layer.bind_guides(), **source, **more},
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


def make_reproject_pass(layer: Layer) -> Pass:
    """Return the pass that finds a layer's history."""
    guides = layer.bind_guides()
    where = "at its place in the frame before"
    part = ""
    if layer.is_reflected:
        guides["reflections"] = "reflections"
        where = "at the places of its surface and of its reflection in the frame before"
        part = copy_template("reflection.part")
    return Pass(
        name=f"{layer.name}_reproject",
        comment=f"Finds the history of every pixel {where}: {layer.light}.\n"
        "The history counts as far as surface and lobe are alike.",
        body="reproject.shader",
        parts={"reflection": part},
        libraries=layer.libraries,
        reads={
            "motion": "motion",
            **guides,
            **{f"{name}_before": f"{name}_before" for name in guides},
            **{f"past_{part}": f"{layer.name}_kept_{part}_before" for part in ("light", "more")},
        },
        writes={f"history_{part}": f"{layer.name}_history_{part}" for part in ("light", "more")},
    )


def make_trust_pass(layer: Layer, screen: str, parts: dict[str, str], extent: tuple[str, str]) -> Pass:
    """Return the pass that compares the samples of a layer with its history."""
    return Pass(
        name=f"{layer.name}_trust",
        comment=f"Tells how far the samples of this frame confirm the history: {layer.light}.\n"
        "The mean difference around a pixel is compared with its standard error, colour by colour.",
        body="trust.shader",
        parts={"screen": screen, "columns": extent[0], "rows": extent[1], **parts},
        libraries=layer.libraries,
        reads={
            **layer.bind_guides(),
            "radiance": layer.name,
            "albedo": f"{layer.name}_albedo",
            "history_light": f"{layer.name}_history_light",
        },
        writes={"trust": f"{layer.name}_trust"},
        extent=extent,
    )


def make_narrow_pass(layer: Layer, screen: str) -> Pass:
    """Return the pass that computes the trust of every pixel, and how narrow its kernel is."""
    return Pass(
        name=f"{layer.name}_narrow",
        comment=f"Averages the trust around every pixel, and narrows its kernel as its history grows: {layer.light}.",
        body="narrow.shader",
        parts={"screen": screen},
        libraries=layer.libraries,
        reads={
            **layer.bind_guides(),
            "trust": f"{layer.name}_trust",
            "history_more": f"{layer.name}_history_more",
        },
        writes={"narrowing": f"{layer.name}_narrowing"},
    )


def make_accumulate_pass(layer: Layer, sums: str) -> Pass:
    """Return the pass that adds the filtered frame to the history."""
    guides = layer.bind_guides()
    needed = ("normals", "axes") if "axes" in guides else ("normals",)
    return Pass(
        name=f"{layer.name}_accumulate",
        comment=f"Adds the filtered frame and the pixel's own sample to the history: {layer.light}.",
        body="accumulate.shader",
        libraries=layer.libraries,
        reads={
            **{name: name for name in needed},
            "radiance": layer.name,
            "albedo": f"{layer.name}_albedo",
            **{f"history_{part}": f"{layer.name}_history_{part}" for part in ("light", "more")},
            "narrowing": f"{layer.name}_narrowing",
            **{f"sums_{part}": f"{sums}_{part}" for part in ("light", "more")},
        },
        writes={f"kept_{part}": f"{layer.name}_kept_{part}" for part in ("light", "more")},
    )


def make_upsample_pass(layer: Layer) -> Pass:
    """Return the pass that brings samples to all pixels and adds them to the history."""
    return Pass(
        name=f"{layer.name}_upsample",
        comment=f"Brings one sample of every block to all pixels and adds it to the history: {layer.light}.\n"
        "The weight of a sample is the similarity of the pixel and of the shaded pixel.",
        body="upsample.shader",
        libraries=[*layer.libraries, "sparse"],
        reads={
            **layer.bind_guides(),
            "radiance": layer.name,
            "albedo": f"{layer.name}_albedo",
            **{f"history_{part}": f"{layer.name}_history_{part}" for part in ("light", "more")},
            "trust": f"{layer.name}_trust",
        },
        writes={f"kept_{part}": f"{layer.name}_kept_{part}" for part in ("light", "more")},
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
