"""The recipe over time: every frame is filtered as it comes, and joined with the history of the frames before it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import MemoryPool
from lobewise.denoising.automatic import estimate_spp, expect_noise, require_full, require_plain, resolve_settings
from lobewise.denoising.bad_pixels import (
    blacken_bad,
    describe_bad,
    fill_holes,
    mark_bad_pixels,
    require_some_good,
)
from lobewise.denoising.layers import (
    Layer,
    describe_exact_light,
    make_ggx_lobes,
    make_layers,
    make_rest_layers,
)
from lobewise.denoising.plain import FilteredSum, add_up
from lobewise.denoising.plan import bound_memory, count_bytes
from lobewise.denoising.recipe import filter_below
from lobewise.denoising.refining.totals import compute_averaged_rest
from lobewise.engine.numbers import choose_larger, choose_smaller
from lobewise.errors import InputError, require_choice, require_kind
from lobewise.features import Feature
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.history.accumulation import AccumulatedOutput, KnownKernel, SampleGrid
from lobewise.filters.history.joining import JoinedLayers, mark_reflecting
from lobewise.filters.history.sums import add_to_sums, split_sums
from lobewise.guides.lobe_fields import GgxField
from lobewise.guides.negative import split_negative
from lobewise.guides.usable import CheckedGuides, check_guides
from lobewise.recipes.temporal.past import HistoryReprojection, Past, pack_past, unpack_past
from lobewise.recipes.temporal.validation import Guides, compute_same_tau
from lobewise.recipes.upsampling import (
    DEFAULT_RADIUS,
    UNSCATTERED,
    join_sparse,
    spread,
    tint_radiance,
    tint_samples,
    upsample,
)
from lobewise.records.frame import FloatArray, Frame, Radiance, Result
from lobewise.records.sparse_frame import AnyFrame, SparseFrame
from lobewise.settings import DenoiseSettings, ResolvedSettings, TemporalChanges, TemporalSettings
from lobewise.work.limits import set_aside

if TYPE_CHECKING:
    from typing_extensions import Unpack

ALPHA_STAYS = "The opacity of the frame is not filtered."
ALSO_STAYS = "The light groups and other images beside the image are not filtered."
"""What a filter over time says of `Frame.alpha` and `Frame.also`."""
BORDERS_APART = "The image wraps around: a filter over time filters its borders apart, and compares no places."
HISTORY_SHARE = 3.0
"""Memory of the history, as a multiple of that of a frame."""
MAX_OWN_WEIGHT = 1e8
"""Weight of a pixel's own sample where shading has no noise. Beside it, samples of neighbours are lost in rounding."""
BORROWED_ERROR = 0.005
"""Squared relative error of a neighbour's radiance as an estimate of the pixel's own radiance, without noise."""


