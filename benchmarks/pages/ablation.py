"""The text of docs/research/affinity_ablation.md, from what `benchmarks/training/affinity_ablation.py` has measured."""

from __future__ import annotations

import math
from typing import Any

from benchmarks.pages.tables import describe_run, make_table

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

TEXT = """# What the affinity network owes to lobes and to halves

Written by `benchmarks/publish.py` from `benchmarks/results/affinity_ablation.json`, which `python -m benchmarks.training.affinity_ablation` makes; no figure is typed by hand. {run}.

The network that [training.md](../training.md) trains gives two pixels the weight `exp(-distance of their features)` times the similarity of their reflection lobes, with an exponent for every pixel. It sees how far the two halves of the samples are apart. Here each of the two is left out, in training and in judging. All variants had {steps} steps of
training on the same {frames} frames of {scenes} random scenes, and are judged on {aside} frames of other scenes. Steps are equal, not minutes: without lobes a step is cheaper, and minutes of a machine that does other work tell little. Two seeds of the whole network tell how far runs differ by chance.

Error (`rel_mse`) over that of Open Image Denoise with the same guides, the geometric mean over sample counts of the means below; less is better:

{means}

{verdict}

By samples per pixel, the geometric mean over frames:

{tables}
"""


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


def make_ablation_page(data: dict[str, Any]) -> str:
    """Return docs/research/affinity_ablation.md."""
    variants = data["variants"]
    full = variants["full"]
    names = list(NAMES)
    means = [
        [told, *(f"{find_mean(variants[name]['errors'][guides]):.2f}" for name in names)]
        for guides, told in SETS.items()
    ]
    tables = []
    for guides, told in SETS.items():
        rows = [
            [f"{spp} spp", *(f"{variants[name]['errors'][guides][spp]:.2f}" for name in names)]
            for spp in full["errors"][guides]
        ]
        tables.append(make_table([told, *NAMES.values()], rows))
    return TEXT.format(
        run=describe_run(data),
        steps=full["steps"],
        frames=full["frames"],
        scenes=full["scenes"],
        aside=full["frames_aside"],
        means=make_table(["guides", *NAMES.values()], means),
        verdict=describe_verdict(variants),
        tables="\n\n".join(tables),
    )
