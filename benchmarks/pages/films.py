"""The figures of docs/windows.md, measured by `benchmarks/films`."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import judge, make_table

NAMES = {
    "hall": "`hall`: Blender, the camera walks past glossy things",
    "juggler": "`juggler`: Blender, balls and a ring fly, the camera rests",
    "lamps": "`lamps`: Blender, lamps change and fly, the camera drifts",
    "dining-room": "`dining-room`: Mitsuba, the camera turns",
    "country-kitchen": "`country-kitchen`: Mitsuba, the camera turns",
}
GOALS = {
    "high": {"error": 0.6, "flicker": 0.4, "came_into_view": 1.1},
    "auto": {"error": 0.7, "flicker": 0.4, "came_into_view": 1.1},
}
"""Goals of each quality, over its base frame by frame."""
MAX_NOISE_OF_REFERENCE = 0.005
"""As in ``benchmarks/films``: films with noisier references have an error only."""
KEYS = ("alone", "window")
TITLES = {"error": "error", "flicker": "flicker", "came_into_view": "error of what came into view"}


def make_error_table(films: dict[str, Any], figure: str) -> str:
    """Return a figure of every film: noisy, frame by frame, and with windows."""
    rows = []
    for name, film in films.items():
        if figure != "error" and film["noise_of_reference"] > MAX_NOISE_OF_REFERENCE:
            continue
        alone = [f"{film['alone'][key][figure]:.4f}" for key in ("noisy", "high", "oidn", "auto")]
        window = [f"{film['window'][key][figure]:.4f}" for key in ("high", "auto")]
        rows.append([NAMES[name], *alone, *window])
    header = ["", "noisy", "`high`", "Open Image Denoise", "both", "`high`, window", "Open Image Denoise, window"]
    return make_table(header, rows)


def make_goal_table(ratios: dict[str, Any]) -> str:
    """Return the mean ratios over the films, with their goals."""
    names = {"high": "`high`", "auto": "Open Image Denoise"}
    rows = [
        [f"{names[quality]}: {TITLES[figure]}", f"{ratios[quality][figure]:.2f}", f"{goal:.1f}", met]
        for quality, goals in GOALS.items()
        for figure, goal in goals.items()
        for met in [judge(ratios[quality][figure] <= goal)]
    ]
    return make_table(["window of two frames over frame by frame", "mean ratio", "goal", ""], rows)


def make_many_table(many: dict[str, Any]) -> str:
    """Return the errors of frames with many samples: noisy, by themselves, and with windows."""
    names = {"high": "`high`", "auto": "Open Image Denoise mixed with `high`"}
    rows = [
        [f"`{film}`, {names[quality]}", f"{cells['noisy']:.5f}", *(f"{cells[quality][key]:.5f}" for key in KEYS)]
        for film, cells in many.items()
        for quality in names
    ]
    spp = next(iter(many.values()))["spp"]
    return make_table([f"{spp} samples per pixel", "noisy", "by itself", "window"], rows)


def make_figures(data: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/windows.md by place."""
    figures = {
        "error": make_error_table(data["films"], "error"),
        "flicker": make_error_table(data["films"], "flicker"),
        "goals": make_goal_table(data["ratios"]),
    }
    if "many_samples" in data:
        figures["many"] = make_many_table(data["many_samples"])
    return figures
