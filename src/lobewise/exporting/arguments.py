"""What the arguments of an exported function mean, said once for header and README."""

from __future__ import annotations

from dataclasses import dataclass

from lobewise.exporting.ahead_of_time import Argument


@dataclass(frozen=True)
class Meaning:
    """What an argument is."""

    text: str
    unit: str = ""
    recipe: str = ""
    """Of a number: what the Python recipe takes."""


MEANINGS = {
    "radiance": Meaning(
        "noisy linear radiance; a pixel with a negative, infinite or NaN channel has no weight and is filled from its "
        "neighbours",
        "any",
    ),
    "albedo": Meaning(
        "directional albedo of the lobe: divides the radiance on the way in, multiplies the result; a pixel whose "
        "channels are all 0.001 or less has no weight",
        "0 to 1",
    ),
    "mask": Meaning("1 where a pixel gives and takes, 0 where it has no surface or no lobe; there the output is 0"),
    "position": Meaning("world position of the surface", "world units"),
    "depth": Meaning("distance of that position from the camera; 0 where there is no surface", "world units"),
    "normal": Meaning("shading normal in world space; the filter wants unit length, the lobes any"),
    "alpha": Meaning("microfacet roughness of GGX, the square of perceptual roughness; 0 is a mirror", "0 to 1"),
    "alpha_u": Meaning("microfacet roughness of GGX along the tangent; 0 is a mirror", "0 to 1"),
    "alpha_v": Meaning("the same across the tangent", "0 to 1"),
    "tangent": Meaning("tangent in world space, any length; 0 where a surface has none"),
    "axis": Meaning("unit axis of the reflection lobe, in world space, away from the surface"),
    "sharpness": Meaning("sharpness of the spherical Gaussian, band-limited, above 0", "1/rad^2"),
    "amplitude": Meaning("value at the axis, 0 for a lobe that is absent", "1/sr, any scale"),
    "covariance": Meaning("covariance of the lobe across its axis: xx, xy, xz, yy, yz, zz", "rad^2"),
    "determinant": Meaning("product of the two principal variances, above 0", "rad^4"),
    "screen_sigma": Meaning(
        "standard deviation of the Gaussian over the distance on the screen",
        "pixels",
        "radius * min(1, 0.6 (8 / spp)^(1/4)), at least 0.5",
    ),
    "position_sigma": Meaning(
        "standard deviation of the Gaussian over the distance in the scene, in what a pixel covers there",
        "footprints",
        "16",
    ),
    "pixel_angle": Meaning(
        "angle of a pixel: depth times it is the footprint", "rad", "2 tan(fov_y / 2) / height of the whole image"
    ),
    "normal_exponent": Meaning("sharpness e of exp(-e (1 - n_i . n_j))", "1/rad^2", "64"),
    "beta": Meaning(
        "exponent of the lobe similarity; larger keeps more detail and more noise", "", "2.5 spp^(1/3), from 1 to 64"
    ),
    "eye_x": Meaning("position of the camera, x", "world units", "camera.position"),
    "eye_y": Meaning("position of the camera, y", "world units", "camera.position"),
    "eye_z": Meaning("position of the camera, z", "world units", "camera.position"),
    "tau": Meaning(
        "band-limit: its square is added to the variance of every lobe, which makes a mirror's finite",
        "rad",
        "0.03 sqrt(4 / spp), at least sqrt(pixel_angle^2 + 0.002^2)",
    ),
    "output": Meaning(
        "filtered red, green, blue; the sum of the weights; the effective number of samples (sum w)^2 / sum w^2"
    ),
}


def describe_shape(argument: Argument) -> str:
    """Return the extents of an image, fastest first, as the buffers have them."""
    return "(width, height)" if argument.planar else f"({argument.channels}, width, height)"


def get_meaning(argument: Argument) -> Meaning:
    """Return what an argument is."""
    return MEANINGS[argument.name]
