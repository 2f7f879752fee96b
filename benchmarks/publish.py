"""Fill the marked places of README.md and docs with the figures of the committed JSON files.

python -m benchmarks.publish

People write the pages. This program changes nothing outside the marks (see `benchmarks.pages.marks`). It also draws the
plots of docs/bench.md.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

from benchmarks.common import RESULTS, ROOT
from benchmarks.pages import (
    bench,
    core,
    exports,
    farm,
    films,
    foreign,
    gallery,
    how_it_works,
    interactive,
    materials,
    mitsuba,
    performance,
    quality,
    rays,
    results,
    serving,
    streaming,
    temporal,
    trials,
    upsampling,
    users,
    virtual_lights,
)
from benchmarks.pages.marks import fill_places


class Source(NamedTuple):
    """What fills a page: a function that returns figures by place, and the JSON files that it takes."""

    make_figures: Callable[..., dict[str, str]]
    files: tuple[str, ...]


def make_upsampling_figures(skies: dict[str, Any], measured: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/upsampling.md by place."""
    return upsampling.make_sky_figures(skies) | rays.make_upsampling_figures(measured)


PAGES = {
    "README.md": Source(users.make_readme_figures, ("users", "blender_shots", "without_lobes")),
    "docs/bench.md": Source(bench.make_figures, ("startup",)),
    "docs/export.md": Source(exports.make_figures, ("pipelines", "chains")),
    "docs/farm.md": Source(farm.make_figures, ("farm",)),
    "docs/gallery.md": Source(gallery.make_figures, ("gallery",)),
    "docs/how_it_works.md": Source(how_it_works.make_figures, ("paper_pair",)),
    "docs/interactive.md": Source(
        interactive.make_figures,
        ("interactive_quality", "interactive", "viewer", "interactive_again", "moving", "interactive_direct"),
    ),
    "docs/materials.md": Source(materials.make_figures, ("fit_materials", "textured_lobes")),
    "docs/mitsuba.md": Source(mitsuba.make_figures, ("mitsuba",)),
    "docs/performance.md": Source(
        performance.make_figures, ("filters", "roofline", "scaling", "budget", "first_calls")
    ),
    "docs/quality_results.md": Source(quality.make_figures, ("quality",)),
    "docs/renderers_results.md": Source(foreign.make_figures, ("foreign", "foreign_speed")),
    "docs/research/hit_distance.md": Source(results.make_hit_figures, ("similarities", "hit_distance")),
    "docs/research/kernel_trials.md": Source(performance.make_trial_figures, ("kernel_trials", "taps")),
    "docs/research/mixing_networks.md": Source(trials.make_share_figures, ("shares",)),
    "docs/research/quality_trials.md": Source(trials.make_trial_figures, ("quality_trials", "training")),
    "docs/research/refinement.md": Source(trials.make_refinement_figures, ("refinement_trials",)),
    "docs/research/rays.md": Source(rays.make_trial_figures, ("rays",)),
    "docs/results.md": Source(results.make_figures, ("similarities", "filters", "paper_table", "upsampling")),
    "docs/start.md": Source(core.make_figures, ("core",)),
    "docs/serving.md": Source(serving.make_figures, ("robustness",)),
    "docs/streaming.md": Source(streaming.make_figures, ("streaming",)),
    "docs/temporal.md": Source(temporal.make_figures, ("reflections",)),
    "docs/upsampling.md": Source(make_upsampling_figures, ("skies", "rays")),
    "docs/users_results.md": Source(users.make_figures, ("users", "blender_shots")),
    "docs/virtual_lights.md": Source(virtual_lights.make_figures, ("virtual_lights", "virtual_light_clusters")),
    "docs/windows.md": Source(films.make_figures, ("films",)),
}
"""The pages that have marked places."""


def fill_page(name: str) -> str:
    """Return the text of a page with the figures of the committed JSON files."""
    source = PAGES[name]
    measured = (json.loads((RESULTS / f"{file}.json").read_text()) for file in source.files)
    return fill_places((ROOT / name).read_text(), source.make_figures(*measured))


def main() -> None:
    """Fill every page and draw the plots."""
    for name in PAGES:
        (ROOT / name).write_text(fill_page(name))
    bench.write_pictures(bench.load_machines())


if __name__ == "__main__":
    main()
