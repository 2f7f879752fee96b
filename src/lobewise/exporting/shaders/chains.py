"""The chains that can be exported, and their passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from lobewise.errors import require_choice
from lobewise.exporting.folder import read_template
from lobewise.exporting.names import CHAINS
from lobewise.exporting.shaders.constants import FILTER_CONSTANTS, HISTORY_CONSTANTS, UPSAMPLE_CONSTANTS
from lobewise.exporting.shaders.images import (
    GIVEN,
    HITS,
    LAYERS,
    MOTION,
    REFLECTIONS,
    RESULT,
    SAMPLES,
    keep,
    list_guides,
    list_history,
    list_sums,
)
from lobewise.exporting.shaders.passes import Chain, Image, Lifetime, Pass
from lobewise.filters.forms import ATROUS_RADIUS, Taps, list_form_passes
from lobewise.settings import FORM_NAMES


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

    @property
    def samples(self) -> dict[str, str]:
        """The noisy light and its albedo as bindings."""
        return {"radiance": self.name, "albedo": f"{self.name}_albedo"}

    def make_pass(
        self, step: str, comment: str, *, reads: dict[str, str], writes: dict[str, str], body: str = "", **more: Any
    ) -> Pass:
        """Return a pass of the layer. In its comment ``{}`` stands for what the layer is."""
        return Pass(
            name=f"{self.name}_{step}",
            comment=comment.format(self.light),
            body=body or f"{step}.shader",
            reads=reads,
            writes=writes,
            **{"libraries": self.libraries, **more},
        )


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

FOOTPRINT = "spot.w * constants.pixel_angle"
"""Width of a pixel on its surface."""
OWN_FOOTPRINT = (
    f"{FOOTPRINT} * (1.0 + lobewise_find_own_motion(pixel, spot.xyz, load(motion, pixel).xy) / constants.plane_sigma)"
)
"""The same, wider where the surface moved by itself."""


def bind(*names: str) -> dict[str, str]:
    """Return images as bindings of the same names."""
    return {name: name for name in names}


def bind_sums(name: str, image: str) -> dict[str, str]:
    """Return the two images of sums as bindings; ``{}`` stands for what tells them apart."""
    return {name.format(part): image.format(part) for part in ("light", "more")}


def make_guides_pass(lobes: Lobes, footprint: str, more: Sequence[str] = ()) -> Pass:
    """Return the pass that makes lobes."""
    return Pass(
        name="guides",
        comment="Makes what the other passes compare pixels by: place, normal and the lobe of the specular reflection.",
        body="guides.shader",
        parts={"footprint": footprint, "lobe": read_template(f"shaders/{lobes.part}"), "none": lobes.none},
        reads=bind("surface", "place", *more),
        writes=bind(*lobes.guides),
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
    read, source = "lobewise_read_radiance", layer.samples
    for taps, _, step in list_form_passes(form, 0):
        described = _describe_taps(taps, step)
        after = f"{layer.name}_{described.name}"
        images += list_sums(after, f"{layer.name} light, summed over {described.over}", Lifetime.FRAME)
        passes.append(
            layer.make_pass(
                described.name,
                f"Sums similar pixels over {described.over}: {{}}.\n"
                "weight = place on the screen * place in the scene * overlap of the lobes",
                body=described.body,
                parts={**described.parts, "power": power, "read": read},
                reads={**bind(*layer.guides), **source, **more},
                writes=bind_sums("added_{}", f"{after}_{{}}"),
            )
        )
        read, source = "lobewise_read_sums", bind_sums("sums_{}", f"{after}_{{}}")
    return passes, images


def make_reflections_pass() -> Pass:
    """Return the pass that finds where reflections were in the frame before."""
    return Pass(
        name="reflections",
        comment="Finds where each pixel's reflection was in the frame before: at its virtual image behind the mirror.",
        body="reflections.shader",
        reads=bind("surface", "place", "hits"),
        writes=bind("reflections"),
    )


def make_reproject_pass(layer: Layer) -> Pass:
    """Return the pass that finds a layer's history."""
    guides, where, part = layer.guides, "at its place in the frame before", ""
    if layer.is_reflected:
        guides = (*guides, "reflections")
        where = "at the places of its surface and of its reflection in the frame before"
        part = read_template("shaders/reflection.part")
    return layer.make_pass(
        "reproject",
        f"Finds the history of every pixel {where}: {{}}.\nThe history counts as far as surface and lobe are alike.",
        parts={"reflection": part},
        reads={
            **bind("motion", *guides, *(f"{name}_before" for name in guides)),
            **bind_sums("past_{}", f"{layer.name}_kept_{{}}_before"),
        },
        writes=bind_sums("history_{}", f"{layer.name}_history_{{}}"),
    )


