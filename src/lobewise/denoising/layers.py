"""The layers of a frame, one for each lobe whose light it holds apart, and the features that filter each layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.denoising.bad_pixels import mark_good
from lobewise.features import (
    BandLimitFeature,
    DiffuseFeature,
    Feature,
    GgxFeature,
    GgxLobe,
    NormalFeature,
    PositionFeature,
    ScreenFeature,
    SgFeature,
    SgMixtureFeature,
)
from lobewise.filters.cross_filter import FilterOutput, run_filter
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.glue import define_common_mask, define_whole_albedo
from lobewise.guides.lobe_fields import (
    GgxField,
    SgField,
    make_ggx_field,
    make_sg_field,
    spread_lobes,
)
from lobewise.guides.surfaces import compute_points, mark_surface_pixels
from lobewise.records.frame import FloatArray, GBuffer
from lobewise.records.sparse_frame import AnyFrame, SparseFrame
from lobewise.settings import ResolvedSettings
from lobewise.settings.choices import get_similarity

Mask = NDArray[np.bool_]

MAX_SHARE_UNTOLD = 0.1
"""Share of a frame's light above which the user is told that it is left out. At edges of lamps the emission of samples
is noisy, so that small shares tell nothing."""
MIN_WHOLE_ALBEDO = 10.0 * ALBEDO_FLOOR
"""Albedo below which light that is not split by lobe is not divided by it."""


@dataclass(frozen=True)
class Layer:
    """One radiance to filter, and the features by which its pixels are compared.

    Parameters
    ----------
    radiance : (height, width, 3)
    albedo : (height, width, 3), optional
        Divides the radiance.
    mask : (height, width), bool
        Pixels that have this light.
    features : tuple of Feature
    name : str
    is_diffuse, is_transmitted : bool
        Whether surfaces scattered the light diffusely, or bent it. Bent light may have passed other surfaces behind, so
        the lobe of the first surface does not tell where it came from.
    """

    radiance: FloatArray
    albedo: FloatArray | None
    mask: Mask
    features: tuple[Feature, ...]
    name: str = "color"
    is_diffuse: bool = False
    is_transmitted: bool = False
    weights: FloatArray | None = None
    """Weights of the samples' rays, (rows, columns), of a frame with rays; see `lobewise.records.sparse_frame.Rays`."""

    @property
    def is_reflected(self) -> bool:
        """Whether the light follows a specular lobe."""
        return not self.is_diffuse and not self.is_transmitted


def _name_similarity(settings: ResolvedSettings) -> str:
    return f"similarity {settings.similarity!r}"


def make_position_features(frame: AnyFrame, settings: ResolvedSettings) -> list[ScreenFeature | PositionFeature]:
    """Return the features that compare places: on the screen, and in the scene where the frame tells them."""
    features: list[ScreenFeature | PositionFeature] = []
    if settings.form != "atrous":
        features.append(ScreenFeature(settings.screen_sigma))
    if frame.camera is not None and frame.gbuffer.is_placed:
        place, depth = compute_points(frame.gbuffer, frame.camera)
        pixel_angle = frame.camera.get_pixel_angle(frame.height)
        features.append(PositionFeature(place, depth, pixel_angle=pixel_angle, sigma=settings.position_sigma))
    return features


class Compared(NamedTuple):
    """What compares the specular light of a frame, or all light that is not split.

    Parameters
    ----------
    features : tuple of Feature
    mask : (height, width), bool
        Pixels that have such light.
    surface : (height, width), bool
        Pixels that see a surface with finite guides.
    """

    features: tuple[Feature, ...]
    mask: Mask
    surface: Mask


def _compare_normals(frame: AnyFrame, settings: ResolvedSettings) -> Compared:
    normal = frame.gbuffer.require("normal", _name_similarity(settings))
    feature = NormalFeature(normal, settings.normal_exponent)
    if settings.band_limit is None:
        surface = mark_surface(frame)
        return Compared((feature,), surface, surface)
    lobes = _make_sg_lobes(frame, settings)
    limit = BandLimitFeature(
        lobes.sharpness,
        pixel_angle=frame.require_camera(_name_similarity(settings)).get_pixel_angle(frame.height),
        scale=settings.band_limit,
        largest_sigma=float(max(settings.radius, 1)),
    )
    return Compared((feature, limit), lobes.mask, lobes.surface)


def _make_sg_lobes(frame: AnyFrame, settings: ResolvedSettings) -> SgField:
    camera = frame.require_camera(_name_similarity(settings))
    return make_sg_field(frame.gbuffer, camera, tau=settings.tau, diffuse_fallback=True)


def make_ggx_lobes(frame: AnyFrame, similarity: str, *taus: float) -> GgxField | None:
    """Return the lobes of a frame for several band-limits at once; None if the similarity compares others."""
    if not get_similarity(similarity).has_covariance:
        return None
    return make_ggx_field(frame.gbuffer, frame.require_camera(f"similarity {similarity!r}"), taus)


