"""The verb `doctor`."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from lobewise.cli.terminal.steps import Steps

EXIT_CANNOT_WORK = 2
"""Exit code where lobewise cannot denoise, as for a verb that lacks a package."""


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Print what lobewise found on this machine, and what to do about each problem.

    The report is plain text, to be pasted where you ask for help: versions, extras, devices, LLVM, the cache of
    compiled kernels, folders, terminal. The exit code is 0 unless lobewise cannot work here.
    """
    from lobewise.cli.doctor.examining import examine

    with Steps() as steps:
        steps.tell("Looking at this machine")
        report = examine()
    if as_json:
        typer.echo(json.dumps(report.to_record(), indent=2, ensure_ascii=False))
    else:
        for line in report.list_lines():
            typer.echo(line)
    if not report.works:
        raise typer.Exit(EXIT_CANNOT_WORK)
