"""The chains that can be exported."""

from __future__ import annotations

from dataclasses import replace

from lobewise.errors import require_choice
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
)
from lobewise.exporting.shaders.passes import Chain, Image, Lifetime
from lobewise.exporting.shaders.steps import (
    LOBES,
    OWN_FOOTPRINT,
    Lobes,
    make_accumulate_pass,
    make_composite_pass,
    make_filter_passes,
    make_guides_pass,
    make_narrow_pass,
    make_reflections_pass,
    make_reproject_pass,
    make_trust_pass,
    make_upsample_pass,
)
from lobewise.settings import FORM_NAMES


def make_filter_chain(form: str, lobes: Lobes) -> Chain:
    """Return the chain that filters each frame by itself: `lobewise.denoise` with quality "fast"."""
    passes, images = (
        [make_guides_pass(lobes, "spot.w * constants.pixel_angle")],
        list_guides(lobes.guides, Lifetime.FRAME),
    )
    last = {}
    for layer in lobes.layers:
        more, between = make_filter_passes(layer, form, "1.0")
        passes, images = [*passes, *more], [*images, *between]
        last[layer.name] = more[-1].writes["added_light"]
    return Chain(
        name="filter",
        comment="Filters every frame by itself, as lobewise.denoise does with the quality 'fast'.",
        images=[*GIVEN, *images, RESULT],
        constants=FILTER_CONSTANTS,
        passes=[*passes, make_composite_pass(last, has_noisy=True)],
    )


def make_history_chain(form: str, lobes: Lobes) -> Chain:
    """Return the chain that joins each frame with its history: `TemporalFilter` on whole frames."""
    screen = "0.0" if form == "atrous" else "lobewise_compare_screen(offset, constants.screen_sigma)"
    guides = [*list_guides(lobes.guides, Lifetime.KEPT), REFLECTIONS]
    images = [*GIVEN, MOTION, HITS, *guides, *keep(guides)]
    passes = [make_guides_pass(lobes, OWN_FOOTPRINT, ["motion"]), make_reflections_pass()]
    for layer in lobes.layers:
        filters, between = make_filter_passes(
            layer, form, "load(narrowing, pixel).y", narrowing=f"{layer.name}_narrowing"
        )
        narrowing = Image(
            name=f"{layer.name}_narrowing",
            comment="trust in the history (x), power to which the pixel raises its weights (y)",
            lifetime=Lifetime.FRAME,
        )
        images += [*list_history(layer.name), narrowing, *between]
        whole = {"here": "pixel", "other": "tap"}
        passes += [
            make_reproject_pass(layer),
            make_trust_pass(layer, screen, whole, ("width", "height")),
            make_narrow_pass(layer, screen),
            *filters,
            make_accumulate_pass(layer, filters[-1].name),
        ]
    return Chain(
        name="history",
        comment="Filters every frame and joins it with the history of those before, as lobewise.TemporalFilter does.",
        images=[*images, RESULT],
        constants=HISTORY_CONSTANTS,
        passes=[*passes, make_composite_pass({layer: f"{layer}_kept_light" for layer in LAYERS}, has_noisy=True)],
    )


def make_upsample_chain(form: str, lobes: Lobes) -> Chain:
    """Return the chain that upsamples and accumulates sparse frames: `TemporalFilter` on sparse frames."""
    require_choice("form of the chain 'upsample'", form, ("full",))
    screen = "lobewise_compare_screen(offset, constants.screen_sigma)"
    guides = [*list_guides(lobes.guides, Lifetime.KEPT), REFLECTIONS]
    sparse = {"here": "lobewise_find_pixel(pixel)", "other": "lobewise_find_pixel(tap)"}
    inputs = [replace(image, extent=SAMPLES) if image.name in LAYERS else image for image in GIVEN]
    images = [*inputs, MOTION, HITS, *guides, *keep(guides)]
    passes = [make_guides_pass(lobes, OWN_FOOTPRINT, ["motion"]), make_reflections_pass()]
    for layer in lobes.layers:
        images += [
            replace(image, extent=SAMPLES) if image.name == f"{layer.name}_trust" else image
            for image in list_history(layer.name)
        ]
        trust = make_trust_pass(layer, screen, sparse, SAMPLES)
        passes += [
            make_reproject_pass(layer),
            replace(trust, libraries=[*layer.libraries, "sparse"]),
            make_upsample_pass(layer),
        ]
    return Chain(
        name="upsample",
        comment="Brings frames of which one pixel in every block is shaded to all pixels, and joins them with their "
        "history, as lobewise.TemporalFilter does.",
        images=[*images, RESULT],
        constants=UPSAMPLE_CONSTANTS,
        passes=[*passes, make_composite_pass({layer: f"{layer}_kept_light" for layer in LAYERS}, has_noisy=False)],
    )


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
    require_choice("similarity of a chain", similarity, tuple(LOBES))
    make, usual = _MAKERS[name]
    require_choice("form", form or usual, FORM_NAMES)
    return make(form or usual, LOBES[similarity])
