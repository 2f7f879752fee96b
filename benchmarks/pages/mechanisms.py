"""The table of docs/developers/quality.md: what each mechanism of the denoiser is worth, and why it stays."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import describe_run, make_table

QUALITIES = ("balanced", "high", "auto")
GROUPS = ("tests/images", "crops", "blender")
REASONS = {
    "bound of fireflies": "keeps one huge pixel out of Open Image Denoise",
    "lamps": "the sum of the light of lamps: without it `film` loses a tenth",
    "damage": "keeps one huge pixel below 0 out of the light; no frame here has one",
    "mean emission": "edges of lamps of our own renderer (built-in scenes: street 1.06, corridor 1.02 in `high`)",
    "lamps without normals kept": "`fast` on files of color, albedo and normal, where lamps would be smeared",
    "keep light": "the sum of the light, at a cost in error",
    "peer's images may differ as noise does": "4 and 64 samples: 0.8 % in the mean, print 4 % (these shots have 16)",
}
"""Why a mechanism stays whose pictures say little, by its name."""


def make_mechanism_figures(board: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures by place, of ``switched_off.json``."""
    rows = []
    for name, by_quality in board["mechanisms"].items():
        cells = [" · ".join(_show(by_quality.get(quality, {}).get(group)) for group in GROUPS) for quality in QUALITIES]
        rows.append([name, *cells, REASONS.get(name) or _name_saved(by_quality)])
    table = make_table(
        ["switched off", *(f"`{quality}`" for quality in QUALITIES), "frames it saves, or why it stays"], rows
    )
    return {"mechanisms": f"{table}\n\n{_count_frames(board)}; {describe_run(board)}."}


def _count_frames(board: Mapping[str, Any]) -> str:
    """Return how many frames of each group were measured, and of which quality fewer."""
    rows = next(by_quality for by_quality in board["mechanisms"].values() if "auto" in by_quality)
    counts = {
        group: {quality: row[group]["frames"] for quality, row in rows.items() if group in row} for group in GROUPS
    }
    words = []
    for group, by_quality in counts.items():
        most = max(by_quality.values())
        fewer = [f"{count} with `{quality}`" for quality, count in by_quality.items() if count < most]
        words.append(f"{most} of {group}" + (f" ({', '.join(fewer)})" if fewer else ""))
    return ", ".join(words)


def _show(row: Mapping[str, Any] | None) -> str:
    return f"{row['trimmed']:.3f}" if row else ""


def _name_saved(by_quality: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> str:
    """Return the two frames whose error rises most without the mechanism, in any quality, and by which factor."""
    rises: dict[str, float] = {}
    for groups in by_quality.values():
        for row in groups.values():
            for frame, ratio in row["moved"].items():
                rises[frame] = max(rises.get(frame, 0.0), ratio)
    most = sorted(rises, key=rises.__getitem__, reverse=True)[:2]
    return ", ".join(f"`{frame}` {rises[frame]:.2f}" for frame in most if rises[frame] > 1.0)
