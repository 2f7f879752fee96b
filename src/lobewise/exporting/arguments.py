"""The arguments of exported functions, declared once for compiler, header, example and README."""

from __future__ import annotations

from dataclasses import dataclass, replace

from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.guides.lobe_fields import NORMAL_ERROR
from lobewise.settings import DenoiseSettings

PLANAR = 0
"""Number of channels that stands for an image without an axis for channels, (width, height)."""


@dataclass(frozen=True)
class Argument:
    """An argument of a compiled function."""

    name: str
    text: str
    """Its meaning, for headers and READMEs."""
    unit: str = ""
    recipe: str = ""
    """The formula by which `lobewise.denoise` chooses a number."""
    channels: int = PLANAR
    type: str = "float32"
    role: str = "input"
    """"input", "output" or "number" (a float)."""

    @property
    def planar(self) -> bool:
        """Whether it is an image without an axis for channels."""
        return self.channels == PLANAR

    @property
    def extents(self) -> str:
        """The extents of an image in the order of Halide's buffers: the axis with the smallest stride comes first."""
        return "(width, height)" if self.planar else f"({self.channels}, width, height)"


def _number(name: str, text: str, unit: str, recipe: str) -> Argument:
    return Argument(name, text, unit, recipe, role="number")


_ARGUMENTS = (
    Argument(
        "radiance",
        "noisy linear radiance; a pixel with a negative, infinite or NaN channel has no weight and is filled from its "
        "neighbours",
        "any",
        channels=3,
    ),
    Argument(
        "albedo",
        "directional albedo of the lobe: the radiance is divided by it and the result multiplied by it; a pixel whose "
        f"channels are all {ALBEDO_FLOOR:g} or less has no weight",
        "0 to 1",
        channels=3,
    ),
    Argument(
        "mask",
        "1 where a pixel is filtered and has weight; 0 where it has no surface or no lobe: its output is 0",
        type="uint8",
    ),
    Argument("position", "world position of the surface", "world units", channels=3),
    Argument("depth", "distance of the surface from the camera; 0 where there is no surface", "world units"),
    Argument("normal", "shading normal in world space; the filter needs unit length, the lobes do not", channels=3),
    Argument("alpha", "microfacet roughness of GGX, the square of perceptual roughness; 0 is a mirror", "0 to 1"),
    Argument("alpha_u", "microfacet roughness of GGX along the tangent; 0 is a mirror", "0 to 1"),
    Argument("alpha_v", "microfacet roughness of GGX across the tangent; 0 is a mirror", "0 to 1"),
    Argument("tangent", "tangent in world space, of any length; 0 where a surface has no tangent", channels=3),
    Argument("axis", "unit axis of the reflection lobe, in world space, away from the surface", channels=3),
    Argument("sharpness", "sharpness of the spherical Gaussian, band-limited, above 0", "1/rad^2"),
    Argument("amplitude", "value at the axis, 0 for a lobe that is absent", "1/sr, any scale"),
    Argument("covariance", "covariance of the lobe across its axis: xx, xy, xz, yy, yz, zz", "rad^2", channels=6),
    Argument("determinant", "product of the two principal variances, above 0", "rad^4"),
    _number(
        "screen_sigma",
        "standard deviation of the Gaussian over the distance on the screen",
        "pixels",
        "radius * min(1, 0.6 (8 / spp)^(1/4)), at least 0.5",
    ),
    _number(
        "position_sigma",
        "standard deviation of the Gaussian over the distance in the scene; a footprint is what a pixel covers there",
        "footprints",
        f"{DenoiseSettings.position_sigma:g}",
    ),
    _number(
        "pixel_angle",
        "angle of a pixel; a pixel's footprint is its depth times this angle",
        "rad",
        "2 tan(fov_y / 2) / height of the whole image",
    ),
    _number(
        "normal_exponent",
        "sharpness e of exp(-e (1 - n_i . n_j))",
        "1/rad^2",
        f"{DenoiseSettings.normal_exponent:g}",
    ),
    _number(
        "beta",
        "exponent of the lobe similarity; larger keeps more detail and more noise",
        "",
        "2.5 spp^(1/3), from 1 to 64",
    ),
    *(_number(f"eye_{axis}", f"position of the camera, {axis}", "world units", "camera.position") for axis in "xyz"),
    _number(
        "tau",
        "band-limit: its square is added to the variance of every lobe, so that a mirror's lobe is finite",
        "rad",
        f"0.03 sqrt(4 / spp), at least sqrt(pixel_angle^2 + {2.0 * NORMAL_ERROR:g}^2)",
    ),
    Argument(
        "output",
        "filtered red, green, blue; the sum of the weights; the effective number of samples (sum w)^2 / sum w^2",
        channels=5,
        role="output",
    ),
)
_BY_NAME = {argument.name: argument for argument in _ARGUMENTS}


def list_arguments(*names: str, lobes: int = PLANAR, role: str = "") -> list[Argument]:
    """Return arguments by their names. ``lobes`` counts those of a mixture; ``role`` replaces the declared role."""
    found = [_BY_NAME[name] for name in names]
    found = [replace(each, channels=lobes) if each.name in ("sharpness", "amplitude") else each for each in found]
    return [replace(each, role=role) for each in found] if role else found