def make_trust_pass(layer: Layer, screen: str, parts: dict[str, str], extent: tuple[str, str], *more: str) -> Pass:
    """Return the pass that compares the samples of a layer with its history; ``more`` are libraries."""
    return layer.make_pass(
        "trust",
        "Tells how far the samples of this frame confirm the history: {}.\n"
        "The mean difference around a pixel is compared with its standard error, colour by colour.",
        parts={"screen": screen, "columns": extent[0], "rows": extent[1], **parts},
        reads={**bind(*layer.guides), **layer.samples, "history_light": f"{layer.name}_history_light"},
        writes={"trust": f"{layer.name}_trust"},
        extent=extent,
        libraries=[*layer.libraries, *more],
    )


def make_narrow_pass(layer: Layer, screen: str) -> Pass:
    """Return the pass that computes the trust of every pixel, and how narrow its kernel is."""
    return layer.make_pass(
        "narrow",
        "Averages the trust around every pixel, and narrows its kernel as its history grows: {}.",
        parts={"screen": screen},
        reads={
            **bind(*layer.guides),
            "trust": f"{layer.name}_trust",
            "history_more": f"{layer.name}_history_more",
        },
        writes={"narrowing": f"{layer.name}_narrowing"},
    )


def make_accumulate_pass(layer: Layer, sums: str) -> Pass:
    """Return the pass that adds the filtered frame to the history."""
    return layer.make_pass(
        "accumulate",
        "Adds the filtered frame and the pixel's own sample to the history: {}.",
        reads={
            **bind(*(name for name in layer.guides if name in ("normals", "axes"))),
            **layer.samples,
            **bind_sums("history_{}", f"{layer.name}_history_{{}}"),
            "narrowing": f"{layer.name}_narrowing",
            **bind_sums("sums_{}", f"{sums}_{{}}"),
        },
        writes=bind_sums("kept_{}", f"{layer.name}_kept_{{}}"),
    )


def make_upsample_pass(layer: Layer) -> Pass:
    """Return the pass that brings samples to all pixels and adds them to the history."""
    return layer.make_pass(
        "upsample",
        "Brings one sample of every block to all pixels and adds it to the history: {}.\n"
        "The weight of a sample is the similarity of the pixel and of the shaded pixel.",
        libraries=[*layer.libraries, "sparse"],
        reads={
            **bind(*layer.guides),
            **layer.samples,
            **bind_sums("history_{}", f"{layer.name}_history_{{}}"),
            "trust": f"{layer.name}_trust",
        },
        writes=bind_sums("kept_{}", f"{layer.name}_kept_{{}}"),
    )


def make_composite_pass(sums: dict[str, str], *, has_noisy: bool = True) -> Pass:
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
            **bind(*(f"{layer}_albedo" for layer in sums)),
            **noisy,
            **bind("emission"),
        },
        writes=bind("image"),
    )


SCREEN = "lobewise_compare_screen(offset, constants.screen_sigma)"
KEPT = {layer: f"{layer}_kept_light" for layer in LAYERS}
"""The sums that a history keeps of each layer."""


