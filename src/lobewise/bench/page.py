"""A measurement as one HTML file without other files."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping
from typing import Any

from lobewise.bench.summary import Section, describe_machine_in_words, make_sections
from lobewise.reporting.report import fill_page


def make_bench_page(data: Mapping[str, Any], plots: Mapping[str, bytes], command: str) -> str:
    """Return the page of a measurement of `lobewise.bench.filters.measure_filters`.

    ``plots`` are from `lobewise.bench.plots.draw_plots` and may be empty; ``command`` makes the page again.
    """
    remarks = "".join(f"<p>Left out: {html.escape(sentence)}</p>\n" for sentence in data["skipped"])
    body = "\n".join(_make_section(section, plots) for section in make_sections(data))
    title = f"lobewise on {data['machine']['processor']}"
    return fill_page(
        "bench.html",
        {
            "title": html.escape(title),
            "machine": html.escape(describe_machine_in_words(data)),
            "command": html.escape(command),
            "remarks": remarks,
            "sections": body,
        },
    )


def _make_section(section: Section, plots: Mapping[str, bytes]) -> str:
    head = "".join(f'<th scope="col">{html.escape(name)}</th>' for name in section.header)
    lines = "\n".join(
        f'<tr><th scope="row">{html.escape(name)}</th>{"".join(f"<td>{html.escape(cell)}</td>" for cell in cells)}</tr>'
        for name, *cells in section.rows
    )
    picture = ""
    if section.key in plots:
        source = base64.b64encode(plots[section.key]).decode("ascii")
        picture = f'\n<img alt="{html.escape(section.title)}" src="data:image/png;base64,{source}">'
    return (
        f"<h2>{html.escape(section.title)}</h2>\n<p>{html.escape(section.note)}</p>\n"
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>\n{lines}\n</tbody></table></div>{picture}'
    )
