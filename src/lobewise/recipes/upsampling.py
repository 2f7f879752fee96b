"""The recipe that brings sparsely shaded radiance to every pixel."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.denoising.automatic import change_settings, require_full, require_plain, resolve_settings
from lobewise.denoising.bad_pixels import describe_bad, fill_holes, mark_bad_pixels, require_some_good
from lobewise.denoising.layers import (
    Layer,
    describe_exact_light,
    knows_exact_light,
    make_layers,
    make_rest_layers,
)
from lobewise.denoising.plan import bound_memory
from lobewise.errors import require_kind
from lobewise.features import Feature, TentFeature
from lobewise.filters.compositing import composite_parts
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.glue import define_tinted, define_unmatched
from lobewise.filters.history.accumulation import run_upsampling
from lobewise.filters.history.joining import JoinedLayers, join_layers
from lobewise.guides.negative import split_negative
from lobewise.guides.usable import check_guides
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance, Result
from lobewise.records.sparse_frame import SparseFrame
from lobewise.settings import DenoiseChanges, DenoiseSettings, ResolvedSettings
from lobewise.work.progress import Watcher, enter_stage, plan_stages, watched
from lobewise.work.progress.stages import FILL

if TYPE_CHECKING:
    from typing_extensions import Unpack

UNSCATTERED = ("rest", "background")
"""Layers of light that no lobe scattered."""
UPSAMPLE = "average the samples of every layer"
"""The stage that takes most of the time."""
DEFAULT_RADIUS = 5
"""Samples from the centre to the edge of the kernel."""


@watched
def upsample(
    frame: SparseFrame,
    settings: DenoiseSettings | None = None,
    *,
    bilinear: bool = False,
    features: Sequence[Feature] = (),
    progress: Watcher | None = None,
    **changes: Unpack[DenoiseChanges],
) -> Result:
    """Bring sparsely shaded radiance to every pixel, by averaging the samples whose pixels reflect like it.

    The weight of a sample is the similarity between the pixel and the *shaded* pixel. Both have guides, so an edge
    between two materials stays where the guides show it. Diffuse and specular radiance are upsampled apart where the
    frame has both. Source: Tokuyoshi 2015, slide "Spatio-Temporal Upsampling", its spatial part.

    Parameters
    ----------
    frame : SparseFrame
        Radiance at every ``scale``-th pixel, guides at all.
    settings : DenoiseSettings, optional
        As `lobewise.denoise`, with two differences: ``radius`` counts samples, 5 by default, and ``form`` is "full".
    bilinear : bool
        Interpolate on the screen alone instead: the baseline without guides.
    features : sequence of Feature
        More distributions that pixel and sample must share.
    progress : callable, optional
        As of `lobewise.denoise`.
    **changes
        Single parameters, by name, that replace those of ``settings``.

    Returns
    -------
    Result
        A result of the full size. Where no sample has any weight, the weight sum is 0 and the pixel is filled from its
        neighbours on the screen.

    Raises
    ------
    InputError
        If a parameter is out of range or unknown, or no sample is usable.
    MissingChannelError
        If the frame lacks what the similarity compares.
    DeviceError
        If the device cannot run here.
    CancelledError
        If ``progress`` has returned False.
    """
    start = time.perf_counter()
    require_kind("frame", frame, SparseFrame)
    maker, checked = frame.radiance.maker, check_guides(frame)
    frame = checked.frame
    notes = (*checked.notes, *(() if bilinear else describe_exact_light(frame)))
    wished = change_settings(settings or DenoiseSettings(radius=DEFAULT_RADIUS), changes)
    require_full(wished)
    require_plain(wished, "upsampling")
    chosen = resolve_settings(frame, wished, frame.scale)
    frame, below = split_negative(frame)
    if not bilinear:
        frame = tint_samples(frame)
    bad = mark_bad_pixels(Frame(frame.radiance))
    require_some_good(int(np.count_nonzero(bad)), bad.size, "sample")
    with (
        bound_memory(frame, "fast", with_oidn=False),
        engine.on(chosen.device),
        plan_stages({UPSAMPLE: 10.0, FILL: 1.0}),
    ):
        if bilinear:
            enter_stage(UPSAMPLE)
            everywhere = np.ones(frame.shape, dtype=bool)
            tent = Layer(frame.radiance.color, None, everywhere, (TentFeature(float(frame.scale)), *features))
            joined = join_layers([upsample_layer(frame, tent, 1)], [(everywhere, None)])
        else:
            joined = upsample_by_guides(frame, chosen, features)
        enter_stage(FILL)
        image = fill_holes(joined.image, joined.holes, frame)
    diffuse, specular = joined.parts or (None, None)
    result = Result(
        image=image,
        diffuse=diffuse,
        specular=specular,
        weight_sum=joined.weight_sum,
        effective_samples=joined.effective_samples,
        bad_pixels=spread(frame, bad),
        settings={**asdict(chosen), "scale": frame.scale, "place": frame.place, "bilinear": bilinear},
        seconds=0.0,
        notes=(*notes, *describe_bad(int(np.count_nonzero(bad)), bad.size)),
    )
    if below is not None:
        result = result.subtract(upsample(below, wished, bilinear=bilinear, features=features))
    return replace(result, seconds=time.perf_counter() - start).convert(maker)


def upsample_by_guides(
    frame: SparseFrame, settings: ResolvedSettings, features: Sequence[Feature] = ()
) -> JoinedLayers:
    """Return all pixels of a sparse frame: every layer is averaged by the guides of pixels and samples.

    Source: Tokuyoshi 2015, slide "Spatio-Temporal Upsampling", its spatial part.

    Parameters
    ----------
    frame, settings
    features : sequence of Feature
        More features of every layer.
    """
    # Light of lobes, and light that no lobe scattered, which is compared by place alone.
    layers = [*make_layers(frame, settings, features), *make_rest_layers(frame, settings, features)]
    outputs = []
    for number, layer in enumerate(layers):
        enter_stage(UPSAMPLE, (number / len(layers), (number + 1) / len(layers)))
        with engine.part(f"{layer.name}: {describe_upsampling(settings.radius, frame.scale)}"):
            outputs.append(upsample_layer(frame, layer, settings.radius))
    with engine.part("sum of the light"):
        return join_sparse(frame, layers, outputs)


def describe_upsampling(radius: int, scale: int) -> str:
    """Return the kernel of upsampling in a few words."""
    return f"upsampling kernel, {2 * radius + 1}x{2 * radius + 1} samples, {scale} pixels apart"


def upsample_layer(frame: SparseFrame, layer: Layer, radius: int) -> FilterOutput:
    """Return a layer at every pixel; the radius counts samples."""
    return run_upsampling(
        layer.radiance,
        layer.mask,
        layer.features,
        scale=frame.scale,
        place=frame.place,
        radius=radius,
        albedo=layer.albedo,
        weights=layer.weights,
        name=layer.name,
    )


def join_sparse(
    frame: SparseFrame,
    layers: Sequence[Layer],
    outputs: Sequence[FilterOutput],
    variances: Sequence[FloatArray] = (),
) -> JoinedLayers:
    """Return the sum of a sparse frame's layers over pixel areas, and of the light that the frame knows exactly.

    Parameters
    ----------
    frame : SparseFrame
    layers, outputs : sequences of equal length
        Those that lobes scattered come first.
    variances
        See `lobewise.filters.history.joining.join_layers`.
    """
    # Emission and background are compared by place alone, so their support says nothing about lobes.
    lobes = [layer for layer in layers if layer.name not in UNSCATTERED]
    images = list(outputs)
    if knows_areas(frame.radiance, frame.gbuffer):
        images[: len(AREAS)] = composite_areas(frame, outputs[: len(AREAS)])
    # Nothing is scattered where nothing reflects.
    is_black_beside = frame.radiance.parts is not None and not any(layer.name == "background" for layer in layers)
    joined = join_layers(
        images,
        [(layer.mask, layer.albedo) for layer in lobes],
        variances=variances,
        exact=frame.gbuffer.mean_emission if knows_exact_light(frame) else None,
        is_black_beside=is_black_beside,
        names=[layer.name for layer in lobes],
    )
    return replace(joined, holes=mark_unmatched(frame.gbuffer, joined.weight_sum, joined.holes))


MAX_MIXED_LENGTH = 0.9
"""Length of a mean normal below which a pixel shows several surfaces."""
MIN_MATCHED = 1.0
"""Weight sum from which on samples match a pixel of several surfaces: that of one sample of the same surface."""


def mark_unmatched(guides: GBuffer, weight_sum: FloatArray, holes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the holes of a sparse frame, and the pixels that must be filled like them.

    The guides of other renderers are means over a pixel. At silhouettes they are those of no surface: light that was
    divided by the dark albedo of a metal would be multiplied by the mean of it and of what is behind, as white dots.
    """
    if guides.denoiser_normal is None:
        return holes
    images = {"holes": holes, "mean_normal": guides.denoiser_normal, "weight": weight_sum}
    text = "pixels of several surfaces that no sample matches"
    (marked,) = engine.pixels(
        define_unmatched, images, {}, MAX_MIXED_LENGTH, MIN_MATCHED, names=["unmatched"], text=text
    )
    return marked


