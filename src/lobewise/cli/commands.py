"""The verbs. Each imports what it needs when it runs, so that the help appears at once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.benching import bench
from lobewise.cli.comparing import compare
from lobewise.cli.diagnosing import doctor
from lobewise.cli.exporting import export
from lobewise.cli.filtering import denoise, upsample
from lobewise.cli.fitting import fit
from lobewise.cli.options.common import Input, output_option
from lobewise.cli.options.reading import PassReading
from lobewise.cli.options.spreading import with_groups, with_settings
from lobewise.cli.rendering import render
from lobewise.cli.terminal.help import EXAMPLES, EXIT_USER_ERROR, FILTER_DETAILS, make_app
from lobewise.cli.terminal.steps import Steps
from lobewise.cli.viewing import view
from lobewise.errors import LobewiseError
from lobewise.settings import DenoiseSettings

if TYPE_CHECKING:
    from lobewise.guides.usable import CheckedGuides
    from lobewise.interchange import Imported
    from lobewise.io import FileDescription
    from lobewise.records.frame import Frame

app = make_app()


@app.command(epilog=EXAMPLES["demo"])
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="The folder of the page.")] = Path(
        "lobewise-demo"
    ),
    everything: Annotated[
        bool, typer.Option("--all", help="Show the usual filters and every kind of lobe filter as well.")
    ] = False,
    live: Annotated[bool, typer.Option("--live", help="Render the frame first, instead of the one inside.")] = False,
    scene: Annotated[str, typer.Option(metavar="SCENE", help="With --live: the scene to render.")] = "showroom",
    spp: Annotated[int, typer.Option(metavar="N", min=1, help="With --live: samples per pixel.")] = 4,
    reference_spp: Annotated[
        int, typer.Option(metavar="N", min=1, help="With --live: samples of the reference.")
    ] = 1024,
    size: Annotated[int, typer.Option(metavar="N", min=1, help="With --live: pixels per side.")] = 512,
    device: Annotated[
        str, typer.Option(metavar="auto|NAME", help="Device of the filters; see `lobewise devices`.")
    ] = "auto",
) -> None:
    """Denoise a small noisy frame, and write a page that compares it with Open Image Denoise and a reference."""
    from lobewise.cli.demo import make_demo
    from lobewise.cli.output import print_line

    with Steps() as steps:
        page = make_demo(
            output,
            everything=everything,
            live=live,
            scene=scene,
            spp=spp,
            reference_spp=reference_spp,
            size=size,
            device=device,
            tell=print_line,
            progress=steps.tell,
        )
    print_line(f"Wrote {page}: open it in a browser.")


for verb in (render, view, denoise, upsample, fit, compare):
    app.command(epilog=EXAMPLES[verb.__name__])(verb)


app.add_typer(bench, name="bench")
app.add_typer(export, name="export")


@app.command(epilog=EXAMPLES["inspect"])
@with_settings(
    DenoiseSettings,
    *("quality", "with_oidn", "similarity", "form", "radius"),
    only_given=True,
    group=FILTER_DETAILS,
)
@with_groups
def inspect(
    source: Input,
    *,
    settings: dict[str, Any],
    everything: Annotated[
        bool, typer.Option("--all", help="Show every channel, what each is read as, and how it is converted.")
    ] = False,
    attributes: Annotated[
        bool, typer.Option("--attributes", "-a", help="Show every channel and the attributes as well.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
    page: Annotated[
        Path | None,
        output_option("--html", metavar="FILE", help="Write a page with a picture of every image in the file."),
    ] = None,
    plan: Annotated[
        bool,
        typer.Option(
            "--plan", help="Print which steps denoising will run, with kernels, memory and time; filters nothing."
        ),
    ] = False,
    reading: PassReading,
) -> None:
    """Print which renderer wrote an EXR file, what denoising will use, and how to switch on what is missing.

    The exit code is 2 if `denoise` refuses the file.
    """
    from dataclasses import asdict

    from lobewise.cli.terminal.lines import to_json
    from lobewise.cli.terminal.summary import print_summary
    from lobewise.cli.terminal.tables import print_description
    from lobewise.interchange.describing import inspect_file
    from lobewise.io.files import require_other_files, require_writable

    if plan:
        print_plan(source, reading, settings)
        return
    if page is not None:
        require_writable(page)
        require_other_files([page], [source])
    description, imported = inspect_file(
        source, **reading.parse(), half=reading.half, also=reading.also or (), all_layers=reading.all_layers
    )
    if page is not None:
        write_contents(page, source, description, reading)
    description, method = add_method(description, source, reading, imported)
    if as_json:
        typer.echo(to_json({**asdict(description), "method": method}), nl=False)
    else:
        print_summary(description, method, reading.list_words())
        if everything or attributes:
            print_description(description, with_attributes=attributes)
    if not description.can_be_denoised:
        raise typer.Exit(EXIT_USER_ERROR)


def write_contents(page: Path, source: Path, description: FileDescription, reading: PassReading) -> None:
    """Write the page of a file's images."""
    from lobewise.cli.output import print_note
    from lobewise.interchange import import_file
    from lobewise.io.files import write_text
    from lobewise.reporting.contents import make_contents_page

    frame = import_file(source, **reading.parse(), half=reading.half, also=reading.also or (), light_passes=True).frame
    write_text(page, make_contents_page(description, frame))
    print_note(f"Wrote {page}.")


