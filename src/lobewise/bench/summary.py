"""A measurement as tables for a terminal, a page or a document."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lobewise.bench.kernels import PAPER_MILLISECONDS, PAPER_RADII, PAPER_SIZE
from lobewise.bench.plan import OIDN, OIDN_LABELS

Row = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Section:
    """A table of figures."""

    key: str
    """Short name, which is also the name of its plot, if it has one."""
    title: str
    note: str
    """How to read the table."""
    header: list[str]
    """Names of the columns; the first column is text, the others are figures."""
    rows: list[list[str]]
    """Cells, row by row."""


def make_sections(data: Mapping[str, Any]) -> list[Section]:
    """Return the tables of a measurement of `lobewise.bench.filters.measure_filters`, without empty tables."""
    rows = data["rows"]
    made = [
        _make_denoising(rows),
        _make_paper(rows),
        _make_forms(rows),
        _make_pivot(
            rows,
            "pixels",
            "Time over pixels",
            "Milliseconds of one image, radius 8, separable, and of Open Image Denoise (OIDN). The plot shows the time "
            "of a pixel: it should be flat.",
            lambda row: f"{1e-6 * row['width'] * row['height']:.2g}",
            "megapixels",
        ),
        _make_pivot(
            rows,
            "radius",
            "Time over radius",
            "Milliseconds of one image, separable: both passes have 2r + 1 taps.",
            lambda row: str(row["radius"]),
            "radius",
        ),
        _make_pivot(
            rows,
            "lobes",
            "Time over lobes",
            "Milliseconds of one image, radius 8, separable. Each lobe of a pixel is compared with each lobe of the "
            "other pixel. Lobes that approximate GGX share an axis, which is faster; lobes of measured materials do "
            "not.",
            lambda row: str(row["lobes"]),
            "lobes",
        ),
        _make_threads(rows),
        _make_pivot(
            rows,
            "upsampling",
            f"Upsampling to {_tell_size(pick(rows, 'upsampling'))}",
            "Milliseconds of lobewise.upsample, diffuse and specular, one pixel shaded of every 2x2 or 4x4.",
            lambda row: f"{row['scale']}x{row['scale']}, ms",
            "similarity",
        ),
    ]
    return [section for section in made if section.rows]


def describe_machine_in_words(data: Mapping[str, Any]) -> str:
    """Return processor, threads, devices, version and commit of a measurement, in a sentence."""
    machine = data["machine"]
    others = [f"{name}: {reason}" for name, reason in data["devices"].items() if name != "cpu"]
    version = f"lobewise {machine['version']}" + (f", commit {machine['commit']}" if "commit" in machine else "")
    parts = [f"{machine['processor']}, {machine['threads']} threads", *others, version]
    return "; ".join(parts) + f"; measured in {data['seconds'] / 60.0:.1f} minutes."


def name_series(rows: Sequence[Row]) -> Callable[[Row], str]:
    """Return a function that names the series of a row: by its name, and by its device where there are several."""
    several = len({row["device"] for row in rows}) > 1
    return lambda row: f"{row['name']}, {row['device']}" if several and not is_peer(row) else str(row["name"])


def is_peer(row: Row) -> bool:
    """Return whether a row is a time of Open Image Denoise."""
    return str(row["name"]).startswith(OIDN)


def pick(rows: Sequence[Row], part: str, **facts: Any) -> list[Row]:
    """Return the rows of a part with the given facts; of Open Image Denoise, which has no device, one per setting."""
    picked: dict[Any, Row] = {}
    for row in rows:
        if row["part"] == part and all(row.get(name) == value for name, value in facts.items()):
            rest = tuple((name, value) for name, value in row.items() if name not in ("milliseconds", "device"))
            picked.setdefault(rest if is_peer(row) else (rest, row["device"]), row)
    return list(picked.values())


def _make_pivot(
    rows: Sequence[Row], part: str, title: str, note: str, column: Callable[[Row], str], name: str
) -> Section:
    """Return a table of times with a line for each series and a column for each value of ``column``."""
    chosen = pick(rows, part)
    series = name_series(chosen)
    columns = list(dict.fromkeys(map(column, chosen)))
    cells = {(series(row), column(row)): format_time(row["milliseconds"]) for row in chosen}
    lines = list(dict.fromkeys(map(series, chosen)))
    return Section(
        key=part,
        title=title,
        note=note,
        header=[name, *columns],
        rows=[[line, *(cells.get((line, value), "") for value in columns)] for line in lines],
    )


def _make_paper(rows: Sequence[Row]) -> Section:
    """Return the times and ratios on this machine beside the paper's ratios."""
    lines = []
    chosen = [
        row
        for radius in PAPER_RADII
        for row in pick(rows, "radius", radius=radius, width=PAPER_SIZE, height=PAPER_SIZE, form="separable")
    ]
    series = name_series(chosen)
    normal = {(row["device"], row["radius"]): row["milliseconds"] for row in chosen if row["name"] == "normal"}
    for row in chosen:
        theirs = PAPER_MILLISECONDS[row["radius"]]
        ratio_of_paper = f"{theirs[row['name']] / theirs['normal']:.2f}" if row["name"] in theirs else ""
        ratio = row["milliseconds"] / normal[row["device"], row["radius"]]
        lines.append(
            [series(row), str(row["radius"]), format_time(row["milliseconds"]), f"{ratio:.2f}", ratio_of_paper]
        )
    return Section(
        key="paper",
        title="The paper's table",
        note=f"{PAPER_SIZE}x{PAPER_SIZE} pixels, separable; the paper measured on a Radeon HD 6990.",
        header=["similarity", "radius", "ms", "ratio to normal", "the paper's"],
        rows=lines,
    )


