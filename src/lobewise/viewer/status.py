"""The text of the page's status: a headline, figures, a bar for each stage."""

from __future__ import annotations

from html import escape

from lobewise.viewer.messages import Picture

STAGES = {
    "gbuffer": "G-buffer, direct light",
    "indirect": "indirect light",
    "upsampling": "upsampling",
    "adaptive": "adaptive",
    "composite": "composite",
    "picture": "tone map",
}
"""Stages by their keys in the seconds of a picture, with their names on the page."""

_QUIET = "opacity:.65"
_WARNING = "#ff8f70"
_BOX = "font-size:.8em;line-height:1.5;padding:.15em .9em .4em;"


def write_message(text: str, *, bad: bool = False) -> str:
    """Return HTML of one line of plain text."""
    color = f"color:{_WARNING};" if bad else ""
    return f'<div style="{_BOX}{color}">{escape(text)}</div>'


def write_figures(picture: Picture, shown: int, fps: float | None, note: str = "", *, unseen: str = "") -> str:
    """Return HTML with the size and the times of a picture.

    ``shown`` counts the pictures so far. ``fps`` is None while there are too few. ``note`` is a line of plain text
    below. ``unseen`` says what is missing in the picture.
    """
    width, height = picture.size
    parts = [f"{width}\u202f\u00d7\u202f{height}", f"frame {shown}", f"{picture.accumulated} averaged"]
    if picture.moment is not None:
        parts.append(f"objects at {picture.moment:.1f}")
    if picture.recomputed:
        parts.append(f"{picture.recomputed} re-computed")
    total = picture.seconds.get("total", 0.0) + picture.seconds.get("picture", 0.0)
    rate = "" if fps is None else f"{fps:.1f} fps \u00b7 "
    head = f'<b style="font-size:1.15em">{rate}{1e3 * total:.0f} ms</b>'
    rows = [
        f'<tr><td style="padding:0 .8em 0 0;{_QUIET}">{label}</td>'
        f'<td style="text-align:right;padding-right:.8em;font-variant-numeric:tabular-nums">'
        f"{1e3 * picture.seconds[name]:.1f}</td>"
        f'<td style="width:45%"><div style="height:.5em;border-radius:2px;background:#e8a33d;'
        f'width:{100.0 * picture.seconds[name] / max(total, 1e-9):.0f}%"></div></td></tr>'
        for name, label in STAGES.items()
        if name in picture.seconds
    ]
    table = f'<table style="width:100%;border-collapse:collapse">{"".join(rows)}</table>'
    # Keep the line where it is empty too, so that the controls below never move.
    below = f'<div style="{_QUIET}">{escape(note) or "&nbsp;"}</div>'
    missing = f'<div style="color:{_WARNING}">{escape(unseen)}</div>' if unseen else ""
    return f'<div style="{_BOX}">{head}<div style="{_QUIET}">{" · ".join(parts)}</div>{table}{missing}{below}</div>'
