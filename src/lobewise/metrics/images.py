"""Errors of an image compared with its reference.

Images are linear and scene-referred, shape (height, width, 3). A mask chooses the pixels that count, for example the
specular ones. All sums are in float64. Pixels that are not finite raise an error: skipping them would lower the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError, MissingChannelError, MissingDependencyError, require_choice
from lobewise.records.frame import GBuffer, LobeKind
from lobewise.records.images import read_array, refuse_size

EPSILON = 0.01
"""Constant in the denominators of `rel_mse` and `smape`. Below a radiance of about 0.1 errors are nearly absolute."""

FLIP_PIXELS_PER_DEGREE = 3840.0 * math.pi / 180.0
"""About 67: a display 3840 pixels wide, seen from a distance of its width, as FLIP's authors choose."""

METRICS = ("mse", "rel_mse", "smape", "psnr", "flip")
"""All metrics. Lower is better, except for `psnr`."""


def mse(image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Return the mean squared error, ``mean((a - r)^2)`` over pixels and colour channels.

    Parameters
    ----------
    image, reference : array_like, shape (height, width, 3)
        Linear radiance, finite.
    mask : array_like of bool, shape (height, width), optional
        Pixels that count; all by default.

    Raises
    ------
    InputError
        If the sizes differ, a pixel is not finite, or the mask chooses no pixel.
    """
    return _average("mse", image, reference, mask)


def rel_mse(image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Return the relative mean squared error, ``mean((a - r)^2 / (r^2 + 0.01))`` over pixels and colour channels.

    The 0.01 is added to the square and so corresponds to a radiance of 0.1. Other programs use other epsilons, or
    divide by the squared luminance: values of different definitions cannot be compared.

    Parameters and errors are those of `mse`.

    Notes
    -----
    Source: Rousselle, Knaus, Zwicker 2011, "Adaptive sampling and reconstruction using greedy error minimization",
    doi 10.1145/2070781.2024193.
    """
    return _average("rel_mse", image, reference, mask)


def smape(image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Return the symmetric mean absolute relative error, ``mean(|a - r| / (|a| + |r| + 0.01))``, in [0, 1).

    Parameters and errors are those of `mse`.

    Notes
    -----
    Source: Vogels et al. 2018, "Denoising with kernel prediction and asymmetric loss functions",
    doi 10.1145/3197517.3201388.
    """
    return _average("smape", image, reference, mask)


def psnr(image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None, *, peak: float = 1.0) -> float:
    """Return the peak signal-to-noise ratio in decibels, ``10 log10(peak^2 / mse)``; infinite for equal images.

    Values are linear, neither clipped nor tone mapped, so a single bright wrong pixel has a large weight.

    Parameters
    ----------
    image, reference : array_like, shape (height, width, 3)
        Linear radiance, finite.
    mask : array_like of bool, shape (height, width), optional
        Pixels that count; all by default.
    peak : float
        Radiance of the full signal, > 0.

    Raises
    ------
    InputError
        If the sizes differ, a pixel is not finite, the mask chooses no pixel, or the peak is not above 0.
    """
    if not 0.0 < peak < np.inf:
        raise InputError("peak", expected="a finite number above 0", got=str(peak), action="pass peak=1.0")
    error = mse(image, reference, mask)
    return float("inf") if error == 0.0 else float(10.0 * np.log10(peak**2 / error))


def flip(image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None, *, hdr: bool = True) -> float:
    """Return the mean FLIP error, in [0, 1]: the difference that people see when they flip between the two images.

    Parameters
    ----------
    image, reference : array_like, shape (height, width, 3)
        With ``hdr`` finite linear radiance, whose negative values count as 0; otherwise sRGB-encoded values in [0, 1].
    mask : array_like of bool, shape (height, width), optional
        Pixels of the error map that count; all by default. The map is always made from the whole image.
    hdr : bool
        Whether to compare at many exposures, chosen from the reference, with the ACES tone curve.

    Raises
    ------
    InputError
        If the sizes differ, a pixel is not finite, or the mask chooses no pixel.
    MissingDependencyError
        If ``flip_evaluator`` is not installed.

    Notes
    -----
    Source: Andersson et al. 2020, "FLIP: A difference evaluator for alternating images", doi 10.1145/3406183, and
    Andersson et al. 2021, "Visualizing errors in rendered high dynamic range images", doi 10.2312/egs.20211015, by
    their authors' program at 67 pixels per degree.
    """
    a, r, chosen = check_pair(image, reference, mask)
    return float(_flip_map(a, r, hdr=hdr)[chosen].mean())


def make_error_map(image: ArrayLike, reference: ArrayLike, metric: str = "rel_mse") -> NDArray[np.float32]:
    """Return the error of every pixel, shape (height, width): its mean is the metric of that name.

    Parameters
    ----------
    image, reference : array_like, shape (height, width, 3)
        Linear radiance, finite.
    metric : str
        One of ``mse, rel_mse, smape, flip``.

    Raises
    ------
    InputError
        If the metric has no map, the sizes differ, or a pixel is not finite.
    MissingDependencyError
        If the metric is ``flip`` and ``flip_evaluator`` is not installed.
    """
    require_choice("metric", metric, ("mse", "rel_mse", "smape", "flip"))
    a, r, _ = check_pair(image, reference, None)
    if metric == "flip":
        return _flip_map(a, r, hdr=True).astype(np.float32)
    return _ERRORS[metric](a, r).mean(axis=-1).astype(np.float32)  # type: ignore[no-any-return]  # NumPy's mean


def evaluate(
    image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None = None, *, metrics: Iterable[str] = METRICS
) -> dict[str, float]:
    """Return several metrics at once, by name.

    Raises
    ------
    InputError
        If a metric is unknown, the sizes differ, a pixel is not finite, or the mask chooses no pixel.
    MissingDependencyError
        If ``flip`` is among the metrics and ``flip_evaluator`` is not installed.
    """
    functions: dict[str, Callable[..., float]] = {
        "mse": mse, "rel_mse": rel_mse, "smape": smape, "psnr": psnr, "flip": flip,
    }  # fmt: skip
    names = [require_choice("metric", name, METRICS) for name in metrics]
    return {name: functions[name](image, reference, mask) for name in names}


def find_specular_pixels(gbuffer: GBuffer) -> NDArray[np.bool_]:
    """Return which pixels show a surface with a specular lobe, shape (height, width).

    Raises
    ------
    MissingChannelError
        If the G-buffer has neither ``lobe_kind`` nor ``specular_albedo``.
    """
    if gbuffer.lobe_kind is not None:
        # Some renderers average kinds over a pixel: round to the nearest.
        return np.asarray(np.rint(gbuffer.lobe_kind) != float(LobeKind.NONE), dtype=np.bool_)
    if gbuffer.specular_albedo is not None:
        return np.asarray((gbuffer.specular_albedo > 0.0).any(axis=-1), dtype=np.bool_)
    raise MissingChannelError(
        "specular pixels",
        expected="lobe_kind or specular_albedo in the G-buffer",
        got="neither",
        action="render them with the frame",
    )


_ERRORS: dict[str, Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]] = {
    "mse": lambda a, r: (a - r) ** 2,
    "rel_mse": lambda a, r: (a - r) ** 2 / (r**2 + EPSILON),
    "smape": lambda a, r: np.abs(a - r) / (np.abs(a) + np.abs(r) + EPSILON),
}


def _average(metric: str, image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None) -> float:
    a, r, chosen = check_pair(image, reference, mask)
    return float(_ERRORS[metric](a[chosen], r[chosen]).mean())


def _flip_map(a: NDArray[np.float64], r: NDArray[np.float64], *, hdr: bool) -> NDArray[Any]:
    try:
        import flip_evaluator
    except ImportError:
        raise MissingDependencyError(
            "flip",
            expected="the package flip-evaluator",
            got="none installed",
            action="pip install 'lobewise[compare]', or leave flip out",
        ) from None
    if not hdr and not ((a >= 0.0) & (a <= 1.0) & (r >= 0.0) & (r <= 1.0)).all():
        raise InputError(
            "flip", expected="values in [0, 1] with hdr=False", got="values outside", action="pass hdr=True"
        )
    test, target = (np.ascontiguousarray(np.maximum(x, 0.0), dtype=np.float32) for x in (a, r))
    parameters: dict[str, Any] = {"ppd": FLIP_PIXELS_PER_DEGREE}
    if hdr and not (target > 0.0).any():
        # FLIP cannot choose exposures from a black reference.
        parameters |= {"startExposure": 0.0, "stopExposure": 0.0}
    error, _, _ = flip_evaluator.evaluate(
        target, test, "HDR" if hdr else "LDR", applyMagma=False, computeMeanError=False, parameters=parameters
    )
    return np.asarray(error)[..., 0]


def check_pair(
    image: ArrayLike, reference: ArrayLike, mask: ArrayLike | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return image and reference in float64, and a mask; raise InputError as in `mse`."""
    a, r = require_image("image", image), require_image("reference", reference)
    if a.shape != r.shape:
        raise refuse_size("image", "the reference", r.shape, a.shape, "compare images of one size")
    if mask is None:
        return a, r, np.ones(a.shape[:2], dtype=np.bool_)
    chosen = np.asarray(mask)
    if chosen.dtype != np.bool_ or chosen.shape != a.shape[:2] or not chosen.any():
        raise InputError(
            "mask",
            expected=f"booleans of shape {a.shape[:2]} with at least one True",
            got=f"{chosen.dtype} of shape {chosen.shape} with {int(np.count_nonzero(chosen))} nonzero",
            action="leave it out to take every pixel",
        )
    return a, r, chosen


def require_image(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return an image of finite numbers in float64, or raise InputError."""
    array = read_array(name, value)
    if array.ndim != 3 or array.shape[-1] != 3 or 0 in array.shape or array.dtype.kind not in "fiu":
        raise InputError(
            name,
            expected="real numbers of shape (height, width, 3) with at least one pixel",
            got=f"{array.dtype} of shape {array.shape}",
            action="reshape it",
        )
    bad = ~np.isfinite(array).all(axis=-1)
    if bad.any():
        y, x = np.argwhere(bad)[0]
        raise InputError(
            name,
            expected="finite pixels",
            got=f"{np.count_nonzero(bad)} of {bad.size} pixels that are NaN or infinite, the first at x={x}, y={y}",
            action="denoise or repair it before comparing",
        )
    return array.astype(np.float64)
