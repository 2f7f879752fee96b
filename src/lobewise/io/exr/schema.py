"""The channel names of lobewise's own EXR files: which channels hold which image of a `Frame`, and what they mean."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

SCHEMA_VERSION = 1
SCHEMA = "lobewise/schema"
SPP = "lobewise/spp"
SPARSE = "lobewise/sparse"
"""Attribute with the text "scale row column": the shaded pixel in every block of scale x scale pixels."""
CAMERA = "lobewise/camera/"
DENOISED = "lobewise/denoised"
LOBES = "lobewise/lobes/"
"""Prefix of the attributes of lobe tables; the number of the material follows, from 1."""


@dataclass(frozen=True)
class Slot:
    """One image of a frame and the channels that hold it."""

    owner: str
    """Attribute of `Frame`, such as ``gbuffer``."""
    field: str
    """Attribute of the owner."""
    channels: tuple[str, ...]
    """Full channel names, in the order of the image's last axis."""
    kind: str
    """``radiance``, ``variance``, ``share`` or ``geometry``; it decides the pixel type."""
    meaning: str
    """Meaning of the values, with unit, space and range."""
    missing: str
    """Consequence of missing channels."""

    @property
    def role(self) -> str:
        """The image in one word, for example ``normal`` or ``half_a.color``."""
        return self.field if self.owner in ("radiance", "gbuffer") else f"{self.owner}.{self.field}"

    @property
    def label(self) -> str:
        """The channels in short, for example ``normal.X/Y/Z``."""
        words = "/".join(name.rpartition(".")[2] for name in self.channels)
        return f"{self.prefix}.{words}" if self.prefix else words

    @property
    def prefix(self) -> str:
        """The words before the last one of its channels, for example ``half_a.diffuse``; empty for R, G and B."""
        return self.channels[0].rpartition(".")[0]


def _name(prefix: str, suffixes: str) -> tuple[str, ...]:
    return tuple(f"{prefix}.{suffix}" if prefix else suffix for suffix in suffixes)


_LAYERS = {
    "color": ("", "total radiance", "nothing can be denoised"),
    "diffuse": ("diffuse", "radiance whose first bounce was diffuse", "diffuse and specular are filtered together"),
    "specular": ("specular", "radiance whose first bounce was specular", "diffuse and specular are filtered together"),
    "direct": ("direct", "radiance that came straight from a light to the first surface", "not needed to denoise"),
    "indirect": ("indirect", "radiance after more bounces", "not needed to denoise"),
}
_COPIES = {
    "radiance": ("", "{}", "radiance", "{}"),
    "half_a": ("half_a", "{}, from one half of the samples", "radiance", "noise is not measured between halves"),
    "half_b": ("half_b", "{}, from the other half of the samples", "radiance", "noise is not measured between halves"),
    "variance": ("variance", "variance of the mean of: {}", "variance", "noise is judged by the sample count"),
}
_GBUFFER = (
    ("depth", "depth", "Z", "distance along the ray, world units, 0 = no surface", "taken from position"),
    ("position", "position", "XYZ", "world position of the first surface", "taken from depth"),
    ("normal", "normal", "XYZ", "shading normal, world space, unit, towards the camera",
     "no similarity can be computed"),
    ("tangent", "tangent", "XYZ", "direction of alpha.U, world space, unit", "alpha.V must equal alpha.U"),
    ("alpha_u", "alpha", "U", "microfacet alpha along the tangent, 0..1, 0 = mirror", "only normals can be compared"),
    ("alpha_v", "alpha", "V", "microfacet alpha across the tangent, 0..1", "taken equal to alpha.U"),
    ("lobe_kind", "lobe_kind", "I", "0 none, 1 GGX, 2 Beckmann, 3 perfect mirror", "every lobe is taken for GGX"),
    ("diffuse_albedo", "diffuse_albedo", "RGB", "directional albedo of the diffuse lobe, 0..1",
     "texture is filtered too"),
    ("specular_albedo", "specular_albedo", "RGB", "directional albedo of the specular lobe, tinted, 0..1",
     "texture is filtered too"),
    ("hit_distance", "hit_distance", "Z", "distance to what the specular lobe sees, world units, 0 = unknown",
     "what is reflected is not compared"),
    ("hit_position", "hit_position", "XYZ", "world position of that hit", "what is reflected is not compared"),
    ("mean_normal", "mean_normal", "XYZ", "mean shading normal over the pixel's area, world space, length 0..1",
     "not needed to denoise"),
    ("mean_diffuse_albedo", "mean_diffuse_albedo", "RGB", "mean of diffuse_albedo over the pixel's area, 0..1",
     "not needed to denoise"),
    ("mean_specular_albedo", "mean_specular_albedo", "RGB", "mean of specular_albedo over the pixel's area, 0..1",
     "not needed to denoise"),
    ("denoiser_albedo", "denoiser_albedo", "RGB", "albedo that a renderer made for denoisers", "not needed to denoise"),
    ("denoiser_normal", "denoiser_normal", "XYZ", "normal that a renderer made for denoisers", "not needed to denoise"),
    ("mean_emission", "mean_emission", "RGB", "mean over the pixel's area of unscattered light, radiance, >= 0",
     "edges of lamps and of the background are as noisy as the samples"),
    ("coverage", "coverage", "012345678", "shares of the pixel's area that its 3x3 neighbours stand for, sum 1",
     "not needed to denoise"),
    ("blur_radius", "blur_radius", "R", "radius over which the lens blurs the pixel, pixels, 0 in focus",
     "specks of lights out of focus stay"),
    ("motion", "motion", "XY", "pixels from here to the previous frame, x right, y down", "not needed for one frame"),
    ("reflected_motion", "reflected_motion", "XYZ",
     "world position in the previous frame of what the specular lobe sees, minus that in this frame",
     "what is reflected is taken for still"),
    ("material", "material", "I", "which of the header's lobe tables, from 1, 0 = none", "lobes are taken from alpha"),
)  # fmt: skip


def _make_slots() -> Iterable[Slot]:
    for owner, (copy, meaning, kind, missing) in _COPIES.items():
        for field, (layer, what, without) in _LAYERS.items():
            prefix = ".".join(part for part in (copy, layer) if part)
            yield Slot(owner, field, _name(prefix, "RGB"), kind, meaning.format(what), missing.format(without))
    for field, prefix, suffixes, meaning, missing in _GBUFFER:
        yield Slot("gbuffer", field, _name(prefix, suffixes), _name_kind(field), meaning, missing)


def _name_kind(field: str) -> str:
    """Return the kind of an image of the G-buffer, as in `Slot`."""
    if field == "mean_emission":
        return "radiance"
    return "share" if field.endswith(("albedo", "coverage")) else "geometry"


SLOTS: tuple[Slot, ...] = tuple(_make_slots())
BEAUTY = SLOTS[0]