def compare_specular(
    frame: AnyFrame,
    settings: ResolvedSettings,
    apart: bool,
    *,
    spread: bool = False,
    lobes: GgxField | None = None,
) -> Compared:
    """Return what compares specular radiance, or all radiance where it is not split (``apart`` is False).

    With ``spread`` single lobes are as wide as what a pixel's area reflects; see `spread_lobes`. Covariances are those
    at pixel centres.
    ``lobes`` hold the frame's lobes for the band-limit of the settings, if they were made beforehand.
    """
    similarity = get_similarity(settings.similarity)
    if not similarity.has_lobes:
        return _compare_normals(frame, settings)
    if similarity.is_mixture:
        return _compare_mixtures(frame, settings, apart)
    lobes = lobes or make_ggx_lobes(frame, settings.similarity, settings.tau)
    if lobes is not None:
        feature = GgxFeature(GgxLobe(*lobes.lobes[settings.tau]), settings.beta)
        return Compared((feature,), lobes.mask, lobes.surface)
    single = _make_sg_lobes(frame, settings)
    single = spread_lobes(single) if spread else single
    return Compared((SgFeature(single.axis, single.sharpness, settings.beta),), single.mask, single.surface)


def _compare_mixtures(frame: AnyFrame, settings: ResolvedSettings, apart: bool) -> Compared:
    from lobewise.guides.mixture_fields import make_mixture_field

    mixture = make_mixture_field(
        frame.gbuffer,
        frame.require_camera(_name_similarity(settings)),
        tau=settings.tau,
        lobes=settings.lobes,
        lobe_tables=frame.lobe_tables,
        diffuse=not apart,
    )
    feature = SgMixtureFeature(mixture.axis, mixture.sharpness, mixture.amplitude, settings.beta)
    surface = mark_surface(frame)
    images = {"surface": surface, "valid": mixture.valid}
    (mask,) = engine.pixels(define_common_mask, images, {}, names=["specular_mask"], text="surfaces with a lobe")
    return Compared((feature,), mask, surface)


def mark_surface(frame: AnyFrame) -> Mask:
    """Return where a pixel sees a surface with finite guides."""
    return mark_surface_pixels(frame.gbuffer, frame.shape)


def make_layers(
    frame: AnyFrame,
    settings: ResolvedSettings,
    extra: Sequence[Feature] = (),
    *,
    finest: bool = False,
    lobes: GgxField | None = None,
) -> list[Layer]:
    """Return the layers of a frame, as `make_lobe_layers`; ``extra`` features count in all of them."""
    shared = (*make_position_features(frame, settings), *extra)
    layers = make_lobe_layers(frame, settings, finest=finest, lobes=lobes)
    return [replace(layer, features=(*shared, *layer.features)) for layer in layers]


def make_lobe_layers(
    frame: AnyFrame,
    settings: ResolvedSettings,
    *,
    finest: bool = False,
    spread: bool = False,
    lobes: GgxField | None = None,
) -> list[Layer]:
    """Return the layers of a frame, compared by what they reflect alone.

    With ``finest`` those that the frame names itself, where it does; else one, or diffuse and specular. ``spread`` and
    ``lobes`` as in `compare_specular`.
    """
    guides, parts = frame.gbuffer, frame.radiance.parts
    normal = guides.require("normal", _name_similarity(settings))
    specular = compare_specular(frame, settings, parts is not None, spread=spread, lobes=lobes)
    # One layer: light that is not split is compared as specular light is.
    if parts is None:
        return [Layer(frame.radiance.color, compute_whole_albedo(guides), specular.mask, specular.features)]
    diffuse: Feature
    if get_similarity(settings.similarity).has_lobes:
        diffuse = DiffuseFeature(normal, settings.diffuse_beta)
    else:
        diffuse = NormalFeature(normal, settings.normal_exponent)
    # Every kind of light: where it is, and what compares it. The first surface's lobe tells nothing of bent light.
    scattered, reflected = (specular.surface, (diffuse,)), (specular.mask, specular.features)
    transmitted = specular.surface, (NormalFeature(normal, settings.normal_exponent),)
    named = getattr(frame, "layers", ())  # sparse frames have none
    if finest and named:
        return [
            Layer(
                own.radiance,
                own.albedo,
                *(scattered if own.is_diffuse else transmitted if own.is_transmitted else reflected),
                own.name,
                own.is_diffuse,
                own.is_transmitted,
            )
            for own in named
        ]
    # Two layers. Sparse frames weigh their specular samples by the rays.
    layers = [
        Layer(parts[0], guides.diffuse_albedo, *scattered, "diffuse", is_diffuse=True),
        Layer(parts[1], guides.specular_albedo, *reflected, "specular"),
    ]
    if getattr(frame, "rays", None) is not None:  # whole frames have none
        from lobewise.guides.rays import compute_ray_weights

        layers[1] = replace(layers[1], weights=compute_ray_weights(cast(SparseFrame, frame)))
    return layers


