"""The figures of docs/results.md on upsampling and on sequences, measured by `upsampling/measure.py`."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import describe_run, judge, list_facts, make_table

TITLES = {
    "bilinear": "bilinear",
    "normal (tuned)": "`normal`, tuned",
    "default": "default (`ggx`)",
    **{f"{name} (tuned)": f"`{name}`, tuned" for name in ("sg", "sg_mixture", "asg", "ggx")},
    "ggx (tuned) with hits": "`ggx`, tuned, with hit distances",
}
MIN_GAIN, MAX_REPEATS_PERCENT = 8.0, 30.0
"""Goals: error of pixels before they are shaded again over that after, and pixels that are chosen twice in turn."""
LOBES = ("sg", "sg_mixture", "asg", "ggx")
MAX_RATIO_INDIRECT = 0.6
"""Goal: largest error of the best lobes over that of tuned normals, indirect light."""


def list_measured(cells: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Return the named measurements of a part, without its settings."""
    return [(name, cell) for name, cell in cells.items() if isinstance(cell, dict)]


def make_orbit_table(orbit: dict[str, Any]) -> str:
    """Return the errors of one frame, alone and with the frames before it."""
    rows = [
        [
            f"{light} light, {settings}",
            f"{cells['spatial']['rel_mse']:.4f}",
            f"{cells['temporal']['rel_mse']:.4f}",
            f"{cells['ratio']['rel_mse']:.2f}",
        ]
        for light in ("indirect", "all")
        for settings, cells in orbit[light].items()
        if settings in ("default", "tuned")
    ]
    return make_table(["", "alone", "with its history", "ratio"], rows)


def make_adaptive_table(adaptive: dict[str, Any]) -> str:
    """Return the errors before and after the least supported pixels are shaded again."""
    keys = ("masked_before", "masked_after", "gain", "all_before", "all_after")
    rows = [
        [name, *(f"{cells[key]:.{1 if key == 'gain' else 4}f}" for key in keys)]
        for name, cells in list_measured(adaptive)
    ]
    return make_table(["after", "before", "shaded again", "times lower", "image before", "image after"], rows)


def make_ghost_table(ghosts: dict[str, Any]) -> str:
    """Return the errors with history over those without, by what came into view and how many frames ago."""
    masks = [f"{kind}, {age} ago" for kind in ("surfaces", "reflections") for age in (0, 1, 2)]
    rows = [
        [name, *(f"{cells[mask]['ratio']:.2f}" if mask in cells else "" for mask in (*masks, "all"))]
        for name, cells in list_measured(ghosts)
    ]
    return make_table(["", *masks, "all pixels"], rows)


def make_speed_table(speed: dict[str, Any]) -> str:
    """Return the times of a frame, alone and with history, of every stage, and of its passes over memory."""
    stages = list(dict.fromkeys(stage for _, cells in list_measured(speed) for stage in cells["stages_milliseconds"]))
    rows = [
        [
            name,
            f"{cells['alone_milliseconds']:.0f}",
            f"{cells['temporal_milliseconds']:.0f}",
            f"{cells['temporal_over_alone']:.1f}",
            *(f"{cells['stages_milliseconds'].get(stage, 0.0):.0f}" for stage in stages),
            f"{cells['roofline_milliseconds']:.0f}",
            f"{100.0 * cells['roofline_milliseconds'] / cells['temporal_milliseconds']:.0f} %",
        ]
        for name, cells in list_measured(speed)
    ]
    return make_table(["milliseconds", "alone", "with history", "ratio", *stages, "memory alone", "share"], rows)


