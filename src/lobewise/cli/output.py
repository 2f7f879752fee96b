"""What the verbs print: results on standard output, remarks on standard error."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from lobewise.cli.terminal.steps import pause_steps
from lobewise.errors import make_printable
from lobewise.frame import Result
from lobewise.io import FileDescription
from lobewise.lobe_table import LobeTable

if TYPE_CHECKING:
    from lobewise.streaming import DenoisedFile


class _Console(Console):
    """A console that leaves closed pipes to the entry point."""

    def on_broken_pipe(self) -> None:
        """Pass the failure on: the default is to leave at once, with exit code 1."""
        raise BrokenPipeError


def make_text(text: str, style: str = "") -> Text:
    """Return a text that comes out letter for letter: no markup, and no control characters of file names."""
    return Text(make_printable(text), style=style)


def open_console() -> Console:
    """Return a console for results, on standard output."""
    return _Console()


def print_line(text: str) -> None:
    """Print a line of result, exactly as it is."""
    with pause_steps():
        _Console().print(make_text(text), soft_wrap=True)


def print_note(text: str) -> None:
    """Print a remark that is no result."""
    with pause_steps():
        Console(stderr=True).print(make_text(text, style="dim"), soft_wrap=True)


def describe_result(result: Result | DenoisedFile) -> str:
    """Return in one line the size, how it was filtered, the seconds it took and the bad pixels."""
    settings = result.settings
    if isinstance(result, Result):
        (height, width), bands = result.image.shape[:2], ""
    else:
        height, width = result.shape
        bands = f" in {result.bands} band{'s' if result.bands != 1 else ''}"
    told = [f"{width}x{height} pixels{bands}"]
    if settings.get("bilinear"):
        told.append("interpolated between pixels")
    elif "quality" in settings:
        peer = " with Open Image Denoise" if settings.get("with_oidn") else ""
        told.append(f"quality {settings['quality']}{peer}")
    line = ", ".join([*told, f"{result.seconds:.2f} s"])
    count = result.bad_pixel_count
    return f"{line}; {count} bad pixel{'s' if count != 1 else ''} refilled" if count else line


def describe_settings(result: Result | DenoisedFile) -> str:
    """Return in one line the settings of the filter by their names."""
    names = ("similarity", "form", "quality", "radius", "beta", "device")
    return ", ".join(f"{name} {_format(result.settings[name])}" for name in names if name in result.settings)


def to_json(value: Any) -> str:
    """Return strict JSON: arrays as lists, infinite and undefined numbers as null."""

    def clean(item: Any) -> Any:
        if isinstance(item, Mapping):
            return {str(key): clean(part) for key, part in item.items()}
        if isinstance(item, (list, tuple)):
            return [clean(part) for part in item]
        if hasattr(item, "tolist"):
            return clean(item.tolist())
        if isinstance(item, float) and not math.isfinite(item):
            return None
        return item

    return json.dumps(clean(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def print_comparison(reference: str, metrics: Iterable[str], rows: Sequence[tuple[str, Mapping[str, Any]]]) -> None:
    """Print one line of figures per image; the best of each column stands out, and a missing one is none."""
    metrics = list(metrics)
    # Without lines between them seven figures and a name fit 80 columns.
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
            cells.append(make_text(_format(figures[metric], digits=4), style="bold" if stands_out else ""))
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
    """Print the devices, those that cannot run with the reason."""
    table = Table()
    for title in ("device", "runs here", "what it is, or why not"):
        table.add_column(title, overflow="fold")
    for name, available, reason in devices:
        table.add_row(make_text(name), "yes" if available else "no", make_text(reason))
    _Console().print(table)


def print_fit(table: LobeTable) -> None:
    """Print how near the lobes of a material are to its data at each view, and the GGX that is nearest."""
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
        # The distance of the best multiple of the lobes from the data, in the unit of the data's norm.
        cells = [f"{table.cosine[row]:.3f}", f"{nearness:.4f}", f"{100 * math.sqrt(1 - min(nearness, 1) ** 2):.1f} %"]
        if not many:
            cells.append(", ".join(f"{alpha:.3f}" for alpha in table.alpha[row, 0]))
            cells.append(", ".join(f"{albedo:.2f}" for albedo in table.albedo[row, 0]))
        listing.add_row(*map(make_text, cells))
    _Console().print(listing)


def print_description(found: FileDescription, *, with_attributes: bool) -> None:
    """Print the parts and channels, what each image of a frame is read from, and what that means."""
    console = _Console()
    size = found.bytes / 1e6
    console.print(
        make_text(f"{found.path}: {size:.1f} MB, {len(found.parts)} part{'s' if len(found.parts) != 1 else ''}")
    )
    for index, part in enumerate(found.parts):
        data, display = part.data_window, part.display_window
        title = (
            f"part {index}" + (f" '{part.name}'" if part.name else "") + (f", view {part.view}" if part.view else "")
        )
        window = f"{data.width}x{data.height}"
        if data != display:
            window += f" at ({data.x_min}, {data.y_min}) of {display.width}x{display.height}"
        table = Table(title=make_text(f"{title}: {window}, {part.kind}, {part.compression}"), title_justify="left")
        for column in ("channel", "type", "read as"):
            table.add_column(column, overflow="fold")
        for channel in part.channels:
            table.add_row(
                make_text(channel.name), channel.pixel_type, channel.used_as or make_text("only copied", style="dim")
            )
        console.print(table)
        if with_attributes:
            listing = Table(title="attributes", title_justify="left")
            for column in ("name", "type", "value"):
                listing.add_column(column, overflow="fold")
            for row in part.attributes:
                listing.add_row(*map(make_text, row))
            console.print(listing)
    table = Table(title="what a frame can have", title_justify="left")
    for column in ("image", "found", "meaning, or what follows without it"):
        table.add_column(column)
    for image in found.images:
        # A half or variance that is missing as a whole is one line, not five.
        if not image.found and image.label.count(".") > 1:
            continue
        text = image.meaning if image.found else f"missing: {image.missing}"
        table.add_row(image.label, "yes" if image.found else "no", make_text(text, style="" if image.found else "dim"))
    console.print(table)
    if found.reason:
        console.print(make_text(f"Read as {found.preset}, because {found.reason}."), soft_wrap=True)
        listing = Table(title="what is taken", title_justify="left")
        for column in ("image", "channels", "converted"):
            listing.add_column(column, overflow="fold")
        for role in found.roles:
            listing.add_row(
                make_text(role.role),
                make_text(role.channels),
                make_text(role.conversion or "as it is", style="" if role.conversion else "dim"),
            )
        console.print(listing)
    camera = "known" if found.camera else "unknown"
    console.print(make_text(f"Camera: {camera}. Samples per pixel: {found.spp or 'unknown'}."))
    if found.materials:
        listed = "; ".join(f"{number} {text}" for number, text in enumerate(found.materials, start=1))
        console.print(make_text(f"Fitted materials: {listed}."), soft_wrap=True)
    console.print(make_text(f"Similarities that can be used: {', '.join(found.similarities) or 'none'}."))
    for note in found.notes:
        console.print(make_text(note), soft_wrap=True)


def _format(value: Any, digits: int = 5) -> str:
    if value is None:
        return "none"
    if isinstance(value, float):
        return "inf" if math.isinf(value) else f"{value:.{digits}g}"
    return str(value)
