"""The figures of docs/developers/interactive.md, by `lobewise bench interactive` and `benchmarks/interactive`."""

from typing import Any

from benchmarks.pages.tables import describe_run, judge, list_facts, make_table

STAGES = {
    "gbuffer": "guides and direct light",
    "indirect": "indirect light at 1/4",
    "upsampling": "upsampling over space and time",
    "adaptive": "re-computation of 5 %",
    "composite": "filter of direct light, composite",
    "frame": "the whole frame",
}
CHAINS = {
    "none": "interpolated on the screen",
    "normal": "geometry-aware",
    "normal, tuned": "geometry-aware, tuned",
    "sg": "`sg`",
    "asg": "`asg`",
    "ggx": "`ggx`",
}
TARGET_RATE = {"paths": 20.0, "voxel_cones": 12.0}
"""Goals, frames per second on two cores at 512x512."""
MAX_RATIO = 0.6
"""Goal: largest error of `ggx` over that of the geometry-aware chain."""
MAX_SECONDS_TO_FIRST_PICTURE = 2.0
"""Goal: longest time from the command to the first picture in the browser, seconds."""


def make_stage_table(stages: dict[str, Any], device: str) -> str:
    """Return milliseconds by stage, one column for each method and size."""
    rows = stages["devices"][device]
    header = [f"{row['method'].replace('_', ' ')}, {row['width']}x{row['height']}" for row in rows]
    lines = [[title, *(f"{1000.0 * row['seconds'][name]:.1f}" for row in rows)] for name, title in STAGES.items()]
    lines.append(["frames per second", *(f"{row['frames_per_second']:.1f}" for row in rows)])
    return make_table(["milliseconds", *header], lines)


def make_quality_table(quality: dict[str, Any]) -> str:
    """Return the errors of every scene and chain."""
    lines = []
    for scene, kinds in quality["scenes"].items():
        for chain, title in CHAINS.items():
            cells = []
            for kind in ("single frame", "over time"):
                row = kinds[kind][chain]
                cells += [f"{row['without_adaptive']:.4f}", f"{row['rel_mse']:.4f}", f"{row['rel_mse_specular']:.4f}"]
            lines.append([scene, title, *cells])
    header = ["scene", "compared"]
    for kind in ("one frame", "8 frames"):
        header += [kind, f"{kind}, 5 % again", "of these, specular pixels"]
    lines = [header, ["---", "---"] + ["---:"] * 6, *lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def compute_ratios(quality: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return by scene the error of `ggx` over time, 5 % computed again, over geometry-aware and over tuned."""
    found = {}
    for scene, kinds in quality["scenes"].items():
        rows = kinds["over time"]
        ours = rows["ggx"]["rel_mse"]
        found[scene] = ours / rows["normal"]["rel_mse"], ours / rows["normal, tuned"]["rel_mse"]
    return found


def make_rate_table(viewer: dict[str, Any]) -> str:
    """Return frames per second by method, with and without a browser that draws on the same cores."""
    lines = []
    for name, cell in viewer["pace"].items():
        rate, goal = cell["frames_per_second"], TARGET_RATE.get(name)
        told = "" if goal is None else f"{goal:g}: {judge(rate >= goal)}"
        drawn = viewer["motion"][name]["frames_per_second"]
        lines.append([name.replace("_", " "), f"{rate:.1f}", told, f"{drawn:.1f}"])
    header = ["512x512, one of 4x4 pixels", "frames per second", "goal", "with the browser's software GL beside it"]
    return make_table(header, lines)


def make_viewer_facts(viewer: dict[str, Any]) -> str:
    """Return how soon the viewer shows a picture, and how steady it is on a long orbit."""
    first, orbit = viewer["first_picture"]["paths"], viewer["orbit"]
    goal = f"goal {MAX_SECONDS_TO_FIRST_PICTURE:g}: {judge(first <= MAX_SECONDS_TO_FIRST_PICTURE)}"
    events = f"{orbit['dropped_connections']} dropped connections, {len(orbit['console_errors'])} errors on the console"
    growth = f"{100.0 * orbit['growth']:+.1f} %"
    return list_facts(
        {
            "First picture in the browser after the command": f"{first:.1f} s ({goal})",
            f"Orbit of {orbit['frames']} frames": events,
            "Growth of the rendering process's memory over the second half of the orbit": growth,
            "Machine": describe_run(viewer),
        }
    )


def make_figures(quality: dict[str, Any], stages: dict[str, Any], viewer: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/interactive.md by place."""
    tables = "\n\n".join(
        f"Rays on {'the CPU' if device == 'cpu' else device}:\n\n{make_stage_table(stages, device)}"
        for device in stages["devices"]
    )
    ratios = [
        [f"`{scene}`", f"{plain:.2f} ({judge(plain <= MAX_RATIO)})", f"{tuned:.2f}"]
        for scene, (plain, tuned) in compute_ratios(quality).items()
    ]
    return {
        "stages": tables,
        "stages-run": list_facts(
            {
                "Frames": f"median of {stages['frames']}, on an orbit of `{stages['scene']}`, one degree a frame",
                "Machine": describe_run(stages),
            }
        ),
        "rates": make_rate_table(viewer),
        "viewer": make_viewer_facts(viewer),
        "errors": make_quality_table(quality),
        "ratios": make_table(
            ["scene", f"over the geometry-aware chain (goal {MAX_RATIO:g})", "over the chain tuned on this scene"],
            ratios,
        ),
        "errors-run": list_facts(
            {
                "Jittered sample sets of the reference": quality["reference_samples"],
                "Camera": f"an orbit of {quality['degrees_per_frame']:g} degrees a frame",
                "Machine": describe_run(quality),
            }
        ),
    }
