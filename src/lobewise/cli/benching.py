"""The verb `bench`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.common import output_option, parse_size
from lobewise.cli.terminal.help import App
from lobewise.cli.terminal.steps import Steps
from lobewise.errors import InputError, MissingDependencyError

if TYPE_CHECKING:
    from collections.abc import Sequence

bench = App(help="Measure how fast this machine is.", invoke_without_command=True)

DEFAULT_FOLDER = Path("lobewise-bench")


@bench.callback()
def filters(
    context: typer.Context,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FOLDER", help="Where page, plots and JSON go.", show_default=str(DEFAULT_FOLDER)
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small images and few rounds: about a minute.")] = False,
    device: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="See `lobewise devices`; may be repeated.", show_default="all there are"),
    ] = None,
) -> None:
    """Measure how fast this machine is: filters, upsampling, whole frames, and Open Image Denoise beside them.

    Takes up to ten minutes, during which nothing else should run. `interactive` measures the viewer instead.
    """
    if context.invoked_subcommand is not None:
        if output is not None or quick or device:
            raise InputError(
                "bench",
                expected=f"its options behind `{context.invoked_subcommand}`",
                got="some before it",
                action="move or remove them",
            )
        return
    from lobewise.bench.filters import measure_filters
    from lobewise.bench.page import make_bench_page
    from lobewise.bench.plan import FULL, QUICK
    from lobewise.bench.plots import draw_plots
    from lobewise.bench.summary import describe_machine_in_words, make_sections
    from lobewise.cli.output import print_line, print_note, print_table, to_json
    from lobewise.io.files import make_folder, open_atomic, write_text

    folder = make_folder(output or DEFAULT_FOLDER)
    with Steps() as steps:
        measured = measure_filters(
            device, extent=QUICK if quick else FULL, progress=lambda done, total: steps.tell("Measuring", done, total)
        )
    for section in make_sections(measured):
        print_table(
            section.title, [name.replace(" faster than ", "\nfaster than ") for name in section.header], section.rows
        )
    print_line(describe_machine_in_words(measured))
    for sentence in measured["skipped"]:
        print_note(f"Left out: {sentence}")
    try:
        plots = draw_plots(measured)
    except MissingDependencyError as problem:
        plots = {}
        print_note(str(problem))
    for name, png in plots.items():
        with open_atomic(folder / f"{name}.png", what="plot") as stream:
            stream.write(png)
    write_text(folder / "bench.json", to_json(measured))
    command = "lobewise bench" + " --quick" * quick + "".join(f" --device {name}" for name in device or ())
    write_text(folder / "index.html", make_bench_page(measured, plots, command))
    print_line(f"Wrote {folder / 'index.html'}: open it in a browser; figures and plots lie beside it.")


@bench.command()
def interactive(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A built-in scene or a Mitsuba XML file.")] = "showroom",
    size: Annotated[
        list[str] | None,
        typer.Option(metavar="WxH", help="Size of the images; may be repeated.", show_default="512x512, 1024x1024"),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="paths, voxel_cones or virtual_lights; may be repeated.", show_default="all"),
    ] = None,
    similarity: Annotated[
        str, typer.Option(metavar="NAME", help="none, or a similarity of `lobewise denoise`.")
    ] = "ggx",
    scale: Annotated[int, typer.Option(metavar="N", help="One of NxN pixels is shaded.")] = 4,
    frames: Annotated[int, typer.Option(metavar="N", help="Frames that are timed.")] = 24,
    device: Annotated[
        str | None,
        typer.Option(metavar="cpu|cuda", help="Where rays are traced.", show_default="both, where there is CUDA"),
    ] = None,
    output: Annotated[
        Path | None, output_option("--output", "-o", metavar="FILE.json", help="Write the figures as JSON as well.")
    ] = None,
) -> None:
    """Time every stage of the viewer while the camera moves along an orbit, one degree per frame."""
    from lobewise.bench.interactive import measure_devices
    from lobewise.cli.output import print_line, to_json
    from lobewise.interactive import InteractiveSettings
    from lobewise.io.files import require_other_files, require_writable, write_text

    if output is not None:
        require_writable(output)
        require_other_files([output], [scene])
    options: dict[str, Any] = {"similarity": similarity, "scale": scale}
    with Steps() as steps:
        measured = measure_devices(
            [device] if device else None,
            scene=scene,
            sizes=[parse_size(text) for text in size or ("512x512", "1024x1024")],
            methods=method,
            settings=InteractiveSettings(**options),
            frames=frames,
            progress=lambda done, total: steps.tell("frames", done, total),
        )
    for name, rows in measured["devices"].items():
        _print_stages(name, rows)
    if output is not None:
        write_text(output, to_json(measured))
        print_line(f"Wrote {output}")


def _print_stages(device: str, rows: Sequence[dict[str, Any]]) -> None:
    from lobewise.cli.output import print_table
    from lobewise.interactive.frames import STAGES

    header = ["", *(f"{row['method']}_{row['width']}x{row['height']}".replace("_", "\n") for row in rows)]
    lines = [[name, *(f"{1000.0 * row['seconds'][name]:.1f}" for row in rows)] for name in (*STAGES, "frame")]
    lines.append(["frames a second", *(f"{row['frames_per_second']:.1f}" for row in rows)])
    print_table(f"milliseconds, rays on {device}", header, lines)
