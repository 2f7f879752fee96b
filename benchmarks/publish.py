"""Write the figures of README.md and docs/results.md from the committed JSON; nothing else puts numbers there.

python -m benchmarks.publish
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, ROOT
from benchmarks.pages.ablation import make_ablation_page
from benchmarks.pages.bench import load_machines, make_bench_page, write_pictures
from benchmarks.pages.foreign import make_foreign_page
from benchmarks.pages.gallery import make_gallery_page
from benchmarks.pages.interactive import make_interactive_page
from benchmarks.pages.mitsuba import make_mitsuba_figures
from benchmarks.pages.performance import make_performance_page
from benchmarks.pages.quality import make_quality_page
from benchmarks.pages.results import (
    make_readme_figures,
    make_results_page,
)
from benchmarks.pages.streaming import make_streaming_page
from benchmarks.pages.trials import make_trials_page
from benchmarks.pages.users import make_users_page

INTERACTIVE = ("interactive_quality", "interactive", "viewer")
"""What docs/interactive.md is made of."""
PERFORMANCE = ("filters", "roofline", "scaling", "kernel_trials", "taps")
"""What docs/performance.md is made of."""
TRIALS = ("quality_trials", "training", "shares")
"""What docs/quality.md is made of."""
START, END = "<!-- figures:start -->", "<!-- figures:end -->"


def load_startup() -> dict[str, Any] | None:
    """Return what ``startup.py`` has measured, None before it has."""
    path = RESULTS / "startup.json"
    return json.loads(path.read_text()) if path.exists() else None


def put_figures(page: Path, figures: str) -> None:
    """Put figures between the marks of a page."""
    head, rest = page.read_text().split(START)
    tail = rest.split(END)[1]
    page.write_text(f"{head}{START}\n{figures}\n{END}{tail}")


def main() -> None:
    """Write the pages."""
    similarities = json.loads((RESULTS / "similarities.json").read_text())
    filters = json.loads((RESULTS / "filters.json").read_text())
    upsampling = json.loads((RESULTS / "upsampling.json").read_text())
    quality = json.loads((RESULTS / "quality.json").read_text())
    users = json.loads((RESULTS / "users.json").read_text())
    put_figures(ROOT / "README.md", make_readme_figures(quality, upsampling, users))
    paper = json.loads((RESULTS / "paper_table.json").read_text())
    hits = json.loads((RESULTS / "hit_distance.json").read_text())
    gallery = json.loads((RESULTS / "gallery.json").read_text())
    (ROOT / "docs" / "results.md").write_text(make_results_page(similarities, filters, paper, hits, upsampling))
    (ROOT / "docs" / "gallery.md").write_text(make_gallery_page(gallery))
    measured = (json.loads((RESULTS / f"{name}.json").read_text()) for name in INTERACTIVE)
    (ROOT / "docs" / "interactive.md").write_text(make_interactive_page(*measured))
    trials = (json.loads((RESULTS / f"{name}.json").read_text()) for name in TRIALS)
    (ROOT / "docs" / "quality.md").write_text(make_trials_page(*trials))
    (ROOT / "docs" / "quality_results.md").write_text(make_quality_page(quality))
    foreign, speed = (json.loads((RESULTS / f"{name}.json").read_text()) for name in ("foreign", "foreign_speed"))
    (ROOT / "docs" / "renderers_results.md").write_text(make_foreign_page(foreign, speed))
    ablation = json.loads((RESULTS / "affinity_ablation.json").read_text())
    (ROOT / "docs" / "research" / "affinity_ablation.md").write_text(make_ablation_page(ablation))
    (ROOT / "docs" / "users_results.md").write_text(make_users_page(users))
    put_figures(ROOT / "docs" / "mitsuba.md", make_mitsuba_figures(json.loads((RESULTS / "mitsuba.json").read_text())))
    streamed = json.loads((RESULTS / "streaming.json").read_text())
    (ROOT / "docs" / "streaming.md").write_text(make_streaming_page(streamed))
    performance = (json.loads((RESULTS / f"{name}.json").read_text()) for name in PERFORMANCE)
    (ROOT / "docs" / "performance.md").write_text(make_performance_page(*performance))
    machines = load_machines()
    write_pictures(machines)
    (ROOT / "docs" / "bench.md").write_text(make_bench_page(load_startup(), machines))


if __name__ == "__main__":
    main()
