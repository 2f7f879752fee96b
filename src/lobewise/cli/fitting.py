"""The verb `fit`: a material becomes a lobe file, with a table of residuals and a plot of fit against data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.common import output_option
from lobewise.cli.terminal.children import go_on_in_child
from lobewise.errors import InputError, require_choice, require_integer
from lobewise.settings import MAX_LOBES

if TYPE_CHECKING:
    from lobewise.fitting.fit import Evaluate


def fit(
    output: Annotated[
        Path, output_option("--output", "-o", metavar="FILE.lobes", help="The file to write.", show_default=False)
    ],
    material: Annotated[
        Path | None,
        typer.Argument(metavar="MATERIAL.binary", help="A material of the MERL database.", show_default=False),
    ] = None,
    mitsuba: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE#ID",
            help="Instead: a BSDF of a Mitsuba scene, by its id or the id of a shape.",
            show_default=False,
        ),
    ] = None,
    lobes: Annotated[int, typer.Option(metavar="1-4", help="Lobes for each view.")] = 3,
    kind: Annotated[str, typer.Option(metavar="sg|asg", help="Round or anisotropic lobes.")] = "asg",
    plot: Annotated[
        Path | None,
        output_option(
            "--plot",
            metavar="FILE.png",
            help="The plot of fit against data; by default beside the output.",
            show_default=False,
        ),
    ] = None,
    no_plot: Annotated[bool, typer.Option("--no-plot", help="Draw nothing.")] = False,
) -> None:
    """Fit lobes to a measured material, or to a material of a Mitsuba scene, and print how well they fit."""
    if (material is None) == (mitsuba is None):
        raise InputError(
            "material",
            expected="either MATERIAL.binary or --mitsuba SCENE#ID",
            got="neither" if material is None else "both",
            action="name one material",
        )
    require_choice("kind", kind, ("sg", "asg"))
    require_integer("lobes", lobes, 1, MAX_LOBES)
    if mitsuba is not None:
        go_on_in_child(mitsuba.partition("#")[0], [output])
    from lobewise.io.files import require_other_files

    picture = choose_plot(output, plot, wanted=not no_plot)
    require_other_files([output, *([picture] if picture else [])], [material or str(mitsuba).partition("#")[0]])
    if material is not None:
        from lobewise.io.materials import read_merl

        brdf = read_merl(material)
        fit_material(brdf, name=brdf.name, output=output, lobes=lobes, kind=kind, plot=picture)
    elif mitsuba is not None:
        from lobewise.render import open_scene_material

        opened = open_scene_material(mitsuba)
        grid = {"cosines": opened.cosines, "azimuths": opened.azimuths}
        fit_material(opened.evaluate, name=opened.name, output=output, lobes=lobes, kind=kind, plot=picture, grid=grid)


def choose_plot(output: Path, plot: Path | None, *, wanted: bool) -> Path | None:
    """Return the path of the plot, None for no plot; raise an error unless both files can be written."""
    from lobewise.io.files import require_writable
    from lobewise.reporting.fit_plot import require_matplotlib

    target = require_writable(output)
    if not wanted:
        return None
    picture = output.with_suffix(".png") if plot is None else plot
    if require_writable(picture, what="plot") == target:
        raise InputError(
            "--plot", expected="another file than the output", got=f"{str(picture)!r}", action="rename one of them"
        )
    require_matplotlib()
    return picture


def fit_material(
    evaluate: Evaluate,
    *,
    name: str,
    output: Path,
    lobes: int,
    kind: str,
    plot: Path | None,
    grid: Mapping[str, Any] | None = None,
) -> None:
    """Fit a material, print the residuals, and write its lobe file and plot after everything is computed.

    ``grid`` holds ``cosines`` and ``azimuths`` of the views; by default those of `lobewise.fitting.fit.fit_lobes`.
    """
    from lobewise.cli.output import print_line
    from lobewise.cli.terminal.steps import Steps
    from lobewise.cli.terminal.tables import print_fit
    from lobewise.fitting.fit import fit_lobes
    from lobewise.io.files import open_atomic
    from lobewise.io.materials import write_lobe_table
    from lobewise.reporting.fit_plot import draw_fit

    with Steps() as steps:
        table = fit_lobes(
            evaluate,
            lobes=lobes,
            kind=kind,
            name=name,
            progress=lambda done, total: steps.tell(f"Fitting {name}", done, total),
            **(grid or {}),
        )
    picture = None if plot is None else draw_fit(table, evaluate)
    write_lobe_table(output, table)
    if plot is not None and picture is not None:
        with open_atomic(plot, what="plot") as stream:
            stream.write(picture)
    print_fit(table)
    print_line(f"Wrote {output}." if plot is None else f"Wrote {output} and {plot}.")
