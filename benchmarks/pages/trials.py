"""The figures of the pages docs/research/mixing_networks.md, quality_trials.md and refinement.md."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import Any

from benchmarks.pages.tables import list_facts, make_table


def make_trials(trials: list[dict[str, Any]]) -> str:
    """Return a heading and a table for each group of trials."""
    parts = []
    for group, members in groupby(trials, key=lambda trial: trial["group"]):
        rows = list(members)
        header = ["tried", *rows[0]["columns"], "verdict"]
        table = [
            [row["name"], *map(str, row["values"]), ": ".join(word for word in (row["verdict"], row["note"]) if word)]
            for row in rows
        ]
        parts.append(f"### {group}\n\n{make_table(header, table)}")
    return "\n\n".join(parts)


def make_ratios(ratios: dict[str, dict[str, float]]) -> str:
    """Return the trainer's table."""
    names = list(next(iter(ratios.values())))
    rows = [[f"{spp} spp", *(f"{row[name]:.2f}" for name in names)] for spp, row in ratios.items()]
    return make_table(["samples", *names], rows)


SETS = {
    "all": "all",
    "passes": "split light, albedos, normal, depth, roughness; no halves",
    "plain": "color, one albedo, normal, depth; no halves",
    "shared": "all, no halves, and a pixel filter that shares samples",
}


HALVES = {"all": "all guides and halves", "less": "fewer, no halves", "color": "light alone", "drawn": "drawn textures"}
RESULTS_NAMED = {"balanced": "`balanced`", "high": "`high`", "peer": "Open Image Denoise"}


def make_shares(ratios: dict[str, dict[str, float]], image: str, other: str) -> str:
    """Return the table of a network that mixes another image into an image: its errors over those of both."""
    names = [f"over {image}", "largest", f"over {other}", "largest"]
    keys = ("over_image", "over_image_largest", "over_other", "over_other_largest")
    rows = [[name, str(row["images"]), *(f"{row[key]:.2f}" for key in keys)] for name, row in ratios.items()]
    return make_table(["frames", "count", *names], rows)


def rename(ratios: dict[str, dict[str, float]], sets: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """Return the rows of the trainer with names in words: what was mixed, its guides, its samples."""
    named = {}
    for group, row in ratios.items():
        first, guides, samples = group.split(" ", 2)
        words = [sets[guides], samples] if sets is SETS else [RESULTS_NAMED[first], sets[guides], samples]
        # Drawn textures have no samples.
        named[", ".join(word for word in words if word != "0 spp")] = row
    return named


def make_share_figures(share: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/research/mixing_networks.md by place."""
    detail, peer = share["noisy"]["kept aside"] | share["refined"]["kept aside"], share["peer"]["kept aside"]
    made = [f"{share[name]['scenes']} ({result})" for name, result in (("noisy", "`balanced`"), ("refined", "`high`"))]
    drawn = [str(share[name]["drawn_frames"]) for name in ("noisy", "refined")]
    return {
        "training": list_facts({"Random scenes": ", ".join(made), "Frames of drawn textures": ", ".join(drawn)}),
        "detail": make_shares(rename(detail, HALVES), "the result", "the noisy image"),
        "peer": make_shares(rename(peer, SETS), "Open Image Denoise", "ours"),
    }


def make_trial_figures(trials: dict[str, Any], training: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/research/quality_trials.md by place."""
    facts = {"Random scenes": len(training["scenes"]), "Networks": 3, "Weights": training["weights"]}
    return {
        "trials": make_trials(trials["trials"]),
        "networks": list_facts(facts),
        "networks-errors": make_ratios(training["ratios"]),
    }


def make_refinement_figures(trials: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/research/refinement.md by place."""
    names = ("balanced", "with similarities", "without")
    rows = [
        [f"{guides}, {spp} spp", *(f"{trials[name][guides][spp]:.2f}" for name in names)]
        for guides, row in trials["without"].items()
        for spp in row
    ]
    seconds = trials["seconds at 1920x1080, two threads, best of three"]
    light = trials["light shared out"]
    ways = (
        "up to half the mean",
        "in proportion to all light",
        "a twentieth in proportion, more up to half the mean",
        "where light is missing",
    )
    shared = [
        [f"{guides}, {spp} spp", f"{before:.3f}", *(f"{light[way][guides][spp]:.3f}" for way in ways)]
        for guides, row in light["light before"].items()
        for spp, before in row.items()
    ]
    longer = trials["longer training"]["errors"]
    guides = list(next(iter(longer.values())))
    trained = [[name, *(f"{row[each]:.3f}" for each in guides)] for name, row in longer.items()]
    less = [
        [name, *(f"{row[key]:.2f}" if key in row else "" for key in ("shots", "largest", "interiors", "built-in"))]
        for name, row in trials["less work"]["rows"].items()
    ]
    part = trials["less work"]["share of the time"]
    shares = {name: f"{part[name]:.2f}" for name in ("passes over the layers", "network", "what is taken back")}
    blender = [
        [name, f"{row['before']:.2f}", f"{row['after']:.2f}"]
        for name, row in trials["less work"]["trained on frames of Blender"]["rows"].items()
    ]
    more, keys = trials["more of Blender"], ("all", "largest", "plain", "color", "built-in")
    tries = {
        name: [[tried, *(f"{row[key]:.2f}" if key in row else "" for key in keys)] for tried, row in more[name].items()]
        for name in ("high", "auto")
    }
    drawn = more["residual"]
    residual = [[name, f"{value:.2f}", f"{drawn['with'][name]:.2f}"] for name, value in drawn["without"].items()]
    header = ["all guides", "largest", "plain", "color", "built-in scenes"]
    facts = {"Training steps of each network": trials["steps"], "Training files": trials["frames"]}
    return {
        "similarities-run": list_facts(facts),
        "similarities": make_table(["guides", "`balanced`", "with similarities", "without"], rows),
        "light": make_table(["guides", "light before", *ways], shared),
        "longer": make_table(["weights", *guides], trained),
        "less": make_table(["`high`", "shots of Blender", "largest", "public interiors", "built-in scenes"], less),
        "less-shares": make_table(["part of `high`", "share of its time"], [[*pair] for pair in shares.items()]),
        "less-trained": make_table(["frames, two smaller passes", "before", "after"], blender),
        "more-high": make_table(["weights of `high`", *header], tries["high"]),
        "more-auto": make_table(["`auto`", *header[:-1]], [row[:-1] for row in tries["auto"]]),
        "more-residual": make_table(["frames kept aside", "without", "with"], residual),
        "time": make_table(["method", "seconds"], [[name, f"{value:.1f}"] for name, value in seconds.items()]),
    }
