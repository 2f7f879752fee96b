"""The chains that can be exported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lobewise.errors import require_choice
from lobewise.exporting.names import CHAINS
from lobewise.exporting.shaders.constants import FILTER_CONSTANTS, HISTORY_CONSTANTS, UPSAMPLE_CONSTANTS
from lobewise.exporting.shaders.passes import Chain, Image, Lifetime, Pass
from lobewise.filters.forms import ATROUS_RADIUS, Taps, list_passes
from lobewise.settings import FORMS

LAYERS = {"diffuse": "diffuse", "specular": "specular"}
_LIGHT = {"diffuse": "light that surfaces scatter diffusely", "specular": "light that surfaces reflect"}
_GUIDES = ("points", "normals", "axes", "spreads")


def _give(name: str, comment: str) -> Image:
    return Image(name=name, comment=comment, lifetime=Lifetime.GIVEN, format="rgba16float")


GIVEN = (
    Image(
        name="surface",
        comment="unit normal in world space (xyz; 0 where the pixel shows no surface), GGX alpha (w; 0 is a mirror)",
        lifetime=Lifetime.GIVEN,
    ),
    Image(
        name="place",
        comment="position in world space (xyz), distance from the camera (w; 0 where the pixel shows no surface)",
        lifetime=Lifetime.GIVEN,
    ),
    _give("diffuse", "noisy radiance that surfaces scatter diffusely, albedo included, linear"),
    _give("specular", "noisy radiance that surfaces reflect, albedo included, linear"),
    _give("diffuse_albedo", "albedo of diffuse reflection, 0 to 1"),
    _give("specular_albedo", "albedo of specular reflection, 0 to 1"),
    _give("emission", "light that reaches the camera unscattered: lamps and background, linear"),
)
RESULT = Image(name="image", comment="the denoised image, linear (xyz); 1 (w)", lifetime=Lifetime.RESULT)


def list_guides(lifetime: Lifetime) -> list[Image]:
    """Return the images that compare pixels."""
    return [
        Image(
            name="points",
            comment="position in world space (xyz), width of a pixel on the surface, world units (w)",
            lifetime=lifetime,
        ),
        Image(name="normals", comment="normal (xyz), distance from the camera or 0 (w)", lifetime=lifetime),
        Image(
            name="axes",
            comment="axis of the specular lobe (xyz), its larger variance, rad^2, -1 without a lobe (w)",
            lifetime=lifetime,
        ),
        Image(
            name="spreads",
            comment="vector along which the lobe is wider (xyz), its smaller variance, rad^2 (w)",
            lifetime=lifetime,
        ),
    ]


def list_sums(name: str, what: str, lifetime: Lifetime) -> list[Image]:
    """Return the two images that hold sums over samples."""
    return [
        Image(
            name=f"{name}_light",
            comment=f"{what}: sums of weight times light over albedo (xyz) and of weights (w)",
            lifetime=lifetime,
        ),
        Image(
            name=f"{name}_more",
            comment=f"{what}: sums of squared weights (x), of weight times squared luminance (y), frames (z)",
            lifetime=lifetime,
        ),
    ]


def list_layer_guides(layer: str) -> dict[str, str]:
    """Return the guides that a layer's pixels are compared by, as bindings."""
    return {name: name for name in (_GUIDES if layer == "specular" else _GUIDES[:2])}


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


def make_filter_chain(form: str) -> Chain:
    """Return the chain that filters each frame by itself: `lobewise.denoise` with quality "fast"."""
    passes, images, last = [make_guides_pass("spot.w * constants.pixel_angle")], list_guides(Lifetime.FRAME), {}
    for layer in LAYERS:
        more, between = make_filter_passes(layer, form, "1.0")
        passes, images = [*passes, *more], [*images, *between]
        last[layer] = more[-1].writes["added_light"]
    return Chain(
        name="filter",
        comment="Filters every frame by itself, as lobewise.denoise does with the quality 'fast'.",
        images=[*GIVEN, *images, RESULT],
        constants=FILTER_CONSTANTS,
        passes=[*passes, make_composite_pass(last, has_noisy=True)],
    )


