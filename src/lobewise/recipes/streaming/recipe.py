"""The recipe of `denoise_file`: measure the whole frame, then filter it band by band, to the same bits."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import share_memory
from lobewise.denoising.also import refine_parts
from lobewise.denoising.automatic import (
    ask,
    change_settings,
    explain_ours,
    judge_noise,
    list_relative_variances,
    needs_spp,
    resolve_all,
)
from lobewise.denoising.bad_pixels import (
    blacken_bad,
    compute_mean_color,
    describe_bad,
    mark_bad_pixels,
    require_some_good,
    sum_colors,
)
from lobewise.denoising.chain import Filtered, compute_gains, filter_rows
from lobewise.denoising.combining import describe_method
from lobewise.denoising.inputs import describe_lacks, list_images, list_unused
from lobewise.denoising.light_loss import (
    MIN_SHARE_BOUNDED,
    Loss,
    RowSums,
    compute_loss,
    compute_share_missing,
    describe_loss,
    sum_light,
)
from lobewise.denoising.noisy import make_bounded_layers, measure_layer
from lobewise.denoising.recipe import scale_unscattered
from lobewise.denoising.refining.totals import compute_rest
from lobewise.denoising.refining.unguided import LEFT_OUT, MIN_SHARE, compute_salt_share, count_isolated, judge_guides
from lobewise.denoising.refining.whole_image import WholeImage, join_measured, measure_rows
from lobewise.errors import InputError
from lobewise.filters.fireflies import FIREFLY_REACH, compute_energy_lost
from lobewise.filters.noise_guides import compute_mean_light
from lobewise.guides.negative import describe_bright, split_negative, sum_below
from lobewise.guides.stand_ins import stand_in_surfaces
from lobewise.guides.survey import GuideSurvey
from lobewise.guides.usable import Unusable, bound_guides, join_unusable, list_unusable
from lobewise.io.exr.bands import BandReader, BandWriter
from lobewise.io.files import PathLike, open_spool, require_writable
from lobewise.recipes.streaming.checks import describe_file, open_bands, require_bands, survey_guides
from lobewise.recipes.streaming.finishing import Finisher, finish_bands, finish_parts
from lobewise.recipes.streaming.kept import KeptBands
from lobewise.recipes.streaming.plan import (
    CHECKED_REACH,
    MEASURED_ROWS,
    Bands,
    choose_rows,
    compute_band_reach,
    cut_bands,
    forgets,
    list_measured,
    widen_band,
)
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.lobe_table import LobeTable
from lobewise.records.result import Described
from lobewise.settings import DenoiseChanges, DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import get_quality
from lobewise.work.progress import FILTER, WRITE, Watcher, enter_stage, plan_stages, raise_cost, watched

if TYPE_CHECKING:
    from typing_extensions import Unpack

MEASURE = "measuring"
COSTS = {MEASURE: 0.0, FILTER: 3.0, WRITE: 0.5}
"""The stages of a file in bands, and their time over that of measuring it, which not all settings need."""


@dataclass(frozen=True)
class DenoisedFile(Described):
    """The report of `denoise_file`.

    Parameters
    ----------
    shape : (int, int)
        (height, width).
    bands : int
        Number of bands.
    bad_pixel_count, energy_lost, settings, seconds, notes, unused, method
        As in `lobewise.Result`.
    """

    shape: tuple[int, int]
    bands: int
    bad_pixel_count: int
    energy_lost: float
    settings: dict[str, Any]
    seconds: float
    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    method: str = ""


@watched
def denoise_file(
    source: PathLike,
    output: PathLike,
    settings: DenoiseSettings | None = None,
    *,
    lobe_tables: Sequence[LobeTable] | None = None,
    rows: int | None = None,
    memory: float | None = None,
    progress: Watcher | None = None,
    **changes: Unpack[DenoiseChanges],
) -> DenoisedFile:
    """Denoise an EXR file of any size in bounded memory.

    The file that comes out is that of ``write_result(output, denoise(read_frame(source), ...), source=source)``, to the
    byte, with ``with_oidn=False``: Open Image Denoise takes whole images, so that "auto" is "high" here. Light groups,
    passes of shadow catchers and opacity stay noisy, with a note. Where guides are noise, "high" mixes in an image
    filtered by its color alone, and bands leave this out, with a note.
    The file appears whole or not at all, whatever interrupts this.

    Parameters
    ----------
    source, output : path
        The file to read; the one to write, which may be the same.
    settings, **changes
        As in `lobewise.denoise`; Open Image Denoise cannot be asked for.
    lobe_tables : sequence of LobeTable, optional
        As in `lobewise.read_frame`.
    rows : int, optional
        Rows of a band, >= 1; by default as many as fit ``memory``.
    memory : float, optional
        GiB that a band may take, > 0; by default `DEFAULT_MEMORY`, or less inside `lobewise.limit_call`. With large
        kernels the rows around a band alone may take more: the band then has `MIN_ROWS` rows.
    progress : callable, optional
        As of `lobewise.denoise`. The stages are "measuring", where something hangs on the whole frame, "filtering" and
        "writing".

    Returns
    -------
    DenoisedFile

    Raises
    ------
    InputError, MissingChannelError, DeviceError
        As `lobewise.denoise`, or if ``rows`` or ``memory`` is out of range, or the file must be read as a whole
        (`docs/streaming.md`).
    FileError
        As `lobewise.read_frame` and `lobewise.write_result`, or if the file has subsampled channels.
    LimitError
        Inside `lobewise.limit_call`, also if a band of the smallest height would take more memory.
    CancelledError
        If ``progress`` has returned False.
    """
    start = time.perf_counter()
    named = change_settings(settings or DenoiseSettings(), changes)
    with_quality = ask(named, {}, whole=False)
    require_bands(source, with_quality, rows, memory)
    require_writable(output)
    reader = open_bands(source, lobe_tables, list_images(with_quality)).reopen(list_images(with_quality))
    height, _ = reader.shape
    with open_spool(output) as spool, open_spool(output) as waiting, plan_stages(COSTS), share_memory():
        guided = get_quality(with_quality.quality).reads_halves
        # Only the recipes that take the noisy image back change light that no surface scattered.
        scattered = {"color", *reader.layers}
        written = [name for name in reader.outputs if guided or name.partition("/")[0] in scattered]
        writer = BandWriter(reader, written, spool)
        # "auto" depends on which channels exist, not on their values, apart from the noise, which is measured.
        survey = survey_guides(reader.reopen(list_images(with_quality)))
        probe = survey.apply(reader.read_frame(0, 1))
        chosen = resolve_all(probe, with_quality, spp=1.0)
        most = choose_rows(reader, chosen, rows, memory)
        bands = cut_bands(height, most)

        @cache
        def measure() -> _Measured:
            with engine.on(chosen.device):
                again = reader.reopen(list_measured(with_quality))
                return _measure(again, survey, chosen, cut_bands(height, min(most, MEASURED_ROWS)))

        judges = not guided and needs_spp(with_quality)
        raise_cost(MEASURE, float(guided or (judges and ("variance", "color") in reader.images)))
        if judges:
            variances = measure().variances if ("variance", "color") in reader.images else np.empty(0)
            chosen = resolve_all(probe, with_quality, spp=judge_noise(variances, probe.spp))
        below = resolve_all(replace(probe, variance=None), replace(with_quality, quality="fast", with_oidn=False))
        whole = measure().whole if guided else None
        share_bounded = compute_energy_lost(measure().tallies) if guided else 0.0
        seen = _Seen(survey, share_bounded >= MIN_SHARE_BOUNDED)
        held = KeptBands(waiting)
        bad_count = _filter(reader, held, _Settings(chosen, below), whole, bands, seen)
        with engine.on(chosen.device):
            losses = seen.compute_losses()
            finish_bands(reader, held, writer, Finisher(lambda: measure().mean_color), [loss.gain for loss in losses])
        writer.finish(output, asdict(chosen))
    lacks = (*describe_lacks(probe, named), *describe_bad(bad_count, height * reader.shape[1]))
    return DenoisedFile(
        shape=reader.shape,
        bands=len(bands),
        bad_pixel_count=bad_count,
        energy_lost=compute_share_missing(losses),
        settings=asdict(chosen),
        seconds=time.perf_counter() - start,
        notes=seen.list_notes(reader, share_bounded, (*lacks, *(measure().notes if guided else ()))),
        unused=list_unused(survey.apply(reader.reopen().read_frame(0, 1)), chosen),
        method=describe_method(chosen, ("normal",), why_ours=explain_ours(named, whole=False)),
    )


class _Settings(NamedTuple):
    """Settings of a frame, and of its light below 0."""

    above: ResolvedSettings
    below: ResolvedSettings


@dataclass(frozen=True)
class _Measured:
    """Measurements of the whole frame; the quality "fast" makes them only where a setting needs them."""

    whole: WholeImage
    tallies: tuple[RowSums, ...]
    variances: RowSums
    mean_color: FloatArray
    notes: tuple[str, ...]


@dataclass
class _Seen:
    """Sums and findings of the bands, collected for the notes at the end."""

    survey: GuideSurvey
    """What the guides of the whole frame are worth."""
    measures_light: bool
    """Whether bounding took so much from fireflies that the light before and after is compared."""
    light: list[RowSums] = field(default_factory=list)
    below: list[NDArray[np.float64]] = field(default_factory=list)
    """Result of `sum_below` for each band."""
    missing: list[list[RowSums]] = field(default_factory=list)
    """Results of `sum_missing` for the layers of each band."""
    unusable: list[Unusable] = field(default_factory=list)

    def list_notes(self, reader: BandReader, share_bounded: float, lacks: Iterable[str]) -> tuple[str, ...]:
        """Return the notes on the whole frame, one sentence each."""
        light = np.concatenate(self.light) if self.light else np.zeros((0, 3))
        return (
            *describe_file(reader),
            *self.survey.list_idle(),
            *self.survey.list_notes(),
            *map(str, join_unusable(self.unusable)),
            *lacks,
            *describe_loss(light, share_bounded),
            *describe_bright(self.below),
        )

    def compute_losses(self) -> list[Loss]:
        """Return the light of every layer; empty with the quality "fast"."""
        rows = [np.concatenate(blocks) for blocks in zip(*self.missing, strict=True)]
        return [compute_loss(blocks) for blocks in rows]


def _measure(reader: BandReader, survey: GuideSurvey, settings: ResolvedSettings, bands: Bands) -> _Measured:
    """Read a frame once and sum it row by row, to the same bits as of the whole frame."""
    height, width = reader.shape
    guided = get_quality(settings.quality).reads_halves
    lights: list[list[RowSums]] = []
    tallies: list[list[RowSums]] = []
    colors: list[RowSums] = []
    rows: list[RowSums] = []
    variances: list[RowSums] = []
    isolated: list[RowSums] = []
    salt = bad_count = 0
    for number, band in enumerate(bands):
        enter_stage(MEASURE, (band[0] / height, band[1] / height))
        top, bottom = widen_band(band, CHECKED_REACH + (FIREFLY_REACH if guided else 0), height)
        bounded = bound_guides(survey.apply(reader.read_frame(top, bottom)))
        frame, _ = split_negative(stand_in_surfaces(bounded)[0])
        core = slice(band[0] - top, band[1] - top)
        bad_count += int(np.count_nonzero(mark_bad_pixels(frame)[core]))
        colors.append(sum_colors(frame.radiance.color)[core])
        if guided:
            layers = make_bounded_layers(frame, settings)
            lights.append([measure_layer(layer)[core] for layer in layers])
            tallies.append([layer.bounded.tally[core] for layer in layers])
            rows.append(measure_rows(frame)[core])
            if get_quality(settings.quality).refines:
                color, blur, rest = frame.radiance.color, frame.gbuffer.blur_radius, compute_rest(frame)
                isolated.append(count_isolated(color, bounded.gbuffer)[core])
                if rest is not None and blur is not None:
                    salt += int(np.count_nonzero(compute_salt_share(rest, color, blur) >= MIN_SHARE))
        elif frame.variance is not None:
            variances.append(list_relative_variances(reader.read_frame(*band)))
        if number + 1 < len(bands):
            reader.forget(widen_band(bands[number + 1], CHECKED_REACH + FIREFLY_REACH, height)[0])
    require_some_good(bad_count, height * width, "pixel")
    levels = tuple(compute_mean_light(np.concatenate(light)) for light in zip(*lights, strict=True))
    return _Measured(
        join_measured(levels, np.concatenate(rows) if rows else np.zeros((0, 4)), reader.camera, height),
        tuple(np.concatenate(tally) for tally in zip(*tallies, strict=True)),
        np.concatenate(variances) if variances else np.empty(0),
        compute_mean_color(np.concatenate(colors)),
        (LEFT_OUT,) if salt or (isolated and judge_guides(np.concatenate(isolated)) >= MIN_SHARE) else (),
    )


def _filter(
    reader: BandReader,
    held: KeptBands,
    settings: _Settings,
    whole: WholeImage | None,
    bands: Bands,
    seen: _Seen,
) -> int:
    """Filter and keep band after band; return the number of bad pixels. ``seen`` collects the notes."""
    height, width = reader.shape
    reach, bad_count = compute_band_reach(settings.above), 0
    for number, band in enumerate(bands):
        enter_stage(FILTER, (band[0] / height, band[1] / height))
        top, bottom = widen_band(band, reach, height)
        core = slice(band[0] - top, band[1] - top)
        images, bad = _filter_band(reader, settings, whole, (top, bottom), core, seen)
        held.add(images)
        bad_count += bad
        del images
        if number + 1 < len(bands):
            reader.forget(widen_band(bands[number + 1], reach, height)[0])
    require_some_good(bad_count, height * width, "pixel")
    return bad_count


def _filter_band(
    reader: BandReader,
    settings: _Settings,
    whole: WholeImage | None,
    rows: tuple[int, int],
    core: slice,
    seen: _Seen,
) -> tuple[dict[str, NDArray[Any]], int]:
    """Return the images of the rows of ``core`` by their fields, and the number of bad pixels.

    Beside the fields there are ``holes``, the pixels without a value, and for each layer ``mask0`` and so on, the
    pixels that take part in sharing. "below color" and so on is the filtered light below 0 of a field.
    """
    frame = seen.survey.apply(reader.read_frame(*rows))
    seen.unusable += list_unusable(frame, core)
    frame, _ = stand_in_surfaces(bound_guides(frame))
    frame, below = split_negative(frame)
    if get_quality(settings.above.quality).reads_halves:
        seen.below.append(sum_below(below, frame, core))
    if forgets(settings.above):
        reader.forget(reader.shape[0])
    bad = mark_bad_pixels(frame)
    with engine.on(settings.above.device):
        band_result = filter_rows(frame, settings.above, (), bad, whole=whole)
        _, holes = band_result.mark_holes()
    seen.missing.append(band_result.sum_missing(core))
    if seen.measures_light:
        seen.light.append(sum_light(frame, band_result.image, bad, core))
    images: dict[str, NDArray[Any]] = {"holes": holes[core], **_name_fields(reader, band_result, core)}
    with engine.on(settings.above.device):
        images |= _refine_parts(reader, frame, band_result, core)
    nothing = {f"below {field}": np.zeros_like(images[field]) for field in images if field != "holes"}
    if below is None:
        images |= nothing
    else:
        with engine.on(settings.below.device):
            filtered = filter_rows(below, settings.below, (), mark_bad_pixels(below))
            refined = _refine_parts(reader, below, filtered, core)
        fields = _name_fields(reader, filtered, core)
        fields |= finish_parts(reader.layers, {**fields, **refined})
        images |= {f"below {field}": image for field, image in fields.items()}
    images |= {f"mask{number}": mask[core] for number, mask in enumerate(band_result.shared_masks)}
    scaled = scale_unscattered(frame, band_result, compute_gains(band_result))
    images |= {name: light[core] for name, light in scaled.items()}
    return images, int(np.count_nonzero(bad[core]))


def _refine_parts(reader: BandReader, frame: Frame, filtered: Filtered, core: slice) -> dict[str, FloatArray]:
    """Return the rows of ``core`` of the parts of layers, which are not brought to the results of their layers yet."""
    images: dict[str, FloatArray] = {}
    for layer in frame.layers:
        others = filtered.others[layer.name] if layer.parts else ()
        if len(others) > len(layer.parts):
            raise InputError(
                f"input {str(reader.container.path)!r}",
                expected="passes that add up to their layer",
                got=f"others for {layer.name}, by light below 0",
                action="denoise it as a whole (--bands off)",
            )
        if others:
            refined = refine_parts(others, filtered.look_up_passed(layer.name))
            images |= {f"{layer.name}/{part}": each[core] for part, each in zip(layer.parts, refined, strict=True)}
    return images


def _name_fields(reader: BandReader, filtered: Filtered, core: slice) -> dict[str, FloatArray]:
    """Return the rows of ``core`` of the filtered images by their fields."""
    parts = zip(reader.layers, filtered.parts, strict=True) if reader.layers else ()
    return {"color": filtered.image[core], **{name: blacken_bad(part[core]) for name, part in parts}}
