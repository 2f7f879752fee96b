"""The verb `bench`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.shared import parse_size, show_progress

if TYPE_CHECKING:
    from collections.abc import Sequence

bench = typer.Typer(help="Measure how fast this machine is.", no_args_is_help=True)


@bench.callback()
def root() -> None:
    """Measure how fast this machine is."""


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
        str, typer.Option(metavar="NAME", help="What is compared; none, or as for `lobewise denoise`.")
    ] = "ggx",
    scale: Annotated[int, typer.Option(metavar="N", help="One of NxN pixels is shaded.")] = 4,
    frames: Annotated[int, typer.Option(metavar="N", help="Frames that are counted.")] = 24,
    device: Annotated[
        str | None,
        typer.Option(metavar="cpu|cuda", help="Where rays are traced.", show_default="both, where there is CUDA"),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.json", help="Write the figures there as well.")
    ] = None,
) -> None:
    """Time every stage of the interactive chain while the camera goes round an orbit, one degree a frame."""
    from lobewise.bench.interactive import measure_devices
    from lobewise.cli.output import print_line, to_json
    from lobewise.io.files import require_writable, write_text
    from lobewise.render import InteractiveSettings

    if output is not None:
        require_writable(output)
    with show_progress() as progress:
        found = measure_devices(
            [device] if device else None,
            scene=scene,
            sizes=[parse_size(text) for text in size or ("512x512", "1024x1024")],
            methods=method,
            settings=InteractiveSettings(similarity=similarity, scale=scale),
            frames=frames,
            progress=lambda done, total: progress("frames", done, total),
        )
    for name, rows in found["devices"].items():
        _print_stages(name, rows)
    if output is not None:
        write_text(output, to_json(found))
        print_line(f"Wrote {output}")


def _print_stages(device: str, rows: Sequence[dict[str, Any]]) -> None:
    from lobewise.cli.output import print_table
    from lobewise.render.interactive_frame import STAGES

    header = ["", *(f"{row['method']}_{row['width']}x{row['height']}".replace("_", "\n") for row in rows)]
    lines = [[name, *(f"{1000.0 * row['seconds'][name]:.1f}" for row in rows)] for name in (*STAGES, "frame")]
    lines.append(["frames a second", *(f"{row['frames_per_second']:.1f}" for row in rows)])
    print_table(f"milliseconds, rays on {device}", header, lines)