MOTION = Image(
    name="motion",
    comment="place of the surface in the frame before minus its place in this frame, pixels, right and down (xy)",
    lifetime=Lifetime.GIVEN,
    format="rgba16float",
)


def keep(images: Sequence[Image]) -> list[Image]:
    """Return the images as the frame before wrote them."""
    return [
        replace(image, name=f"{image.name}_before", lifetime=Lifetime.BEFORE, before=image.name) for image in images
    ]


def list_history(layer: str) -> list[Image]:
    """Return the images of a layer's history: what was found of it, and what is kept of it."""
    told = f"{layer} light of this frame and its history"
    trust = Image(
        name=f"{layer}_trust", comment="how far the samples confirm the history, 0 to 1 (x)", lifetime=Lifetime.FRAME
    )
    kept = list_sums(f"{layer}_kept", told, Lifetime.KEPT)
    return [*list_sums(f"{layer}_history", f"history of {layer} light", Lifetime.FRAME), trust, *kept, *keep(kept)]


def make_reproject_pass(layer: str) -> Pass:
    """Return the pass that finds a layer's history."""
    guides = list_layer_guides(layer)
    return Pass(
        name=f"{layer}_reproject",
        comment=f"Finds the history of every pixel at its place in the frame before: {_LIGHT[layer]}.\n"
        "The history counts as far as surface and lobe are alike.",
        body="reproject.shader",
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


OWN_FOOTPRINT = (
    "spot.w * constants.pixel_angle * (1.0 + "
    "lobewise_find_own_motion(pixel, spot.xyz, load(motion, pixel).xy) / constants.plane_sigma)"
)
"""Width of a pixel on its surface, wider where the surface moved by itself."""


def make_history_chain(form: str) -> Chain:
    """Return the chain that joins each frame with its history: `TemporalFilter` on whole frames."""
    screen = "0.0" if form == "atrous" else "lobewise_compare_screen(offset, constants.screen_sigma)"
    guides = list_guides(Lifetime.KEPT)
    images = [*GIVEN, MOTION, *guides, *keep(guides)]
    passes = [make_guides_pass(OWN_FOOTPRINT, ["motion"])]
    for layer in LAYERS:
        filters, between = make_filter_passes(layer, form, "load(narrowing, pixel).y", narrowing=f"{layer}_narrowing")
        narrowing = Image(
            name=f"{layer}_narrowing",
            comment="trust in the history (x), power to which the pixel raises its weights (y)",
            lifetime=Lifetime.FRAME,
        )
        images += [*list_history(layer), narrowing, *between]
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


SAMPLES = "columns", "rows"
"""Constants that are the numbers of samples across and down."""


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


def make_upsample_chain(form: str) -> Chain:
    """Return the chain that upsamples and accumulates sparse frames: `TemporalFilter` on sparse frames."""
    require_choice("form of the chain 'upsample'", form, ("full",))
    screen = "lobewise_compare_screen(offset, constants.screen_sigma)"
    guides = list_guides(Lifetime.KEPT)
    sparse = {"here": "lobewise_find_pixel(pixel)", "other": "lobewise_find_pixel(tap)"}
    given = [replace(image, extent=SAMPLES) if image.name in LAYERS else image for image in GIVEN]
    images = [*given, MOTION, *guides, *keep(guides)]
    passes = [make_guides_pass(OWN_FOOTPRINT, ["motion"])]
    for layer in LAYERS:
        images += [
            replace(image, extent=SAMPLES) if image.name == f"{layer}_trust" else image for image in list_history(layer)
        ]
        trust = make_trust_pass(layer, screen, sparse, SAMPLES)
        passes += [make_reproject_pass(layer), replace(trust, libraries=[layer, "sparse"]), make_upsample_pass(layer)]
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


def make_chain(name: str, *, form: str | None = None) -> Chain:
    """Return a chain by its name, with the chain's usual form unless ``form`` names another.

    Raises InputError if there is no such chain, or if the chain has no filter of this form.
    """
    require_choice("chain", name, tuple(CHAINS))
    make, usual = _MAKERS[name]
    require_choice("form", form or usual, FORMS)
    return make(form or usual)
