"""A page of pictures, error maps and figures, in one HTML file without other files."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.display.tones import choose_exposure, index_errors, make_error_palette, map_tones
from lobewise.errors import InputError, MissingDependencyError
from lobewise.io.png import encode_png
from lobewise.metrics import evaluate, make_error_map
from lobewise.records.frame import FloatArray

TITLES = {"rel_mse": "relMSE", "mse": "MSE", "smape": "SMAPE", "psnr": "PSNR, dB", "flip": "FLIP"}
ORDER = ("rel_mse", "mse", "smape", "psnr", "flip")
MAGNIFIER_PIXELS = 64
"""Side of the square that the magnifier shows, image pixels."""


@dataclass(frozen=True)
class Picture:
    """One image of a report."""

    key: str
    """Short name: lower-case letters, digits and hyphens."""
    title: str
    """Title that the reader sees."""
    image: FloatArray
    """Linear radiance, finite, shape (height, width, 3)."""
    note: str = ""
    """Description in one or two sentences."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the filter, by name."""
    seconds: float | None = None
    """Time that the filter took."""


@dataclass(frozen=True)
class Report:
    """The content of a page."""

    title: str
    subtitle: str
    pictures: Sequence[Picture]
    """The pictures that are compared, in order."""
    reference: Picture
    """The picture that errors are measured against."""
    baseline: str
    """Key of the picture that figures are given relative to."""
    left: str
    """Key of the picture that the slider shows first on its left side."""
    right: str
    """Key of the picture that the slider shows first on its right side."""
    mask: NDArray[np.bool_] | None
    """Specular pixels, which the second table measures, shape (height, width); None for no second table."""
    command: str
    """Command line that makes the page again."""
    facts: Mapping[str, str]
    """Machine, versions and other facts, by title."""
    remarks: Sequence[str] = ()
    """Further sentences for the reader."""


def make_page(report: Report, *, progress: Callable[[int, int], None] | None = None) -> str:
    """Return the page as one HTML text that holds every image.

    ``progress`` is called with (done, total) while the errors are measured, which takes most of the time.

    Raises InputError if a key is unknown, repeated or not a plain word, sizes differ, or a pixel is not finite.
    """
    everything = [*report.pictures, report.reference]
    _check(report, everything)
    exposure = choose_exposure(report.reference.image)
    palette = make_error_palette()
    styles, errors = [], {}
    for picture in everything:
        styles.append(_make_style(f"p-{picture.key}", encode_png(map_tones(picture.image, exposure))))
    for picture in report.pictures:
        # The square root of a pixel's relMSE is its relative error, which is easier to read.
        errors[picture.key] = np.sqrt(make_error_map(picture.image, report.reference.image, "rel_mse"))
        styles.append(_make_style(f"e-{picture.key}", encode_png(index_errors(errors[picture.key]), palette)))
    height, width = report.reference.image.shape[:2]
    spot = _locate_largest_gain(errors.get(report.left), errors.get(report.right), height, width)
    data = {
        "width": width,
        "height": height,
        "side": MAGNIFIER_PIXELS,
        "spot": spot,
        "left": report.left,
        "right": report.right,
        "pictures": [{"key": one.key, "title": one.title, "error": one is not report.reference} for one in everything],
    }
    metrics, tables = _make_tables(report, progress or (lambda _done, _total: None))
    return fill_page(
        "report.html",
        {
            "title": html.escape(report.title),
            "subtitle": html.escape(report.subtitle),
            "images": "\n".join(styles),
            "data": json.dumps(data).replace("<", "\\u003c"),
            "aspect": f"{width} / {height}",
            "tables": tables,
            "metrics": "" if "flip" in metrics else "FLIP is left out: the package flip-evaluator is not installed.",
            "methods": "\n".join(_describe_picture(one) for one in everything),
            "ramp": ", ".join(f"rgb({r} {g} {b})" for r, g, b in palette[:: 255 // 15]),
            "exposure": f"{exposure:.3g}",
            "baseline": html.escape(next(one.title for one in everything if one.key == report.baseline)),
            "remarks": "\n".join(f"<p>{html.escape(remark)}</p>" for remark in report.remarks),
            "command": html.escape(report.command),
            "facts": "\n".join(
                f"<dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd>" for name, value in report.facts.items()
            ),
            "options": "\n".join(f'<option value="{one.key}">{html.escape(one.title)}</option>' for one in everything),
            "still": "\n".join(
                f'<figure><div class="shot p-{one.key}" role="img" aria-label="{html.escape(one.title)}"></div>'
                f"<figcaption>{html.escape(one.title)}</figcaption></figure>"
                for one in everything
            ),
        },
    )


def _check(report: Report, everything: Sequence[Picture]) -> None:
    keys = [picture.key for picture in everything]
    for key in keys:
        if not re.fullmatch(r"[a-z0-9-]+", key) or keys.count(key) > 1:
            raise InputError(
                "picture key",
                expected="lower-case letters, digits and hyphens, each once",
                got=repr(key),
                action="rename it",
            )
    for name in (report.baseline, report.left, report.right):
        if name not in keys:
            raise InputError("picture", expected="one of " + ", ".join(keys), got=repr(name), action="add it")


def fill_page(template: str, parts: Mapping[str, str]) -> str:
    """Return a file of the package's data with every ``{{name}}`` replaced once; the parts are not searched."""
    text = (files("lobewise") / "data" / template).read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], text)


