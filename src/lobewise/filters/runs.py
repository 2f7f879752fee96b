"""The kernels between two grids or two frames, called: samples brought to every pixel, histories gathered."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import device_scope, download, lend, make_output, take_image, take_mask
from lobewise.backend.jit import get_kernel
from lobewise.errors import InputError
from lobewise.features.arrays import take_arrays, take_parameters
from lobewise.features.base import Feature
from lobewise.filters.accumulation import PLANES, SUMMARY, make_joining
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.cross_pass import WEIGHT, describe_structure
from lobewise.filters.reprojection import HISTORY_CHANNELS, MOMENT, make_reprojection
from lobewise.filters.schedules.cpu import schedule_joining, schedule_reprojection
from lobewise.frame import FloatArray

Image = NDArray[Any]


def _count_lanes() -> int:
    return int(hl.get_host_target().natural_vector_size(hl.Float(32)))


def _widen(image: Image) -> Image:
    """Return an image that is at least as wide as a vector, which the kernels rely on; its last column is repeated."""
    missing = _count_lanes() - image.shape[1]
    if missing <= 0:
        return image
    return np.pad(image, [(0, 0), (0, missing), *[(0, 0)] * (image.ndim - 2)], mode="edge")


def _fill(value: float, shape: tuple[int, ...], axis: int = 0) -> FloatArray:
    """Return an image of one value whose entries along ``axis`` share their memory."""
    row = np.full([1 if k == axis else length for k, length in enumerate(shape)], value, np.float32)
    strides = [0 if k == axis else stride for k, stride in enumerate(row.strides)]
    return np.lib.stride_tricks.as_strided(row, shape, strides)


class _Planes:
    """Planes that a kernel writes, and the image of which they are the channels."""

    def __init__(self, count: int, size: tuple[int, int], device: str) -> None:
        self._shape = size[0], max(size[1], _count_lanes())
        self._width = size[1]
        # One memory for all of them: who reads the image finds its channels one after the other.
        self._memory = np.empty((count, *self._shape), np.float32)
        self._outputs = [make_output(self._shape, device, plane) for plane in self._memory]
        self.buffers = [buffer for buffer, _ in self._outputs]

    def get_image(self) -> FloatArray:
        """Return the image (height, width, count), once the kernel has returned."""
        for _, plane in self._outputs:
            download(plane)
        return np.moveaxis(self._memory[..., : self._width], 0, -1)


@dataclass(frozen=True, kw_only=True)
class JoinedOutput(FilterOutput):
    """What samples and a history give together; its weight sum is one over what a sample counts that matches fully.

    Parameters
    ----------
    sums : array, shape (height, width, 7)
        What it all follows from; see `lobewise.filters.reprojection`.
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
        tints = [] if albedo is None else [take_image("albedo", albedo, (*self.shape, 3))]
        whole: list[Image] = [*tints, take_mask(mask), *map(download, take_arrays(features, self.shape))]
        self._tinted = bool(tints)
        self._taps = [np.ascontiguousarray(image[self.shaded]) for image in whole] if scale > 1 else whole
        self.size: tuple[int, int] = (self._taps[0].shape[0], self._taps[0].shape[1])
        self._whole = [_widen(image) for image in whole]
        self._parameters = take_parameters(features)
        self._features, self._device = features, device

    def _get_kernel(self) -> Any:
        def make(target: hl.Target) -> Any:
            funcs = make_joining(self._features, self._tinted)
            schedule_joining(funcs, target)
            return funcs

        key: Hashable = ("joining", self._tinted, *map(describe_structure, self._features))
        return get_kernel(self._device, key, make)

    @device_scope()
    def join(
        self,
        samples: FloatArray,
        *,
        radius: int,
        modulate: bool = True,
        strictness: FloatArray | None = None,
        history: FloatArray | None = None,
        trust: FloatArray | None = None,
        trust_radius: int = 1,
        growth: float = 0.0,
        own: float = 1.0,
        shaded_only: bool = False,
        demodulate: bool = True,
    ) -> JoinedOutput:
        """Bring samples to every pixel and join them with its history; see `lobewise.filters.accumulation`.

        Parameters
        ----------
        samples : array, shape (rows, columns, 3)
            Radiance; ``rows = ceil((height - place[0]) / scale)`` and so for columns. Bad ones get weight 0.
        radius : int
            Samples from the centre to the edge of the kernel, >= 0: (2 radius + 1)^2 of them are looked at.
        modulate, demodulate : bool
            Whether the albedo multiplies on the way out, and divides on the way in.
        strictness : array, shape (height, width), optional
            Power to which each pixel raises the weights of its taps, > 0.
        history : array, shape (height, width, 7 or more), optional
            Sums that are added.
        trust : array, shape (rows, columns), optional
            How far each sample bears out its pixel's history, 0 to 1.
        trust_radius : int
            As ``radius``, for the trust.
        growth : float
            How the kernel narrows as the history grows, 0 (not) to 1.
        own : float
            What a shaded pixel's own sample counts there, >= 1; a borrowed one that matches fully counts 1.
        shaded_only : bool
            Compute the shaded pixels alone; what comes back has the shape of ``samples``.

        Returns
        -------
        JoinedOutput

        Raises
        ------
        InputError
            If the samples are not as many as the grid has, or another array is of another shape.
        """
        if samples.shape != (*self.size, 3):
            height, width = self.shape
            raise InputError(
                "shaded radiance",
                expected=f"shape {(*self.size, 3)}, every {self._scale}th of {width}x{height} pixels from row "
                f"{self._place[0]}, column {self._place[1]}",
                got=f"shape {samples.shape}",
                action="check scale and place",
            )
        size = self.size if shaded_only else self.shape

        def pick(image: FloatArray) -> FloatArray:
            return np.ascontiguousarray(image[self.shaded]) if shaded_only else image

        wide = size[0], max(size[1], _count_lanes())
        taps = list(self._taps)
        pixels = [_widen(image) for image in self._taps] if shaded_only else list(self._whole)
        if self._tinted and not demodulate:
            taps[0], pixels[0] = _fill(1.0, (*self.size, 3)), _fill(1.0, (*wide, 3))
        power = (
            _fill(1.0, wide) if strictness is None else _widen(pick(take_image("strictness", strictness, self.shape)))
        )
        bears = _fill(1.0, self.size) if trust is None else take_image("trust", trust, self.size)
        # Every array is held in a local name until the call has returned: Halide keeps no reference.
        held: list[Image] = [np.ascontiguousarray(samples, dtype=np.float32), *taps, bears, *pixels, power]
        past = _fill(0.0, (HISTORY_CHANNELS, *wide), 1) if history is None else _split_history(pick(history), size)
        scale, place = (1, (0, 0)) if shaded_only else (self._scale, self._place)
        planes = _Planes(PLANES, size, self._device)
        self._get_kernel()(
            *(lend(array, self._device) for array in held),
            lend(past, self._device),
            *self._parameters,
            *(radius, 0 if trust is None else trust_radius, scale, place[1], place[0]),
            *(float(self._scale), growth, own, float(modulate)),
            *planes.buffers,
        )
        image = planes.get_image()
        weight_sum, effective, variance = (np.ascontiguousarray(image[..., SUMMARY + k]) for k in (3, 4, 5))
        sums, mean = image[..., :SUMMARY], image[..., SUMMARY : SUMMARY + 3]
        return JoinedOutput(mean, weight_sum, effective, sums=sums, variance=variance)