def filter_layer(layer: Layer, settings: ResolvedSettings, others: Sequence[FloatArray] = ()) -> FilterOutput:
    """Return a layer after one pass by its features; ``others`` are images that are averaged by the same weights."""
    return run_filter(
        layer.radiance,
        layer.mask,
        layer.features,
        form=settings.form,
        radius=settings.radius,
        albedo=layer.albedo,
        more=others,
        name=f"{layer.name}_filtered",
    )


def compute_whole_albedo(guides: GBuffer) -> FloatArray | None:
    """Return the albedo of all light, (height, width, 3): the sum of both albedos, or the one that is known.

    Pixels of albedo 0 may have light, as lamps, skies and mirrors without an albedo do. So no value is below
    `MIN_WHOLE_ALBEDO`, and a pixel without a larger channel gets 1.
    """
    known = [albedo for albedo in (guides.diffuse_albedo, guides.specular_albedo) if albedo is not None]
    if not known:
        return None
    images = {f"albedo{number}": albedo for number, albedo in enumerate(known)}
    (whole,) = engine.pixels(
        define_whole_albedo, images, {}, MIN_WHOLE_ALBEDO, names=["albedo"], text="albedo of all light"
    )
    return whole


def make_rest_layers(frame: SparseFrame, settings: ResolvedSettings, features: Sequence[Feature]) -> list[Layer]:
    """Return the light of a sparse frame that no lobe scattered, as layers that are compared by place alone.

    They are "rest" on surfaces and "background" beside them. A frame that knows this light at every pixel has none (see
    `knows_exact_light`). Where the light is not split, only the background is told apart.
    """
    color, parts = frame.radiance.color, frame.radiance.parts
    if knows_exact_light(frame):
        return []
    surface = mark_surface(frame)
    if parts is None:
        layers = {"background": (color, ~surface)}
    else:
        with np.errstate(invalid="ignore", over="ignore"):
            rest = color - np.maximum(parts[0], np.float32(0.0)) - np.maximum(parts[1], np.float32(0.0))
        # Drop the remainders of rounding.
        rest = np.where(rest > 1e-4 * color, rest, np.float32(0.0))
        layers = {"rest": (rest, surface), "background": (rest, ~surface)}
    shared = (*make_position_features(frame, settings), *features)
    return [
        Layer(light, None, mask, shared, name)
        for name, (light, mask) in layers.items()
        if (light[mask[frame.shaded]] > 0.0).any()
    ]


def knows_exact_light(frame: AnyFrame) -> bool:
    """Return whether a sparse frame knows at every pixel the light that no lobe scattered.

    Without light split by lobe, nobody knows which part of the samples it is.
    """
    known = frame.gbuffer.mean_emission is not None and frame.radiance.parts is not None
    return known and frame.is_sparse


def compute_exact_light(frame: AnyFrame) -> FloatArray | None:
    """Return the light that no lobe scattered at every pixel, finite and >= 0; None where `knows_exact_light` is not.

    It has no noise, so that it is not filtered. Pixels of `GBuffer.mean_emission` that are not finite or negative count
    as black.
    """
    emission = frame.gbuffer.mean_emission
    if emission is None or not knows_exact_light(frame):
        return None
    return np.where(mark_good(emission)[..., None], emission, np.float32(0.0))


def describe_exact_light(frame: SparseFrame) -> tuple[str, ...]:
    """Return what a user should know of the light that is taken from `GBuffer.mean_emission`, one sentence each."""
    emission, notes = frame.gbuffer.mean_emission, []
    if emission is None or not knows_exact_light(frame) or frame.radiance.parts is None:
        return ()
    # The comparison is false for NaN. Most frames need no look at single pixels.
    is_good = float(emission.min()) >= 0.0 and float(emission.max()) < np.inf
    if bad := 0 if is_good else int(np.count_nonzero(~mark_good(emission))):
        pixels = f"{bad} pixel{'s' if bad > 1 else ''}"
        notes.append(f"mean_emission is not finite or below 0 at {pixels}: no emission or background is shown there.")
    total, first, second, rest = (
        float(np.sum(each, where=mark_good(each)[..., None], dtype=np.float64))
        for each in (frame.radiance.color, *frame.radiance.parts, emission[frame.shaded])
    )
    if total - first - second - rest > MAX_SHARE_UNTOLD * total:
        share = 100.0 * (total - first - second - rest) / total
        notes.append(
            f"{share:.2g} % of the light of the samples is neither diffuse nor specular nor in mean_emission, and is "
            "left out: without mean_emission, light beside diffuse and specular is interpolated."
        )
    return tuple(notes)
