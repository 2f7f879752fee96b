"""The images of the chains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lobewise.exporting.shaders.passes import Image, Lifetime

LAYERS = "diffuse", "specular"
"""The layers of light that the chains filter apart."""
SAMPLES = "columns", "rows"
"""Constants that are the numbers of samples across and down."""


_GIVEN, _KEPT, _FRAME = Lifetime.GIVEN, Lifetime.KEPT, Lifetime.FRAME
_HALF = "rgba16float"
"""The format of images for which half floats are enough."""
GIVEN = (
    Image(
        "surface",
        "unit normal in world space (xyz; 0 where the pixel shows no surface), GGX alpha (w; 0 is a mirror)",
        _GIVEN,
    ),
    Image(
        "place",
        "position in world space (xyz), distance from the camera (w; 0 where the pixel shows no surface)",
        _GIVEN,
    ),
    Image("diffuse", "noisy radiance that surfaces scatter diffusely, albedo included, linear", _GIVEN, _HALF),
    Image("specular", "noisy radiance that surfaces reflect, albedo included, linear", _GIVEN, _HALF),
    Image("diffuse_albedo", "albedo of diffuse reflection, 0 to 1", _GIVEN, _HALF),
    Image("specular_albedo", "albedo of specular reflection, 0 to 1", _GIVEN, _HALF),
    Image("emission", "light that reaches the camera unscattered: lamps and background, linear", _GIVEN, _HALF),
)
MOTION = Image(
    "motion",
    "place of the surface in the frame before minus its place in this frame, pixels, right and down (xy)",
    _GIVEN,
    _HALF,
)
RESULT = Image("image", "the denoised image, linear (xyz); 1 (w)", Lifetime.RESULT)
HITS = Image(
    "hits",
    "distance from the surface to what its specular lobe hits, world units (x); 0 where unknown, infinite for the sky",
    _GIVEN,
    _HALF,
)
REFLECTIONS = Image(
    "reflections",
    "1 over the hit distance (x), its tolerance (y), place of the reflection in the frame before, pixels (zw)",
    _KEPT,
)
GUIDES = {
    "points": "position in world space (xyz), width of a pixel on the surface, world units (w)",
    "normals": "normal (xyz), distance from the camera or 0 (w)",
    "axes": "axis of the specular lobe (xyz), its variance or the larger of two, rad^2; -1 without a lobe (w)",
    "spreads": "vector along which the lobe is wider (xyz), its smaller variance, rad^2 (w)",
}
"""The images by which pixels are compared."""


def list_guides(names: Sequence[str], lifetime: Lifetime) -> list[Image]:
    """Return some of the images by which pixels are compared."""
    return [Image(name, text, lifetime) for name, text in GUIDES.items() if name in names]


def list_sums(name: str, what: str, lifetime: Lifetime) -> list[Image]:
    """Return the two images that hold sums over samples."""
    more = "sums of squared weights (x), of weight times squared luminance (y), frames (z)"
    return [
        Image(f"{name}_light", f"{what}: sums of weight times light over albedo (xyz) and of weights (w)", lifetime),
        Image(f"{name}_more", f"{what}: {more}", lifetime),
    ]


def keep(images: Sequence[Image]) -> list[Image]:
    """Return the images as the frame before wrote them."""
    return [
        replace(image, name=f"{image.name}_before", lifetime=Lifetime.BEFORE, before=image.name) for image in images
    ]


def list_history(layer: str) -> list[Image]:
    """Return the images of a layer's history: what was found of it, and what is kept of it."""
    meaning = f"{layer} light of this frame and its history"
    trust = Image(f"{layer}_trust", "how far the samples confirm the history, 0 to 1 (x)", _FRAME)
    state = list_sums(f"{layer}_kept", meaning, _KEPT)
    return [*list_sums(f"{layer}_history", f"history of {layer} light", _FRAME), trust, *state, *keep(state)]
