"""A frame of a sequence, with what its neighbours in time compare: places, lobes, hits."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.automatic import resolve_settings
from lobewise.denoising.combining import mix_albedos
from lobewise.denoising.recipe import denoise_checked
from lobewise.guides.places import compute_surface_places, estimate_curvature
from lobewise.guides.screen_hits import estimate_screen_hits
from lobewise.guides.usable import CheckedGuides
from lobewise.peers import reduce_guides
from lobewise.recipes.temporal.validation import Guides, ValidationFeatures, make_validation_features
from lobewise.recipes.windows.layers import LayerImages, list_layers
from lobewise.recipes.windows.motion import describe_motion
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import DenoiseSettings, QualityName, SimilarityName, TemporalSettings

MIN_OWN_MOTION_PIXELS = 0.1
"""Distance between the motion of a surface and the motion of the camera. Below it the surface stands still: the places
of still surfaces are computed from the cameras, without the errors of motion vectors."""
MAX_STEP_SHARE = 0.25
"""Longest own motion between two frames, as a share of the image's longer side."""
PILOT_QUALITY: QualityName = "balanced"
"""Quality of the first denoising, which samples of other frames are compared with. With "fast" shadows that move are
smeared: films of textures have up to 10 % more error."""
MAX_SHARP_ALPHA = 0.1
"""Roughness alpha below which reflections are interpolated between pixels."""


class Shot:
    """A frame, prepared once for all windows in which it takes part.

    Parameters
    ----------
    frame : Frame
        With guides that `lobewise.guides.usable.check_guides` has seen.
    previous : Camera, optional
        Camera of the frame before; tells which surfaces move by themselves.
    similarity : str
        How lobes are compared.
    settings : DenoiseSettings
        How frames are denoised.
    reach : int
        Frames to each side of a window.
    """

    def __init__(
        self, frame: Frame, previous: Camera | None, similarity: SimilarityName, settings: DenoiseSettings, reach: int
    ) -> None:
        self.frame = frame
        # The camera of an image that wraps around has no rays of its own, and projects nothing.
        self.guides = Guides(frame.gbuffer, None if frame.wraps else frame.camera, frame.lobe_tables)
        self._previous = previous
        self._similarity = similarity
        self._settings = settings
        self._reach = reach

    @property
    def is_placed(self) -> bool:
        """Whether camera and surface points are known, and how the camera moved tells where points were."""
        return self.guides.is_placed

    @cached_property
    def own_motion(self) -> FloatArray:
        """Distance in pixels that surfaces moved in addition to the camera's motion, (height, width)."""
        motion, camera = self.frame.gbuffer.motion, self.guides.camera
        if motion is None or camera is None or self._previous is None or not self.is_placed:
            return np.zeros(self.frame.shape, np.float32)
        _, distance = compute_surface_places(camera, self._previous, self.guides.places, motion)
        assert distance is not None
        # At a cut the camera jumps, and motion vectors know nothing of it.
        return np.where(distance < MAX_STEP_SHARE * max(self.frame.shape), distance, np.float32(0.0))

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the motion vectors."""
        motion = self.frame.gbuffer.motion
        if motion is None or self._previous is None or not self.is_placed:
            return ()
        return describe_motion(motion, self.guides, self._previous)

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """Where surfaces move by themselves, (height, width)."""
        return self.own_motion > MIN_OWN_MOTION_PIXELS

    @cached_property
    def features(self) -> dict[str, ValidationFeatures]:
        """What recognises the pixels of each kind of light; see `make_validation_features`."""
        settings = resolve_settings(self.frame, DenoiseSettings(similarity=self._similarity), spp=1.0)
        allowance = np.float32(self._reach) * self.own_motion if self.is_placed else None
        names = ("diffuse", "specular") if self.frame.radiance.parts is not None else ("color",)
        names = (*names, "background")
        return make_validation_features(self.guides, settings, TemporalSettings(), allowance, names, spread=True)

    @cached_property
    def layers(self) -> dict[str, LayerImages]:
        """The layers of the frame by name, with their pilots: what a first denoising makes of them."""
        settings = replace(self._settings, quality=PILOT_QUALITY, with_oidn=False)
        # Passes have the weights of their layers, and need no pilots.
        bare = tuple(replace(layer, parts={}) for layer in self.frame.layers)
        frame = self.frame.with_changes(alpha=None, also={}, layers=bare)
        pilot = denoise_checked(CheckedGuides(frame), settings)
        return list_layers(self.frame, pilot)

    @cached_property
    def whole_albedo(self) -> FloatArray | None:
        """The albedo of all light, (height, width, 3), in [0, 1]; None where none is known."""
        return reduce_guides(mix_albedos(self.frame.gbuffer)).denoiser_albedo

    @cached_property
    def curvature(self) -> FloatArray:
        """Curvature of the surfaces, 1/world unit, (height, width)."""
        normal = self.frame.gbuffer.require("normal", "reflections over time")
        return estimate_curvature(self.guides.places[0], normal)

    @cached_property
    def is_sharp(self) -> NDArray[np.bool_]:
        """Where lobes are so narrow that half a pixel shows, (height, width); nowhere without roughness."""
        guides = self.frame.gbuffer
        widths = [alpha for alpha in (guides.alpha_u, guides.alpha_v) if alpha is not None]
        if not widths:
            return np.zeros(self.frame.shape, np.bool_)
        return np.asarray(np.minimum.reduce(widths) < MAX_SHARP_ALPHA)

    @cached_property
    def hits(self) -> FloatArray:
        """Distances to the reflected surfaces, (height, width), 0 where unknown: the frame's, or from the screen."""
        position, depth = self.guides.places
        camera = self.guides.require_camera("reflections over time")
        normal = self.frame.gbuffer.require("normal", "reflections over time")
        on_screen = estimate_screen_hits(camera, position, depth, normal, self.curvature)
        of_frame = self.frame.gbuffer.hit_distance
        return on_screen if of_frame is None else np.where(of_frame > 0.0, of_frame, on_screen)


def extrapolate_camera(camera: Camera, following: Camera) -> Camera:
    """Return the camera of the frame before, if the camera moves on evenly to the ``following`` frame."""
    back = {name: 2.0 * getattr(camera, name) - getattr(following, name) for name in ("position", "forward", "up")}
    return replace(camera, **back)
