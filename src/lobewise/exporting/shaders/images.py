"""The images of the chains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lobewise.exporting.shaders.passes import Image, Lifetime

LAYERS = "diffuse", "specular"
"""The layers of light that the chains filter apart."""
SAMPLES = "columns", "rows"
"""Constants that are the numbers of samples across and down."""


def give(name: str, comment: str) -> Image:
    """Return an image that the caller writes, for which half floats are enough."""
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
    give("diffuse", "noisy radiance that surfaces scatter diffusely, albedo included, linear"),
    give("specular", "noisy radiance that surfaces reflect, albedo included, linear"),
    give("diffuse_albedo", "albedo of diffuse reflection, 0 to 1"),
    give("specular_albedo", "albedo of specular reflection, 0 to 1"),
    give("emission", "light that reaches the camera unscattered: lamps and background, linear"),
)
MOTION = Image(
    name="motion",
    comment="place of the surface in the frame before minus its place in this frame, pixels, right and down (xy)",
    lifetime=Lifetime.GIVEN,
    format="rgba16float",
)
RESULT = Image(name="image", comment="the denoised image, linear (xyz); 1 (w)", lifetime=Lifetime.RESULT)


HITS = give(
    "hits",
    "distance from the surface to what its specular lobe hits, world units (x); 0 where unknown, infinite for the sky",
)
REFLECTIONS = Image(
    name="reflections",
    comment="1 over the hit distance (x), its tolerance (y), place of the reflection in the frame before, pixels (zw)",
    lifetime=Lifetime.KEPT,
)


def list_guides(names: Sequence[str], lifetime: Lifetime) -> list[Image]:
    """Return some of the images by which pixels are compared."""
    known = [
        Image(
            name="points",
            comment="position in world space (xyz), width of a pixel on the surface, world units (w)",
            lifetime=lifetime,
        ),
        Image(name="normals", comment="normal (xyz), distance from the camera or 0 (w)", lifetime=lifetime),
        Image(
            name="axes",
            comment="axis of the specular lobe (xyz), its variance or the larger of two, rad^2; -1 without a lobe (w)",
            lifetime=lifetime,
        ),
        Image(
            name="spreads",
            comment="vector along which the lobe is wider (xyz), its smaller variance, rad^2 (w)",
            lifetime=lifetime,
        ),
    ]
    return [image for image in known if image.name in names]


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


def keep(images: Sequence[Image]) -> list[Image]:
    """Return the images as the frame before wrote them."""
    return [
        replace(image, name=f"{image.name}_before", lifetime=Lifetime.BEFORE, before=image.name) for image in images
    ]


def list_history(layer: str) -> list[Image]:
    """Return the images of a layer's history: what was found of it, and what is kept of it."""
    meaning = f"{layer} light of this frame and its history"
    trust = Image(
        name=f"{layer}_trust", comment="how far the samples confirm the history, 0 to 1 (x)", lifetime=Lifetime.FRAME
    )
    state = list_sums(f"{layer}_kept", meaning, Lifetime.KEPT)
    return [*list_sums(f"{layer}_history", f"history of {layer} light", Lifetime.FRAME), trust, *state, *keep(state)]
