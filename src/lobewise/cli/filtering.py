"""The verbs `denoise` and `upsample`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lobewise.cli.shared import Input, Output, parse_beta, parse_place
from lobewise.errors import InputError, LobewiseError, describe_problem


def denoise(
    source: Input,
    output: Output,
    similarity: Annotated[
        str,
        typer.Option(
            metavar="auto|normal|sg|sg_mixture|asg|ggx",
            help="What makes two pixels similar; auto takes the best that the file allows.",
        ),
    ] = "auto",
    form: Annotated[
        str, typer.Option(metavar="full|separable|atrous", help="full is best, separable and atrous are faster.")
    ] = "full",
    radius: Annotated[int, typer.Option(metavar="N", help="Pixels from the centre to the edge of the kernel.")] = 8,
    beta: Annotated[str, typer.Option(metavar="auto|X", help="Strictness; auto follows the noise.")] = "auto",
    lobes: Annotated[int, typer.Option(metavar="1-4", help="With sg_mixture: Gaussians that stand for GGX.")] = 3,
    hit_distance: Annotated[
        bool | None,
        typer.Option(
            "--hit-distance/--no-hit-distance",
            help="With sg, asg, ggx: compare what the lobes hit, where the file has hit distances.",
            show_default="auto",
        ),
    ] = None,
    material: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE.lobes",
            help="With sg_mixture: the lobes of material 1 (again for 2, ...) of channel material.I.",
            show_default="those in the file",
        ),
    ] = None,
    device: Annotated[str, typer.Option(metavar="auto|NAME", help="Where to filter; see `lobewise devices`.")] = "auto",
) -> None:
    """Denoise an EXR file; its other parts, channels and attributes are kept."""
    from lobewise.cli.output import describe_result, print_line
    from lobewise.denoising import denoise as run_denoise
    from lobewise.io import read_frame, write_result
    from lobewise.io.files import require_writable
    from lobewise.io.materials import read_lobe_table

    require_writable(output)
    tables = [read_lobe_table(path) for path in material] if material else None
    frame = read_frame(source, lobe_tables=tables)
    try:
        result = run_denoise(
            frame,
            similarity=similarity,
            form=form,
            radius=radius,
            beta=parse_beta(beta),
            lobes=lobes,
            hit_distance="auto" if hit_distance is None else hit_distance,
            device=device,
        )
    except LobewiseError as problem:
        raise type(problem)(f"{source}: {problem}") from problem
    write_result(output, result, source=source)
    print_line(f"Wrote {output}: {describe_result(result)}.")


def upsample(
    source: Input,
    output: Output,
    scale: Annotated[
        int | None,
        typer.Option(metavar="N", help="Pixels from shaded pixel to shaded pixel.", show_default="the file's"),
    ] = None,
    place: Annotated[
        str | None,
        typer.Option(metavar="ROW,COLUMN", help="The shaded pixel of each block.", show_default="the file's, or 0,0"),
    ] = None,
    similarity: Annotated[
        str, typer.Option(metavar="auto|normal|sg|sg_mixture|asg|ggx", help="What pixel and sample must share.")
    ] = "auto",
    bilinear: Annotated[bool, typer.Option("--bilinear", help="Interpolate on the screen alone.")] = False,
    radius: Annotated[int, typer.Option(metavar="N", help="Samples from the centre to the edge of the kernel.")] = 5,
    beta: Annotated[str, typer.Option(metavar="auto|X", help="Strictness; auto follows the noise.")] = "auto",
    adaptive: Annotated[
        str, typer.Option(metavar="PERCENT", help="Shade so many pixels again, the least supported; needs --scene.")
    ] = "0%",
    scene: Annotated[
        str | None, typer.Option(metavar="SCENE", help="With --adaptive: what was rendered.", show_default=False)
    ] = None,
    adaptive_spp: Annotated[int, typer.Option(metavar="N", help="With --adaptive: samples of each pixel.")] = 64,
    device: Annotated[str, typer.Option(metavar="auto|NAME", help="Where to filter; see `lobewise devices`.")] = "auto",
) -> None:
    """Bring sparsely shaded radiance to every pixel; the guides are kept."""
    from lobewise.cli.output import describe_result, print_line
    from lobewise.frame import Frame, Radiance
    from lobewise.io import read_sparse_frame, write_frame
    from lobewise.io.files import require_writable
    from lobewise.upsampling import upsample as run_upsample

    budget = parse_percent(adaptive)
    if budget > 0.0 and scene is None:
        raise InputError(
            describe_problem("--adaptive", expected="--scene beside it", got="none", action="say what was rendered")
        )
    require_writable(output)
    frame = read_sparse_frame(source, scale=scale, place=None if place is None else parse_place(place))
    try:
        result = run_upsample(
            frame, bilinear=bilinear, similarity=similarity, radius=radius, beta=parse_beta(beta), device=device
        )
    except LobewiseError as problem:
        raise type(problem)(f"{source}: {problem}") from problem
    if budget > 0.0 and scene is not None:
        from lobewise.adaptive import recompute
        from lobewise.render import load_scene, render_pixels

        loaded = load_scene(scene, width=frame.width, height=frame.height)
        result = recompute(
            result,
            lambda rows, columns: render_pixels(loaded, rows, columns, spp=adaptive_spp, seed=1),
            samples=adaptive_spp / (frame.spp or 1),
            budget=budget,
        )
        print_line(f"Shaded {result.settings['recomputed']} pixels again, {adaptive_spp} spp.")
    radiance = Radiance(result.image, diffuse=result.diffuse, specular=result.specular)
    whole = Frame(radiance, frame.gbuffer, frame.camera, spp=frame.spp, lobe_tables=frame.lobe_tables)
    write_frame(output, whole)
    print_line(f"Wrote {output}: {describe_result(result)}.")


def parse_percent(text: str) -> float:
    """Return the share that ``5%`` or ``5`` stands for."""
    try:
        percent = float(text.removesuffix("%"))
    except ValueError:
        percent = -1.0
    if 0.0 <= percent <= 100.0:
        return percent / 100.0
    raise InputError(describe_problem("--adaptive", expected="0% to 100%", got=repr(text), action="5% is usual"))
