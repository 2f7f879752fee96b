"""What the pixels of a layer are recognised by a frame later: the features that are compared between two frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.layers import find_places, find_surface, make_specular_features
from lobewise.denoising.settings import DenoiseSettings, can_use_hits
from lobewise.frame import Camera, FloatArray, Frame, GBuffer, Radiance
from lobewise.kernels.cross_filter import describe_structure
from lobewise.kernels.features import Feature, NormalFeature, PlaneFeature
from lobewise.kernels.lobe_features import DiffuseFeature, HitDistanceFeature
from lobewise.lobe_table import LobeTable
from lobewise.lobes.field import default_tau
from lobewise.temporal.settings import TemporalSettings

FAR = 1e8
"""Distance of the background, world units."""
HIT_TOLERANCE = 0.08
"""Standard deviation of the logarithm of a mirror's hit distance: what of a frame's change is no change of the hit."""
HIT_TOLERANCE_PER_LOBE = 1.5
"""How much of it a lobe adds for each radian that it is wide: its hit distance is an average over what it sees."""


@dataclass(frozen=True)
class Guides:
    """What is known of a frame's surfaces, whatever was shaded."""

    gbuffer: GBuffer
    camera: Camera | None
    lobe_tables: tuple[LobeTable, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        assert self.gbuffer.shape is not None
        return self.gbuffer.shape

    @cached_property
    def frame(self) -> Frame:
        """A black frame with these guides."""
        black = np.broadcast_to(np.float32(0.0), (*self.shape, 3))
        return Frame(Radiance(black), self.gbuffer, self.camera, lobe_tables=self.lobe_tables)

    @property
    def is_placed(self) -> bool:
        """Whether every pixel's surface point is known."""
        placed = self.gbuffer.position is not None or self.gbuffer.depth is not None
        return placed and self.camera is not None


@dataclass(frozen=True)
class Marks:
    """What one layer is recognised by.

    Parameters
    ----------
    mask : bool array, shape (height, width)
        Where the layer has meaning.
    surface : tuple of Feature
        Compared where the surface point was.
    virtual : tuple of Feature
        Compared where the reflection was; empty where reflections are not told apart or not tracked.
    """

    mask: NDArray[np.bool_]
    surface: tuple[Feature, ...]
    virtual: tuple[Feature, ...] = ()

    def fits(self, other: Marks) -> bool:
        """Return whether both compare the same things in images of one size."""

        def describe(features: Sequence[Feature]) -> list[object]:
            return [describe_structure(feature) for feature in features]

        return (
            self.mask.shape == other.mask.shape
            and describe(self.surface) == describe(other.surface)
            and describe(self.virtual) == describe(other.virtual)
        )


def make_marks(
    guides: Guides, settings: DenoiseSettings, temporal: TemporalSettings, allowance: FloatArray | None, apart: bool
) -> dict[str, Marks]:
    """Return the marks of every layer by its name: ``diffuse``, ``specular`` (``color`` without parts) and ``rest``.

    Parameters
    ----------
    guides : Guides
        Of one frame.
    settings : DenoiseSettings
        Resolved; which similarity compares lobes.
    temporal : TemporalSettings
        How strictly.
    allowance : array, shape (height, width), optional
        Pixel footprints by which the surface moved by itself, allowed for beside those of the settings.
    apart : bool
        Whether diffuse and specular radiance are.
    """
    frame = guides.frame
    surface = find_surface(frame)
    everywhere = np.ones(guides.shape, dtype=bool)
    plane = _make_plane(guides, temporal, surface, allowance)
    normal = guides.gbuffer.normal
    assert normal is not None
    # The background faces the camera from far away, so that it is itself again and no surface.
    looking = normal if surface.all() else np.where(surface[..., None], normal, -_make_rays(guides))
    facing = NormalFeature(looking, settings.normal_exponent)
    marks = {"rest": Marks(everywhere, (*plane, facing))}
    same = replace(
        settings,
        beta=temporal.beta,
        diffuse_beta=temporal.beta,
        tau=default_tau(guides.camera, guides.shape[0]) if guides.camera is not None else settings.tau,
        hit_distance=can_use_hits(frame),
    )
    lobes, mask = make_specular_features(frame, same, surface, apart)
    # Reflections that are mixed with diffuse light do not move as one.
    virtual = (*lobes, *_make_hit_features(guides)) if apart and same.hit_distance else ()
    marks["specular" if apart else "color"] = Marks(mask, (*plane, *(virtual or lobes)), virtual)
    if apart:
        diffuse = facing if settings.similarity == "normal" else DiffuseFeature(normal, temporal.beta)
        marks["diffuse"] = Marks(surface, (*plane, diffuse))
    return marks


def _make_rays(guides: Guides) -> FloatArray:
    """Return the directions in which the pixels look, (height, width, 3); without a camera one for all."""
    height, width = guides.shape
    if guides.camera is None:
        return np.broadcast_to(np.array([0.0, 0.0, -1.0], np.float32), (height, width, 3))
    return guides.camera.make_ray_directions(width, height)


def _make_plane(
    guides: Guides, temporal: TemporalSettings, surface: NDArray[np.bool_], allowance: FloatArray | None
) -> tuple[Feature, ...]:
    if not guides.is_placed:
        return ()
    assert guides.camera is not None and guides.gbuffer.normal is not None
    position, depth = find_places(guides.frame)
    footprint = depth * np.float32(guides.camera.get_pixel_angle(guides.shape[0]))
    if allowance is not None:
        footprint = footprint * (1.0 + allowance / np.float32(temporal.plane_sigma))
    footprint = np.where(surface, footprint, np.float32(1.0)).astype(np.float32)
    normal = np.where(surface[..., None], guides.gbuffer.normal, np.float32(0.0))
    if not surface.all():
        away = guides.camera.position.astype(np.float32) + np.float32(FAR) * _make_rays(guides)
        position = np.where(surface[..., None], position, away)
    return (PlaneFeature(position, normal, footprint, temporal.plane_sigma),)


def _make_hit_features(guides: Guides) -> tuple[Feature, ...]:
    """Return what compares how far away is what a lobe sees, the more strictly the narrower it is."""
    distance, alpha_u, alpha_v = (getattr(guides.gbuffer, name) for name in ("hit_distance", "alpha_u", "alpha_v"))
    if alpha_u is None:
        return ()
    widest = alpha_u if alpha_v is None else np.maximum(alpha_u, alpha_v)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(distance > 0.0, 1.0 / distance, 0.0)
    tolerance = HIT_TOLERANCE + HIT_TOLERANCE_PER_LOBE * np.where(widest > 0.0, widest, np.float32(0.0))
    return (HitDistanceFeature(inverse.astype(np.float32), tolerance.astype(np.float32)),)
