"""Accumulate samples over space and time: how far samples confirm a history, and their sum with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import HostImage, device_scope, download, take_dense, take_image, take_mask
from lobewise.backend.expressions import LOG2_E
from lobewise.backend.jit import Scheduled
from lobewise.errors import InputError
from lobewise.features.arrays import give_features, give_scalars
from lobewise.features.base import Feature, describe_structure
from lobewise.filters.cross_filter import FilterOutput, run_filter
from lobewise.filters.history.accumulation_pass import (
    make_accumulation,
    make_filtered_accumulation,
    make_narrowing,
    make_trust,
)
from lobewise.filters.history.sums import (
    HISTORY_CHANNELS,
    Sums,
    cut,
    join_channels,
    split_history,
    take_planes,
    widen_to_vector,
)
from lobewise.records.frame import FloatArray

TRUST_RADIUS = 2
"""Radius of the window in which history and samples are compared, samples."""


@dataclass(frozen=True, kw_only=True)
class AccumulatedOutput(FilterOutput):
    """The result of samples and history together. The weight sum is in units of a sample that matches fully.

    Parameters
    ----------
    sums : array, shape (height, width, 7)
        The new history; see `lobewise.filters.history.sums`.
    variance : array, shape (height, width)
        Variance of the luminance of the mean.
    """

    sums: FloatArray
    variance: FloatArray


class KnownKernel(NamedTuple):
    """The kernel of pixels that have a history.

    Parameters
    ----------
    radius : int
        Radius in samples, >= 0.
    screen_sigma : float
        Standard deviation of the screen distance that the grid's features have, pixels.
    sigma : float
        Standard deviation that these pixels have instead, pixels, at most ``screen_sigma``.
    """

    radius: int
    screen_sigma: float
    sigma: float

    @property
    def precision(self) -> float:
        """What is subtracted from the base-2 logarithm of a weight, times the squared distance in pixels."""
        return 0.5 * LOG2_E * (self.sigma**-2 - self.screen_sigma**-2)


class SampleGrid:
    """Guides of an image of which one pixel in every block of ``scale`` times ``scale`` is shaded.

    The sample at (row Y, column X) belongs to pixel (Y scale + place[0], X scale + place[1]) of the full image. Its
    weight for another pixel is the product of the features' similarities between the two pixels.

    Parameters
    ----------
    mask : bool array, shape (height, width)
        False where a pixel has no meaning for the features: it has weight 0 and its result is 0.
    features : sequence of Feature
        Features of the full image.
    scale : int
        Distance of neighbouring samples, pixels, >= 1.
    place : (int, int)
        Row and column of the shaded pixel within each block.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance on the way in, at the shaded pixels, and multiplies it on the way out.
    name : str
        Name of the light in recorded plans. The sums are kept there as ``<name>_sums``.
    """

    def __init__(
        self,
        mask: NDArray[np.bool_],
        features: Sequence[Feature],
        *,
        scale: int,
        place: tuple[int, int] = (0, 0),
        albedo: FloatArray | None = None,
        name: str = "light",
    ) -> None:
        self.shape: tuple[int, int] = (mask.shape[0], mask.shape[1])
        self.name = name
        self._scale, self._place = scale, place
        self._mask, self._features = mask, tuple(features)
        self._tinted = albedo is not None
        tint = {} if albedo is None else {"own_albedo": take_image("albedo", albedo, (*self.shape, 3))}
        guides = {each: download(image) for each, image in give_features("own", features, self.shape).items()}
        whole: dict[str, HostImage] = {"own_mask": take_mask(mask), **tint, **guides}
        self._taps = {each.replace("own", "tap"): self._pick(image) for each, image in whole.items()}
        self.size: tuple[int, int] = self._taps["tap_mask"].shape
        self._whole = {each: widen_to_vector(image) for each, image in whole.items()}

    def _pick(self, image: HostImage, *, stacked: bool = False) -> HostImage:
        """Return an image, or with ``stacked`` the planes of a stack (count, height, width), at the shaded pixels."""
        return engine.pick(image, self._scale, self._place, stacked=stacked) if self._scale > 1 else image

    @device_scope()
    def compute_trust(
        self, samples: FloatArray, history: FloatArray, own: float, weights: FloatArray | None = None
    ) -> FloatArray:
        """Return how far samples confirm the history, 0 to 1, at the shaded pixels, (rows, columns).

        Guides show a change of surface or lobe, but not a light that went out or a change in a reflection. Samples do:
        the mean of many differences between sample and history must be as small as their deviation allows. The result
        for a sample also holds for the pixels that are similar to its own.

        Parameters
        ----------
        samples, history, own, weights
            See `accumulate`.
        """
        weighed = {} if weights is None else {"weights": take_image("weights of rays", weights, self.size)}
        pixels = {name.replace("tap", "own"): widen_to_vector(image) for name, image in self._taps.items()}
        images = {
            "samples": self._take_samples(samples),
            "history": take_dense(self._pick(take_planes(history), stacked=True)),
            **self._taps,
            **{name: image for name, image in pixels.items() if name != "own_albedo"},
            **weighed,
        }
        numbers = {"trust_radius": TRUST_RADIUS, "own": own, **self._place_samples(1, (0, 0))}
        options, text = self._list_options(weights), "how far samples confirm the history"
        trust: FloatArray = self._run(images, numbers, self.size, make_trust, *options, text=text)[0]
        return trust

    @device_scope()
    def accumulate(
        self,
        samples: FloatArray,
        *,
        radius: int,
        history: FloatArray | None = None,
        trust: FloatArray | None = None,
        growth: float = 0.0,
        own: float = 1.0,
        known: KnownKernel | None = None,
        weights: FloatArray | None = None,
    ) -> AccumulatedOutput:
        """Spread samples over all pixels and add them to the history; see `lobewise.filters.history.accumulation_pass`.

        Parameters
        ----------
        samples : array, shape (rows, columns, 3)
            Radiance; ``rows = ceil((height - place[0]) / scale)``, columns alike. Bad samples have weight 0.
        radius : int
            Radius of the kernel in samples, >= 0.
        history : array, shape (height, width, 7 or more), optional
            Sums to add to.
        trust : array, shape (rows, columns), optional
            How far each sample confirms its pixel's history, 0 to 1.
        growth : float
            How much the kernel narrows as the history grows, 0 (not at all) to 1.
        own : float
            Weight of a shaded pixel's own sample, >= 1; a sample of another pixel that matches fully has weight 1.
        known : KnownKernel, optional
            Kernel of the pixels that have a history; without it all pixels have the same kernel.
        weights : array, shape (rows, columns), optional
            Weights of the samples' rays, >= 0; see `lobewise.records.sparse_frame.Rays`. By default 1.

        Returns
        -------
        AccumulatedOutput

        Raises
        ------
        InputError
            If an array has another shape.
        """
        images = {
            "samples": self._take_samples(samples),
            "history": self._take_history(history),
            "trust": self._take_trust(trust),
            **self._taps,
            **self._whole,
            **({} if weights is None else {"weights": take_image("weights of rays", weights, self.size)}),
        }
        trust_radius = 0 if trust is None else self._trust_radius
        numbers = {"radius": radius, "trust_radius": trust_radius, "growth": growth, "own": own}
        numbers |= self._place_samples(self._scale, self._place)
        radii = {"known_radius": radius, "known_precision": 0.0}
        if known is not None and known.radius < radius:
            radii = {"known_radius": known.radius, "known_precision": known.precision}
        options = self._list_options(weights)
        text = f"{self.name} light at every pixel"
        planes = self._run(
            images, {**numbers, **radii}, self.shape, make_accumulation, *options, text=text, keeps=history is not None
        )
        return _split_output(planes)

    @device_scope()
    def accumulate_filtered(
        self,
        samples: FloatArray,
        *,
        form: str,
        radius: int,
        history: FloatArray | None = None,
        trust: FloatArray | None = None,
        growth: float = 0.0,
        own: float = 1.0,
    ) -> AccumulatedOutput:
        """Filter samples, one per pixel, by a form of `run_filter` and add the result to the history; for scale 1.

        See `accumulate` and `run_filter` for parameters, result and errors.
        """
        share = unit = engine.fill("one", 1.0, self.shape)
        if history is not None and trust is not None:
            share, unit = self._narrow(history, trust, growth)
        albedo = self._whole.get("own_albedo")
        filtered = run_filter(
            self._take_samples(samples),
            self._mask,
            self._features,
            form=form,
            radius=radius,
            albedo=None if albedo is None else cut(albedo, self.shape[1], axis=1),
            modulate=False,
            moment=True,
            strictness=unit,
            name=f"{self.name}_filtered",
        )
        assert filtered.moment is not None
        sources = {
            "samples": self._take_samples(samples),
            "mean": filtered.image,
            "total": filtered.weight_sum,
            "effective": filtered.effective_samples,
            "mean_square": filtered.moment,
            "share": share,
            "unit": unit,
        }
        images = {each: widen_to_vector(image) for each, image in sources.items()}
        images |= {"history": self._take_history(history), "own_mask": self._whole["own_mask"]}
        images |= {} if albedo is None else {"own_albedo": albedo}
        # Strict order of floats: the sums come from several passes, and must not differ more than the passes do.
        accumulated = self._run(
            images,
            {"own": own, "bonus": own - 1.0},
            self.shape,
            make_filtered_accumulation,
            self._tinted,
            text="add the frame to the history",
            keeps=history is not None,
            strict=True,
        )
        return _split_output(accumulated)

    def _narrow(self, history: FloatArray, trust: FloatArray, growth: float) -> Any:
        """Return trust in the history and unit of every pixel, two images (height, width)."""
        frames = self._take_history(history)[Sums._fields.index("frames")]
        images = {"frames": frames, "trust": self._take_trust(trust), **self._taps, **self._whole}
        images = {name: image for name, image in images.items() if not name.endswith("albedo")}
        numbers = {"trust_radius": self._trust_radius, "growth": growth, **self._place_samples(1, (0, 0))}
        return self._run(
            images, numbers, self.shape, make_narrowing, self._features, text="how much the kernel narrows"
        )

    def _list_options(self, weights: FloatArray | None) -> tuple[tuple[Feature, ...], bool, bool]:
        return self._features, self._tinted, weights is not None

    @property
    def _trust_radius(self) -> int:
        """Radius of the window over which a pixel averages the trust of samples."""
        return TRUST_RADIUS if self.size == self.shape else 1

    def _take_samples(self, samples: FloatArray) -> FloatArray:
        if samples.shape != (*self.size, 3):
            height, width = self.shape
            raise InputError(
                "shaded radiance",
                expected=f"shape {(*self.size, 3)}, every {self._scale}th of {width}x{height} pixels from row "
                f"{self._place[0]}, column {self._place[1]}",
                got=f"shape {samples.shape}",
                action="check scale and place",
            )
        return take_dense(samples)

    def _take_trust(self, trust: FloatArray | None) -> FloatArray:
        return engine.fill("full_trust", 1.0, self.size) if trust is None else take_image("trust", trust, self.size)

    def _take_history(self, history: FloatArray | None) -> FloatArray:
        if history is not None:
            return split_history(history, self.shape)
        size = self._whole["own_mask"].shape
        nothing: FloatArray = engine.fill("no_sums", 0.0, (HISTORY_CHANNELS, *size))
        return nothing

    def _place_samples(self, factor: int, place: tuple[int, int]) -> dict[str, float]:
        """Return the numbers that place samples among pixels, and the scalars of the features."""
        where = {"factor": factor, "row": place[0], "column": place[1], "spacing": float(self._scale)}
        return {**where, **give_scalars(self._features)}

    def _run(
        self,
        images: Mapping[str, HostImage],
        numbers: Mapping[str, float],
        size: tuple[int, int],
        make: Callable[..., Scheduled],
        *options: Any,
        text: str,
        keeps: bool = False,
        strict: bool = False,
    ) -> Any:
        """Return the output planes of the pass ``make(*options)``, (planes, rows, columns).

        With ``keeps`` the first of them are the sums that the next frame reads.
        """
        structures = (tuple(map(describe_structure, each)) if isinstance(each, tuple) else each for each in options)
        keep = f"{self.name}_sums" if keeps else ""
        planes = engine.planes(
            (make, *structures),
            partial(make, *options),
            images,
            numbers,
            strict=strict,
            name=self.name,
            keep=keep,
            text=text,
        )
        return cut(planes, size[1])


def _split_output(accumulated: Any) -> AccumulatedOutput:
    """Return the output planes of an accumulation by name."""
    first = HISTORY_CHANNELS + 3
    weight_sum, effective, variance = (take_dense(accumulated[first + k]) for k in range(3))
    sums, mean = (
        join_channels(accumulated[part]) for part in (slice(0, HISTORY_CHANNELS), slice(HISTORY_CHANNELS, first))
    )
    return AccumulatedOutput(mean, weight_sum, effective, sums=sums, variance=variance)


def run_upsampling(
    radiance: FloatArray,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    *,
    scale: int,
    place: tuple[int, int] = (0, 0),
    radius: int,
    albedo: FloatArray | None = None,
    weights: FloatArray | None = None,
    name: str = "light",
) -> FilterOutput:
    """Upsample radiance that was shaded at every ``scale``-th pixel, weighted by the similarity of pixels.

    With scale 1 this is the full form of `run_filter`. See `SampleGrid` and `SampleGrid.accumulate` for parameters.
    """
    grid = SampleGrid(mask, features, scale=scale, place=place, albedo=albedo, name=name)
    out = grid.accumulate(radiance, radius=radius, weights=weights)
    return FilterOutput(take_dense(out.image), out.weight_sum, out.effective_samples)
