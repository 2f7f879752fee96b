"""The verbs. Each imports what it needs when it runs, so that the help appears at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

import lobewise
from lobewise.cli.fitting import fit
from lobewise.errors import InputError, LobewiseError, MissingDependencyError, describe_problem

app = typer.Typer(
    name="lobewise",
    help="Denoise renders of glossy things by comparing what each pixel reflects.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Input = Annotated[Path, typer.Argument(metavar="INPUT.exr", help="The EXR file to read.", show_default=False)]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The file to write.", show_default=False)]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"lobewise {lobewise.__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and leave.", is_eager=True, callback=_print_version),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Print a traceback when something fails.")] = False,
) -> None:
    """Denoise renders of glossy things by comparing what each pixel reflects."""


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where to put the page.")] = Path(
        "lobewise-demo"
    ),
    live: Annotated[bool, typer.Option("--live", help="Render the frame first, instead of the one inside.")] = False,
    scene: Annotated[str, typer.Option(metavar="SCENE", help="With --live: the scene to render.")] = "showroom",
    spp: Annotated[int, typer.Option(metavar="N", help="With --live: samples per pixel.")] = 4,
    reference_spp: Annotated[int, typer.Option(metavar="N", help="With --live: samples of the reference.")] = 1024,
    size: Annotated[int, typer.Option(metavar="N", help="With --live: pixels a side.")] = 512,
    device: Annotated[str, typer.Option(metavar="auto|NAME", help="Where to filter; see `lobewise devices`.")] = "auto",
) -> None:
    """Write a page that compares the filters on one noisy frame, beside its reference."""
    from lobewise.cli.output import print_line
    from lobewise.demo import make_demo

    with show_progress() as progress:
        page = make_demo(
            output,
            live=live,
            scene=scene,
            spp=spp,
            reference_spp=reference_spp,
            size=size,
            device=device,
            progress=progress,
        )
    print_line(f"Wrote {page}: open it in a browser.")


@app.command()
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

    shaded = _parse_place(place)
    require_writable(output)
    loaded = load_scene(scene, width=width, height=height)
    with show_progress() as advance:

        def progress(done: int, total: int) -> None:
            advance(f"Rendering {scene}", done, total)

        common: dict[str, Any] = {"spp": spp, "seed": seed, "max_depth": max_depth, "progress": progress}
        if scale != 1:
            sparse = render_sparse_frame(loaded, scale=scale, place=shaded, **common)
            write_sparse_frame(output, sparse, half=not exact)
            share = f"one of {scale}x{scale} pixels shaded"
            print_line(f"Wrote {output}: {sparse.width}x{sparse.height} pixels, {share}, {spp} spp.")
            return
        frame = render_reference(loaded, **common) if reference else render_frame(loaded, aov_only=aov_only, **common)
    write_frame(output, frame, half=not exact, attributes={"lobewise/scene": scene})
    print_line(f"Wrote {output}: {frame.width}x{frame.height} pixels, {spp} spp.")


@app.command()
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
            beta=_parse_beta(beta),
            lobes=lobes,
            hit_distance="auto" if hit_distance is None else hit_distance,
            device=device,
        )
    except LobewiseError as problem:
        raise type(problem)(f"{source}: {problem}") from problem
    write_result(output, result, source=source)
    print_line(f"Wrote {output}: {describe_result(result)}.")


@app.command()
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

    budget = _parse_percent(adaptive)
    if budget > 0.0 and scene is None:
        raise InputError(
            describe_problem("--adaptive", expected="--scene beside it", got="none", action="say what was rendered")
        )
    require_writable(output)
    frame = read_sparse_frame(source, scale=scale, place=None if place is None else _parse_place(place))
    try:
        result = run_upsample(
            frame, bilinear=bilinear, similarity=similarity, radius=radius, beta=_parse_beta(beta), device=device
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


app.command()(fit)


@app.command()
def compare(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE.exr...", help="The images to judge.", show_default=False)
    ],
    reference: Annotated[
        Path, typer.Option("--reference", "-r", metavar="FILE", help="The image that is right.", show_default=False)
    ],
    json_output: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures as JSON; - is standard output.")
    ] = None,
) -> None:
    """Measure how far images are from a reference: mse, rel_mse, smape, psnr and flip."""
    from lobewise.cli.output import print_comparison, print_note, to_json
    from lobewise.io import read_image
    from lobewise.io.files import require_writable, write_text
    from lobewise.metrics import EPSILON, METRICS, evaluate, flip

    to_terminal = str(json_output) == "-"
    if json_output is not None and not to_terminal:
        require_writable(json_output)
    target = read_image(reference)
    metrics = list(METRICS)
    try:
        flip(target[:1, :1] * 0, target[:1, :1] * 0)
    except MissingDependencyError as problem:
        metrics.remove("flip")
        print_note(f"{problem}")
    except LobewiseError:
        pass
    rows = []
    for path in images:
        try:
            rows.append((str(path), evaluate(read_image(path), target, metrics=metrics)))
        except InputError as problem:
            whose = reference if str(problem).startswith("reference") else path
            raise type(problem)(f"{whose}: {problem}") from None
    text = to_json(
        {
            "reference": str(reference),
            "epsilon": EPSILON,
            "images": [{"path": path, **figures} for path, figures in rows],
        }
    )
    if to_terminal:
        typer.echo(text, nl=False)
        return
    if json_output is not None:
        write_text(json_output, text)
    print_comparison(str(reference), metrics, rows)


@app.command()
def inspect(
    source: Input,
    attributes: Annotated[bool, typer.Option("--attributes", "-a", help="Show the attributes as well.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Say what an EXR file holds, what is missing, and what denoising will use."""
    from dataclasses import asdict

    from lobewise.cli.output import print_description, to_json
    from lobewise.io import describe_file

    found = describe_file(source)
    if as_json:
        typer.echo(to_json(asdict(found)), nl=False)
        return
    print_description(found, with_attributes=attributes)


@app.command()
def devices() -> None:
    """List where filters can run, and why one cannot."""
    from lobewise.cli.output import print_devices
    from lobewise.kernels.engine import list_devices

    print_devices([(device.name, device.available, device.reason) for device in list_devices()])


@contextmanager
def show_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on standard error for work that reports (what, done, total)."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    console = Console(stderr=True)
    # Without a terminal the bar would leave an empty line.
    hidden = not console.is_terminal
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True, disable=hidden) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield advance


def _parse_percent(text: str) -> float:
    """Return the share that ``5%`` or ``5`` stands for."""
    try:
        percent = float(text.removesuffix("%"))
    except ValueError:
        percent = -1.0
    if 0.0 <= percent <= 100.0:
        return percent / 100.0
    raise InputError(describe_problem("--adaptive", expected="0% to 100%", got=repr(text), action="5% is usual"))


def _parse_place(text: str) -> tuple[int, int]:
    """Return row and column of ``ROW,COLUMN``."""
    words = text.split(",")
    if len(words) == 2 and all(word.strip().isdecimal() for word in words):
        return int(words[0]), int(words[1])
    raise InputError(
        describe_problem("--place", expected="ROW,COLUMN, such as 1,2", got=repr(text), action="write two numbers")
    )


def _parse_beta(text: str) -> str | float:
    if text == "auto":
        return text
    try:
        return float(text)
    except ValueError:
        raise InputError(
            describe_problem("beta", expected="auto or a number above 0", got=repr(text), action="pass --beta auto")
        ) from None