def make_upsampling_figures(data: dict[str, Any]) -> dict[str, str]:
    """Return the figures on upsampling and on sequences by place."""
    parts = data["parts"]
    spatial, flicker = parts["spatial"], parts["flicker"]
    lights = tuple(spatial[light] for light in ("indirect", "all"))
    alone = [
        [title, *(f"{cells[key][column]:.4f}" for cells in lights for column in ("rel_mse", "rel_mse, specular"))]
        for key, title in TITLES.items()
    ]
    indirect, best = (
        spatial["indirect"],
        [
            min(cells[f"{name} (tuned)"]["rel_mse"] for name in LOBES) / cells["normal (tuned)"]["rel_mse"]
            for cells in lights
        ],
    )
    still = max(cells["one turn"]["largest"] for _, cells in list_measured(parts["still"]))
    cuts = list_measured(parts["cut"])
    same = all(cells[kind]["same_bits"] for _, cells in cuts for kind in ("announced", "unannounced"))
    return {
        "upsampling-run": list_facts(
            {
                "Samples per pixel of the reference for indirect light": indirect["reference_spp"],
                "Samples per pixel of the reference for all light": spatial["all"]["reference_spp"],
                "Settings of `normal` that were tried": indirect["normal (tuned)"]["tried"],
                "Settings of `ggx` that were tried": indirect["ggx (tuned)"]["tried"],
                "Machine": describe_run(data),
            }
        ),
        "upsampling": make_table(["", "indirect light", "specular", "all light", "specular"], alone),
        "upsampling-goal": list_facts(
            {
                "Error of the best lobes over tuned normals, indirect light": (
                    f"{best[0]:.2f} (goal {MAX_RATIO_INDIRECT:g}: {judge(best[0] <= MAX_RATIO_INDIRECT)})"
                ),
                "Error of the best lobes over tuned normals, all light": f"{best[1]:.2f}",
            }
        ),
        "orbit": make_orbit_table(parts["orbit"]),
        "exactness": list_facts(
            {
                "Largest relative error after one turn": f"{still:.0e}",
                f"Frames after a cut, {len(cuts)} pairs of shots": (
                    f"{'the same bits as' if same else 'other bits than'} those of a fresh start"
                ),
            }
        ),
        "adaptive-run": list_facts(
            {"Share of the pixels that is shaded again": f"{100 * parts['adaptive']['spatial']['share']:.0f} %"}
        ),
        "adaptive": make_adaptive_table(parts["adaptive"]),
        "ghosts": make_ghost_table(parts["ghosting"]),
        "flicker-run": list_facts(
            {"Frames": flicker["frames"], "Samples per pixel of the references": flicker["reference_spp"]}
        ),
        "flicker": make_table(
            ["", "each frame alone", "with history", "ratio"],
            [
                [name, f"{cells['alone']:.4f}", f"{cells['temporal']:.4f}", f"{cells['ratio']:.2f}"]
                for name, cells in list_measured(flicker)
            ],
        ),
        "history-time": make_speed_table(parts["speed"]),
    }


def make_sky_figures(skies: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/upsampling.md: errors of scenes with lamps and skies in view."""
    scenes = skies["scenes"]
    methods = list(next(iter(scenes.values()))["errors"])
    errors = [
        [name, *(f"{cells['errors'][method]['all']:.4f}" for method in methods)] for name, cells in scenes.items()
    ]
    shining = [
        [name, *(f"{cells['errors'][method]['lamps and sky']:.4f}" for method in methods)]
        for name, cells in scenes.items()
    ]
    again, by_spp = [], []
    for name, cells in scenes.items():
        held = cells["shaded again"]
        shares = (f"{100.0 * held[key]:.0f} %" for key in ("share of the error", "repeats", "repeats, kept"))
        share, *repeats = shares
        before, after = held["error before"], held["error after"]
        lower = f"{before / after:.1f} ({judge(before / after >= MIN_GAIN)})"
        again.append([name, share, f"{before:.4f}", f"{after:.4f}", lower, *repeats])
        tried = held["error after, by spp"]
        by_spp.append([name, *(f"{before / error:.1f}" for error in tried.values())])
    header = ["5 % shaded again", "of the error", "before", "after", f"times lower (goal {MIN_GAIN:g})"]
    header += ["repeats", f"repeats, kept (goal {MAX_REPEATS_PERCENT:g} %)"]
    each = skies["shaded again"]["share"]
    return {
        "sky-errors": make_table(["all pixels", *methods], errors),
        "sky-lamps": make_table(["lamps and sky", *methods], shining),
        "sky-again": make_table(header, again),
        "sky-spp": make_table(
            ["samples of each pixel", *tried],
            [["for the whole image", *(f"{each * int(spp):g}" for spp in tried)], *by_spp],
        ),
        "sky-run": list_facts({"Machine": describe_run(skies)}),
    }
