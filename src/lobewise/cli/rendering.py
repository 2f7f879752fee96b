"""The verb `render`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from lobewise.cli.shared import Output, parse_place, show_progress
from lobewise.errors import InputError, describe_problem


def render(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE", help="showroom, brushed, parlour, sparks, or a Mitsuba XML file.", show_default=False
        ),
    ],
    output: Output,
    spp: Annotated[int, typer.Option(metavar="N", help="Samples per pixel.")] = 4,
    width: Annotated[int | None, typer.Option(metavar="N", help="Columns; by default those of the scene.")] = None,
    height: Annotated[int | None, typer.Option(metavar="N", help="Rows; by default those of the scene.")] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="The same seed gives the same image.")] = 0,
    max_depth: Annotated[int, typer.Option(metavar="N", help="Longest path, in vertices after the camera.")] = 8,
    light: Annotated[
        str, typer.Option(metavar="all|indirect", help="indirect: only what was scattered more than once.")
    ] = "all",
    aov_only: Annotated[bool, typer.Option("--aov-only", help="Only the G-buffer; the radiance is black.")] = False,
    reference: Annotated[bool, typer.Option("--reference", help="Only the radiance, for many samples.")] = False,
    scale: Annotated[
        int, typer.Option(metavar="N", help="Shade one pixel of every NxN; guides everywhere, for upsample.")
    ] = 1,
    place: Annotated[str, typer.Option(metavar="ROW,COLUMN", help="With --scale: which pixel of the block.")] = "0,0",
    exact: Annotated[bool, typer.Option("--float", help="Store everything as 32-bit floats.")] = False,
) -> None:
    """Render a scene with Mitsuba, with all that denoising needs, in one EXR file."""
    if scale != 1 and (aov_only or reference):
        raise InputError(
            describe_problem(
                "--scale",
                expected="no --aov-only and no --reference beside it",
                got="both",
                action="leave one of them out",
            )
        )
    if aov_only and reference:
        raise InputError(
            describe_problem(
                "--aov-only", expected="no --reference beside it", got="both", action="leave one of them out"
            )
        )
    from lobewise.cli.output import print_line
    from lobewise.io import write_frame, write_sparse_frame
    from lobewise.io.files import require_writable
    from lobewise.render import load_scene, render_frame, render_reference, render_sparse_frame

    shaded = parse_place(place)
    require_writable(output)
    loaded = load_scene(scene, width=width, height=height)
    with show_progress() as advance:

        def progress(done: int, total: int) -> None:
            advance(f"Rendering {scene}", done, total)

        common: dict[str, Any] = {
            "spp": spp,
            "seed": seed,
            "max_depth": max_depth,
            "light": light,
            "progress": progress,
        }
        if scale != 1:
            sparse = render_sparse_frame(loaded, scale=scale, place=shaded, **common)
            write_sparse_frame(output, sparse, half=not exact)
            share = f"one of {scale}x{scale} pixels shaded"
            print_line(f"Wrote {output}: {sparse.width}x{sparse.height} pixels, {share}, {spp} spp.")
            return
        frame = render_reference(loaded, **common) if reference else render_frame(loaded, aov_only=aov_only, **common)
    write_frame(output, frame, half=not exact, attributes={"lobewise/scene": scene})
    print_line(f"Wrote {output}: {frame.width}x{frame.height} pixels, {spp} spp.")