def make_filter_chain(form: str, lobes: Lobes) -> Chain:
    """Return the chain that filters each frame by itself: `lobewise.denoise` with quality "fast"."""
    images, passes = list_guides(lobes.guides, Lifetime.FRAME), [make_guides_pass(lobes, FOOTPRINT)]
    last = {}
    for layer in lobes.layers:
        more, between = make_filter_passes(layer, form, "1.0")
        passes, images = [*passes, *more], [*images, *between]
        last[layer.name] = more[-1].writes["added_light"]
    text = "Filters every frame by itself, as lobewise.denoise does with the quality 'fast'."
    images = [*GIVEN, *images, RESULT]
    return Chain("filter", text, images, FILTER_CONSTANTS, [*passes, make_composite_pass(last)])


def make_history_chain(form: str, lobes: Lobes) -> Chain:
    """Return the chain that joins each frame with its history: `TemporalFilter` on whole frames."""
    screen = "0.0" if form == "atrous" else SCREEN
    images, passes = begin_history(lobes)
    for layer in lobes.layers:
        trust = f"{layer.name}_narrowing"
        filters, between = make_filter_passes(layer, form, "load(narrowing, pixel).y", narrowing=trust)
        text = "trust in the history (x), power to which the pixel raises its weights (y)"
        images += [*list_history(layer.name), Image(trust, text, Lifetime.FRAME), *between]
        passes += [
            make_reproject_pass(layer),
            make_trust_pass(layer, screen, {"here": "pixel", "other": "tap"}, ("width", "height")),
            make_narrow_pass(layer, screen),
            *filters,
            make_accumulate_pass(layer, filters[-1].name),
        ]
    text = "Filters every frame and joins it with the history of those before, as lobewise.TemporalFilter does."
    return Chain("history", text, [*images, RESULT], HISTORY_CONSTANTS, [*passes, make_composite_pass(KEPT)])


def make_upsample_chain(form: str, lobes: Lobes) -> Chain:
    """Return the chain that upsamples and accumulates sparse frames: `TemporalFilter` on sparse frames."""
    require_choice("form of the chain 'upsample'", form, ("full",))
    sparse = {"here": "lobewise_find_pixel(pixel)", "other": "lobewise_find_pixel(tap)"}
    images, passes = begin_history(lobes)
    for layer in lobes.layers:
        images += list_history(layer.name)
        passes += [
            make_reproject_pass(layer),
            make_trust_pass(layer, SCREEN, sparse, SAMPLES, "sparse"),
            make_upsample_pass(layer),
        ]
    of_samples = {*LAYERS, *(f"{name}_trust" for name in LAYERS)}
    images = [replace(image, extent=SAMPLES) if image.name in of_samples else image for image in images]
    text = (
        "Brings frames of which one pixel in every block is shaded to all pixels, and joins them with their history, "
        "as lobewise.TemporalFilter does."
    )
    composite = make_composite_pass(KEPT, has_noisy=False)
    return Chain("upsample", text, [*images, RESULT], UPSAMPLE_CONSTANTS, [*passes, composite])


def begin_history(lobes: Lobes) -> tuple[list[Image], list[Pass]]:
    """Return the images and the passes with which every chain with a history begins."""
    guides = [*list_guides(lobes.guides, Lifetime.KEPT), REFLECTIONS]
    passes = [make_guides_pass(lobes, OWN_FOOTPRINT, ["motion"]), make_reflections_pass()]
    return [*GIVEN, MOTION, HITS, *guides, *keep(guides)], passes


_MAKERS = {
    "filter": (make_filter_chain, "separable"),
    "history": (make_history_chain, "separable"),
    "upsample": (make_upsample_chain, "full"),
}
"""What makes each chain, and its usual form."""


def make_chain(name: str, *, form: str | None = None, similarity: str = "ggx") -> Chain:
    """Return a chain by its name, with the chain's usual form unless ``form`` names another.

    Raises InputError if there is no such chain, or if it has no filter of this form or no lobes of this similarity.
    """
    require_choice("chain", name, tuple(CHAINS))
    require_choice("similarity", similarity, tuple(LOBES))
    make, usual = _MAKERS[name]
    require_choice("form", form or usual, FORM_NAMES)
    return make(form or usual, LOBES[similarity])
