"""What is filtered, and by which features: one layer of radiance for each lobe that the frame tells apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.settings import DenoiseSettings
from lobewise.errors import MissingChannelError, describe_problem
from lobewise.features.base import BandLimitFeature, Feature, NormalFeature, PositionFeature, ScreenFeature
from lobewise.features.covariance import AsgFeature, GgxFeature
from lobewise.features.lobe import DiffuseFeature, SgFeature
from lobewise.features.sg_mixture import SgMixtureFeature
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.frame import FloatArray
from lobewise.guides.lobe_fields import make_lobe_field
from lobewise.guides.surfaces import find_inverse_hits, find_places, find_surface_pixels
from lobewise.lobes.field import LobeField
from lobewise.lobes.hits import HitField
from lobewise.lobes.mixture_field import build_mixture_field
from lobewise.sparse_frame import AnyFrame

NEAREST_HIT = 2.0
"""Hits count as no nearer than this many pixel footprints."""


class Support(Protocol):
    """How much a layer's filter gathered at every pixel, two images (height, width)."""

    @property
    def weight_sum(self) -> FloatArray:
        """Sum of the weights."""

    @property
    def effective_samples(self) -> FloatArray:
        """How many equal samples that is worth."""


@dataclass(frozen=True)
class Layer:
    """One radiance to filter and what it is filtered by."""

    radiance: FloatArray
    albedo: FloatArray | None
    mask: NDArray[np.bool_]
    features: tuple[Feature, ...]


def _require_channel(value: FloatArray | None, name: str, settings: DenoiseSettings) -> FloatArray:
    if value is None:
        raise MissingChannelError(
            describe_problem(
                f"channel {name}",
                expected=f"one for similarity {settings.similarity!r}",
                got="none",
                action="render it with the frame, or choose another similarity",
            )
        )
    return value


def make_position_features(frame: AnyFrame, settings: DenoiseSettings) -> list[Feature]:
    assert not isinstance(settings.screen_sigma, str)
    features: list[Feature] = [] if settings.form == "atrous" else [ScreenFeature(settings.screen_sigma)]
    guides = frame.gbuffer
    if frame.camera is not None and (guides.position is not None or guides.depth is not None):
        place, depth = find_places(guides, frame.camera)
        pixel_angle = frame.camera.get_pixel_angle(frame.height)
        features.append(PositionFeature(place, depth, pixel_angle=pixel_angle, sigma=settings.position_sigma))
    return features


def _make_normal_features(frame: AnyFrame, settings: DenoiseSettings, lobes: LobeField | None) -> list[Feature]:
    normal = _require_channel(frame.gbuffer.normal, "normal", settings)
    features: list[Feature] = [NormalFeature(normal, settings.normal_exponent)]
    if settings.band_limit is not None:
        assert lobes is not None and lobes.sharpness is not None and frame.camera is not None
        features.append(
            BandLimitFeature(
                lobes.sharpness,
                pixel_angle=frame.camera.get_pixel_angle(frame.height),
                scale=settings.band_limit,
                largest_sigma=float(max(settings.radius, 1)),
            )
        )
    return features


def _make_hits(frame: AnyFrame, settings: DenoiseSettings) -> HitField | None:
    """Return the hits, no nearer than `NEAREST_HIT` footprints, so that contacts do not close the kernel."""
    if not settings.hit_distance:
        return None
    assert frame.camera is not None
    distance = _require_channel(frame.gbuffer.hit_distance, "hit_distance", settings)
    place, depth = find_places(frame.gbuffer, frame.camera)
    nearest = NEAREST_HIT * frame.camera.get_pixel_angle(frame.height)
    return HitField(place, find_inverse_hits(distance, depth, nearest))


def _make_lobe_feature(frame: AnyFrame, settings: DenoiseSettings, lobes: LobeField) -> Feature:
    assert not isinstance(settings.beta, str)
    hits = _make_hits(frame, settings)
    if settings.similarity == "sg":
        assert lobes.axis is not None and lobes.sharpness is not None
        return SgFeature(lobes.axis, lobes.sharpness, settings.beta, hits)
    assert lobes.tangent_axis is not None and lobes.covariance is not None and lobes.determinant is not None
    kind = AsgFeature if settings.similarity == "asg" else GgxFeature
    return kind(lobes.tangent_axis, lobes.covariance, lobes.determinant, settings.beta, hits)