def _make_forms(rows: Sequence[Row]) -> Section:
    chosen = pick(rows, "forms")
    series = name_series(chosen)
    forms = list(dict.fromkeys(row["form"] for row in chosen))
    normal = {(row["device"], row["form"]): row["milliseconds"] for row in chosen if row["name"] == "normal"}
    cells = {
        (series(row), row["form"]): (
            format_time(row["milliseconds"]),
            f"{row['milliseconds'] / normal[row['device'], row['form']]:.2f}",
        )
        for row in chosen
    }
    lines = list(dict.fromkeys(map(series, chosen)))
    return Section(
        key="forms",
        title=f"Forms and similarities, {_tell_size(chosen)}",
        note="Radius 8 (atrous: five 5x5 passes); milliseconds of one image, and the ratio to normal.",
        header=["similarity", *(word for form in forms for word in (form, "ratio"))],
        rows=[[line, *(word for form in forms for word in cells[line, form])] for line in lines],
    )


def _make_threads(rows: Sequence[Row]) -> Section:
    chosen = pick(rows, "threads")
    section = _make_pivot(
        rows,
        "threads",
        f"Time over threads, {_tell_size(chosen)}",
        "Milliseconds of one image, radius 8, separable, and how many times faster all threads are than one.",
        lambda row: str(row["threads"]),
        "threads",
    )
    series = name_series(chosen)
    times: dict[str, list[float]] = {}
    for row in chosen:
        times.setdefault(series(row), []).append(row["milliseconds"])
    gains = [f"{seconds[0] / seconds[-1]:.2f}" for seconds in times.values()]
    lines = [[*line, gain] for line, gain in zip(section.rows, gains, strict=True)]
    return replace(section, header=[*section.header, "gain"], rows=lines)


def _make_denoising(rows: Sequence[Row]) -> Section:
    """Return the times of whole frames, and how many times faster each is than Open Image Denoise."""
    chosen = pick(rows, "denoising")
    series = name_series(chosen)
    peers = {row["name"]: row["milliseconds"] for row in chosen if is_peer(row)}
    against = [OIDN_LABELS[quality] for quality in ("high", "fast") if OIDN_LABELS[quality] in peers]
    lines = [
        [
            series(row),
            format_time(row["milliseconds"]),
            *(f"{peers[name] / row['milliseconds']:.2f}" for name in against),
        ]
        for row in chosen
    ]
    return Section(
        key="denoising",
        title=f"Whole frames, {_tell_size(chosen)}",
        note="Milliseconds of lobewise.denoise, diffuse and specular apart, radius 8, and how many times faster it is "
        "than Open Image Denoise (OIDN), which filters one image with clean guides; its default is its best quality.",
        header=["method", "ms", *(f"vs {name}" for name in against)],
        rows=lines,
    )


def _tell_size(rows: Sequence[Row]) -> str:
    return f"{rows[0]['width']}x{rows[0]['height']}" if rows else ""


def format_time(milliseconds: float) -> str:
    """Return a time with at least three significant digits."""
    if milliseconds >= 100.0:
        return f"{milliseconds:.0f}"
    return f"{milliseconds:.1f}" if milliseconds >= 10.0 else f"{milliseconds:.2f}"