class TemporalFilter:
    """Denoises or upsamples a sequence frame by frame; every frame uses the history of the frames before it.

    Each pixel carries the sum of all weights and the sum of all weighted samples, so that well supported estimates
    weigh more, whichever frame they came from. A pixel finds its history at the earlier place of its surface point and
    at the earlier place of its reflection. It takes the history as far as surface and lobe match, and drops it where
    the samples of this frame contradict it. Memory does not grow with the length of the sequence. One thread at a time
    uses a filter; several filters may run at once.

    Frames are filtered with the quality "fast" alone, and only in total, diffuse and specular: named layers of a frame
    and their passes are not. Where the noise is moderate `lobewise.denoise`, frame by frame, has less error.

    Source: Herzog et al. 2010, "Spatio-temporal upsampling on the GPU" (sums over space and time); Tokuyoshi 2015
    (weights). Departs: the kernel narrows as a pixel's history grows; see docs/developers/temporal.md.

    Parameters
    ----------
    settings : DenoiseSettings, optional
        As for `lobewise.denoise` and `lobewise.upsample`.
    temporal : TemporalSettings, optional
        Settings of the history.
    **changes
        Single parameters of either, by name.

    Raises
    ------
    InputError
        If a parameter is out of range or unknown, or asks for another quality than "fast".

    Examples
    --------
    >>> import lobewise
    >>> temporal = lobewise.TemporalFilter()
    >>> images = [temporal.add(lobewise.read_frame(path, light_passes=False)).image for path in paths]  # doctest: +SKIP
    """

    def __init__(
        self,
        settings: DenoiseSettings | None = None,
        *,
        temporal: TemporalSettings | None = None,
        **changes: Unpack[TemporalChanges],
    ) -> None:
        own = {item.name for item in fields(TemporalSettings)} - {"beta"}
        for name in changes:
            require_choice("setting", name, [*(item.name for item in fields(DenoiseSettings)), *sorted(own)])
        spatial: dict[str, Any] = {name: value for name, value in changes.items() if name not in own}
        over_time: dict[str, Any] = {name: value for name, value in changes.items() if name in own}
        self.temporal = replace(temporal or TemporalSettings(), **over_time)
        self._settings = replace(settings, **spatial) if settings is not None else None
        self._changes = spatial
        require_plain(self._settings or DenoiseSettings(**spatial), "a filter with history")
        self._past: Past | None = None
        self._albedos: dict[str, FloatArray | None] = {}
        self._is_sparse = False
        self._memory = MemoryPool()

    def reset(self) -> None:
        """Forget everything, as before the first frame."""
        self._past, self._albedos = None, {}
        self._memory.clear()

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Return the history as arrays by name."""
        return {} if self._past is None else pack_past(self._past)

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take the history that `get_state` returned; every further result then has the same bits as without a break.

        Raises
        ------
        InputError
            If `get_state` did not return ``state``.
        """
        require_kind("state", state, Mapping)
        self._past, self._albedos = unpack_past(state) if state else None, {}

    @property
    def history_length(self) -> FloatArray | None:
        """Frames in the longest history of each pixel's layers, (height, width); None before the first frame."""
        if self._past is None:
            return None
        frames = [split_sums(sums).frames for sums in self._past.sums.values()]
        return np.asarray(np.maximum.reduce(frames), dtype=np.float32)

    def add(self, frame: AnyFrame, *, features: Sequence[Feature] = (), cut: bool = False) -> Result:
        """Return the result of the next frame.

        Parameters
        ----------
        frame : Frame or SparseFrame
            The next frame of the sequence. Motion vectors tell the earlier places. Without motion vectors, only the
            camera is taken to move; without a camera as well there is no history. A frame of another size starts anew.
        features : sequence of Feature
            As for `lobewise.denoise`; of this frame.
        cut : bool
            Whether the frame begins another shot. The filter also detects cuts itself.

        Returns
        -------
        Result
            As of `lobewise.denoise` or `lobewise.upsample`, with ``variance``; ``weight_sum`` and ``effective_samples``
            count the history.

        Raises
        ------
        InputError, MissingChannelError, DeviceError
            As `lobewise.denoise` and `lobewise.upsample`; the history is then as it was.
        """
        start = time.perf_counter()
        require_kind("frame", frame, Frame, SparseFrame)
        maker = frame.radiance.maker
        if isinstance(frame, Frame) and frame.wraps:
            frame = frame.with_changes(camera=None)
        checked = check_guides(frame)
        chosen = self._resolve(checked.frame)
        with (
            set_aside(HISTORY_SHARE * count_bytes(checked.frame)),
            bound_memory(checked.frame, "fast", with_oidn=False),
            self._memory.use(),
            engine.on(chosen.device),
        ):
            result = self._add(checked, chosen, features, cut)
        return replace(result, seconds=time.perf_counter() - start).convert(maker)

    def _add(
        self, checked: CheckedGuides[AnyFrame], chosen: ResolvedSettings, features: Sequence[Feature], cut: bool
    ) -> Result:
        frame, notes = checked.frame, checked.notes
        if isinstance(frame, SparseFrame):
            notes += describe_exact_light(frame)
        else:
            notes += (
                *frame.notes,
                *(() if frame.alpha is None else (ALPHA_STAYS,)),
                *((ALSO_STAYS,) if frame.also else ()),
                *((BORDERS_APART,) if frame.wraps else ()),
            )
        frame, below = split_negative(frame)
        if isinstance(frame, SparseFrame):
            frame = tint_samples(frame)
        bad = mark_bad_pixels(Frame(frame.radiance))
        require_some_good(int(np.count_nonzero(bad)), bad.size, "sample")
        guides = Guides(frame.gbuffer, frame.camera, frame.lobe_tables)
        # The lobes are compared within the frame and between frames, by two band-limits.
        lobes = make_ggx_lobes(frame, chosen.similarity, chosen.tau, compute_same_tau(guides, chosen))
        how = self._plan(frame, chosen)
        layers = make_named_layers(frame, chosen, features, lobes, how.own)
        reprojection = HistoryReprojection(
            guides, chosen, self.temporal, None if cut else self._past, {n: layers[n].mask for n in layers}, lobes
        )
        outputs = {
            name: join_history(frame, layer, chosen, reprojection.reproject(name), how)
            for name, layer in layers.items()
        }
        result = self._make_result(frame, layers, outputs, chosen, bad, reprojection.share)
        sums = {name: output.sums for name, output in outputs.items()}
        self._albedos = {name: layer.albedo for name, layer in layers.items() if name not in UNSCATTERED}
        self._is_sparse = isinstance(frame, SparseFrame)
        self._past = Past(guides, chosen.similarity, sums, reprojection.validation, reprojection.allowance)
        if below is not None:
            # Light below 0 is dim in most frames, and has no history.
            named = self._ask(frame)
            if isinstance(frame, SparseFrame):
                result_below = upsample(below, named, features=features)
            else:
                result_below = filter_below(below, frame, named, features)
            result = result.subtract(result_below)
        return replace(result, notes=(*notes, *describe_bad(int(np.count_nonzero(bad)), bad.size)))

    def add_samples(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], radiance: Radiance, weights: FloatArray
    ) -> None:
        """Add radiance that was shaded after the last frame to the history of single pixels.

        The result of the last frame does not change; the next frame finds the radiance in the history.

        Parameters
        ----------
        rows, columns : int arrays, shape (count,)
            Pixels of the last frame, each at most once.
        radiance : Radiance
            Of shape (count, 1), with the parts that the frame has. Pixels that are not finite or negative add nothing.
        weights : array, shape (count,)
            How many samples of the frame each pixel's radiance is worth, >= 0.

        Raises
        ------
        InputError
            If there was no frame before, a pixel lies outside of it, or the radiance lacks a part or has another size.
        """
        if self._past is None or not self._albedos:
            raise InputError("history", expected="a frame before", got="none", action="call add first")
        height, width = self._past.guides.shape
        if not all(((each >= 0) & (each < most)).all() for each, most in ((rows, height), (columns, width))):
            expected = f"rows and columns of {width}x{height}"
            raise InputError("pixels", expected=expected, got="others", action="pass pixels of the last frame")
        for name in self._albedos:
            light = getattr(radiance, name)
            if light is None or light.shape[:2] != (len(rows), 1):
                expected = f"{name}, one for each of {len(rows)} pixels"
                action = "pass all parts of the frame"
                raise InputError("radiance", expected=expected, got=repr(radiance), action=action)
        # As the samples of the frame were; see `_add`.
        if self._is_sparse and "diffuse" in self._albedos:
            where = rows[:, None], columns[:, None]
            if (light := tint_radiance(radiance, self._past.guides.gbuffer, lambda image: image[where])) is not None:
                radiance = Radiance(light[0], diffuse=light[1], specular=light[2])
        for name, albedo in self._albedos.items():
            divisor = 1.0 if albedo is None else np.maximum(albedo[rows, columns], np.float32(ALBEDO_FLOOR))
            means = getattr(radiance, name)[:, 0] / divisor
            add_to_sums(self._past.sums[name], (rows, columns), means, weights, self.temporal.strictness)

    def change_sums(self, changes: Mapping[str, Callable[[FloatArray], FloatArray]]) -> None:
        """Change the history of single layers, for example after a light changed.

        Parameters
        ----------
        changes : mapping of callable
            By the name of a layer, a function that takes its sums, (height, width, 7), and returns the new ones; see
            `lobewise.filters.history.sums`. Layers that the history does not have are ignored.

        Raises
        ------
        InputError
            If a function returns another shape; then nothing has changed.
        """
        sums = {} if self._past is None else self._past.sums
        changed = {name: np.asarray(change(sums[name]), np.float32) for name, change in changes.items() if name in sums}
        for name, new in changed.items():
            if new.shape != sums[name].shape:
                expected, got = f"sums of shape {sums[name].shape}", f"shape {new.shape}"
                raise InputError(f"history of {name}", expected=expected, got=got, action="keep its shape")
        sums.update(changed)

    def _plan(self, frame: AnyFrame, chosen: ResolvedSettings) -> Growth:
        known = min(self.temporal.history_radius, chosen.radius)
        is_auto = self._ask(frame).screen_sigma == "auto"
        # The automatic screen sigma is proportional to the radius.
        sigma = chosen.screen_sigma * known / chosen.radius if is_auto and known > 0 else chosen.screen_sigma
        kernel = KnownKernel(known, chosen.screen_sigma, sigma)
        return Growth(self.temporal.strictness, compute_own_weight(frame), kernel)

    def _ask(self, frame: AnyFrame) -> DenoiseSettings:
        """Return the settings that the user asked for."""
        if self._settings is not None:
            return self._settings
        sparse = isinstance(frame, SparseFrame)
        return replace(DenoiseSettings(radius=DEFAULT_RADIUS) if sparse else DenoiseSettings(), **self._changes)

    def _resolve(self, frame: AnyFrame) -> ResolvedSettings:
        named = self._ask(frame)
        if isinstance(frame, SparseFrame):
            require_full(named)
        return resolve_settings(frame, named, frame.scale if isinstance(frame, SparseFrame) else 1)

    @staticmethod
    def _make_result(
        frame: AnyFrame,
        layers: dict[str, Layer],
        outputs: dict[str, AccumulatedOutput],
        chosen: ResolvedSettings,
        bad: NDArray[np.bool_],
        share: float,
    ) -> Result:
        support: FilteredSum | JoinedLayers
        if isinstance(frame, SparseFrame):
            variances = [output.variance for output in outputs.values()]
            joined = support = join_sparse(frame, list(layers.values()), list(outputs.values()), variances)
            image, holes, variance = joined.image, joined.holes, joined.variance
            parts = dict(zip(layers, joined.parts, strict=False))
            bad = spread(frame, bad)
        else:
            filtered = list(outputs.values())
            emission = frame.gbuffer.mean_emission
            exact = None if emission is None else compute_averaged_rest(frame)
            support = added = add_up(frame, list(layers.values()), filtered, bad, exact)
            image, holes = added.image, added.holes
            parts = dict(zip(layers, map(blacken_bad, added.parts), strict=True))
            variance = np.asarray(sum(output.variance for output in filtered), dtype=np.float32)
        return Result(
            image=fill_holes(image, holes, frame),
            diffuse=parts.get("diffuse"),
            specular=parts.get("specular"),
            weight_sum=support.weight_sum,
            effective_samples=support.effective_samples,
            bad_pixels=bad,
            settings={**asdict(chosen), "history_share": share},
            seconds=0.0,
            variance=variance,
            find_noisy=ref(frame.radiance.color),
            origin=None if isinstance(frame, SparseFrame) else frame.origin,
        )


