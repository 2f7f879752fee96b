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
from lobewise.exporting.shaders.passes import Chain, Image, Lifetime, Pass
from lobewise.exporting.shaders.steps import (
    FOOTPRINT,
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
