"""A page of pictures, differences and figures: one HTML file that needs nothing else."""

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

from lobewise.errors import InputError, MissingDependencyError
from lobewise.frame import FloatArray
from lobewise.io.png import encode_png
from lobewise.metrics import evaluate, make_error_map
from lobewise.reporting.display import choose_exposure, index_errors, make_error_palette, map_tones

TITLES = {"rel_mse": "relMSE", "mse": "MSE", "smape": "SMAPE", "psnr": "PSNR, dB", "flip": "FLIP"}
ORDER = ("rel_mse", "mse", "smape", "psnr", "flip")
SPOT = 64
"""Side of the square that the magnifier shows, pixels."""


@dataclass(frozen=True)
class Picture:
    """One image of a report."""

    key: str
    """Short name: lower-case letters, digits and hyphens."""
    title: str
    """What the reader sees."""
    image: FloatArray
    """Linear radiance, finite, shape (height, width, 3)."""
    note: str = ""
    """What it is, in a sentence or two."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Parameters that it was made with."""
    seconds: float | None = None
    """How long that took."""


@dataclass(frozen=True)
class Report:
    """What a page shows."""

    # Its head.
    title: str
    subtitle: str
    pictures: Sequence[Picture]
    """What is compared, in order."""
    reference: Picture
    """What is right."""
    baseline: str
    """Key of the picture that figures are given relative to."""
    # Keys of the two pictures that the slider shows first.
    left: str
    right: str
    mask: NDArray[np.bool_] | None
    """Pixels of the second table, the specular ones, shape (height, width)."""
    command: str
    """What makes the page again."""
    facts: Mapping[str, str]
    """Machine, versions and the like."""
    remarks: Sequence[str] = ()
    """Further sentences for the reader."""


def make_page(report: Report, *, progress: Callable[[int, int], None] | None = None) -> str:
    """Return the page as one HTML text with every image inside.

    ``progress`` is called with (done, total) while the figures are taken, which is what takes long.

    Raises InputError if a key is unknown, twice there or not a plain word, the sizes differ, or a pixel is not finite.
    """
    everything = [*report.pictures, report.reference]
    _check(report, everything)
    exposure = choose_exposure(report.reference.image)
    palette = make_error_palette()
    styles, errors = [], {}
    for picture in everything:
        styles.append(_make_style(f"p-{picture.key}", encode_png(map_tones(picture.image, exposure))))
    for picture in report.pictures:
        # The square root of a pixel's relMSE is its relative error, which is what people think in.
        errors[picture.key] = np.sqrt(make_error_map(picture.image, report.reference.image, "rel_mse"))
        styles.append(_make_style(f"e-{picture.key}", encode_png(index_errors(errors[picture.key]), palette)))
    height, width = report.reference.image.shape[:2]
    spot = _choose_spot(errors.get(report.left), errors.get(report.right), height, width)
    data = {
        "width": width,
        "height": height,
        "side": SPOT,
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
    """Return a file of the package's data with every ``{{name}}`` replaced, so that content is never searched again."""
    text = (files("lobewise") / "data" / template).read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], text)


def _make_style(name: str, png: bytes) -> str:
    return f".{name}{{background-image:url(data:image/png;base64,{base64.b64encode(png).decode('ascii')})}}"


def _choose_spot(left: FloatArray | None, right: FloatArray | None, height: int, width: int) -> list[int]:
    """Return the centre (x, y) of the square where the two pictures differ most in error."""
    if left is None or right is None or height < SPOT or width < SPOT:
        return [width // 2, height // 2]
    gain = np.minimum(left, 1.0) - np.minimum(right, 1.0)
    sums = np.pad(gain.astype(np.float64), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    box = sums[SPOT:, SPOT:] - sums[:-SPOT, SPOT:] - sums[SPOT:, :-SPOT] + sums[:-SPOT, :-SPOT]
    y, x = np.unravel_index(int(np.abs(box).argmax()), box.shape)
    return [int(x) + SPOT // 2, int(y) + SPOT // 2]


def _make_tables(report: Report, progress: Callable[[int, int], None]) -> tuple[list[str], str]:
    """Return the metrics that could be taken, and the tables."""
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
        # FLIP is slow, and one map serves every mask.
        seen: FloatArray | None = None
        if "flip" in metrics:
            try:
                seen = make_error_map(picture.image, target, "flip")
            except MissingDependencyError:
                metrics.remove("flip")
        for row, (_, mask) in zip(rows, masks, strict=True):
            row[picture.key] = evaluate(picture.image, target, mask, metrics=plain)
            if seen is not None:
                row[picture.key]["flip"] = float(seen.mean() if mask is None else seen[mask].mean())
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
            # Decibels are a logarithm already: their comparison is a difference.
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