def _make_style(name: str, png: bytes) -> str:
    return f".{name}{{background-image:url(data:image/png;base64,{base64.b64encode(png).decode('ascii')})}}"


def _locate_largest_gain(left: FloatArray | None, right: FloatArray | None, height: int, width: int) -> list[int]:
    """Return the centre (x, y) of the square where the errors of two pictures differ most."""
    if left is None or right is None or height < MAGNIFIER_PIXELS or width < MAGNIFIER_PIXELS:
        return [width // 2, height // 2]
    gain = np.minimum(left, 1.0) - np.minimum(right, 1.0)
    sums = np.pad(gain.astype(np.float64), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    box = (
        sums[MAGNIFIER_PIXELS:, MAGNIFIER_PIXELS:]
        - sums[:-MAGNIFIER_PIXELS, MAGNIFIER_PIXELS:]
        - sums[MAGNIFIER_PIXELS:, :-MAGNIFIER_PIXELS]
        + sums[:-MAGNIFIER_PIXELS, :-MAGNIFIER_PIXELS]
    )
    y, x = np.unravel_index(int(np.abs(box).argmax()), box.shape)
    return [int(x) + MAGNIFIER_PIXELS // 2, int(y) + MAGNIFIER_PIXELS // 2]


def _make_tables(report: Report, progress: Callable[[int, int], None]) -> tuple[list[str], str]:
    """Return the metrics that could be measured, and the HTML of the tables."""
    metrics = list(ORDER)
    masks: list[tuple[str, NDArray[np.bool_] | None]] = [("Whole image", None)]
    if report.mask is not None:
        share = f"{100.0 * float(report.mask.mean()):.0f} % of the image"
        masks.append((f"Specular pixels, {share}", report.mask))
    plain = [name for name in ORDER if name != "flip"]
    target = report.reference.image
    rows: list[dict[str, dict[str, float]]] = [{} for _ in masks]
    for done, picture in enumerate(report.pictures):
        progress(done, len(report.pictures))
        # FLIP is slow: compute its map once for all masks.
        flip_map: FloatArray | None = None
        if "flip" in metrics:
            try:
                flip_map = make_error_map(picture.image, target, "flip")
            except MissingDependencyError:
                metrics.remove("flip")
        for row, (_, mask) in zip(rows, masks, strict=True):
            row[picture.key] = evaluate(picture.image, target, mask, metrics=plain)
            if flip_map is not None:
                row[picture.key]["flip"] = float(flip_map.mean() if mask is None else flip_map[mask].mean())
    progress(len(report.pictures), len(report.pictures))
    tables = [_make_table(caption, report, metrics, row) for (caption, _), row in zip(masks, rows, strict=True)]
    return metrics, "\n".join(tables)


def _make_table(caption: str, report: Report, metrics: Sequence[str], rows: Mapping[str, Mapping[str, float]]) -> str:
    best = {name: (max if name == "psnr" else min)(row[name] for row in rows.values()) for name in metrics}
    head = "".join(f'<th scope="col">{TITLES[name]}</th>' for name in metrics)
    body = []
    for picture in report.pictures:
        cells = []
        for name in metrics:
            value, base = rows[picture.key][name], rows[report.baseline][name]
            # Decibels are logarithms: compare them by their difference.
            if name == "psnr":
                ratio = f"{value - base:+.2f}".replace("-", "\u2212")
            else:
                ratio = f"\u00d7{value / base:.2f}" if base > 0.0 else ""
            mark = ' class="best"' if value == best[name] else ""
            text = f"{value:.2f}" if name == "psnr" else f"{value:.4f}"
            cells.append(f"<td{mark}>{text}<small>{'' if picture.key == report.baseline else ratio}</small></td>")
        body.append(f'<tr><th scope="row">{html.escape(picture.title)}</th>{"".join(cells)}</tr>')
    return (
        f'<div class="scroll" tabindex="0"><table><caption>{html.escape(caption)}</caption>'
        f'<thead><tr><th scope="col">Picture</th>{head}</tr></thead><tbody>{"".join(body)}</tbody></table></div>'
    )


def _describe_picture(picture: Picture) -> str:
    time = "" if picture.seconds is None else f"{picture.seconds * 1e3:.0f} ms"
    settings = ", ".join(f"{name} {_format(value)}" for name, value in picture.settings.items() if value is not None)
    return (
        f'<tr><th scope="row">{html.escape(picture.title)}</th><td>{html.escape(picture.note)}</td>'
        f'<td>{html.escape(settings)}</td><td class="time">{time}</td></tr>'
    )


def _format(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
