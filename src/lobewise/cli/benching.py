"""The verb `bench`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.common import output_option, parse_size
from lobewise.cli.terminal.help import App
from lobewise.cli.terminal.steps import Steps
from lobewise.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

bench = App(help="Measure how fast this machine is.", invoke_without_command=True)


@bench.callback()
def filters(
    context: typer.Context,
    output: Annotated[
        Path | None, output_option("--output", "-o", metavar="FILE.json", help="Write the figures as JSON as well.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Images of 512x512 pixels instead of 1920x1080.")] = False,
    device: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="See `lobewise devices`; may be repeated.", show_default="all there are"),
    ] = None,
) -> None:
    """Measure how fast this machine is: filters, upsampling, whole frames, and Open Image Denoise beside them.

    Takes about two minutes, during which nothing else should run. `interactive` measures the viewer instead.
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
    from lobewise.cli.bench.filters import FULL_SIZE, QUICK_SIZE, make_tables, measure_filters
    from lobewise.cli.bench.machine import describe_machine_in_words
    from lobewise.cli.output import print_line, print_note
    from lobewise.cli.terminal.lines import to_json
    from lobewise.cli.terminal.tables import print_table
    from lobewise.io.files import require_writable, write_text

    if output is not None:
        require_writable(output)
    with Steps() as steps:
        measured = measure_filters(
            device,
            size=QUICK_SIZE if quick else FULL_SIZE,
            progress=lambda done, total: steps.tell("runs", done, total),
        )
    for title, (header, rows) in make_tables(measured).items():
        print_table(title, [name.replace(", over", ",\nover") for name in header], rows)
    print_line(describe_machine_in_words(measured))
    for sentence in measured["skipped"]:
        print_note(f"Left out: {sentence}")
    if output is not None:
        write_text(output, to_json(measured))
        print_line(f"Wrote {output}")


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
    from lobewise.cli.bench.interactive import measure_devices
    from lobewise.cli.output import print_line
    from lobewise.cli.terminal.lines import to_json
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
    from lobewise.cli.terminal.tables import print_table
    from lobewise.interactive.views import STAGES

    header = ["", *(f"{row['method']}_{row['width']}x{row['height']}".replace("_", "\n") for row in rows)]
    lines = [[name, *(f"{1000.0 * row['seconds'][name]:.1f}" for row in rows)] for name in (*STAGES, "frame")]
    lines.append(["frames a second", *(f"{row['frames_per_second']:.1f}" for row in rows)])
    print_table(f"milliseconds, rays on {device}", header, lines)