def _split_history(history: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return the channels of sums one after the other, each wide enough; nothing is copied if they lie so already."""
    if history.shape[:2] != size or history.ndim != 3 or history.shape[2] < HISTORY_CHANNELS:
        raise InputError(
            "history",
            expected=f"sums of shape {(*size, HISTORY_CHANNELS)}",
            got=f"shape {history.shape}",
            action="give those of this image",
        )
    planes = np.moveaxis(_widen(history[..., :HISTORY_CHANNELS]), -1, 0)
    if planes.dtype == np.float32 and planes.strides[2] == planes.itemsize:
        return planes
    return np.ascontiguousarray(planes, dtype=np.float32)


def _flatten_history(past: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return sums (height * width, 7) whose channels lie one after the other; copied only where they do not yet."""
    planes = np.moveaxis(past, -1, 0)
    if past.shape != (*size, HISTORY_CHANNELS) or past.dtype != np.float32 or not planes[0].flags.c_contiguous:
        planes = np.ascontiguousarray(np.moveaxis(take_image("past", past, (*size, HISTORY_CHANNELS)), -1, 0))
    return np.moveaxis(planes.reshape(HISTORY_CHANNELS, size[0] * size[1]), 0, -1)


def run_upsampling(
    radiance: FloatArray,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    *,
    scale: int,
    place: tuple[int, int] = (0, 0),
    radius: int,
    albedo: FloatArray | None = None,
    modulate: bool = True,
    moment: bool = False,
    strictness: FloatArray | None = None,
    shaded_only: bool = False,
    device: str = "cpu",
) -> FilterOutput:
    """Bring radiance that was shaded at every ``scale``-th pixel to every pixel, by what the pixels have in common.

    With scale 1 this is the full form of `run_filter`.

    Parameters
    ----------
    radiance
        Samples; see `SampleGrid.join`.
    mask, features, scale, place, albedo, device
        See `SampleGrid`.
    radius, modulate, strictness, shaded_only
        See `SampleGrid.join`.
    moment : bool
        Whether to average the squared luminance as well.

    Returns
    -------
    FilterOutput
        Of shape (height, width), or that of ``radiance``.

    Raises
    ------
    InputError
        If the samples are not as many as the grid has.
    """
    grid = SampleGrid(mask, features, scale=scale, place=place, albedo=albedo, device=device)
    out = grid.join(radiance, radius=radius, modulate=modulate, strictness=strictness, shaded_only=shaded_only)
    average = None
    if moment:
        weight = out.sums[..., WEIGHT]
        average = np.asarray(out.sums[..., MOMENT] / np.where(weight > 0.0, weight, np.inf), dtype=np.float32)
    return FilterOutput(np.ascontiguousarray(out.image), out.weight_sum, out.effective_samples, average)


@device_scope()
def run_reprojection(
    past: FloatArray,
    places: FloatArray,
    masks: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    features: tuple[Sequence[Feature], Sequence[Feature]],
    *,
    virtual: tuple[FloatArray, int] | None = None,
    memory: float = 1.0,
    device: str = "cpu",
) -> FloatArray:
    """Gather the history of every pixel from where it was in the frame before.

    Parameters
    ----------
    past : array, shape (height, width, 7)
        Sums of the frame before; see `lobewise.filters.reprojection`.
    places : array, shape (height, width, 2)
        Column and row where each pixel was, pixel centres at whole numbers; NaN or outside where it was nowhere.
    masks : pair of bool arrays, shape (height, width)
        Where a pixel has meaning, before and now.
    features : pair of sequences of Feature
        Of the frame before and of this one, of one structure; a pixel's history counts by their similarities.
    virtual : (array, int), optional
        Second places, where each pixel's reflection was, and the first of the features that are compared there.
    memory : float
        What the weights found are scaled by, 0 to 1.
    device : str
        A name from `list_devices`.

    Returns
    -------
    array, shape (height, width, 8)
        The sums here, and how much of each place agrees, 0 to 1 (and what `exp2` errs).
    """
    height, width = size = (masks[1].shape[0], masks[1].shape[1])
    ways = [places] if virtual is None else [places, virtual[0]]
    key = ("reprojection", None if virtual is None else virtual[1], *map(describe_structure, features[1]))

    def make(target: hl.Target) -> Any:
        funcs = make_reprojection(features[1], None if virtual is None else virtual[1])
        schedule_reprojection(funcs, target)
        return funcs

    kernel = get_kernel(device, key, make)
    sums = _flatten_history(past, size)
    sides: list[list[Image]] = [
        [take_mask(mask), *map(download, take_arrays(each, size))] for mask, each in zip(masks, features, strict=True)
    ]
    # Every array is held in a local name until the call has returned: Halide keeps no reference.
    arrays = [image.reshape(height * width, *image.shape[2:]) for image in sides[0]]
    before: list[Image] = [sums, *(_widen(take_image("places", way, (*size, 2))) for way in ways), *arrays]
    now = [_widen(image) for image in sides[1]]
    planes = _Planes(HISTORY_CHANNELS + 1, size, device)
    kernel(
        *(lend(array, device) for array in before),
        *take_parameters(features[1]),
        *(lend(array, device) for array in now),
        *(memory, width, height),
        *planes.buffers,
    )
    return planes.get_image()
