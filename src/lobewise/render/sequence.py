"""Sequences of frames with a moving camera and moving objects, with motion in the guides."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from lobewise.errors import InputError
from lobewise.records.camera import Camera
from lobewise.records.sparse_frame import AnyFrame, list_places
from lobewise.render.camera import get_camera, set_camera
from lobewise.render.loading import MovingScene
from lobewise.render.moving.object_paths import PlacedScene
from lobewise.render.renderer import render_frame, render_reference, render_sparse_frame


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
    """Render a frame from each camera of a path, one at a time, as the iterator asks for them.

    Every frame but the first of the path has ``gbuffer.motion`` since the previous frame, and where shapes move
    ``gbuffer.reflected_motion`` as well. The radiance of each frame has its own random numbers. The guides of all
    frames share theirs, so they do not change while neither the camera nor objects move. A frame depends on its place
    in the path, not on ``first``, so a path may be rendered in pieces.

    Parameters
    ----------
    scene : mitsuba.Scene, MovingScene or PlacedScene
        The sensor of a ``mitsuba.Scene`` is moved. A `MovingScene` is loaded again for the time of each frame. The
        shapes of a `PlacedScene` move in the loaded scene.
    cameras : sequence of Camera
        One camera for each frame, counted from 0.
    spp : int
        Samples of a shaded pixel.
    scale : int
        1 renders whole frames. Above 1 frames are sparse: of every block of ``scale`` times ``scale`` pixels, the one
        at place ``list_places(scale)[index % scale**2]`` is shaded.
    first : int
        Index of the camera with which to begin.
    seed : int
        Seed of the guides; the radiance of frame ``index`` has the seed ``seed + index``.
    guide_spp : int
        Samples of every pixel for the guides that are means.
    max_depth, light, integrator
        See `render_frame`.
    reference : bool
        Render only the radiance of whole frames, with `render_reference`.

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
    light_settings: dict[str, Any] = {"spp": spp, "max_depth": max_depth, "light": light, "integrator": integrator}
    places = list_places(scale)

    def render(current: Any, index: int, since: dict[str, Any]) -> AnyFrame:
        common = {**light_settings, "seed": (seed + index) % (1 << 32)}
        if reference:
            return render_reference(current, **common)
        if scale > 1:
            guided: dict[str, Any] = {"guide_spp": guide_spp, "guide_seed": seed, **since}
            return render_sparse_frame(current, scale=scale, place=places[index % len(places)], **guided, **common)
        guides = render_frame(current, spp=guide_spp, seed=seed, max_depth=max_depth, aov_only=True, **since)
        return render_frame(current, coverage=False, **common).with_changes(gbuffer=guides.gbuffer)

    return _render_path(scene, cameras, first, render)


def _render_path(
    scene: Any, cameras: Sequence[Camera], first: int, render: Callable[[Any, int, dict[str, Any]], AnyFrame]
) -> Iterator[AnyFrame]:
    """Yield ``render(scene, index, since)`` for each camera; ``since`` holds the motion since the previous frame."""
    moving = scene if isinstance(scene, MovingScene | PlacedScene) else None
    current = None if moving else scene
    previous: Camera | None = None
    for index in range(first, len(cameras)):
        if moving is not None:
            # Dr.Jit compiles for every BSDF that exists, so drop the previous frame's scene before loading the next.
            current = None
            current = moving.load(index)
        since: dict[str, Any] = {}
        if index > 0:
            # Take the camera in the sensor's single precision: still objects must not seem to move.
            since["previous_camera"] = previous or _round_camera(current, cameras[index - 1])
            since["moves"] = moving.compute_moves(index, index - 1) if moving is not None else None
        set_camera(current, cameras[index])
        frame = render(current, index, since)
        previous = frame.camera
        yield frame


def _round_camera(scene: Any, camera: Camera) -> Camera:
    """Return a camera in the precision of the scene's sensor."""
    set_camera(scene, camera)
    return get_camera(scene)
