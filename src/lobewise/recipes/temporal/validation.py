"""The features that recognise the pixels of a layer one frame later."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.layers import compare_specular
from lobewise.features import (
    DiffuseFeature,
    Feature,
    GgxFeature,
    HitDistanceFeature,
    NormalFeature,
    PlaneFeature,
    SgFeature,
)
from lobewise.features.base import describe_structure
from lobewise.filters.history.reprojection import ComparedPixels, prepare_pixels
from lobewise.guides.lobe_fields import GgxField, default_tau
from lobewise.guides.surfaces import (
    Backdrop,
    compute_footprints,
    compute_inverse_hits,
    compute_points,
    compute_tolerances,
    put_backdrop,
)
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, Guided, Radiance
from lobewise.records.lobe_table import LobeTable
from lobewise.settings import ResolvedSettings, TemporalSettings
from lobewise.settings.choices import get_similarity

BACKGROUND_DISTANCE = 1e8
"""Distance of the background, world units."""
HIT_TOLERANCE = 0.08
"""Standard deviation of the logarithm of a mirror's hit distance between two frames that show the same hit."""
HIT_TOLERANCE_PER_LOBE = 1.5
"""Increase of this standard deviation for each radian of a lobe's width: a wide lobe averages its hit distances."""


@dataclass(frozen=True, repr=False)
class Guides(Guided):
    """The surfaces of a frame, full or sparse."""

    gbuffer: GBuffer
    camera: Camera | None
    lobe_tables: tuple[LobeTable, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.gbuffer.shape or (0, 0)

    @cached_property
    def frame(self) -> Frame:
        """A black frame with these guides."""
        black = np.broadcast_to(np.float32(0.0), (*self.shape, 3))
        return Frame(Radiance(black), self.gbuffer, self.camera, lobe_tables=self.lobe_tables)

    @cached_property
    def places(self) -> tuple[FloatArray, FloatArray]:
        """The surface points (height, width, 3) and their depths."""
        return compute_points(self.gbuffer, self.require_camera("places"))


@dataclass(frozen=True)
class ValidationFeatures:
    """The features that recognise one layer.

    Parameters
    ----------
    mask : bool array, shape (height, width)
        Pixels that have this light.
    surface : tuple of Feature
        Compared at the earlier place of the surface point.
    virtual : tuple of Feature
        Compared at the earlier place of the reflection; empty where reflections are not split off or not tracked.
    name : str
        Name of the layer.
    """

    mask: NDArray[np.bool_]
    surface: tuple[Feature, ...]
    virtual: tuple[Feature, ...] = ()
    name: str = "light"

    @cached_property
    def pixels(self) -> ComparedPixels:
        """The pixels, ready to be compared. They are prepared once, for this frame and the next."""
        return prepare_pixels(self.mask, self.surface, self.name)

    def fits(self, other: ValidationFeatures) -> bool:
        """Return whether both have the same kinds of features and one size."""

        def describe(features: Sequence[Feature]) -> list[object]:
            return [describe_structure(feature) for feature in features]

        return (
            self.mask.shape == other.mask.shape
            and describe(self.surface) == describe(other.surface)
            and describe(self.virtual) == describe(other.virtual)
        )


def compute_same_tau(guides: Guided, settings: ResolvedSettings) -> float:
    """Return the band-limit of lobes that are compared between frames, radians: a pixel's."""
    return default_tau(guides.camera, guides.height) if guides.camera is not None else settings.tau


def make_validation_features(
    guides: Guides,
    settings: ResolvedSettings,
    temporal: TemporalSettings,
    allowance: FloatArray | None,
    names: Collection[str],
    lobes: GgxField | None = None,
    *,
    spread: bool = False,
) -> dict[str, ValidationFeatures]:
    """Return the features of all layers: ``diffuse`` and ``specular``, or ``color``; ``rest``, perhaps ``background``.

    Parameters
    ----------
    guides : Guides
        Surfaces of one frame.
    settings : ResolvedSettings
        Its similarity compares the lobes.
    temporal : TemporalSettings
        Its ``beta`` and ``plane_sigma`` say how strictly.
    allowance : array, shape (height, width), optional
        Own motion of the surface, pixel footprints. It widens the tolerance of the settings.
    names : collection of str
        Names of the layers: "diffuse" among them if diffuse and specular radiance are split.
    lobes : GgxField, optional
        The lobes for the band-limit of `compute_same_tau`, if they were made beforehand.
    spread : bool
        Whether lobes are as wide as what a pixel's area reflects; see `lobewise.guides.lobe_fields.spread_lobes`.
    """
    frame = guides.frame
    normal = guides.gbuffer.require("normal", "a history")
    position = guides.places[0] if guides.is_placed else None
    same = replace(
        settings,
        beta=temporal.beta,
        diffuse_beta=temporal.beta,
        tau=compute_same_tau(guides, settings),
    )
    apart = "diffuse" in names
    alike, mask, surface = compare_specular(frame, same, apart, spread=spread, lobes=lobes)
    # Put the background far away, facing the camera: it then matches itself and no surface.
    backdrop = put_backdrop(surface, normal, position, guides.camera, BACKGROUND_DISTANCE)
    plane = _make_plane(guides, temporal, surface, allowance, backdrop)
    facing = NormalFeature(backdrop.facing, settings.normal_exponent)
    masks = {"rest": surface, **({"background": ~surface} if "background" in names else {})}
    validation = {name: ValidationFeatures(mask, (*plane, facing), (), name) for name, mask in masks.items()}
    # Track reflections only where they are split from diffuse light, which moves with the surface.
    follows = apart and position is not None and guides.gbuffer.hit_distance is not None
    virtual = (*alike, *_make_hit_features(guides)) if follows else ()
    name = "specular" if apart else "color"
    validation[name] = ValidationFeatures(mask, (*plane, *(virtual or alike)), virtual, name)
    if apart:
        diffuse = DiffuseFeature(normal, temporal.beta) if get_similarity(settings.similarity).has_lobes else facing
        validation["diffuse"] = ValidationFeatures(surface, (*plane, diffuse), (), "diffuse")
    return validation


def follow_hits(
    validation: Mapping[str, ValidationFeatures],
    hit_distance: FloatArray,
    axis: FloatArray,
    followed: NDArray[np.bool_],
) -> dict[str, ValidationFeatures]:
    """Return features that recognise reflections of moving objects in the frame before.

    Hits and the lobes of narrow reflections are compared at their earlier places. Features of the frame before need no
    change.

    Parameters
    ----------
    validation : mapping of ValidationFeatures
        Features of this frame, by layer; only those of ``specular`` change.
    hit_distance, axis : array, shape (height, width) and (height, width, 3)
        Distance and direction of each hit in the frame before; see
        `lobewise.guides.reflections.compute_moved_reflections`.
    followed : bool array, shape (height, width)
        Pixels whose lobe has this axis.
    """
    inverse = compute_inverse_hits(hit_distance)

    def follow(feature: Feature) -> Feature:
        if isinstance(feature, HitDistanceFeature):
            return replace(feature, inverse_distance=inverse)
        if isinstance(feature, SgFeature):
            return replace(feature, axis=np.where(followed[..., None], axis, feature.axis))
        if isinstance(feature, GgxFeature):
            x, y, z = (np.where(followed, axis[..., k], plane) for k, plane in enumerate(feature.lobe[:3]))
            return replace(feature, lobe=feature.lobe._replace(axis_x=x, axis_y=y, axis_z=z))
        return feature

    followed_features = dict(validation)
    if "specular" in validation and validation["specular"].virtual:
        mask, surface, virtual = (getattr(validation["specular"], name) for name in ("mask", "surface", "virtual"))
        moved = tuple(map(follow, virtual))
        features = (*surface[: len(surface) - len(virtual)], *moved)
        followed_features["specular"] = ValidationFeatures(mask, features, moved, "specular")
    return followed_features


def _make_plane(
    guides: Guides,
    temporal: TemporalSettings,
    surface: NDArray[np.bool_],
    allowance: FloatArray | None,
    backdrop: Backdrop,
) -> tuple[Feature, ...]:
    if backdrop.position is None:
        return ()
    footprint = update_footprints(guides, temporal, surface, allowance)
    return (PlaneFeature(backdrop.position, backdrop.normal, footprint, temporal.plane_sigma),)


def update_footprints(
    guides: Guides,
    temporal: TemporalSettings,
    surface: NDArray[np.bool_],
    allowance: FloatArray | None,
    plane: PlaneFeature | None = None,
) -> FloatArray:
    """Return the widths of pixels on their surfaces, wider where these moved by themselves.

    With ``plane`` its footprints become these widths.
    """
    angle = guides.require_camera("a plane").get_pixel_angle(guides.height)
    into = None if plane is None else plane.footprint
    return compute_footprints(surface, guides.places[1], angle, allowance, 1.0 / temporal.plane_sigma, into)


def _make_hit_features(guides: Guides) -> tuple[Feature, ...]:
    """Return the feature of hit distances; narrow lobes are compared more strictly."""
    distance, alpha_u, alpha_v = (getattr(guides.gbuffer, name) for name in ("hit_distance", "alpha_u", "alpha_v"))
    if alpha_u is None:
        return ()
    tolerances = compute_tolerances(alpha_u, alpha_v, HIT_TOLERANCE, HIT_TOLERANCE_PER_LOBE)
    return (HitDistanceFeature(compute_inverse_hits(distance), tolerances),)
