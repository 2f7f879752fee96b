"""The verb `compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lobewise.errors import InputError, LobewiseError, MissingDependencyError


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
