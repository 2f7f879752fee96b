"""The text of docs/results.md and of the figures in README.md."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.quality import make_readme_quality
from benchmarks.pages.tables import describe_run, make_table
from benchmarks.pages.upsampling import make_upsampling_section
from benchmarks.pages.users import make_readme_users

COLUMNS = ("noisy", "normal", "band-limited", "sg", "sg_mixture", "asg", "ggx", "oidn")
TITLES = {
    "noisy": "noisy",
    "normal": "normal-aware, tuned",
    "band-limited": "band-limited, tuned",
    "sg": "`sg`",
    "sg_mixture": "`sg_mixture`",
    "asg": "`asg`",
    "ggx": "`ggx`",
    "oidn": "Open Image Denoise",
}


TIMED = ("normal", "sg", "sg_mixture, 3 lobes", "sg_mixture, 3 coaxial", "asg", "ggx")
"""Names in filters.json and paper_table.json."""


def make_error_table(similarities: dict[str, Any], key: str, samples: list[str]) -> str:
    """Return the errors ``key`` of every scene at the sample counts ``samples``."""
    rows = []
    for scene, by_spp in similarities["scenes"].items():
        for spp in samples:
            row = by_spp[spp]
            cells = []
            for name in COLUMNS:
                best = f"{name} (for specular)"
                source = row[best] if key == "rel_mse_specular" and best in row else row.get(name)
                cells.append("" if source is None else f"{source[key]:.4f}")
            rows.append([scene, spp, *cells])
    return make_table(["scene", "spp", *(TITLES[name] for name in COLUMNS)], rows)


def make_ratio_table(similarities: dict[str, Any]) -> str:
    """Return the default's error over that of the tuned baseline and over the neural peer's."""
    rows = []
    for scene, by_spp in similarities["scenes"].items():
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


def make_anisotropic_table(similarities: dict[str, Any]) -> str:
    """Return the errors on the anisotropic pixels, and how much lower than `sg` the anisotropic lobes are."""
    rows = []
    for scene, by_spp in similarities["scenes"].items():
        for spp, row in by_spp.items():
            if "rel_mse_anisotropic" not in row["sg"]:
                continue
            errors = [row[name]["rel_mse_anisotropic"] for name in ("sg", "sg_mixture", "asg", "ggx")]
            gains = [f"{100.0 * (1.0 - error / errors[0]):.0f} %" for error in errors[2:]]
            rows.append([scene, spp, *(f"{error:.4f}" for error in errors), *gains])
    header = ["scene", "spp", "`sg`", "`sg_mixture`", "`asg`", "`ggx`", "`asg` below `sg`", "`ggx` below `sg`"]
    return make_table(header, rows)


def make_hit_tables(similarities: dict[str, Any], hits: dict[str, Any]) -> tuple[str, str]:
    """Return what the hit-distance term does on the four scenes, and on the one made for it."""
    names = ("sg", "asg", "ggx")
    rows = []
    for scene, by_spp in similarities["scenes"].items():
        for spp, row in by_spp.items():
            ratios = [row[f"{name} with hits"]["rel_mse"] / row[name]["rel_mse"] for name in names]
            rows.append([scene, spp, *(f"{ratio:.2f}" for ratio in ratios)])
    header = [f"`{name}` with over without" for name in names]
    scenes = make_table(["scene", "spp", *header], rows)
    rows = []
    for spp, row in hits["samples"].items():
        for name in names:
            cells = []
            for key, tuned in (("rel_mse", "tuned"), ("rel_mse_contacts", "tuned for contacts")):
                for kind in ("default", tuned):
                    without, with_hits = row[name][kind][key], row[f"{name} with hits"][kind][key]
                    cells.append(f"{without:.5f}, {with_hits:.5f}")
            rows.append([spp, f"`{name}`", *cells])
    columns = ["image, default", "image, tuned", "contacts, default", "contacts, tuned"]
    return scenes, make_table(["spp", "similarity", *columns], rows)


def make_paper_table(paper: dict[str, Any]) -> str:
    """Return our times and ratios beside the paper's."""
    rows = []
    for row in paper["rows"]:
        for name, cell in row["similarities"].items():
            theirs = f"{cell['paper_ratio_to_normal']:.2f}" if "paper_ratio_to_normal" in cell else ""
            cells = [f"{cell['milliseconds']:.1f} ms", f"{cell['ratio_to_normal']:.2f}", theirs]
            rows.append([row["form"], str(row["radius"]), f"`{name}`", *cells])
    return make_table(["form", "radius", "similarity", "time", "ratio to normal", "the paper's ratio"], rows)