def make_specular_features(
    frame: AnyFrame, settings: DenoiseSettings, surface: NDArray[np.bool_], apart: bool
) -> tuple[list[Feature], NDArray[np.bool_]]:
    """Return what compares specular radiance (or all of it, where it is not apart), and the pixels that have it."""
    if settings.similarity == "normal" and settings.band_limit is None:
        return _make_normal_features(frame, settings, None), surface
    assert not isinstance(settings.beta, str) and not isinstance(settings.tau, str)
    if frame.camera is None:
        raise MissingChannelError(
            describe_problem(
                "camera",
                expected=f"one for similarity {settings.similarity!r}",
                got="none in the frame",
                action="give the frame a camera, or use similarity 'normal'",
            )
        )
    if settings.similarity == "sg_mixture":
        mixture = build_mixture_field(
            frame.gbuffer,
            frame.camera,
            tau=settings.tau,
            lobes=settings.lobes,
            lobe_tables=frame.lobe_tables,
            diffuse=not apart,
        )
        feature = SgMixtureFeature(mixture.axis, mixture.sharpness, mixture.amplitude, settings.beta)
        return [feature], surface & mixture.valid
    lobes = make_lobe_field(
        frame.gbuffer,
        frame.camera,
        tau=settings.tau,
        representation=settings.similarity if settings.similarity in ("ggx", "asg") else "sg",
        diffuse_fallback=True,
    )
    if settings.similarity == "normal":
        return _make_normal_features(frame, settings, lobes), surface & lobes.valid
    return [_make_lobe_feature(frame, settings, lobes)], surface & lobes.valid


def find_surface(frame: AnyFrame) -> NDArray[np.bool_]:
    """Return where a pixel sees a surface with finite guides."""
    return find_surface_pixels(frame.gbuffer, frame.shape)


def make_layers(frame: AnyFrame, settings: DenoiseSettings, extra: Sequence[Feature] = ()) -> list[Layer]:
    """Return the layers of a frame; ``extra`` features count in all of them."""
    shared = (*make_position_features(frame, settings), *extra)
    return [replace(layer, features=(*shared, *layer.features)) for layer in make_lobe_layers(frame, settings)]


def make_lobe_layers(frame: AnyFrame, settings: DenoiseSettings) -> list[Layer]:
    """Return the layers of a frame, compared by what they reflect alone."""
    guides, radiance = frame.gbuffer, frame.radiance
    normal = _require_channel(guides.normal, "normal", settings)
    apart = radiance.diffuse is not None and radiance.specular is not None
    assert not isinstance(settings.diffuse_beta, str)
    surface = find_surface(frame)
    specular, specular_mask = make_specular_features(frame, settings, surface, apart)
    if not apart:
        albedo = None
        if guides.diffuse_albedo is not None and guides.specular_albedo is not None:
            albedo = guides.diffuse_albedo + guides.specular_albedo
        return [Layer(radiance.color, albedo, specular_mask, tuple(specular))]
    assert radiance.diffuse is not None and radiance.specular is not None
    diffuse: list[Feature]
    if settings.similarity == "normal":
        diffuse = [NormalFeature(normal, settings.normal_exponent)]
    else:
        diffuse = [DiffuseFeature(normal, settings.diffuse_beta)]
    return [
        Layer(radiance.diffuse, guides.diffuse_albedo, surface, tuple(diffuse)),
        Layer(radiance.specular, guides.specular_albedo, specular_mask, tuple(specular)),
    ]


def make_rest_layer(frame: AnyFrame, settings: DenoiseSettings, features: Sequence[Feature]) -> list[Layer]:
    """Return what no lobe scattered, emission and background, as a layer that is compared by place alone."""
    radiance = frame.radiance
    if radiance.diffuse is None or radiance.specular is None:
        return []
    with np.errstate(invalid="ignore", over="ignore"):
        rest = radiance.color - radiance.diffuse - radiance.specular
    # Rounding leaves a little of a scattered sample behind.
    rest = np.where(rest > 1e-4 * radiance.color, rest, np.float32(0.0))
    if not (rest > 0.0).any():
        return []
    everywhere = np.ones(frame.shape, dtype=bool)
    return [Layer(rest, None, everywhere, (*make_position_features(frame, settings), *features))]


def find_support(layers: Sequence[Layer], outputs: Sequence[Support]) -> tuple[FloatArray, FloatArray]:
    """Return weight sum and effective samples of the least supported layer that reflects anything at a pixel.

    Where a surface reflects by no layer's lobe (a light, the background) those of the first layer count.
    """
    total, effective = outputs[0].weight_sum, outputs[0].effective_samples
    known = _find_reflecting(layers[0])
    for layer, output in zip(layers[1:], outputs[1:], strict=True):
        here = _find_reflecting(layer)
        weaker = here & (~known | (output.weight_sum < total))
        total = np.where(weaker, output.weight_sum, total)
        effective = np.where(weaker, output.effective_samples, effective)
        known = known | here
    return total, effective


def _find_reflecting(layer: Layer) -> NDArray[np.bool_]:
    """Return where a layer's lobe reflects more than `ALBEDO_FLOOR` of the light; everywhere without albedo."""
    if layer.albedo is None:
        return layer.mask
    x, y, z = (layer.albedo[..., k] for k in range(3))
    return np.asarray(layer.mask & ((x > ALBEDO_FLOOR) | (y > ALBEDO_FLOOR) | (z > ALBEDO_FLOOR)))
