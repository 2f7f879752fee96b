"""The memory of the frame before, and the search of each pixel's history in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.errors import InputError, LobewiseError, require_kind
from lobewise.features import PlaneFeature
from lobewise.filters.history.reprojection import ComparedPixels, reproject
from lobewise.filters.history.reprojection_pass import AGREEMENT
from lobewise.filters.history.sums import HISTORY_CHANNELS, get_channel, get_sums, join_channels
from lobewise.guides.lobe_fields import GgxField
from lobewise.guides.places import add_grid, compute_surface_places, compute_virtual_places, estimate_curvature
from lobewise.guides.reflections import Mirror, compute_moved_reflections
from lobewise.recipes.temporal.validation import (
    Guides,
    ValidationFeatures,
    follow_hits,
    make_validation_features,
    update_footprints,
)
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, GBuffer
from lobewise.records.lobe_table import LobeTable
from lobewise.settings import ResolvedSettings, TemporalSettings

MIN_PAST_AGREEMENT = 0.1
"""Agreement above which a pixel counts as found in the frame before, 0 to 1."""
MAX_SHARE_SAMPLES = 256
"""About the rows and columns of the shorter side that are counted for that: a share needs no more."""
MIN_DIFFUSE_SHARE = 0.1
"""Share of the image that reflects diffusely, above which these pixels tell how much of the image continues."""
MAX_STEP = 0.25
"""Longest way of a found pixel, as a share of the image's longer side. Pixels that jump further are of another shot."""
MAX_FOLLOWED_ALPHA = 0.4
"""Largest alpha of a mirror whose moving reflections have their history at their own earlier place alone.

The place of the surface looks nearly as similar, because a reflection moves by little of its lobe from frame to frame.
Histories that take a part of their light there lag behind the reflection, further with every frame. On rougher surfaces
reflections of all things mix, and both places count.
"""
MIN_FOLLOWED_AGREEMENT = 0.7
"""Agreement below which the earlier place of a reflection does not count alone: hit distances of few samples are noisy,
and the mirror may have another roughness there. These pixels find their history as if nothing moved in the mirror."""


@dataclass(frozen=True)
class Past:
    """The memory of the frame before.

    Parameters
    ----------
    guides : Guides
        The surfaces of the frame.
    similarity : str
        The similarity by which its lobes were compared.
    sums : dict of array, shape (height, width, 7)
        Sums of each layer, by its name; see `lobewise.filters.history.sums`.
    validation : dict of ValidationFeatures
        Features of each layer, by its name; empty until they are made.
    allowance : array, shape (height, width), optional
        Argument of `lobewise.recipes.temporal.validation.make_validation_features`.
    """

    guides: Guides
    similarity: str
    sums: dict[str, FloatArray]
    validation: dict[str, ValidationFeatures] = field(default_factory=dict)
    allowance: FloatArray | None = None
    exists: ClassVar[bool] = True
    """Whether there was a frame before; a pipeline asks it for every frame."""

    def get_pixels(self, name: str, features: ValidationFeatures) -> ComparedPixels | None:
        """Return the pixels of a layer; None if it has none that this frame's features can be compared with."""
        old = self.validation.get(name)
        return old.pixels if old is not None and features.fits(old) else None


class _Places(NamedTuple):
    """The places of a frame's pixels in the frame before."""

    surface: FloatArray
    """Column and row of the surface points, (height, width, 2)."""
    virtual: FloatArray | None = None
    """Column and row of the reflections; None where they are not tracked."""
    hit_distance: FloatArray | None = None
    """Hit distances in the frame before, (height, width), if it is known how the hits have moved."""
    axis: FloatArray | None = None
    """Directions to the hits in the frame before, unit length, (height, width, 3), if hit distances are known."""
    followed: NDArray[np.bool_] | None = None
    """Pixels whose reflection has its history at its own place alone, (height, width)."""


