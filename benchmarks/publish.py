"""Fill the marked places of README.md and docs with the figures of the committed JSON files.

python -m benchmarks.publish

People write the pages. This program changes nothing outside the marks (see `benchmarks.pages.marks`).
"""

import json
from collections.abc import Callable
from typing import NamedTuple

from benchmarks.common import RESULTS, ROOT
from benchmarks.pages import (
    bench,
    core,
    exports,
    films,
    groups,
    interactive,
    mechanisms,
    paper,
    performance,
    quality,
    results,
    serving,
    shares,
    streaming,
    users,
)
from benchmarks.pages.marks import fill_places


class Source(NamedTuple):
    """What fills a page: a function that returns figures by place, and the JSON files that it takes."""

    make_figures: Callable[..., dict[str, str]]
    files: tuple[str, ...]


PAGES = {
    "README.md": Source(results.make_shot_figures, ("blender_shots", "budget")),
    "docs/index.md": Source(results.make_shot_figures, ("blender_shots", "budget")),
    "docs/blender.md": Source(results.make_shot_figures, ("blender_shots", "budget")),
    "docs/quality.md": Source(results.make_quality_figures, ("blender_shots", "budget")),
    "docs/paper.md": Source(paper.make_figures, ("paper_pair", "paper_table")),
    "docs/results.md": Source(
        results.make_figures,
        ("blender_shots", "budget", "blender_training_shots", "users", "films", "without_lobes", "robustness"),
    ),
    "docs/developers/bench.md": Source(bench.make_figures, ("startup",)),
    "docs/developers/export.md": Source(exports.make_figures, ("pipelines", "chains")),
    "docs/developers/interactive.md": Source(
        interactive.make_figures, ("interactive_quality", "interactive", "viewer")
    ),
    "docs/developers/performance.md": Source(performance.make_figures, ("filters", "budget", "files")),
    "docs/developers/quality.md": Source(mechanisms.make_mechanism_figures, ("switched_off",)),
    "docs/developers/quality_results.md": Source(quality.make_figures, ("quality",)),
    "docs/developers/renderers_results.md": Source(groups.make_figures, ("groups", "light_passes")),
    "docs/developers/releasing.md": Source(core.make_figures, ("core",)),
    "docs/developers/research/mixing_networks.md": Source(shares.make_figures, ("shares",)),
    "docs/developers/filter_results.md": Source(performance.make_result_figures, ("filters", "lobes")),
    "docs/developers/robustness.md": Source(serving.make_figures, ("robustness", "farm")),
    "docs/developers/bands.md": Source(streaming.make_figures, ("streaming",)),
    "docs/developers/users_results.md": Source(users.make_figures, ("users", "blender_shots")),
    "docs/developers/windows.md": Source(films.make_figures, ("films",)),
}
"""The pages that have marked places."""


def fill_page(name: str) -> str:
    """Return the text of a page with the figures of the committed JSON files."""
    source = PAGES[name]
    measured = (json.loads((RESULTS / f"{file}.json").read_text()) for file in source.files)
    return fill_places((ROOT / name).read_text(), source.make_figures(*measured))


def main() -> None:
    """Fill every page."""
    for name in PAGES:
        (ROOT / name).write_text(fill_page(name))


if __name__ == "__main__":
    main()
