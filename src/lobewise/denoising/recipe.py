"""The recipe: a noisy frame in, a clean one out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.layers import Layer, find_support, make_layers
from lobewise.denoising.settings import DenoiseSettings, resolve_settings
from lobewise.errors import InputError, describe_problem, require_choice
from lobewise.frame import FloatArray, Frame, Result
from lobewise.kernels.engine import FilterOutput, run_filter
from lobewise.kernels.features import Feature, ScreenFeature


def find_good(image: FloatArray) -> NDArray[np.bool_]:
    """Return where all three channels are finite and not negative.

    Channel by channel: NumPy's reductions over an axis of three are several times slower.
    """
    # Not-finite compares false with everything, so the good side is what is tested.
    each = (image >= 0.0) & (image <= np.finfo(np.float32).max)
    good: NDArray[np.bool_] = each[..., 0] & each[..., 1] & each[..., 2]
    return good


def blacken_bad(image: FloatArray) -> FloatArray:
    """Return ``image`` with 0 where a pixel is not finite or negative."""
    good = find_good(image)
    return image if good.all() else np.where(good[..., None], image, np.float32(0.0))


def find_bad_pixels(frame: Frame) -> NDArray[np.bool_]:
    """Return where any radiance of the frame is NaN, infinite or negative, shape (height, width)."""
    bad = np.zeros(frame.shape, dtype=bool)
    for image in (frame.radiance.color, frame.radiance.diffuse, frame.radiance.specular):
        if image is not None:
            bad |= ~find_good(image)
    return bad


def require_some_good(bad: NDArray[np.bool_], what: str) -> None:
    """Raise InputError if all of ``bad`` are; ``what`` they are is a pixel or a sample."""
    if bad.all():
        raise InputError(
            describe_problem(
                "radiance",
                expected=f"at least one {what} that is finite and not negative",
                got=f"{bad.size} bad {what}s of {bad.size}",
                action="check the render or the channel mapping",
            )
        )


def refill(image: FloatArray, holes: NDArray[np.bool_], settings: DenoiseSettings) -> FloatArray:
    """Return ``image`` with the pixels of ``holes`` replaced by the mean of the nearest others on the screen."""
    everywhere = np.ones(holes.shape, dtype=bool)
    source = np.where(holes[..., None], np.float32(np.nan), image)
    for features in ([ScreenFeature(1.0)], [ScreenFeature(16.0)], []):
        filled = run_filter(source, everywhere, features, form="atrous", radius=0, device=settings.device)
        reached = holes & (filled.weight_sum > 0.0)
        source = np.where(reached[..., None], filled.image, source)
        holes = holes & ~reached
        if not holes.any():
            return source
    return np.where(holes[..., None], np.nanmean(source.reshape(-1, 3), axis=0).astype(np.float32), source)


def denoise(
    frame: Frame,
    settings: DenoiseSettings | None = None,
    *,
    features: Sequence[Feature] = (),
    **changes: Any,
) -> Result:
    """Denoise a frame by averaging, for every pixel, the neighbours that reflect like it.

    Diffuse and specular radiance are filtered apart where the frame has both, each divided by its albedo where the
    frame has that; emission and background pass through. Source: Tokuyoshi 2015, "Specular Lobe-Aware Filtering and
    Upsampling for Interactive Indirect Illumination". Departs: lobes of two radiances are never mixed, and the lobe
    similarity may be the GGX covariance instead of a spherical Gaussian.

    Parameters
    ----------
    frame : Frame
        Noisy radiance with its G-buffer; normals at least, for lobes also roughness, camera and position or depth.
    settings : DenoiseSettings, optional
        Parameters; by default those that won the comparison.
    features : sequence of Feature
        More distributions that two pixels must share, of your own or from `lobewise.kernels.features`; their
        similarities multiply the others in every layer.
    **changes
        Single parameters, by name, that replace those of ``settings``.

    Returns
    -------
    Result
        Finite, non-negative radiance and the filter's statistics.

    Raises
    ------
    InputError
        If a parameter is out of range or unknown, or no pixel of the frame is usable.
    MissingChannelError
        If the frame lacks what the similarity compares.
    DeviceError
        If the device cannot run here.

    Examples
    --------
    >>> import lobewise
    >>> frame = lobewise.read_frame("frame.exr")  # doctest: +SKIP
    >>> clean = lobewise.denoise(frame, radius=12).image  # doctest: +SKIP
    """
    start = time.perf_counter()
    for name in changes:
        require_choice("setting", name, [item.name for item in fields(DenoiseSettings)])
    chosen = resolve_settings(frame, replace(settings or DenoiseSettings(), **changes))
    bad = find_bad_pixels(frame)
    require_some_good(bad, "pixel")
    layers = make_layers(frame, chosen, features)
    outputs = [
        run_filter(
            layer.radiance,
            layer.mask,
            layer.features,
            form=chosen.form,
            radius=chosen.radius,
            albedo=layer.albedo,
            device=chosen.device,
        )
        for layer in layers
    ]
    parts = [keep_unfiltered(layer, output) for layer, output in zip(layers, outputs, strict=True)]
    image = compose(frame, parts)
    untouched = np.logical_and.reduce([output.weight_sum <= 0.0 for output in outputs])
    holes = ~find_good(image) | (bad & untouched)
    if holes.any():
        image = refill(image, holes, chosen)
    apart = len(parts) == 2
    weight_sum, effective_samples = find_support(layers, outputs)
    return Result(
        image=image,
        diffuse=blacken_bad(parts[0]) if apart else None,
        specular=blacken_bad(parts[1]) if apart else None,
        weight_sum=weight_sum,
        effective_samples=effective_samples,
        bad_pixels=bad,
        settings=asdict(chosen),
        seconds=time.perf_counter() - start,
    )


def keep_unfiltered(layer: Layer, output: FilterOutput) -> FloatArray:
    """Return the filtered radiance, and the input where no tap had weight; NaN where that is bad too."""
    lost = output.weight_sum <= 0.0
    if not lost.any():
        return output.image
    kept = np.where(find_good(layer.radiance)[..., None], layer.radiance, np.float32(np.nan))
    return np.where(lost[..., None], kept, output.image)


def compose(frame: Frame, parts: Sequence[FloatArray]) -> FloatArray:
    """Return the total: the filtered parts, and what was in none of them (emission, background) as it came."""
    if len(parts) == 1:
        return parts[0]
    radiance = frame.radiance
    assert radiance.diffuse is not None and radiance.specular is not None
    with np.errstate(invalid="ignore", over="ignore"):  # bad pixels are infinite or NaN here; the next line drops them
        rest = radiance.color - radiance.diffuse - radiance.specular
    rest = np.where((rest > 0.0) & (rest <= np.finfo(np.float32).max), rest, np.float32(0.0))
    return np.asarray(parts[0] + parts[1] + rest, dtype=np.float32)
