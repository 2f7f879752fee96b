"""The verbs `denoise` and `upsample`, for single files and for sequences."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.bounding import Bands, Bounds
from lobewise.cli.options.common import OverTime, Source, Telling, parse_place, require_device
from lobewise.cli.options.farming import Farm
from lobewise.cli.options.frames import Frames, choose_numbers
from lobewise.cli.options.naming import (
    Sources,
    Target,
    Tev,
    Turn,
    open_streams,
    pair_files,
    prepare_tev,
    require_files,
    require_inputs,
    run_each,
)
from lobewise.cli.options.reading import PassReading
from lobewise.cli.options.shading import Reshading
from lobewise.cli.options.spreading import with_groups, with_settings
from lobewise.cli.options.windows import Window
from lobewise.cli.options.writing import Output, Overwrite, Picture, Writing, protect_inputs
from lobewise.cli.running import Job, run_files
from lobewise.cli.terminal.help import FILTER_DETAILS
from lobewise.cli.terminal.outcome import make_remarks
from lobewise.settings import DenoiseSettings, TemporalSettings

if TYPE_CHECKING:
    from lobewise.recipes.files.running import Request

OPTIONS = {
    "mapping": "--map",
    "wraps": "--wrap",
    "light_groups": "--no-light-groups",
    "past_only": "--temporal",
    "shading": "--adaptive",
}
"""Options by the fields of a request, where they have other names."""


@with_settings(
    DenoiseSettings,
    *("quality", "with_oidn", "similarity", "form", "radius", "beta", "lobes", "device"),
    group=FILTER_DETAILS,
    usual=("quality", "with_oidn"),
)
@with_groups
def denoise(
    sources: Sources,
    output: Target = None,
    *,
    settings: dict[str, Any],
    material: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE.lobes",
            help="With sg_mixture: the lobes of material 1 (again for 2, ...) of channel material.I.",
            show_default="those in the file",
            rich_help_panel=FILTER_DETAILS,
        ),
    ] = None,
    reshading: Reshading,
    frames: Frames = None,
    window: Window,
    farm: Farm,
    bounds: Bounds,
    bands: Bands = "auto",
    reading: PassReading,
    writing: Writing,
    overwrite: Overwrite = False,
    picture: Picture,
    tev: Tev = False,
    telling: Telling,
) -> None:
    """Denoise EXR files of any renderer, or a sequence of them; other parts, channels and attributes are kept."""
    from lobewise.recipes.files import FileRequest

    request = FileRequest(
        settings=DenoiseSettings(**settings),
        shading=reshading.make_shading(),
        bands=int(bands) if bands.isdecimal() else bands,
        materials=tuple(material or ()),
        **reading.list_fields(),
        **window.list_fields(),
        **asdict(writing),
    )
    require_device(settings["device"], is_here=farm.farm is None)
    request.check(name=lambda field: OPTIONS.get(field, f"--{field.replace('_', '-')}"))
    besides = [reading.half, reading.camera, reading.preset, reshading.scene, *(material or ())]
    picture.check()
    bounds.limit()

    def run(path: Path, target: Path, turn: Turn) -> None:
        job = Job.plan(path, target, frames, picture, telling, remarks, turn)
        run_request(job, request, repr(picture), farm, bounds)

    remarks = make_remarks()
    show = prepare_tev(tev)
    require_files(sources, output, "--tev" if tev else "--png" if picture.png else "")
    with open_streams(sources, output) as (paths, target):
        pairs, folders = pair_files(paths, target)
        reading.require_one(len(pairs))
        for path, each in pairs:
            window.require_sequence(path)
            farm.check(path)
            choose_numbers(frames, path, picture)
            protect_inputs(path, each, besides, overwrite=overwrite, png=picture.png)
        require_inputs(paths, [each for _, each in pairs] if output is not None and not folders else [])
        run_each(pairs, folders, run)
        show(pairs)


@with_settings(DenoiseSettings, "similarity", "radius", "beta", "device", group=FILTER_DETAILS, radius=5)
@with_groups
def upsample(
    source: Source,
    output: Output,
    *,
    settings: dict[str, Any],
    scale: Annotated[
        int | None, typer.Option(metavar="N", help="Distance of shaded pixels, in pixels.", show_default="the file's")
    ] = None,
    place: Annotated[
        str | None,
        typer.Option(metavar="ROW,COLUMN", help="The shaded pixel of each block.", show_default="the file's, or 0,0"),
    ] = None,
    bilinear: Annotated[bool, typer.Option("--bilinear", help="Interpolate between pixels, without guides.")] = False,
    reshading: Reshading,
    frames: Frames = None,
    over_time: OverTime,
    farm: Farm,
    bounds: Bounds,
    overwrite: Overwrite = False,
    picture: Picture,
    telling: Telling,
) -> None:
    """Bring sparsely shaded radiance to every pixel, in one file or a sequence of them; the guides are kept."""
    from lobewise.io.files import require_exr_name
    from lobewise.recipes.files.upsampler import UpsampleRequest
    from lobewise.records.sparse_frame import require_place

    where = None if place is None else parse_place(place)
    DenoiseSettings(**settings)
    TemporalSettings(memory=over_time.memory)
    require_device(settings["device"], is_here=farm.farm is None)
    if scale is not None:
        require_place(scale, where or (0, 0))
    picture.check()
    bounds.limit()
    require_exr_name(output)
    protect_inputs(source, output, [reshading.scene], overwrite=overwrite, png=picture.png)
    request = UpsampleRequest(
        settings=settings,
        scale=scale,
        place=where,
        bilinear=bilinear,
        memory=over_time.memory if over_time.temporal else None,
        shading=reshading.make_shading(),
    )
    job = Job.plan(source, output, frames, picture, telling)
    over_time.require_sequence(source)
    farm.check(source)
    run_request(job, request, repr(picture), farm, bounds)


def run_request(job: Job, request: Request, context: str, farm: Farm, bounds: Bounds) -> None:
    """Filter one file, or every file of a pattern, here or on a farm, and print what was done.

    ``context`` is what the outputs depend on beside the files and the request.

    Raises LobewiseError if a frame could not be filtered.
    """
    from lobewise.io.files import require_exr_name
    from lobewise.io.sequence import is_pattern

    require_exr_name(job.output)
    with bounds.limit():
        if is_pattern(job.source):
            job.expose(request, context)
        if farm.is_wanted:
            from lobewise.cli.farming import run_on_farm

            run_on_farm(job, request, context, farm)
        else:
            run_files(job, request, context)
