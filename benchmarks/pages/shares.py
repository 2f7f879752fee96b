"""The figures of docs/developers/research/mixing_networks.md, measured by `benchmarks/training/shares.py`."""

from typing import Any

from benchmarks.pages.tables import list_facts, make_table

SETS = {
    "all": "all",
    "passes": "split light, albedos, normal, depth, roughness; no halves",
    "plain": "color, one albedo, normal, depth; no halves",
    "shared": "all, no halves, and a pixel filter that shares samples",
}
HALVES = {"all": "all guides and halves", "less": "fewer, no halves", "color": "light alone", "drawn": "drawn textures"}


def make_shares(ratios: dict[str, dict[str, float]], image: str, other: str) -> str:
    """Return the table of a network that mixes another image into an image: its errors over those of both."""
    keys = ("over_image", "over_image_largest", "over_other", "over_other_largest")
    rows = []
    for group, row in ratios.items():
        # What was mixed, its guides, its samples. Drawn textures have no samples.
        mixed, guides, samples = group.split(" ", 2)
        words = [SETS[guides]] if mixed == "peer" else [f"`{mixed}`", HALVES[guides]]
        name = ", ".join(words if samples == "0 spp" else [*words, samples])
        rows.append([name, str(row["images"]), *(f"{row[key]:.2f}" for key in keys)])
    return make_table(["frames", "count", f"over {image}", "largest", f"over {other}", "largest"], rows)


def make_figures(share: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/research/mixing_networks.md by place."""
    detail = share["noisy"]["kept aside"] | share["refined"]["kept aside"]
    made = [f"{share[name]['scenes']} ({result})" for name, result in (("noisy", "`balanced`"), ("refined", "`high`"))]
    drawn = [str(share[name]["drawn_frames"]) for name in ("noisy", "refined")]
    return {
        "training": list_facts({"Random scenes": ", ".join(made), "Frames of drawn textures": ", ".join(drawn)}),
        "detail": make_shares(detail, "the result", "the noisy image"),
        "peer": make_shares(share["peer"]["kept aside"], "Open Image Denoise", "ours"),
    }
