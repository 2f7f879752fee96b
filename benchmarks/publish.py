"""Write the figures of README.md and docs/results.md from the committed JSON; nothing else puts numbers there.

python benchmarks/publish.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
START, END = "<!-- figures:start -->", "<!-- figures:end -->"
COLUMNS = ("noisy", "normal", "band-limited", "sg", "ggx", "oidn")
TITLES = {
    "noisy": "noisy",
    "normal": "normal-aware, tuned",
    "band-limited": "band-limited, tuned",
    "sg": "`sg`",
    "ggx": "`ggx`",
    "oidn": "Open Image Denoise",
}


def make_table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def make_error_table(quality: dict[str, Any], key: str, samples: list[str]) -> str:
    """Return the errors ``key`` of every scene at the sample counts ``samples``."""
    rows = []
    for scene, by_spp in quality["scenes"].items():
        for spp in samples:
            row = by_spp[spp]
            cells = []
            for name in COLUMNS:
                best = f"{name} (for specular)"
                source = row[best] if key == "rel_mse_specular" and best in row else row.get(name)
                cells.append("" if source is None else f"{source[key]:.4f}")
            rows.append([scene, spp, *cells])
    return make_table(["scene", "spp", *(TITLES[name] for name in COLUMNS)], rows)


def make_ratio_table(quality: dict[str, Any]) -> str:
    """Return the default's error over that of the tuned baseline and over the neural peer's."""
    rows = []
    for scene, by_spp in quality["scenes"].items():
        for spp, row in by_spp.items():
            cells = [
                f"{row['default_over_normal']:.2f}",
                f"{row['default_over_normal_specular']:.2f}",
                f"{row['default']['rel_mse'] / row['band-limited']['rel_mse']:.2f}",
                f"{row['default']['rel_mse'] / row['oidn']['rel_mse']:.2f}" if "oidn" in row else "",
            ]
            rows.append([scene, spp, *cells])
    header = ["scene", "spp", "over normal-aware", "the same, specular pixels", "over band-limited", "over OIDN"]
    return make_table(header, rows)


def make_time_tables(filters: dict[str, Any]) -> str:
    """Return the kernel times and those beside Open Image Denoise."""
    rows = []
    for row in filters["kernels"]:
        cells = [f"{row['width']}x{row['height']}", row["form"], str(row["radius"])]
        for name in ("normal", "sg", "ggx"):
            cells.append(f"{row[name]['milliseconds']:.1f} ms ({row[name]['ratio_to_normal']:.2f})")
        cells.append(f"{row['normal']['ns_per_tap_and_pixel']:.3f}")
        rows.append(cells)
    kernels = make_table(["size", "form", "radius", "normal", "sg", "ggx", "normal, ns per tap and pixel"], rows)
    rows = [
        [size, name, f"{cell['milliseconds']:.0f} ms", f"{cell['times_faster_than_oidn']:.1f}"]
        for size, cells in filters["oidn"].items()
        for name, cell in cells.items()
    ]
    return kernels + "\n\n" + make_table(["size", "what", "time", "times faster than OIDN"], rows)


def describe_run(data: dict[str, Any]) -> str:
    """Return machine, threads and commit of a result."""
    machine = data["machine"]
    return f"{machine['processor']}, {machine['threads']} threads, commit {machine['commit']}"


def make_readme_figures(quality: dict[str, Any], filters: dict[str, Any]) -> str:
    """Return the block of the README."""
    table = make_error_table(quality, "rel_mse", ["4"])
    wide = filters["oidn"]["1920x1080"]
    kernel = wide["sg kernel, separable, radius 8"]
    recipe = wide["denoise(ggx, separable, radius 8): diffuse and specular"]
    oidn = wide["oidn, default quality"]
    return f"""Error (`rel_mse`, epsilon 0.01, lower is better) of the four built-in scenes, {quality["size"]}x{quality["size"]}, 4 samples per pixel. The two
baselines were tuned on each frame by grid search against its reference, `sg` and `ggx` ran with their defaults:

{table}

Time at 1920x1080 on {describe_run(filters).rsplit(",", 1)[0]}: the separable `sg` kernel takes {kernel["milliseconds"]:.0f} ms, a whole
`denoise` with `ggx` on diffuse and specular radiance {recipe["milliseconds"]:.0f} ms, Open Image Denoise {oidn["milliseconds"]:.0f} ms. All
figures, other sample counts and how they were made: [docs/results.md](docs/results.md)."""


def make_results_page(quality: dict[str, Any], filters: dict[str, Any]) -> str:
    """Return docs/results.md."""
    every = list(next(iter(quality["scenes"].values())))
    return f"""# Results

Written by `benchmarks/publish.py` from `benchmarks/results/*.json`; do not edit.

## Error

`benchmarks/quality.py`, {describe_run(quality)}. {quality["size"]}x{quality["size"]} pixels, full form, radius 8, references of
{quality["reference_spp"]} samples per pixel, one noise realisation per cell. `rel_mse` is the mean of (a - r)^2 / (r^2 + 0.01). The normal-aware
baselines were tuned on each frame against its reference ({len(quality["grid"]["normal_exponent"])} exponents times
{len(quality["grid"]["screen_sigma"])} screen sigmas; band-limited: {len(quality["grid"]["band_limited_normal_exponent"])} times {len(quality["grid"]["band_limited_screen_sigma"])} times {len(quality["grid"]["band_limit"])} band-limits); `sg`, `ggx` and Open Image Denoise
(default quality, noise-free albedo and normal) ran with their defaults.

{make_error_table(quality, "rel_mse", every)}

On the specular pixels alone (baselines tuned for these):

{make_error_table(quality, "rel_mse_specular", every)}

The default similarity's error over that of others, below 1 is better:

{make_ratio_table(quality)}

## Time

`benchmarks/filters.py`, {describe_run(filters)}. Best of many runs, in turn within one process; in brackets the ratio to `normal`.

{make_time_tables(filters)}
"""


def main() -> None:
    """Write both files."""
    quality = json.loads((RESULTS / "quality.json").read_text())
    filters = json.loads((RESULTS / "filters.json").read_text())
    readme = ROOT / "README.md"
    text = readme.read_text()
    head, rest = text.split(START)
    tail = rest.split(END)[1]
    readme.write_text(f"{head}{START}\n{make_readme_figures(quality, filters)}\n{END}{tail}")
    (ROOT / "docs" / "results.md").write_text(make_results_page(quality, filters))


if __name__ == "__main__":
    main()
