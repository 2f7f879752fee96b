"""Tables and descriptions that are printed on standard output."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from lobewise.cli.output import format_value
from lobewise.errors import make_printable
from lobewise.io import FileDescription
from lobewise.io.exr.describe import PartDescription
from lobewise.records.lobe_table import LobeTable


class _Console(Console):
    """A console that reports a closed pipe to the entry point."""

    def on_broken_pipe(self) -> None:
        """Raise the error that Rich turned into an exit with code 1."""
        raise BrokenPipeError


def make_text(text: str, style: str = "") -> Text:
    """Return a text that is printed letter for letter: without markup, and with control characters escaped."""
    return Text(make_printable(text), style=style)


def open_console() -> Console:
    """Return a console on standard output, for results."""
    return _Console()


def print_comparison(reference: str, metrics: Iterable[str], rows: Sequence[tuple[str, Mapping[str, Any]]]) -> None:
    """Print one line of figures per image. The best of each column is bold; a missing figure reads "none"."""
    metrics = list(metrics)
    # Seven figures and a name fit 80 columns only without lines between the columns.
    table = Table(title=make_text(f"against {reference}"), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("image", overflow="fold", min_width=12)
    best: dict[str, float | None] = {}
    for metric in metrics:
        table.add_column(metric, justify="right", no_wrap=True)
        known = [figures[metric] for _, figures in rows if figures[metric] is not None]
        best[metric] = (max if metric == "psnr" else min)(known) if len(rows) > 1 and known else None
    for path, figures in rows:
        cells = []
        for metric in metrics:
            stands_out = best[metric] is not None and figures[metric] == best[metric]
            cells.append(make_text(format_value(figures[metric], digits=4), style="bold" if stands_out else ""))
        table.add_row(make_text(path), *cells)
    _Console().print(table)


def print_table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table whose first column is text and whose others are figures."""
    table = Table(title=make_text(title), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for place, name in enumerate(header):
        table.add_column(name, justify="right" if place else "left", no_wrap=True)
    for row in rows:
        table.add_row(*map(make_text, row))
    _Console().print(table)


def print_devices(devices: Iterable[tuple[str, bool, str]]) -> None:
    """Print the devices, and why filters cannot run on one."""
    rows = [(name, "yes" if available else "no", reason) for name, available, reason in devices]
    _Console().print(_make_listing("", ("device", "runs here", "what it is, or why not"), rows))


def print_fit(table: LobeTable) -> None:
    """Print how well the lobes of a material fit its data at each view, and the parameters of the nearest GGX."""
    many = not table.is_isotropic
    listing = Table(
        title=make_text(
            f"{table.name}: {table.lobe_count} {table.kind} lobe{'s' if table.lobe_count > 1 else ''} a view"
        ),
        title_justify="left",
    )
    for title in ("n.v", "worst L2 cosine" if many else "L2 cosine", "residual"):
        listing.add_column(title, justify="right", no_wrap=True)
    if not many:
        listing.add_column("alpha along, across", justify="right", no_wrap=True)
        listing.add_column("albedo", justify="right", no_wrap=True)
    for row in range(table.cosine.size - 1, -1, -1):
        nearness = float(table.cosine_l2[row].min())
        # The residual is the distance from the data to the best multiple of the lobes, over the norm of the data.
        cells = [f"{table.cosine[row]:.3f}", f"{nearness:.4f}", f"{100 * math.sqrt(1 - min(nearness, 1) ** 2):.1f} %"]
        if not many:
            cells.append(", ".join(f"{alpha:.3f}" for alpha in table.alpha[row, 0]))
            cells.append(", ".join(f"{albedo:.2f}" for albedo in table.albedo[row, 0]))
        listing.add_row(*map(make_text, cells))
    _Console().print(listing)


def print_description(description: FileDescription, *, with_attributes: bool) -> None:
    """Print the parts and channels of a file, the channels of each image of a frame, and what missing images cost."""
    console = _Console()
    parts = f"{len(description.parts)} part{'s' if len(description.parts) != 1 else ''}"
    console.print(make_text(f"{description.path}: {description.bytes / 1e6:.1f} MB, {parts}"))
    for index, part in enumerate(description.parts):
        channels = [(one.name, one.pixel_type, one.used_as or _dim("only copied")) for one in part.channels]
        console.print(_make_listing(_describe_part(index, part), ("channel", "type", "read as"), channels))
        if with_attributes:
            console.print(_make_listing("attributes", ("name", "type", "value"), part.attributes))
    images = [
        (one.label, "yes" if one.found else "no", one.meaning if one.found else _dim(f"missing: {one.missing}"))
        for one in description.images
        # Where a half or a variance is missing as a whole, print one line instead of five.
        if one.found or one.label.count(".") <= 1
    ]
    console.print(_make_listing("what a frame can have", ("image", "found", "meaning, or effect of its lack"), images))
    if description.reason:
        console.print(make_text(f"Read as {description.preset}, because {description.reason}."), soft_wrap=True)
        roles = [(one.role, one.channels, one.conversion or _dim("as it is")) for one in description.roles]
        console.print(_make_listing("what is taken", ("image", "channels", "converted"), roles))
    camera = "known" if description.camera else "unknown"
    console.print(make_text(f"Camera: {camera}. Samples per pixel: {description.spp or 'unknown'}."))
    if description.materials:
        listed = "; ".join(f"{number} {text}" for number, text in enumerate(description.materials, start=1))
        console.print(make_text(f"Fitted materials: {listed}."), soft_wrap=True)
    console.print(make_text(f"Similarities that can be used: {', '.join(description.similarities) or 'none'}."))
    for note in description.notes:
        console.print(make_text(note), soft_wrap=True)


def _describe_part(index: int, part: PartDescription) -> str:
    """Return number, name, view, window and format of a part."""
    data, display = part.data_window, part.display_window
    title = f"part {index}" + (f" '{part.name}'" if part.name else "") + (f", view {part.view}" if part.view else "")
    window = f"{data.width}x{data.height}"
    if data != display:
        window += f" at ({data.x_min}, {data.y_min}) of {display.width}x{display.height}"
    return f"{title}: {window}, {part.kind}, {part.compression}"


def _make_listing(title: str, columns: Sequence[str], rows: Iterable[Sequence[str | Text]]) -> Table:
    """Return a table of texts, which are wrapped where they do not fit."""
    table = Table(title=make_text(title) if title else None, title_justify="left")
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(cell if isinstance(cell, Text) else make_text(cell) for cell in row))
    return table


def _dim(text: str) -> Text:
    return make_text(text, style="dim")