def make_time_tables(filters: dict[str, Any]) -> str:
    """Return the kernel times and those beside Open Image Denoise."""
    rows = []
    for row in filters["kernels"]:
        cells = [f"{row['width']}x{row['height']}", row["form"], str(row["radius"])]
        for name in TIMED:
            cells.append(f"{row[name]['milliseconds']:.1f} ms ({row[name]['ratio_to_normal']:.2f})")
        cells.append(f"{row['normal']['ns_per_tap_and_pixel']:.3f}")
        rows.append(cells)
    kernels = make_table(["size", "form", "radius", *TIMED, "normal, ns per tap and pixel"], rows)
    rows = [
        [size, name, f"{cell['milliseconds']:.0f} ms", f"{cell['times_faster_than_oidn']:.1f}"]
        for size, cells in filters["oidn"].items()
        for name, cell in cells.items()
    ]
    return kernels + "\n\n" + make_table(["size", "what", "time", "times faster than OIDN"], rows)


def make_readme_figures(quality: dict[str, Any], upsampling: dict[str, Any], users: dict[str, Any]) -> str:
    """Return the block of the README."""
    cells = upsampling["parts"]["orbit"]["all"]["default"]
    alone, over_time = cells["spatial"], cells["temporal"]
    flicker = upsampling["parts"]["flicker"]["whole frames"]
    return f"""{make_readme_users(users)}

{make_readme_quality(quality)}

With one of 4x4 pixels shaded (4 samples each), upsampling leaves an error of {alone["rel_mse"]:.4f} in `showroom`; with the fifteen frames before it, on a
slow orbit, {over_time["rel_mse"]:.4f}. Over {upsampling["parts"]["flicker"]["frames"]} denoised frames the flicker falls to {flicker["ratio"]:.2f} of that of frames denoised one by one. All
similarities, other sample counts and how they were made: [docs/results.md](docs/results.md)."""


def make_results_page(
    similarities: dict[str, Any],
    filters: dict[str, Any],
    paper: dict[str, Any],
    hits: dict[str, Any],
    upsampling: dict[str, Any],
) -> str:
    """Return docs/results.md."""
    every = list(next(iter(similarities["scenes"].values())))
    scenes, contacts = make_hit_tables(similarities, hits)
    return f"""# Results

Written by `benchmarks/publish.py` from `benchmarks/results/*.json`; do not edit.

## Error

`benchmarks/quality/similarities.py`, {describe_run(similarities)}. {similarities["size"]}x{similarities["size"]} pixels, full form, radius 8, references of
{similarities["reference_spp"]} samples per pixel, one noise realisation per cell. `rel_mse` is the mean of (a - r)^2 / (r^2 + 0.01). The normal-aware
baselines were tuned on each frame against its reference ({len(similarities["grid"]["normal_exponent"])} exponents times
{len(similarities["grid"]["screen_sigma"])} screen sigmas; band-limited: {len(similarities["grid"]["band_limited_normal_exponent"])} times {len(similarities["grid"]["band_limited_screen_sigma"])} times {len(similarities["grid"]["band_limit"])} band-limits); ours and Open Image Denoise
(default quality, noise-free albedo and normal) ran with their defaults, ours as `quality="fast"`.

{make_error_table(similarities, "rel_mse", every)}

On the specular pixels alone (baselines tuned for these):

{make_error_table(similarities, "rel_mse_specular", every)}

The default similarity's error over that of others, below 1 is better:

{make_ratio_table(similarities)}

### Anisotropic lobes

On the pixels whose two alphas differ by more than a third:

{make_anisotropic_table(similarities)}

### The hit-distance term

Error with the term over the error without it, all by default, on the four scenes:

{scenes}

It is above 1 nearly everywhere: the term narrows the kernel where the reflected thing is near, and the noise that it lets through
outweighs the blur that it saves. So it is off unless asked for. Tried besides, each on three or four scenes at 4 to 64 samples:
beta and screen sigma from a quarter to four times, the hit distance filtered by the lobes first, the largest distance of a 5x5
neighbourhood, and half of the inverse distance. None was below the error without the term on all four scenes.

On a scene made for it, thin posts that stand on satin metal (`benchmarks/quality/hit_distance.py`, {describe_run(hits)};
{hits["size"]}x{hits["size"]}, reference of {hits["reference_spp"]} samples per pixel; contacts are specular pixels whose hit is nearer than a tenth
of their depth; tuned is the best of {len(hits["factors"]) ** 2} settings of beta and screen sigma for that column), error without the term and with it:

{contacts}

It pays from some hundred samples per pixel on, where little noise is left.

{make_upsampling_section(upsampling)}
## Time

### The paper's table

`benchmarks/performance/paper_table.py`, {describe_run(paper)}. 1024x1024 pixels; the paper's ratios are those of its slide "Denoising
Performance" (Radeon HD 6990). Its times grow by less than two from radius 8 to 16, so its filter was separable. "3 lobes" have an axis
each, as fitted materials do; "3 coaxial" are the mixture that stands for GGX.

{make_paper_table(paper)}

### Every size

`benchmarks/performance/filters.py`, {describe_run(filters)}. Best of many runs, in turn within one process; in brackets the ratio to `normal`.

{make_time_tables(filters)}
"""
