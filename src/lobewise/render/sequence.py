"""Frames one after another: the camera moves, objects may, and every pixel tells where its surface was before."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from lobewise.camera import Camera
from lobewise.errors import InputError
from lobewise.render.camera import get_camera, set_camera
from lobewise.render.loading import MovingScene
from lobewise.render.renderer import render_frame, render_reference, render_sparse_frame
from lobewise.sparse_frame import AnyFrame, list_places


def render_sequence(
    scene: Any,
    cameras: Sequence[Camera],
    *,
    spp: int,
    scale: int = 1,
    first: int = 0,
    seed: int = 0,
    guide_spp: int = 4,
    max_depth: int | None = None,
    light: str = "all",
    integrator: str = "auto",
    reference: bool = False,
) -> Iterator[AnyFrame]:
    """Render a frame from each camera of a path, one at a time as they are asked for.

    Every frame but the first of the path has ``gbuffer.motion`` since the one before. The radiance of each frame has
    random numbers of its own, the guides have the same in all: while neither camera nor objects move, guides are the
    same to the bit. What a frame holds depends on its place in the path alone, not on ``first``: a path may be rendered
    in pieces.

    Parameters
    ----------
    scene : mitsuba.Scene or MovingScene
        What to render. The sensor of a ``mitsuba.Scene`` is moved; a `MovingScene` is loaded anew for each frame, as it
        is at that time.
    cameras : sequence of Camera
        The path: one camera for each frame, counted from 0.
    spp : int
        Samples of a shaded pixel.
    scale : int
        1 renders whole frames. Above 1 they are sparse: one pixel of every block of ``scale`` times ``scale`` is
        shaded, that at place ``list_places(scale)[index % scale**2]``.
    first : int
        Index of the camera with which to begin.
    seed : int
        That of the guides; frame ``index`` has the radiance of ``seed + index``.
    guide_spp : int
        Samples of every pixel for the guides that are averages.
    max_depth, light, integrator
        See `render_frame`.
    reference : bool
        Render the radiance alone, of whole frames, as `render_reference` does.

    Yields
    ------
    Frame or SparseFrame

    Raises
    ------
    InputError
        If a number is out of range, or a sensor is not a plain perspective camera.
    UnsupportedBsdfError, MissingDependencyError
        See `render_frame`.
    """
    if not 0 <= first < len(cameras):
        known = f"the index of one of the {len(cameras)} cameras"
        raise InputError("first", expected=known, got=repr(first), action="pass a longer path")
    if reference and scale != 1:
        raise InputError("reference", expected="scale 1", got=str(scale), action="references are whole frames")
    light_settings = {"spp": spp, "max_depth": max_depth, "light": light, "integrator": integrator}
    moving = scene if isinstance(scene, MovingScene) else None
    path = _Path(
        None if moving else scene,
        moving,
        cameras,
        scale,
        list_places(scale),
        seed,
        guide_spp,
        reference,
        light_settings,
    )
    return (path.render(index) for index in range(first, len(cameras)))


@dataclass
class _Path:
    """Renders the frames of a path in turn; what it is made with is told in `render_sequence`."""

    scene: Any
    moving: MovingScene | None
    cameras: Sequence[Camera]
    scale: int
    places: Sequence[tuple[int, int]]
    seed: int
    guide_spp: int
    is_reference: bool
    light: dict[str, Any]
    previous: Camera | None = None

    def render(self, index: int) -> AnyFrame:
        """Return the frame of a place in the path, as it follows the one before."""
        if self.moving is not None:
            # Dr.Jit compiles for every BSDF that lives: the scene of the frame before must go first.
            self.scene = None
            self.scene = self.moving.load(index)
        since: dict[str, Any] = {}
        if index > 0:
            # As the sensor has it, in single precision: what stands still must not seem to move.
            since["previous_camera"] = self.previous or _round_camera(self.scene, self.cameras[index - 1])
            since["moves"] = self.moving.find_moves(index, index - 1) if self.moving is not None else None
        set_camera(self.scene, self.cameras[index])
        frame = self._render(index, since)
        self.previous = frame.camera
        return frame

    def _render(self, index: int, since: dict[str, Any]) -> AnyFrame:
        common = {**self.light, "seed": (self.seed + index) % (1 << 32)}
        if self.is_reference:
            return render_reference(self.scene, **common)
        if self.scale > 1:
            place = self.places[index % len(self.places)]
            guides: dict[str, Any] = {"guide_spp": self.guide_spp, "guide_seed": self.seed}
            return render_sparse_frame(self.scene, scale=self.scale, place=place, **guides, **common, **since)
        alone = {"spp": self.guide_spp, "seed": self.seed, "max_depth": self.light["max_depth"]}
        guides_alone = render_frame(self.scene, **alone, aov_only=True, **since)
        return render_frame(self.scene, coverage=False, **common).with_changes(gbuffer=guides_alone.gbuffer)


def _round_camera(scene: Any, camera: Camera) -> Camera:
    """Return the camera that the scene's sensor makes of a camera."""
    set_camera(scene, camera)
    return get_camera(scene)