def make_named_layers(
    frame: AnyFrame, settings: ResolvedSettings, features: Sequence[Feature], lobes: GgxField | None, own: float
) -> dict[str, Layer]:
    """Return the layers of a frame that have a history, by name; ``own`` is the weight of a pixel's own sample."""
    layers = make_layers(frame, settings, features, lobes=lobes)
    names = ("diffuse", "specular") if len(layers) == 2 else ("color",)
    named = {name: replace(layer, name=name) for name, layer in zip(names, layers, strict=True)}
    if not frame.is_sparse:
        return named
    # A pixel that reflects almost nothing would wait for its own samples.
    floor = ALBEDO_FLOOR / own
    for name, layer in named.items():
        named[name] = replace(layer, mask=mark_reflecting(layer.mask, layer.albedo, floor))
    return named | {layer.name: layer for layer in make_rest_layers(cast(SparseFrame, frame), settings, features)}


class Growth(NamedTuple):
    """How samples join a history.

    Parameters
    ----------
    strictness : float
        How the kernel narrows as the history of a pixel grows, 0 (not) to 1.
    own : float
        Weight of a pixel's own sample, >= 1. A borrowed sample that matches fully has weight 1.
    known : KnownKernel
        Kernel of the pixels of sparse frames that have a history. Whole frames ignore it.
    """

    strictness: float
    own: float
    known: KnownKernel


