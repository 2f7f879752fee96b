"""A measurement as one HTML file that needs nothing else."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping
from typing import Any

from lobewise.bench.summary import Section, describe_machine_in_words, make_sections

STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin: 2.5rem 0 0; }
p { margin: .3rem 0 .8rem; max-width: 45rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .8rem .2rem 0; text-align: right; font-weight: normal; white-space: nowrap; }
th:first-child { text-align: left; }
thead th { border-bottom: 1px solid; opacity: .75; }
img { max-width: 100%; background: white; margin-top: 1rem; }
"""


def make_bench_page(data: Mapping[str, Any], plots: Mapping[str, bytes], command: str) -> str:
    """Return the page of a measurement.

    Parameters
    ----------
    data : mapping
        From `lobewise.bench.filters.measure_filters`.
    plots : mapping of str to bytes
        From `lobewise.bench.plots.draw_plots`; may be empty.
    command : str
        What makes it again.
    """
    remarks = "".join(f"<p>Left out: {html.escape(sentence)}</p>\n" for sentence in data["skipped"])
    body = "\n".join(_make_section(section, plots) for section in make_sections(data))
    title = f"lobewise on {data['machine']['processor']}"
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<h1>{html.escape(title)}</h1>
<p>{html.escape(describe_machine_in_words(data))}</p>
<p>Each time is the best of several, taken in turn with its neighbours. Made by <code>{html.escape(command)}</code>.</p>
{remarks}{body}
</body>
</html>
"""


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
