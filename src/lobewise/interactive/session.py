"""The whole chain, frame after frame: guides, direct light, sparse indirect light, upsampling, repair, composite.

Source: Tokuyoshi 2015, slides "Spatio-Temporal Upsampling" and "Adaptive Sampling".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.backend.buffers import MemoryPool
from lobewise.errors import InputError, name_value
from lobewise.filters.history.light import LightPast
from lobewise.interactive.changes import SceneChanges, Seen
from lobewise.interactive.direct_filter import settle_direct
from lobewise.interactive.filter_choice import FilterChoice
from lobewise.interactive.methods import Methods
from lobewise.interactive.repairing import repair
from lobewise.interactive.resting import Again, Resting
from lobewise.interactive.samples import LensMean, choose_pixels, make_radiance, make_rays
from lobewise.interactive.settings import UNFILTERED, InteractiveSettings
from lobewise.interactive.temporal_gradients import Shaded, compute_changes, relight
from lobewise.interactive.views import STAGES, InteractiveFrame, Parts, watch
from lobewise.recipes.temporal.recipe import TemporalFilter
from lobewise.recipes.upsampling import upsample
from lobewise.records.camera import Camera
from lobewise.records.frame import Radiance, Result
from lobewise.records.sparse_frame import SparseFrame
from lobewise.render.loading import load_scene
from lobewise.render.renderer import PART_STEP
from lobewise.render.stages import DirectLight, FirstHits, Stages
from lobewise.render.tracing.own_samples import OwnLight
from lobewise.scenes.limits import VIEW_BYTES_PER_PIXEL, require_memory
from lobewise.settings import DenoiseSettings

STILL_SCALE_DIVISOR = 2
"""The scale is divided by this while the camera stands still, so that more pixels are shaded in each frame."""


@dataclass
class _Chain:
    """The state of one stream of frames."""

    settings: InteractiveSettings
    chosen: DenoiseSettings
    """The settings of the filter."""
    temporal: TemporalFilter
    shaded: Shaded | None = None
    """The samples of the last frame, if its history was kept."""
    seen: Seen | None = None
    """The scene as the last frame showed it."""
    size: tuple[int, int] | None = None
    """Columns and rows."""
    number: int = 0
    """Frames so far."""
    resting: Resting = field(default_factory=Resting)
    lens: LensMean = field(default_factory=LensMean)
    memory: MemoryPool = field(default_factory=MemoryPool)
    """The memory of direct light."""
    direct: LightPast | None = None
    """The direct light of the last frame, if nothing but the camera moved since."""


@dataclass
class _Shared:
    """The parts of a frame that its streams share."""

    camera: Camera
    seed: int
    hits: FirstHits
    direct: DirectLight
    seconds: dict[str, float]


class Session:
    """Renders frames of a scene for a camera that moves. It needs no window, and belongs to one thread of a process.

    Parameters
    ----------
    scene : mitsuba.Scene or str
        The scene, or its name for `lobewise.render.load_scene`.
    width, height : int, optional
        Size of the images; by default the scene's.
    settings : InteractiveSettings, optional
        The settings of frames that are rendered without settings.
    seed : int
        Equal seeds and equal calls give equal images.
    progress : callable, optional
        Called with ``(done, total)`` while a method prepares the scene (voxels, lights).
    options : mapping of mapping, optional
        By the name of a method, arguments of its class (`PathLight`, `VoxelCones`, `VirtualLights`) beside scene and
        materials: ``{"voxel_cones": {"resolution": 64}}``.

    Raises
    ------
    InputError, FileError, UnsupportedBsdfError, MissingDependencyError
        See `lobewise.render.load_scene` and `lobewise.render.render_frame`.

    Examples
    --------
    >>> from lobewise.interactive import Session  # doctest: +SKIP
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
        options: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        loaded = load_scene(scene, width=width, height=height) if isinstance(scene, str) else scene
        self._stages = Stages(loaded)
        self._methods = Methods(self._stages, progress, options)
        self._changes = SceneChanges(self._stages, self._methods)
        self._choice = FilterChoice(self._stages, self._methods, self._changes)
        self._settings = settings or InteractiveSettings()
        self._seed = seed
        start = self._stages.start_size
        self.resize(width or start[0], height or start[1])
        self._chains: dict[int, _Chain] = {}

    @property
    def camera(self) -> Camera:
        """The camera of the scene's own sensor."""
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
        """Return a session that shares the prepared scene and has a history of its own."""
        sibling = object.__new__(Session)
        sibling.__dict__.update(self.__dict__)
        sibling._chains = {}
        return sibling

    def resize(self, width: int, height: int) -> None:
        """Render images of this size from now on; histories start anew if the size changed.

        Raises
        ------
        InputError
            If a side is below 1, or the images do not fit the memory of the machine.
        """
        for name, value in (("width", width), ("height", height)):
            if value < 1:
                raise InputError(name, expected="at least 1", got=name_value(value), action="pass another")
        require_memory(width, height, VIEW_BYTES_PER_PIXEL)
        self._size = width, height

    def reset(self) -> None:
        """Forget all histories."""
        self._chains.clear()

    def prepare(self, method: str) -> None:
        """Prepare a method of indirect light (voxelise, trace lights) now instead of with its first frame.

        Raises
        ------
        InputError
            If there is no such method, or if the scene has nothing for it to work with.
        """
        self._methods.get(method)

    def move(self, name: str, transform: ArrayLike) -> None:
        """Move one shape; see `set_transforms`."""
        self.set_transforms({name: transform})

    def set_transforms(self, transforms: Mapping[str, ArrayLike]) -> None:
        """Move shapes of the scene before the next frame. Histories follow the surfaces of these shapes.

        The loaded scene changes, and with it all sessions of `make_sibling`. A lamp is moved like any other shape.

        Parameters
        ----------
        transforms : mapping of str to array_like, shape (4, 4)
            By the ids of shapes: the matrix in world space that leads each point of the shape from its place in the
            scene as it was given to this session to its new place. The identity puts a shape back. Shapes that are not
            named stay where they are. Meshes and instances take any matrix that does not mirror; other shapes take
            rotations, translations and one scale.

        Raises
        ------
        InputError
            If the scene has no shape of such an id, or a matrix cannot be used; then nothing has moved.
        """
        self._changes.move(transforms)

    def update_lights(self) -> None:
        """Take note that parameters of emitters changed. Histories are kept, and follow the light."""
        self._changes.note_lights()

    def update_scene(self) -> None:
        """Prepare the methods anew and forget all histories, after materials or geometry changed in other ways."""
        self._changes.note_scene()
        self._choice.forget()
        self.reset()

    def render(self, camera: Camera | None = None, settings: InteractiveSettings | None = None) -> InteractiveFrame:
        """Return the next frame, seen from a camera.

        Parameters
        ----------
        camera : Camera, optional
            By default the scene's own.
        settings : InteractiveSettings, optional
            By default those of the session. The history is kept when settings change, unless the method or the filter
            changes.

        Raises
        ------
        InputError
            If the camera's pixels are not square, or if the scene has nothing for the method to work with.
        """
        return self._render(camera or self.camera, [settings or self._settings])[0]

    def render_pair(
        self, camera: Camera | None, first: InteractiveSettings, second: InteractiveSettings
    ) -> tuple[InteractiveFrame, InteractiveFrame]:
        """Return a frame by two settings. Both share guides and direct light, and each has a history of its own."""
        frames = self._render(camera or self.camera, [first, second])
        return frames[0], frames[1]

    def frames(
        self, cameras: Iterable[Camera], settings: InteractiveSettings | None = None
    ) -> Iterator[InteractiveFrame]:
        """Yield a frame for each camera of a path."""
        for camera in cameras:
            yield self.render(camera, settings)

    def _render(self, camera: Camera, settings_of_frames: Sequence[InteractiveSettings]) -> list[InteractiveFrame]:
        seconds: dict[str, float] = {}
        with watch(seconds, "gbuffer"):
            self._stages.place_camera(camera, *self._size)
        with watch(seconds, "indirect"):
            for settings in settings_of_frames:
                self._methods.advance(settings.method)
        chains = [self._get_chain(index, settings, camera) for index, settings in enumerate(settings_of_frames)]
        with watch(seconds, "indirect"):
            for chain in chains:
                if chain.seen is not None and chain.seen.changes != self._changes.count:
                    chain.direct = None
                    if chain.shaded is not None:
                        self._relight_history(chain, chain.shaded, chain.seen)
                        self._stages.place_camera(camera, *self._size)
        seed = (self._seed << 20) + chains[0].number
        with watch(seconds, "gbuffer"):
            hits, direct = self._stages.trace_first(camera, seed)
        shared = _Shared(camera, seed, hits, direct, seconds)
        frames = []
        for chain in chains:
            with watch(seconds, "gbuffer"):
                moved = replace(shared, hits=self._changes.add_motion(hits, chain.seen))
            chain.seen = self._changes.look(camera)
            frames.append(self._finish(chain, moved))
        return frames

    def _get_chain(self, index: int, settings: InteractiveSettings, camera: Camera) -> _Chain:
        """Return the stream number ``index``, with these settings and camera; its mean starts anew if they changed."""
        chain = self._chains.get(index)
        chosen = self._choice.choose(settings)
        if chain is None or chain.size != self._size or chain.settings.method != settings.method:
            chain = _Chain(settings, chosen, TemporalFilter(chosen), size=self._size)
        elif chain.chosen != chosen:
            chain.chosen, chain.temporal = chosen, TemporalFilter(chosen)
        still = chain.seen is not None and self._changes.is_same(chain.seen, camera)
        same = chain.settings == settings and still
        if not (same and settings.accumulate):
            chain.resting, chain.lens = Resting(), LensMean()
        chain.settings = settings
        chain.number += 1
        self._chains[index] = chain
        return chain

    def _finish(self, chain: _Chain, shared: _Shared) -> InteractiveFrame:
        settings = chain.settings
        seconds = dict(shared.seconds)
        method = self._methods.get(settings.method)
        if isinstance(method, OwnLight):
            shared = replace(shared, direct=shared.direct.make_black())
        with watch(seconds, "indirect"):
            sparse = self._shade_sparse(chain, shared, method)
        with watch(seconds, "upsampling"):
            result = self._upsample(chain, sparse)
            before = result
        again = None
        with watch(seconds, "adaptive"):
            if settings.adaptive > 0.0 and settings.scale > 1:
                result, again = self._repair(chain, shared, method, result, sparse)
        with watch(seconds, "composite"), chain.memory.use():
            new = shared.direct
            # The mean over the frames since the camera stands still.
            mean = DirectLight(*chain.resting.add_direct([new.emitted, new.diffuse, new.specular]))
            direct, chain.direct = settle_direct(mean, shared.hits, settings, chain.direct, chain.resting.frames)
            indirect = chain.resting.add_indirect(result.image, sparse, again)
            image = direct.total
            image += indirect
            if self._stages.has_lens and chain.resting.frames > 1:
                image = chain.lens.add(image, self._stages, shared.hits, settings, chain.number, shared.seed)
        seconds["total"] = math.fsum(seconds[name] for name in STAGES)
        recomputed = int(result.settings.get("recomputed", 0))
        history = chain.temporal.history_length if settings.temporal else None
        parts = Parts(shared.hits, shared.direct, direct, sparse, before, result, indirect, history)
        return InteractiveFrame(image, seconds, settings, shared.camera, chain.resting.frames, recomputed, parts)

    def _shade_sparse(self, chain: _Chain, shared: _Shared, method: Any) -> SparseFrame:
        scale = min(chain.settings.scale, *self._size)
        if chain.resting.frames:
            # A camera that stands still leaves time for more samples.
            scale = max(1, scale // STILL_SCALE_DIVISOR)
        place, grid, shape = choose_pixels(self._size, scale, chain.number)
        light = self._stages.shade_indirect(method, *grid, chain.settings.spp, shared.seed)
        radiance = make_radiance(method, light, shape)
        chain.shaded = None
        if chain.settings.temporal:
            some = (slice(place[0], None, scale), slice(place[1], None, scale))
            depth = np.asarray(shared.hits.gbuffer.depth)[some]
            shapes = np.stack([shared.hits.shape[some], shared.hits.seen_shape[some]])
            spp, seed = chain.settings.spp, shared.seed
            chain.shaded = Shaded(shared.camera, grid, scale, place, spp, seed, radiance, depth, shapes)
        return SparseFrame(
            radiance,
            shared.hits.gbuffer,
            scale,
            place,
            shared.camera,
            spp=max(1, round(chain.settings.spp * method.worth)),
            lobe_tables=shared.hits.lobe_tables,
            rays=make_rays(light, shape),
        )

    def _relight_history(self, chain: _Chain, former: Shaded, seen: Seen) -> None:
        """Let the history follow the light, which changed by as much as the last frame's samples if taken again."""
        self._stages.place_camera(former.camera, *self._size)
        method = self._methods.get(chain.settings.method)
        rows, columns = former.depth.shape
        light = self._stages.shade_indirect(method, *former.pixels, former.spp, former.seed)
        radiance = make_radiance(method, light, (rows, columns))
        depth, shapes = self._stages.trace_surfaces(*former.pixels, former.camera)
        shapes = np.concatenate([shapes.reshape(-1, rows, columns), former.shapes])
        moved = self._changes.mark_moved(seen, shapes)
        size = self._size[1], self._size[0]
        relight(chain.temporal, compute_changes(former, radiance, depth.reshape(rows, columns), size, moved))

    def _upsample(self, chain: _Chain, sparse: SparseFrame) -> Result:
        settings = chain.settings
        unfiltered = settings.similarity == UNFILTERED
        if settings.temporal and not unfiltered:
            return chain.temporal.add(sparse)
        chain.temporal.reset()
        return upsample(sparse, chain.chosen, bilinear=unfiltered)

    def _repair(
        self, chain: _Chain, shared: _Shared, method: Any, result: Result, sparse: SparseFrame
    ) -> tuple[Result, Again | None]:
        """Return the result with its least supported pixels shaded again, and the new samples."""
        settings, spp = chain.settings, chain.settings.spp
        history = chain.temporal if settings.temporal and settings.similarity != UNFILTERED else None

        def shade(rows: NDArray[np.intp], columns: NDArray[np.intp], parts: int) -> Radiance:
            # Draw other samples than those of the frame, and others for each part.
            seeds = [((shared.seed ^ (1 << 31)) + part * PART_STEP) % (1 << 32) for part in range(parts)]
            light = self._stages.shade_indirect(method, rows, columns, spp, *seeds)
            return make_radiance(method, light, (rows.size, parts))

        return repair(result, sparse, settings, spp * method.worth, history, shade)