def knows_areas(radiance: Radiance, guides: GBuffer) -> bool:
    """Return whether it is known which surfaces share a pixel: coverage, mean albedos, and light split by lobe."""
    needed = (guides.coverage, *(getattr(guides, name) for pair in AREAS.values() for name in pair))
    return radiance.parts is not None and all(image is not None for image in needed)


AREAS = {
    "diffuse": ("diffuse_albedo", "mean_diffuse_albedo"),
    "specular": ("specular_albedo", "mean_specular_albedo"),
}
"""Albedo at a pixel's centre, and over its area, for each layer."""
MAX_TINT = 4.0
"""Largest factor by which the radiance of a sample changes when it is divided by the albedo of its pixel's area."""


def tint_samples(frame: SparseFrame) -> SparseFrame:
    """Return a frame whose samples have the albedo of the surface at the pixel's centre; see `tint_radiance`."""
    light = tint_radiance(frame.radiance, frame.gbuffer, lambda image: engine.pick(image, frame.scale, frame.place))
    return frame if light is None else frame.with_light(*light)


def tint_radiance(
    radiance: Radiance, guides: GBuffer, pick: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, ...] | None:
    """Return the radiance of pixel areas with the albedo of the surface at each pixel's centre: color and both parts.

    Where several surfaces share a pixel, the light is its radiance over the mean albedo, and not over the albedo at the
    centre. The result is None for radiance that is not split by lobe, or whose areas are not known: it stays as it is.

    Parameters
    ----------
    radiance : Radiance
    guides : GBuffer
        Guides of the whole image.
    pick : callable
        Returns the pixels of an image, (rows, columns, channels), whose radiance is given.
    """
    if not knows_areas(radiance, guides) or radiance.parts is None:
        return None
    images = {"color": radiance.color}
    for number, (part, names) in enumerate(zip(radiance.parts, AREAS.values(), strict=True)):
        albedo, mean = (pick(guides.require(name, "compositing")) for name in names)
        images |= {f"part{number}": part, f"albedo{number}": albedo, f"mean{number}": mean}
    tinted = ["tinted", *(f"tinted_{name}" for name in AREAS)]
    return engine.pixels(
        define_tinted, images, {}, MAX_TINT, names=tinted, text="light of the surfaces at pixel centres"
    )


def composite_areas(frame: SparseFrame, outputs: Sequence[FilterOutput]) -> list[FilterOutput]:
    """Return diffuse and specular radiance of every pixel's area, from that of the surfaces at pixel centres.

    Of ``frame``, `knows_areas` is true.
    """
    guides = frame.gbuffer
    coverage = guides.require("coverage", "compositing")
    areas = []
    for output, names in zip(outputs, AREAS.values(), strict=True):
        albedo, mean = (guides.require(name, "compositing") for name in names)
        image = composite_parts(output.image, output.weight_sum, albedo, mean, coverage)
        areas.append(replace(output, image=image))
    return areas


def spread(frame: SparseFrame, bad: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the bad samples as a mask of the full size."""
    whole = np.zeros(frame.shape, dtype=bool)
    whole[frame.shaded] = bad
    return whole
