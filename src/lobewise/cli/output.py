"""Printing: results go to standard output, remarks to standard error."""

from __future__ import annotations

import math
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import typer

from lobewise.cli.terminal.lines import write_line, writes_lines
from lobewise.cli.terminal.steps import pause_steps
from lobewise.errors import make_printable
from lobewise.records.frame import Result

if TYPE_CHECKING:
    from lobewise.recipes.files import FileResult


def print_line(text: str) -> None:
    """Print a line of a result, without markup or line breaks."""
    if writes_lines() and sys.stdout is sys.stderr:
        return write_line(note=text)
    with pause_steps():
        typer.echo(make_printable(text))
    return None


def print_note(text: str) -> None:
    """Print a remark on standard error."""
    if writes_lines():
        return write_line(note=text)
    # The reader of standard error may have gone. The work goes on.
    with pause_steps(), suppress(OSError):
        typer.echo(typer.style(make_printable(text), dim=True), err=True)
    return None


def describe_result(result: FileResult) -> str:
    """Return in one line the size, how it was filtered, the seconds it took and the bad pixels."""
    from lobewise.interchange.selections import count_selections

    one, counted = result.first, count_selections(result.selections)
    several, bands = f"{counted}, " if counted else "", ""
    settings = one.settings
    if isinstance(one, Result):
        height, width = one.image.shape[:2]
    else:
        height, width = one.shape
        bands = f" in {one.bands} band{'s' if one.bands != 1 else ''}"
    facts = [f"{several}{width}x{height} pixels{bands}"]
    if settings.get("bilinear"):
        facts.append("interpolated between pixels")
    elif "quality" in settings:
        peer = " with Open Image Denoise" if settings.get("with_oidn") else ""
        facts.append(f"quality {settings['quality']}{peer}")
    line = ", ".join([*facts, f"{result.seconds:.2f} s"])
    count = result.bad_pixel_count
    return f"{line}; {count} bad pixel{'s' if count != 1 else ''} refilled" if count else line


def describe_settings(result: FileResult) -> str:
    """Return in one line the settings of the filter by their names."""
    names = ("similarity", "form", "quality", "radius", "beta", "device")
    return ", ".join(f"{name} {format_value(result.settings[name])}" for name in names if name in result.settings)


def format_value(value: Any, digits: int = 5) -> str:
    """Return a value as a user reads it."""
    if value is None:
        return "none"
    if isinstance(value, float):
        return "inf" if math.isinf(value) else f"{value:.{digits}g}"
    return str(value)
