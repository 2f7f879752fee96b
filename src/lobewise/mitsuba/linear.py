"""The filter of the quality "fast" as a linear map of the radiance, and its transpose.

The weights come from the guides alone, so ``out = W in``. Let ``w(i,j) = w(j,i)`` be the similarity of two pixels,
``s_i`` the sum of ``w(i,j)`` over j and ``a`` the albedo. Then ``W(i,j) = a_i w(i,j) / (s_i a_j)``. The transpose is a
filter with the same similarities, ``(W^T g)_j = (1 / a_j) sum_i w(i,j) a_i g_i / s_i``. The same kernel computes it,
because the kernel returns its weight sums ``s`` as well.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.denoising.automatic import resolve_settings
from lobewise.denoising.bad_pixels import mark_good
from lobewise.denoising.layers import make_layers
from lobewise.errors import InputError
from lobewise.filters.cross_filter import FilterOutput, run_filter
from lobewise.guides.usable import check_guides
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import DenoiseSettings
from lobewise.settings.choices import get_quality


class LinearFilter:
    """The map by which `lobewise.denoise` with the quality "fast" filters one frame, applied to any image.

    Parameters
    ----------
    frame : Frame
        A frame of one layer. Pixels of its radiance that are NaN, infinite or negative have no weight.
    settings : DenoiseSettings
        Settings with the quality "fast" and the form "full".

    Raises
    ------
    InputError
        If the settings have another quality or form, the frame has several layers, or all pixels of a kernel are bad.
    """

    def __init__(self, frame: Frame, settings: DenoiseSettings) -> None:
        fixed = settings.quality != "auto" and not get_quality(settings.quality).reads_halves
        if not fixed or settings.form != "full":
            got = f"quality {settings.quality!r} and form {settings.form!r}"
            action = "other qualities and forms are no symmetric linear filter"
            expected = "quality 'fast' and form 'full', whose weights are fixed and symmetric"
            raise InputError("settings", expected=expected, got=got, action=action)
        frame = check_guides(frame).frame
        self._settings = resolve_settings(frame, settings)
        layers = make_layers(frame, self._settings)
        if len(layers) != 1:
            got = ", ".join(layer.name for layer in layers)
            raise InputError("frame", expected="radiance in one layer", got=got, action="leave its parts out")
        self._layer = layers[0]
        self._good = mark_good(frame.radiance.color)
        self._sums = self._run(self._mark(np.zeros_like(frame.radiance.color)), self._layer.albedo).weight_sum
        self._kept: NDArray[np.bool_] = self._sums <= 0.0
        holes = int(np.count_nonzero(self._kept & ~self._good))
        if holes:
            raise InputError(
                "radiance",
                expected="usable light near every pixel",
                got=f"{holes} pixels that are NaN, infinite or negative and have none",
                action="render with more samples",
            )

    def apply(self, image: FloatArray) -> FloatArray:
        """Return ``W`` times an image, (height, width, 3), of any sign."""
        return self._split(self._apply, image)

    def transpose(self, gradient: FloatArray) -> FloatArray:
        """Return the transpose of ``W`` times an image, (height, width, 3), of any sign."""
        return self._split(self._transpose, gradient)

    @staticmethod
    def _split(run: Callable[[FloatArray], FloatArray], image: FloatArray) -> FloatArray:
        """Return a linear function of an image. The kernel takes no negative values, so both signs run apart."""
        finite = np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0)
        return run(np.maximum(finite, 0.0)) - run(np.maximum(-finite, 0.0)) if (finite < 0.0).any() else run(finite)

    def _run(self, image: FloatArray, albedo: FloatArray | None) -> FilterOutput:
        layer, settings = self._layer, self._settings
        options = {"form": settings.form, "radius": settings.radius}
        with engine.on(settings.device):
            return run_filter(image, layer.mask, layer.features, albedo=albedo, **options)  # type: ignore[arg-type]

    def _mark(self, image: FloatArray) -> FloatArray:
        """Return an image with NaN, which gets no weight, where the frame's radiance is bad."""
        return np.where(self._good[..., None], image, np.float32(np.nan))

    def _apply(self, image: FloatArray) -> FloatArray:
        filtered = self._run(self._mark(image), self._layer.albedo).image
        return np.where(self._kept[..., None], image, filtered)

    def _transpose(self, gradient: FloatArray) -> FloatArray:
        is_kept = self._kept[..., None]
        albedo = self._layer.albedo
        shares = np.where(
            is_kept, np.float32(0.0), gradient / np.where(is_kept, np.float32(1.0), self._sums[..., None])
        )
        shares = shares if albedo is None else shares * albedo
        # In the transpose every pixel gives to others; bad pixels receive nothing, because they gave nothing.
        filtered = self._run(np.asarray(shares, dtype=np.float32), None)
        gathered = filtered.image * filtered.weight_sum[..., None]
        if albedo is not None:
            gathered = gathered / albedo
        gathered = gathered + np.where(is_kept, gradient, np.float32(0.0))
        return np.asarray(np.where(self._good[..., None], gathered, np.float32(0.0)), dtype=np.float32)
