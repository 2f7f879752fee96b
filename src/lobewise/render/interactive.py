"""The whole chain, frame after frame: guides, direct light, sparse indirect light, upsampling, repair, composite.

Source: Tokuyoshi 2015, slides "Spatio-Temporal Upsampling" and "Adaptive Sampling".
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.adaptive import recompute
from lobewise.denoising import DenoiseSettings, denoise
from lobewise.denoising.settings import SIMILARITIES
from lobewise.errors import InputError, describe_problem, require_choice
from lobewise.frame import Camera, FloatArray, Frame, Radiance, Result
from lobewise.render.methods import METHODS, Methods
from lobewise.render.scenes import load_scene
from lobewise.render.stages import DirectLight, FirstHits, Stages
from lobewise.render.views import VIEWS, make_view
from lobewise.sparse_frame import MOST_SCALE, SparseFrame, list_places
from lobewise.temporal.recipe import TemporalFilter
from lobewise.upsampling import upsample

__all__ = ["METHODS", "VIEWS", "InteractiveFrame", "InteractiveSettings", "Session"]

DIRECT_RADIUS = 3
"""Kernel radius, pixels, with which direct light is filtered: the samples of 4x4 pixels are stratified together."""
DIRECT_SIGMA = 1.5
"""Standard deviation of its screen distance, pixels."""
STILL_MEMORY = 1.0
"""Share of its weight that a history keeps from frame to frame while nothing moves."""
STILL_DENSITY = 2
"""How much nearer shaded pixels are to each other then."""
UNFILTERED = "none"
"""The similarity that compares nothing."""
STAGES = ("gbuffer", "direct", "indirect", "upsampling", "adaptive", "composite")
"""What the seconds of a frame are told apart by, in the order in which it is made."""


@dataclass(frozen=True)
class InteractiveSettings:
    """Parameters of a frame of `Session`.

    Parameters
    ----------
    method : {"paths", "voxel_cones", "virtual_lights"}
        What computes indirect light.
    scale : int
        One of ``scale`` times ``scale`` pixels is shaded, 1 to 16.
    spp : int
        Samples of a shaded pixel, >= 1.
    similarity : str
        As `lobewise.DenoiseSettings`, or "none": no filter; samples are interpolated on the screen, without history.
    beta : float or "auto"
        As `lobewise.DenoiseSettings`.
    radius : int
        Samples from the centre to the edge of the kernel, 0 to 64; pixels where the scale is 1.
    temporal : bool
        Whether a frame knows those before it.
    adaptive : float
        Largest share of the pixels that is shaded again because nothing supports them, 0 (none) to 1.
    filter_direct : bool
        Whether direct light, which has one light sample a pixel, is filtered over 7x7 pixels.
    accumulate : bool
        Whether frames are averaged for as long as neither camera nor settings change.
    """

    method: str = "paths"
    scale: int = 4
    spp: int = 1
    similarity: str = "ggx"
    beta: float | str = "auto"
    radius: int = 2
    temporal: bool = True
    adaptive: float = 0.05
    filter_direct: bool = True
    accumulate: bool = True

    def __post_init__(self) -> None:
        require_choice("method", self.method, METHODS)
        require_choice("similarity", self.similarity, (*SIMILARITIES, UNFILTERED))
        for name, highest in (("scale", MOST_SCALE), ("spp", 1 << 16)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= highest:
                raise InputError(
                    describe_problem(
                        name, expected=f"an integer from 1 to {highest}", got=repr(value), action="pass another"
                    )
                )
        if not 0.0 <= self.adaptive <= 1.0:
            raise InputError(
                describe_problem(
                    "adaptive", expected="a share from 0 to 1", got=repr(self.adaptive), action="0.05 is usual"
                )
            )
        self.make_filter_settings()

    def make_filter_settings(self) -> DenoiseSettings:
        """Return the settings of the filter that these ask for."""
        similarity = "auto" if self.similarity == UNFILTERED else self.similarity
        return DenoiseSettings(similarity=similarity, beta=self.beta, radius=self.radius)


@dataclass(frozen=True)
class InteractiveFrame:
    """A finished frame and how it was made.

    Parameters
    ----------
    image : array, shape (height, width, 3)
        Linear radiance.
    seconds : dict of float
        By stage (`STAGES`), and ``total``.
    settings : InteractiveSettings
    camera : Camera
    accumulated : int
        Frames in a row, this one included, with this camera and these settings.
    recomputed : int
        Pixels that were shaded again.
    parts : dict
        What `get_view` shows, by name; arrays that must not be changed.
    """

    image: FloatArray
    seconds: dict[str, float]
    settings: InteractiveSettings
    camera: Camera
    accumulated: int
    recomputed: int
    parts: dict[str, Any] = field(repr=False, default_factory=dict)

    def get_view(self, name: str) -> FloatArray:
        """Return what happens inside as an image, (height, width, 3) of radiance or (height, width) in [0, 1].

        Raises
        ------
        InputError
            If there is no view of that name; they are `VIEWS`.
        """
        require_choice("view", name, VIEWS)
        return make_view(name, self.image, self.parts)

    def make_frame(self) -> Frame:
        """Return the noisy frame of this image's size, with all guides, as `lobewise.write_frame` takes it.

        Its radiance is what the views call "noisy".
        """
        hits: FirstHits = self.parts["hits"]
        return Frame(Radiance(self.get_view("noisy")), hits.gbuffer, self.camera, lobe_tables=hits.lobe_tables)

    def make_result(self) -> Result:
        """Return this image as `lobewise.write_result` takes it."""
        result: Result = self.parts["result"]
        return replace(result, image=self.image, diffuse=None, specular=None, variance=None)


@dataclass
class _Chain:
    """What one stream of frames remembers."""

    settings: InteractiveSettings
    temporal: TemporalFilter
    camera: Camera | None = None
    size: tuple[int, int] | None = None
    number: int = 0
    still: int = 0
    direct: DirectLight | None = None


@dataclass
class _Shared:
    """What the streams of one frame have in common."""

    camera: Camera
    seed: int
    hits: FirstHits
    direct: DirectLight
    seconds: dict[str, float]


class Session:
    """Renders frames of a scene as an artist moves through it; needs no window.

    Parameters
    ----------
    scene : mitsuba.Scene or str
        What to render, or what `lobewise.render.load_scene` takes.
    width, height : int, optional
        Size of the images; by default the scene's.
    settings : InteractiveSettings, optional
        Those of frames that are given none.
    seed : int
        The same seed and the same calls give the same images.
    progress : callable, optional
        Called with ``(done, total)`` while a method prepares the scene (voxels, lights).

    Raises
    ------
    InputError, FileError, UnsupportedBsdfError, MissingDependencyError
        See `lobewise.render.load_scene` and `lobewise.render.render_frame`.

    Examples
    --------
    >>> from lobewise.render import Session  # doctest: +SKIP
    >>> session = Session("showroom", width=256, height=256)  # doctest: +SKIP
    >>> images = [frame.image for frame in session.frames([session.camera] * 4)]  # doctest: +SKIP
    """

    def __init__(
        self,
        scene: Any,
        *,
        width: int | None = None,
        height: int | None = None,
        settings: InteractiveSettings | None = None,
        seed: int = 0,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        loaded = load_scene(scene, width=width, height=height) if isinstance(scene, str) else scene
        self._stages = Stages(loaded)
        self._methods = Methods(self._stages, progress)
        self._settings = settings or InteractiveSettings()
        self._seed = seed
        start = self._stages.start_size
        self.resize(width or start[0], height or start[1])
        self._chains: dict[int, _Chain] = {}

    @property
    def camera(self) -> Camera:
        """Where the scene's own sensor stands."""
        return self._stages.start_camera

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self._size

    @property
    def scene(self) -> Any:
        """The ``mitsuba.Scene``."""
        return self._stages.scene

    def make_sibling(self) -> Session:
        """Return a session of the same scene that shares what was prepared, and has a history of its own."""
        sibling = object.__new__(Session)
        sibling.__dict__.update(self.__dict__)
        sibling._chains = {}
        return sibling

    def resize(self, width: int, height: int) -> None:
        """Render images of another size from now on; histories start anew.

        Raises
        ------
        InputError
            If there are no pixels.
        """
        for name, value in (("width", width), ("height", height)):
            if value < 1:
                raise InputError(describe_problem(name, expected="at least 1", got=repr(value), action="pass another"))
        self._size = width, height

    def reset(self) -> None:
        """Forget all histories."""
        self._chains.clear()

    def prepare(self, method: str) -> None:
        """Make a method of indirect light ready now (voxelise, trace lights) instead of with its first frame.

        Raises
        ------
        InputError
            If there is none of that name, or the scene has nothing that it needs.
        """
        self._methods.get(method)

    def update_lights(self) -> None:
        """Take notice of lights, materials or geometry that changed in the scene."""
        self._methods.update()
        self.reset()

    def render(self, camera: Camera | None = None, settings: InteractiveSettings | None = None) -> InteractiveFrame:
        """Return the next frame, seen from a camera.

        Parameters
        ----------
        camera : Camera, optional
            By default the scene's own.
        settings : InteractiveSettings, optional
            By default those of the session. History goes on where they change.

        Raises
        ------
        InputError
            If the camera's pixels are not square, or the method finds nothing to work with.
        """
        return self._render(camera or self.camera, [settings or self._settings])[0]

    def render_pair(
        self, camera: Camera | None, first: InteractiveSettings, second: InteractiveSettings
    ) -> tuple[InteractiveFrame, InteractiveFrame]:
        """Return the same frame by two settings, each with a history of its own; guides and direct light are shared."""
        frames = self._render(camera or self.camera, [first, second])
        return frames[0], frames[1]

    def frames(
        self, cameras: Iterable[Camera], settings: InteractiveSettings | None = None
    ) -> Iterator[InteractiveFrame]:
        """Yield a frame for each camera of a path."""
        for camera in cameras:
            yield self.render(camera, settings)

    def _render(self, camera: Camera, asked: Sequence[InteractiveSettings]) -> list[InteractiveFrame]:
        seconds: dict[str, float] = {}
        chains = [self._find_chain(index, settings, camera) for index, settings in enumerate(asked)]
        seed = (self._seed << 20) + chains[0].number
        with _Watch(seconds, "gbuffer"):
            self._stages.place_camera(camera, *self._size)
            hits = self._stages.trace_guides(camera)
        with _Watch(seconds, "direct"):
            direct = self._stages.shade_direct(seed)
        shared = _Shared(camera, seed, hits, direct, seconds)
        return [self._finish(chain, shared) for chain in chains]

    def _find_chain(self, index: int, settings: InteractiveSettings, camera: Camera) -> _Chain:
        """Return the stream of frames that goes on with these settings, told whether it stands still."""
        chain = self._chains.get(index)
        if chain is None or chain.size != self._size or chain.settings.method != settings.method:
            chain = _Chain(settings, TemporalFilter(settings.make_filter_settings()), size=self._size)
        elif chain.settings != settings:
            if chain.settings.make_filter_settings() != settings.make_filter_settings():
                chain.temporal = TemporalFilter(settings.make_filter_settings())
            chain.still = 0
        same = chain.camera is not None and _is_same(chain.camera, camera)
        chain.still = chain.still + 1 if same and settings.accumulate else 0
        chain.settings, chain.camera = settings, camera
        chain.number += 1
        self._chains[index] = chain
        return chain

    def _finish(self, chain: _Chain, shared: _Shared) -> InteractiveFrame:
        settings, hits = chain.settings, shared.hits
        seconds = dict(shared.seconds)
        method = self._methods.get(settings.method)
        with _Watch(seconds, "indirect"):
            sparse = self._shade_sparse(chain, shared, method)
        with _Watch(seconds, "upsampling"):
            result = self._upsample(chain, sparse)
            before = result
        with _Watch(seconds, "adaptive"):
            if settings.adaptive > 0.0 and settings.scale > 1:
                result = self._repair(chain, shared, method, result)
        with _Watch(seconds, "composite"):
            direct = self._settle_direct(chain, shared)
            image = direct.emitted + direct.diffuse + direct.specular + result.image
        seconds["total"] = math.fsum(seconds[name] for name in STAGES)
        recomputed = int(result.settings.get("recomputed", 0))
        parts = {
            "hits": hits,
            "direct": direct,
            "noisy_direct": shared.direct,
            "sparse": sparse,
            "before": before,
            "result": result,
            "history": chain.temporal.history_length if settings.temporal else None,
        }
        return InteractiveFrame(image, seconds, settings, shared.camera, chain.still + 1, recomputed, parts)

    def _shade_sparse(self, chain: _Chain, shared: _Shared, method: Any) -> SparseFrame:
        width, height = self._size
        scale = min(chain.settings.scale, width, height)
        if chain.still:
            # Nobody waits for what stands still, and it is to become right.
            scale = max(1, scale // STILL_DENSITY)
        places = list_places(scale)
        place = places[chain.number % len(places)]
        rows, columns = np.arange(place[0], height, scale), np.arange(place[1], width, scale)
        grid = np.repeat(rows, columns.size), np.tile(columns, rows.size)
        radiance = self._shade(method, *grid, chain.settings.spp, shared.seed, (rows.size, columns.size))
        return SparseFrame(
            radiance,
            shared.hits.gbuffer,
            scale,
            place,
            shared.camera,
            spp=chain.settings.spp,
            lobe_tables=shared.hits.lobe_tables,
        )

    def _shade(
        self,
        method: Any,
        rows: NDArray[np.intp],
        columns: NDArray[np.intp],
        samples: int,
        seed: int,
        shape: tuple[int, int],
    ) -> Radiance:
        diffuse, specular, _ = self._stages.shade_indirect(method, rows, columns, samples, seed)
        diffuse, specular = diffuse.reshape(*shape, 3), specular.reshape(*shape, 3)
        return Radiance(diffuse + specular, diffuse=diffuse, specular=specular)

    def _upsample(self, chain: _Chain, sparse: SparseFrame) -> Result:
        settings = chain.settings
        if settings.similarity == UNFILTERED:
            chain.temporal.reset()
            return upsample(sparse, settings.make_filter_settings(), bilinear=True)
        if not settings.temporal:
            chain.temporal.reset()
            return upsample(sparse, settings.make_filter_settings())
        chain.temporal.temporal = replace(
            chain.temporal.temporal, memory=STILL_MEMORY if chain.still else type(chain.temporal.temporal)().memory
        )
        return chain.temporal.add(sparse)

    def _repair(self, chain: _Chain, shared: _Shared, method: Any, result: Result) -> Result:
        spp = chain.settings.spp

        def shade(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Radiance:
            # The samples of the frame itself were drawn with its own seed.
            return self._shade(method, rows, columns, spp, shared.seed ^ (1 << 31), (rows.size, 1))

        return recompute(result, shade, samples=1.0, budget=chain.settings.adaptive)

    def _settle_direct(self, chain: _Chain, shared: _Shared) -> DirectLight:
        """Return direct light as it is shown: filtered while things move, the mean of all frames as they rest."""
        settings, new = chain.settings, shared.direct
        count = chain.still + 1
        mean = new
        if chain.direct is not None and chain.still:
            step = np.float32(1.0 / count)
            mean = DirectLight(*(old + step * (now - old) for old, now in _pair(chain.direct, new)))
        chain.direct = mean
        if not settings.filter_direct or settings.similarity == UNFILTERED:
            return mean
        asked = replace(settings.make_filter_settings(), radius=DIRECT_RADIUS, screen_sigma=DIRECT_SIGMA, beta="auto")
        guides = shared.hits
        clean = denoise(
            Frame(
                Radiance(mean.diffuse + mean.specular, diffuse=mean.diffuse, specular=mean.specular),
                guides.gbuffer,
                shared.camera,
                spp=count,
                lobe_tables=guides.lobe_tables,
            ),
            asked,
        )
        assert clean.diffuse is not None and clean.specular is not None
        # The kernel gives way as the mean gets its own samples.
        own = np.float32(1.0 - 1.0 / count)
        return DirectLight(
            mean.emitted,
            clean.diffuse + own * (mean.diffuse - clean.diffuse),
            clean.specular + own * (mean.specular - clean.specular),
        )


def _pair(first: DirectLight, second: DirectLight) -> list[tuple[FloatArray, FloatArray]]:
    return [(getattr(first, name), getattr(second, name)) for name in ("emitted", "diffuse", "specular")]


def _is_same(first: Camera, second: Camera) -> bool:
    return (
        all(np.array_equal(getattr(first, name), getattr(second, name)) for name in ("position", "forward", "up"))
        and first.fov_y == second.fov_y
    )


class _Watch:
    """Adds the wall time of a ``with`` block to what a stage took."""

    def __init__(self, seconds: dict[str, float], stage: str) -> None:
        self._seconds = seconds
        self._stage = stage

    def __enter__(self) -> None:
        self._start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + time.perf_counter() - self._start
