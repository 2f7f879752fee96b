"""Accumulation over space and time: what samples say of a history, and what both give together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import HostImage, device_scope, download, take_image, take_mask
from lobewise.backend.jit import Scheduled, get_kernel
from lobewise.errors import InputError
from lobewise.features.arrays import give_features, give_scalars
from lobewise.features.base import Feature
from lobewise.filters.cross_filter import FilterOutput, run_filter
from lobewise.filters.cross_pass import describe_structure
from lobewise.filters.history.accumulation_pass import (
    make_accumulation,
    make_filtered_accumulation,
    make_narrowing,
    make_trust,
)
from lobewise.filters.history.accumulation_stages import AccumulationFuncs
from lobewise.filters.history.sums import (
    HISTORY_CHANNELS,
    Sums,
    count_lanes,
    fill,
    run_planes,
    split_history,
    widen,
)
from lobewise.filters.schedules.accumulation import schedule_accumulation
from lobewise.frame import FloatArray

TRUST_RADIUS = 2
"""Samples from the centre to the edge of the window in which history and samples are compared."""


@dataclass(frozen=True, kw_only=True)
class AccumulatedOutput(FilterOutput):
    """What samples and a history give together; its weight sum is one over what a sample counts that matches fully.

    Parameters
    ----------
    sums : array, shape (height, width, 7)
        What it all follows from; see `lobewise.filters.history.sums`.
    variance : array, shape (height, width)
        Of the mean's luminance.
    """

    sums: FloatArray
    variance: FloatArray


class SampleGrid:
    """Guides of an image of which one pixel in every block of ``scale`` times ``scale`` is shaded.

    A shaded sample at (row Y, column X) stands for the full-resolution pixel (Y scale + place[0], X scale + place[1]);
    its weight for another pixel is the product of the features' similarities between these two pixels.

    Parameters
    ----------
    mask : bool array, shape (height, width)
        False where a pixel has no meaning for these features: it neither gives nor takes.
    features : sequence of Feature
        On the full grid.
    scale : int
        Pixels from sample to sample, >= 1.
    place : (int, int)
        Row and column of the shaded pixel within each block.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance on the way in, at the shaded pixels, and multiplies it on the way out.
    device : str
        A name from `list_devices`.
    """

    def __init__(
        self,
        mask: NDArray[np.bool_],
        features: Sequence[Feature],
        *,
        scale: int,
        place: tuple[int, int] = (0, 0),
        albedo: FloatArray | None = None,
        device: str = "cpu",
    ) -> None:
        self.shape: tuple[int, int] = (mask.shape[0], mask.shape[1])
        self.shaded = slice(place[0], None, scale), slice(place[1], None, scale)
        self._scale, self._place = scale, place
        self._mask, self._features, self._device = mask, tuple(features), device
        self._tinted = albedo is not None
        tint = {} if albedo is None else {"own_albedo": take_image("albedo", albedo, (*self.shape, 3))}
        guides = {name: download(image) for name, image in give_features("own", features, self.shape).items()}
        whole: dict[str, HostImage] = {"own_mask": take_mask(mask), **tint, **guides}
        self._taps = {name.replace("own", "tap"): self._pick(image) for name, image in whole.items()}
        self.size: tuple[int, int] = self._taps["tap_mask"].shape
        self._whole = {name: widen(image) for name, image in whole.items()}

    def _pick(self, image: HostImage) -> HostImage:
        """Return an image at the pixels that are shaded."""
        return np.ascontiguousarray(image[self.shaded]) if self._scale > 1 else image

    @device_scope()
    def find_trust(self, samples: FloatArray, history: FloatArray, own: float) -> FloatArray:
        """Return how far samples bear out the history, 0 to 1, at the pixels that were shaded, (rows, columns).

        Guides tell that a surface or a lobe is another one; they do not tell that a light went out, or that something
        else is reflected. Samples do, through their noise: the mean of many differences between sample and history must
        be as small as their deviation allows. What holds for the samples holds for the pixels that resemble them.

        Parameters
        ----------
        samples, history, own
            See `accumulate`.
        """
        pixels = {name.replace("tap", "own"): widen(image) for name, image in self._taps.items()}
        images = {
            "samples": self._take_samples(samples),
            "history": np.ascontiguousarray(np.moveaxis(history[self.shaded], -1, 0)),
            **self._taps,
            **{name: image for name, image in pixels.items() if name != "own_albedo"},
        }
        numbers = {"trust_radius": TRUST_RADIUS, "own": own, **self._place_samples(1, (0, 0))}
        return self._run(images, numbers, self.size, make_trust, self._features, self._tinted)[..., 0]

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
    ) -> AccumulatedOutput:
        """Bring samples to every pixel and add them to its history; see `lobewise.filters.history.accumulation_pass`.

        Parameters
        ----------
        samples : array, shape (rows, columns, 3)
            Radiance; ``rows = ceil((height - place[0]) / scale)`` and so for columns. Bad ones get weight 0.
        radius : int
            Samples from the centre to the edge of the kernel, >= 0: (2 radius + 1)^2 of them are looked at.
        history : array, shape (height, width, 7 or more), optional
            Sums that are added.
        trust : array, shape (rows, columns), optional
            How far each sample bears out its pixel's history, 0 to 1.
        growth : float
            How the kernel narrows as the history grows, 0 (not) to 1.
        own : float
            What a shaded pixel's own sample counts there, >= 1; a borrowed one that matches fully counts 1.

        Returns
        -------
        AccumulatedOutput

        Raises
        ------
        InputError
            If the samples are not as many as the grid has, or another array is of another shape.
        """
        images = {
            "samples": self._take_samples(samples),
            "history": self._take_history(history),
            "trust": self._take_trust(trust),
            **self._taps,
            **self._whole,
        }
        trust_radius = 0 if trust is None else self._trust_radius
        numbers = {"radius": radius, "trust_radius": trust_radius, "growth": growth, "own": own}
        numbers |= self._place_samples(self._scale, self._place)
        found = self._run(images, numbers, self.shape, make_accumulation, self._features, self._tinted)
        return _split_output(found)

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
        """Filter samples, one for every pixel, by a form of `run_filter` and add them to the history.

        Parameters and what is returned and raised are those of `accumulate` and `run_filter`; the scale is 1.
        """
        share = unit = fill(1.0, self.shape)
        if history is not None and trust is not None:
            share, unit = np.moveaxis(self._narrow(history, trust, growth), -1, 0)
        albedo = self._whole.get("own_albedo")
        found = run_filter(
            self._take_samples(samples),
            self._mask,
            self._features,
            form=form,
            radius=radius,
            albedo=None if albedo is None else albedo[:, : self.shape[1]],
            modulate=False,
            moment=True,
            strictness=unit,
            device=self._device,
        )
        assert found.moment is not None
        given = {
            "samples": self._take_samples(samples),
            "mean": found.image,
            "total": found.weight_sum,
            "effective": found.effective_samples,
            "mean_square": found.moment,
            "share": share,
            "unit": unit,
        }
        images = {name: widen(np.asarray(image)) for name, image in given.items()}
        images |= {"history": self._take_history(history), "own_mask": self._whole["own_mask"]}
        images |= {} if albedo is None else {"own_albedo": albedo}
        # In NumPy's order: the sums are those of several passes, and differ by no more than these do.
        accumulated = self._run(
            images, {"own": own, "bonus": own - 1.0}, self.shape, make_filtered_accumulation, self._tinted, strict=True
        )
        return _split_output(accumulated)

    def _narrow(self, history: FloatArray, trust: FloatArray, growth: float) -> FloatArray:
        """Return what of the history counts at every pixel, and what a sample counts there, (height, width, 2)."""
        frames = self._take_history(history)[Sums._fields.index("frames")]
        images = {"frames": frames, "trust": self._take_trust(trust), **self._taps, **self._whole}
        images = {name: image for name, image in images.items() if not name.endswith("albedo")}
        numbers = {"trust_radius": self._trust_radius, "growth": growth, **self._place_samples(1, (0, 0))}
        return self._run(images, numbers, self.shape, make_narrowing, self._features)

    @property
    def _trust_radius(self) -> int:
        """Samples from the centre to the edge of the window from which a pixel takes its trust."""
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
        return np.ascontiguousarray(samples, dtype=np.float32)

    def _take_trust(self, trust: FloatArray | None) -> FloatArray:
        return fill(1.0, self.size) if trust is None else take_image("trust", trust, self.size)

    def _take_history(self, history: FloatArray | None) -> FloatArray:
        wide = self.shape[0], max(self.shape[1], count_lanes())
        return fill(0.0, (HISTORY_CHANNELS, *wide), 1) if history is None else split_history(history, self.shape)

    def _place_samples(self, factor: int, place: tuple[int, int]) -> dict[str, float]:
        """Return where samples lie among the pixels of a call, and the scalars of their features."""
        where = {"factor": factor, "row": place[0], "column": place[1], "spacing": float(self._scale)}
        return {**where, **give_scalars(self._features)}

    def _run(
        self,
        images: Mapping[str, HostImage],
        numbers: Mapping[str, float],
        size: tuple[int, int],
        make: Callable[..., AccumulationFuncs],
        *options: Any,
        strict: bool = False,
    ) -> FloatArray:
        """Return what a pass writes, (rows, columns, planes); ``make`` and its options are what it is."""
        told = (tuple(map(describe_structure, each)) if isinstance(each, tuple) else each for each in options)
        kernel = get_kernel(self._device, (make, *told), partial(_make_scheduled, make, options), strict=strict)
        return run_planes(kernel, self._device, images, numbers, size)


def _make_scheduled(make: Callable[..., AccumulationFuncs], options: tuple[Any, ...], target: hl.Target) -> Scheduled:
    """Return a pass, ready to be compiled."""
    funcs = make(*options)
    schedule_accumulation(funcs, target)
    return Scheduled([funcs.out], funcs.signature)


def _split_output(accumulated: FloatArray) -> AccumulatedOutput:
    """Return the planes of an accumulation by what they are."""
    first = HISTORY_CHANNELS + 3
    weight_sum, effective, variance = (np.ascontiguousarray(accumulated[..., first + k]) for k in range(3))
    sums, mean = accumulated[..., :HISTORY_CHANNELS], accumulated[..., HISTORY_CHANNELS:first]
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
    device: str = "cpu",
) -> FilterOutput:
    """Bring radiance that was shaded at every ``scale``-th pixel to every pixel, by what the pixels have in common.

    With scale 1 this is the full form of `run_filter`; parameters are those of `SampleGrid` and
    `SampleGrid.accumulate`.
    """
    grid = SampleGrid(mask, features, scale=scale, place=place, albedo=albedo, device=device)
    out = grid.accumulate(radiance, radius=radius)
    return FilterOutput(np.ascontiguousarray(out.image), out.weight_sum, out.effective_samples)