class HistoryReprojection:
    """Finds the history of one frame's layers in the past.

    Parameters
    ----------
    guides : Guides
    settings, temporal
    past : Past, optional
        The frame before; None before the first.
    masks : mapping of str to array, shape (height, width)
        Pixels that have the light of each layer, by name.
    lobes : GgxField, optional
        As of `make_validation_features`.

    Attributes
    ----------
    validation : dict of ValidationFeatures
        Features of this frame's layers.
    allowance : array, shape (height, width), or None
        Argument of `make_validation_features` for this frame.
    share : float
        Share of the surface pixels that found their history, 0 to 1.
    """

    def __init__(
        self,
        guides: Guides,
        settings: ResolvedSettings,
        temporal: TemporalSettings,
        past: Past | None,
        masks: Mapping[str, NDArray[np.bool_]],
        lobes: GgxField | None = None,
    ) -> None:
        self._masks, self._temporal, self._guides = masks, temporal, guides
        self._past: Past | None = None
        self._places: _Places | None = None
        self._histories: dict[str, FloatArray | None] = {}
        self.share = 0.0
        self.allowance: FloatArray | None = None
        # Where surfaces and reflections were a frame ago.
        with engine.part("history: places of a frame ago"):
            if past is not None and past.guides.shape == guides.shape and past.similarity == settings.similarity:
                self._places, self.allowance = compute_all_places(guides, past.guides)
            # What recognises pixels there.
            self.validation = make_validation_features(guides, settings, temporal, self.allowance, masks, lobes)
        if past is None or self._places is None:
            return
        # The next frame compares hits with those of this frame, and this frame with their earlier places.
        self._now = self.validation
        distance, axis, followed = self._places.hit_distance, self._places.axis, self._places.followed
        if distance is not None and axis is not None and followed is not None:
            self._now = follow_hits(self.validation, distance, axis, followed)
        if not past.validation:  # it was read from a file
            old = make_validation_features(past.guides, settings, temporal, past.allowance, past.sums)
            past = replace(past, validation=old)
        self._past = past
        for name, features in self.validation.items():
            with engine.part("history: what is compared"):
                self._leave(name, features)
        # A cut drops all history.
        with engine.part("history: cut"):
            self.share = engine.when(past.exists, self._judge_cut)
            self._continues = engine.both(past.exists, engine.compare(self.share, ">=", temporal.cut_share))
            engine.when(self._continues, lambda: None, self._forget)

    def reproject(self, name: str) -> FloatArray | None:
        """Return the history of a layer, faded by a frame, (height, width, 7); None where there is none at all."""
        if self._past is None or name not in self._past.sums:
            return None
        with engine.part(f"{name}: history"):
            if name not in self._histories:
                engine.when(self._continues, partial(self._store, name))
            history = engine.only(self._continues, self._histories.get(name))
            return None if history is None else get_sums(history)

    def _leave(self, name: str, features: ValidationFeatures) -> None:
        """Leave what the next frame compares."""
        engine.keep(f"{name}_mask", lambda: features.mask)
        engine.keep(f"{name}_planes", lambda: features.pixels.planes)

    def _judge_cut(self) -> float:
        """Return how much of the image continues, measured by diffuse light where there is enough of it."""
        assert self._past is not None
        if "diffuse" not in self._past.sums:
            return self._judge("rest")
        diffuse = self._masks["diffuse"]
        self._store("diffuse")
        covered = engine.compare(engine.total(measure_cover, [diffuse], name="cover"), ">", MIN_DIFFUSE_SHARE)
        share: float = engine.when(covered, partial(self._judge, "diffuse"), partial(self._judge, "rest"))
        return share

    def _judge(self, name: str) -> float:
        """Return the share of the pixels of a layer that continue."""
        if name in self._histories:
            history, mask = self._histories[name], self._masks[name]
        else:
            nothing = engine.fill("no_history", 0.0, (HISTORY_CHANNELS, *self._guides.shape))
            history, mask = self._find(name, join_channels(nothing)), self.validation[name].mask
        if history is None or self._places is None:
            return 0.0
        images = [get_channel(history, AGREEMENT), self._places.surface, mask]
        share: float = engine.total(
            measure_share, images, [MIN_PAST_AGREEMENT, MAX_STEP, MAX_SHARE_SAMPLES], name="share"
        )
        return share

    def _forget(self) -> None:
        """Drop the past. Nothing has moved by itself then: the next frame compares plain footprints."""
        self.share = 0.0
        if self.allowance is not None:
            engine.clear(self.allowance)
            plane = self.validation["rest"].surface[0]
            assert isinstance(plane, PlaneFeature)
            update_footprints(self._guides, self._temporal, self.validation["rest"].mask, self.allowance, plane)
            self.validation = {name: replace(features) for name, features in self.validation.items()}
            for name, features in self.validation.items():
                self._leave(name, features)

    def _find(self, name: str, sums: FloatArray) -> FloatArray | None:
        """Return the history of a layer and its agreement, (height, width, 8); None where frames do not compare."""
        assert self._places is not None and self._past is not None
        new = self._now[name]
        old = self._past.get_pixels(name, new)
        if old is None:
            return None
        surface, virtual = self._places.surface, self._places.virtual
        # At the place of the reflection, compare all features but those of the surface.
        second = (virtual, len(new.surface) - len(new.virtual)) if new.virtual and virtual is not None else None

        def find(places: FloatArray, features: ValidationFeatures) -> FloatArray:
            now = features.pixels if name not in self._masks else features.pixels.restrict(self._masks[name])
            memory = self._temporal.memory
            return reproject(sums, places, old, now, virtual=second, memory=memory, name=name)

        followed = self._places.followed
        if second is None or followed is None:
            return find(surface, new)
        history = find(np.where(followed[..., None], np.float32(np.nan), surface), new)
        lost = followed & (history[..., AGREEMENT] < MIN_FOLLOWED_AGREEMENT)
        return np.where(lost[..., None], find(surface, self.validation[name]), history) if lost.any() else history

    def _store(self, name: str) -> None:
        """Find the history of a layer, for `reproject`."""
        assert self._past is not None
        self._histories[name] = self._find(name, self._past.sums[name])