def join_history(
    frame: AnyFrame, layer: Layer, settings: ResolvedSettings, history: FloatArray | None, how: Growth
) -> AccumulatedOutput:
    """Return a layer joined with its history, as far as the samples bear the history out.

    Parameters
    ----------
    frame : Frame or SparseFrame
    layer : Layer
    settings : ResolvedSettings
    history : (height, width, 7), optional
        Sums of the frames before, at the places of this frame's pixels; None for none.
    how : Growth
    """
    sparse: Any = frame if frame.is_sparse else None
    scale, place = (sparse.scale, sparse.place) if frame.is_sparse else (1, (0, 0))
    grid = SampleGrid(layer.mask, layer.features, scale=scale, place=place, albedo=layer.albedo, name=layer.name)
    options: dict[str, Any] = {"radius": settings.radius, "growth": how.strictness, "own": how.own}
    if history is not None:
        # A light that went out shows in the samples alone.
        trust = grid.compute_trust(layer.radiance, history, how.own, layer.weights)
        options |= {"history": history, "trust": trust}
    if frame.is_sparse:
        return grid.accumulate(layer.radiance, known=how.known, weights=layer.weights, **options)
    return grid.accumulate_filtered(layer.radiance, form=settings.form, **options)


def compute_own_weight(frame: AnyFrame) -> float:
    """Return the weight of a pixel's own sample, >= 1: a borrowed one has an error of its own beside the noise."""
    without_noise = frame.variance is not None and not frame.variance.color.any()
    return weigh_own(0.0 if without_noise else expect_noise(estimate_spp(frame)))


def weigh_own(noise: float) -> float:
    """Return the weight of a pixel's own sample, >= 1, for the relative variance of the samples."""
    own = 1.0 + BORROWED_ERROR / choose_larger(noise, BORROWED_ERROR / MAX_OWN_WEIGHT)
    return choose_smaller(own, MAX_OWN_WEIGHT)
