"""The figures of docs/research/affinity_ablation.md, measured by `training/affinity_ablation.py`."""

from __future__ import annotations

import math
from typing import Any

from benchmarks.pages.tables import describe_run, list_facts, make_table

NAMES = {
    "full": "lobes and halves",
    "full2": "the same, another seed",
    "nolobes": "no lobes",
    "nohalves": "no halves",
}
SETS = {
    "all": "all guides",
    "unsplit": "all guides, light not told apart",
    "passes": "split light, albedos, normals, roughness",
    "plain": "color, albedo, normal, depth",
    "color": "color alone",
}


def find_mean(errors: dict[str, float]) -> float:
    """Return the geometric mean over sample counts."""
    return math.exp(sum(map(math.log, errors.values())) / len(errors))


def describe_verdict(variants: dict[str, Any]) -> str:
    """Return what leaving out each part costs, beside how far two seeds differ."""

    def compare(name: str, guides: str) -> float:
        first, second = (find_mean(variants[each]["errors"][guides]) for each in (name, "full"))
        return 100.0 * (first / second - 1.0)

    told = [
        f"Without {what} the error is {compare(name, 'all'):+.0f} % with all guides, "
        f"{compare(name, 'passes'):+.0f} % with split light and roughness, {compare(name, 'plain'):+.0f} % with "
        "color, albedo, normal and depth."
        for name, what in (("nolobes", "lobes"), ("nohalves", "halves"))
    ]
    seeds = ", ".join(f"{compare('full2', guides):+.0f} %" for guides in ("all", "passes", "plain"))
    return f"{' '.join(told)} Another seed alone makes it {seeds}."


def make_figures(data: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/research/affinity_ablation.md by place."""
    variants = data["variants"]
    full = variants["full"]
    means = [
        [told, *(f"{find_mean(variants[name]['errors'][guides]):.2f}" for name in NAMES)]
        for guides, told in SETS.items()
    ]
    tables = [
        make_table(
            [told, *NAMES.values()],
            [
                [f"{spp} spp", *(f"{variants[name]['errors'][guides][spp]:.2f}" for name in NAMES)]
                for spp in full["errors"][guides]
            ],
        )
        for guides, told in SETS.items()
    ]
    run = {
        "Training steps of each variant": full["steps"],
        "Training frames": f"{full['frames']} of {full['scenes']} random scenes",
        "Frames that errors are measured on": f"{full['frames_aside']} of other scenes",
        "Machine": describe_run(data),
    }
    return {
        "run": list_facts(run),
        "means": make_table(["guides", *NAMES.values()], means),
        "verdict": describe_verdict(variants),
        "samples": "\n\n".join(tables),
    }