def measure_cover(mask: NDArray[np.bool_]) -> float:
    """Return the share of the pixels that have the light of a mask."""
    return float(np.mean(mask))


def measure_share(
    agreement: FloatArray,
    places: FloatArray,
    mask: NDArray[np.bool_],
    least_agreement: float,
    longest_step: float,
    most_samples: int,
) -> float:
    """Return the share of surfaces that are found in the frame before, not too far away.

    Parameters
    ----------
    agreement, places, mask : arrays
        Of all pixels: agreement of the history, its place, and whether the pixel counts.
    least_agreement : float
        Agreement of a pixel that is found, exclusive.
    longest_step : float
        Longest way of such a pixel, as a share of the image's longer side, exclusive.
    most_samples : int
        About the rows and columns of the shorter side that are counted.
    """
    some = (slice(None, None, max(1, min(mask.shape) // most_samples)),) * 2
    near = _mark_near(places, longest_step * max(mask.shape), some)
    again, surface = (agreement[some] > least_agreement) & near, mask[some]
    # A frame of sky alone is no cut.
    return float(np.mean(again[surface])) if surface.any() else 1.0


def _mark_near(places: FloatArray, reach: float, some: tuple[slice, slice]) -> NDArray[np.bool_]:
    """Return which of some pixels moved less than ``reach`` pixels."""
    rows, columns = (np.arange(size, dtype=np.float32)[each] for size, each in zip(places.shape, some, strict=False))
    across = np.abs(places[(*some, 0)] - columns) < reach
    return np.asarray(across & (np.abs(places[(*some, 1)] - rows[:, None]) < reach))


def compute_all_places(guides: Guides, before: Guides) -> tuple[_Places | None, FloatArray | None]:
    """Return the earlier places of surfaces and reflections, and the own motion of surfaces, pixels."""
    motion, camera, previous = guides.gbuffer.motion, guides.camera, before.camera
    if camera is None or previous is None or not guides.is_placed:
        if motion is None:
            return None, None
        return _Places(add_grid(motion)), None
    position, _ = guides.places
    surface, allowance = compute_surface_places(camera, previous, guides.places, motion)
    distance, normal = guides.gbuffer.hit_distance, guides.gbuffer.normal
    if distance is None or normal is None:
        return _Places(surface), allowance
    curvature = estimate_curvature(position, normal)
    moved = guides.gbuffer.reflected_motion
    normal_before = None if moved is None else before.gbuffer.normal
    if moved is None or normal_before is None or not before.is_placed:
        return _Places(surface, compute_virtual_places(position, curvature, distance, camera, previous)), allowance
    mirrors = Mirror(position, normal), Mirror(before.places[0], normal_before)
    reflected = compute_moved_reflections(mirrors, curvature, distance, moved, (surface, allowance), (camera, previous))
    followed = reflected.has_moved & _is_narrow(guides.gbuffer)
    return _Places(surface, reflected.places, reflected.hit_distance, reflected.axis, followed), allowance


def _is_narrow(gbuffer: GBuffer) -> NDArray[np.bool_]:
    """Return where neither alpha is above `MAX_FOLLOWED_ALPHA`; nowhere without alphas."""
    alphas = [alpha for alpha in (gbuffer.alpha_u, gbuffer.alpha_v) if alpha is not None]
    if not alphas:
        return np.zeros(gbuffer.shape or (0, 0), dtype=bool)
    return np.asarray(np.logical_and.reduce([alpha <= MAX_FOLLOWED_ALPHA for alpha in alphas]))


def pack_past(past: Past) -> dict[str, NDArray[Any]]:
    """Return a past as arrays by name."""
    packed: dict[str, NDArray[Any]] = {"similarity": np.array(past.similarity)}
    # Samples may be added to the sums in place later.
    packed |= {f"sums/{name}": np.copy(value, order="K") for name, value in past.sums.items()}
    if past.allowance is not None:
        packed["allowance"] = past.allowance
    parts: list[tuple[str, Any]] = [("gbuffer", past.guides.gbuffer), ("camera", past.guides.camera)]
    parts += [(f"table{number:04d}", table) for number, table in enumerate(past.guides.lobe_tables)]
    for prefix, part in parts:
        if part is not None:
            values = {item.name: getattr(part, item.name) for item in fields(part)}
            packed |= {f"{prefix}/{name}": np.asarray(value) for name, value in values.items() if value is not None}
    return packed


_PARTS = ("similarity", "sums", "allowance", "gbuffer", "camera")


def unpack_past(packed: Mapping[str, NDArray[Any]]) -> Past:
    """Return the past from the arrays of `pack_past`; its features are made when they are needed.

    Raises
    ------
    InputError
        If something is missing or does not fit.
    """
    require_kind("state", packed, Mapping)
    parts: dict[str, dict[str, Any]] = {}
    for name, value in packed.items():
        prefix, _, key = name.partition("/")
        array = np.asarray(value)
        parts.setdefault(prefix, {})[key] = array.item() if array.ndim == 0 else array
    try:
        unknown = [name for name in parts if name not in _PARTS and not name.startswith("table")]
        if unknown:
            raise ValueError(f"{unknown[0]}: unknown")
        camera = _unpack_camera(parts["camera"]) if "camera" in parts else None
        tables = [LobeTable(**parts[name]) for name in sorted(parts) if name.startswith("table")]
        guides = Guides(GBuffer(**parts["gbuffer"]), camera, tuple(tables))
        size = guides.shape
        sums = {
            name: _take_image(name, value, (*size, HISTORY_CHANNELS)) for name, value in parts.get("sums", {}).items()
        }
        allowance = _take_image("allowance", packed["allowance"], size) if "allowance" in packed else None
        return Past(guides, str(packed["similarity"]), sums, allowance=allowance)
    except (AssertionError, KeyError, TypeError, ValueError, LobewiseError):
        raise InputError(
            "state",
            expected="what get_state returned",
            got=f"{len(packed)} arrays that do not belong together",
            action="start the sequence again",
        ) from None


def _unpack_camera(values: Mapping[str, Any]) -> Camera:
    """Return a camera with exactly these directions: making them orthonormal again would change their last bits."""
    camera = Camera(**values)
    for name in ("forward", "up"):
        exact = np.array(values[name], dtype=np.float64)
        exact.setflags(write=False)
        object.__setattr__(camera, name, exact)
    return camera


def _take_image(name: str, value: NDArray[Any], shape: tuple[int, ...]) -> FloatArray:
    """Return ``value`` as float32; raise ValueError unless it is real and has this shape."""
    if value.shape != shape or value.dtype.kind != "f":
        raise ValueError(f"{name}: {value.dtype} of shape {value.shape}")
    return np.asarray(value, dtype=np.float32)