def add_method(
    description: FileDescription, source: Path, reading: PassReading, imported: Imported | None
) -> tuple[FileDescription, str]:
    """Return the description of a file with the notes or the refusal of `foretell_file`, and the method that it tells.

    The method is empty for a file that `denoise` refuses.
    """
    from dataclasses import replace

    if not description.can_be_denoised:
        return description, ""
    try:
        method, notes = foretell_file(source, reading, imported)
    except LobewiseError as problem:
        refusal = f"Denoising will refuse this file: {problem}"
        return replace(description, notes=(*description.notes, refusal), refusals=(refusal,)), ""
    return replace(description, notes=(*description.notes, *notes)), method


def foretell_file(source: Path, reading: PassReading, imported: Imported | None) -> tuple[str, tuple[str, ...]]:
    """Return how `denoise` without options for its filters will make the image of a file, and notes on its guides.

    ``imported`` is the file if it was read already.
    """
    from lobewise.denoising.bad_pixels import require_usable
    from lobewise.denoising.plan import foretell_method
    from lobewise.recipes.files.denoiser import check_import

    settings, height = DenoiseSettings(), None
    if imported is not None:
        checked = check_import(imported, settings)
    else:
        checked, height = read_planned(source, reading, {})
    if height is None:
        require_usable(checked.frame)
    return foretell_method(checked.frame, settings, whole=height is None), checked.notes


def read_planned(
    source: Path, reading: PassReading, settings: dict[str, Any]
) -> tuple[CheckedGuides[Frame], int | None]:
    """Return the checked frame of a file, or of a file that is denoised in bands its first row and its height."""
    from lobewise.guides.usable import CheckedGuides
    from lobewise.interchange import import_file
    from lobewise.recipes.files.denoiser import check_import, choose_bands, refuse_results
    from lobewise.recipes.streaming.checks import open_bands

    request = reading.make_request(settings=DenoiseSettings(**settings))
    if choose_bands(source, request):
        reader = open_bands(source)
        return CheckedGuides(reader.read_frame(0, 1)), reader.shape[0]
    imported = import_file(source, **reading.parse(), half=reading.half, also=reading.also or (), light_passes=True)
    refuse_results(source, imported.findings)
    return check_import(imported, request.settings), None


def print_plan(source: Path, reading: PassReading, settings: dict[str, Any]) -> None:
    """Print the plan by which `denoise` would filter a file."""
    from lobewise.denoising.plan import foretell
    from lobewise.recipes.files.foretelling import foretell_reading
    from lobewise.work.limits import GIB

    checked, height = read_planned(source, reading, settings)
    for line in foretell(checked.frame, DenoiseSettings(**settings), height=height):
        typer.echo(line)
    if height is None:
        beside = 2.0 * foretell_reading(source)[0] / GIB
        typer.echo(
            f"In a sequence: about {beside:.2g} GiB more, as the frame after is read and the frame before is written "
            "meanwhile. Where less is there, this waits."
        )


@app.command()
def devices() -> None:
    """List the devices of this machine, and why filters cannot run on one."""
    from lobewise.backend.devices import list_devices
    from lobewise.cli.terminal.tables import print_devices

    print_devices([(device.name, device.available, device.reason) for device in list_devices()])


app.command(epilog=EXAMPLES["doctor"])(doctor)
