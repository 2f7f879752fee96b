"""Write the figures of README.md and docs/results.md from the committed JSON; nothing else puts numbers there.

python benchmarks/publish.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bench_page import load_machines, make_bench_page, write_pictures
from interactive_page import make_interactive_page
from performance_page import make_performance_page
from quality_page import make_quality_page, make_readme_quality
from quality_trials import make_trials_page
from streaming_page import make_streaming_page

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
INTERACTIVE = ("interactive_quality", "interactive", "viewer")
"""What docs/interactive.md is made of."""
PERFORMANCE = ("filters", "roofline", "scaling", "kernel_trials", "taps")
"""What docs/performance.md is made of."""
START, END = "<!-- figures:start -->", "<!-- figures:end -->"
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


def make_table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


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


def describe_run(data: dict[str, Any]) -> str:
    """Return machine, threads and commit of a result."""
    machine = data["machine"]
    return f"{machine['processor']}, {machine['threads']} threads, commit {machine['commit']}"


def make_readme_figures(quality: dict[str, Any], upsampling: dict[str, Any]) -> str:
    """Return the block of the README."""
    cells = upsampling["parts"]["orbit"]["all"]["default"]
    alone, over_time = cells["spatial"], cells["temporal"]
    flicker = upsampling["parts"]["flicker"]["whole frames"]
    return f"""{make_readme_quality(quality)}

With one of 4x4 pixels shaded (4 samples each), upsampling leaves an error of {alone["rel_mse"]:.4f} in `showroom`; with the fifteen frames before it, on a
slow orbit, {over_time["rel_mse"]:.4f}. Over {upsampling["parts"]["flicker"]["frames"]} denoised frames the flicker falls to {flicker["ratio"]:.2f} of that of frames denoised one by one. All
similarities, other sample counts and how they were made: [docs/results.md](docs/results.md)."""


def make_upsampling_section(data: dict[str, Any]) -> str:
    """Return the section on upsampling and on sequences."""
    parts = data["parts"]
    spatial, orbit, ghosts = parts["spatial"], parts["orbit"], parts["ghosting"]
    titles = {
        "bilinear": "bilinear",
        "normal (tuned)": "`normal`, tuned",
        "default": "default (`ggx`)",
        **{f"{name} (tuned)": f"`{name}`, tuned" for name in ("sg", "sg_mixture", "asg", "ggx")},
        "ggx (tuned) with hits": "the same with hit distances",
    }
    lights = tuple(spatial[light] for light in ("indirect", "all"))
    alone = [
        [title, *(f"{cells[key][column]:.4f}" for cells in lights for column in ("rel_mse", "rel_mse, specular"))]
        for key, title in titles.items()
    ]
    over_time = [
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
    again = [
        [
            name,
            f"{cells['masked_before']:.4f}",
            f"{cells['masked_after']:.4f}",
            f"{cells['gain']:.1f}",
            f"{cells['all_before']:.4f}",
            f"{cells['all_after']:.4f}",
        ]
        for name, cells in parts["adaptive"].items()
        if isinstance(cells, dict)
    ]
    masks = [f"{kind}, {age} ago" for kind in ("surfaces", "reflections") for age in (0, 1, 2)]
    trails = [
        [name, *(f"{cells[mask]['ratio']:.2f}" if mask in cells else "" for mask in (*masks, "all"))]
        for name, cells in ghosts.items()
        if isinstance(cells, dict)
    ]
    flicker = [
        [name, f"{cells['alone']:.4f}", f"{cells['temporal']:.4f}", f"{cells['ratio']:.2f}"]
        for name, cells in parts["flicker"].items()
        if isinstance(cells, dict)
    ]
    stages = list(
        dict.fromkeys(
            s for cells in parts["speed"].values() if isinstance(cells, dict) for s in cells["stages_milliseconds"]
        )
    )
    speed = [
        [
            name,
            f"{cells['alone_milliseconds']:.0f}",
            f"{cells['temporal_milliseconds']:.0f}",
            f"{cells['temporal_over_alone']:.1f}",
            *(f"{cells['stages_milliseconds'].get(stage, 0.0):.0f}" for stage in stages),
        ]
        for name, cells in parts["speed"].items()
        if isinstance(cells, dict)
    ]
    still = max(cells["one turn"]["largest"] for cells in parts["still"].values() if isinstance(cells, dict))
    cuts = [cells for cells in parts["cut"].values() if isinstance(cells, dict)]
    same = all(cells[kind]["same_bits"] for cells in cuts for kind in ("announced", "unannounced"))
    indirect = spatial["indirect"]
    best = [
        min(cells[f"{name} (tuned)"]["rel_mse"] for name in ("sg", "sg_mixture", "asg", "ggx"))
        / cells["normal (tuned)"]["rel_mse"]
        for cells in lights
    ]
    return f"""## Upsampling, and sequences

`benchmarks/upsampling.py`, {describe_run(data)}. `showroom`, 4 samples per shaded pixel, one of 4x4 pixels shaded.

### One frame

512x512, the last frame of a slow orbit; reference of {indirect["reference_spp"]} samples per pixel for indirect light alone and {spatial["all"]["reference_spp"]} for all of it. Tuned is
the best that a search along each parameter in turn found (radius, screen sigma, position sigma; normals: exponent; lobes: both betas and tau;
{indirect["normal (tuned)"]["tried"]} settings of `normal` and {indirect["ggx (tuned)"]["tried"]} of `ggx` were tried). `rel_mse` of the image and of its specular pixels:

{make_table(["", "indirect light", "specular", "all light", "specular"], alone)}

Comparing lobes, the best of them, leaves {best[0]:.2f} of the error of tuned normals with indirect light and {best[1]:.2f} with all light; the aim was 0.6 with
indirect light. What is left there has other reasons: the noise of diffuse pixels, which lobes cannot tell apart better than normals; fireflies; and mirrors that show more than one sample in
sixteen pixels can. Tried besides: clamping samples to what the lobe-weighted mean and deviation of their neighbours allow (which lowers the
error of both filters alike, and darkens the image), hit distances (last line), kernels of up to 33x33 samples, the other similarities.

### A slow orbit

The same frame with the fifteen before it:

{make_table(["", "alone", "with its history", "ratio"], over_time)}

Nothing moves and shading has no noise: after one turn through all places (4x4, 3x3, 2x2) the largest relative error against shading every pixel
is {still:.0e}. After a cut, announced or not ({len(cuts)} pairs of shots), the frames {"have the same bits as" if same else "differ from"} those of a fresh start.

### Shading again

The least supported {100 * parts["adaptive"]["spatial"]["share"]:.0f} % of the pixels, 64 samples each; error in these pixels, and of the image:

{make_table(["after", "before", "shaded again", "times lower", "image before", "image after"], again)}

### Ghosts

Objects move before a camera that stands still (pace 1: two pixels a frame), 256x256; error with history over that without, where a surface or what a
mirror (alpha below 0.1) reflects came into view so many frames ago. Below 1 the history helps already; the aim was 1.3 two frames later:

{make_table(["", *masks, "all pixels"], trails)}

### Flicker

{parts["flicker"]["frames"]} frames of a slow orbit, 256x256; the flicker of the references ({parts["flicker"]["reference_spp"]} samples per pixel) is taken off:

{make_table(["", "each frame alone", "with history", "ratio"], flicker)}

### Time of a frame

1920x1080 from 480x270, milliseconds, by stage; alone is `upsample`. The aim was 60 ms. What was done towards it: the arithmetic on sums runs in pieces on
every core, sparse grids are read and written in place, the four taps of a reprojection are a loop. What is left is passes over memory: the stages
beside the kernels are NumPy, and reflections are looked for in two places.

{make_table(["", "alone", "with history", "ratio", *stages], speed)}
"""


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

`benchmarks/similarities.py`, {describe_run(similarities)}. {similarities["size"]}x{similarities["size"]} pixels, full form, radius 8, references of
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

On a scene made for it, thin posts that stand on satin metal (`benchmarks/hit_distance.py`, {describe_run(hits)};
{hits["size"]}x{hits["size"]}, reference of {hits["reference_spp"]} samples per pixel; contacts are specular pixels whose hit is nearer than a tenth
of their depth; tuned is the best of {len(hits["factors"]) ** 2} settings of beta and screen sigma for that column), error without the term and with it:

{contacts}

It pays from some hundred samples per pixel on, where little noise is left.

{make_upsampling_section(upsampling)}
## Time

### The paper's table

`benchmarks/paper_table.py`, {describe_run(paper)}. 1024x1024 pixels; the paper's ratios are those of its slide "Denoising
Performance" (Radeon HD 6990). Its times grow by less than two from radius 8 to 16, so its filter was separable. "3 lobes" have an axis
each, as fitted materials do; "3 coaxial" are the mixture that stands for GGX.

{make_paper_table(paper)}

### Every size

`benchmarks/filters.py`, {describe_run(filters)}. Best of many runs, in turn within one process; in brackets the ratio to `normal`.

{make_time_tables(filters)}
"""


def make_gallery_page(gallery: dict[str, Any]) -> str:
    """Return docs/gallery.md."""

    def tell(name: str, *columns: str, key: str = "rel_mse") -> str:
        errors = gallery[name]["errors"]
        return ", ".join(f"`{each}` {errors[each][key]:.4f}" for each in columns)

    return f"""# Gallery

Written by `benchmarks/publish.py`; the pictures and their errors by `benchmarks/make_gallery.py`, with default settings on frames of
{gallery["brushed"]["spp"]} samples per pixel ({gallery["measured"]["spp"]} for the measured materials and the upsampling). Under each stands the command that makes it; the frames are rendered on first use into the folder after
`--cache`.

## Brushed metal: a lobe has a direction

![Brushed copper and aluminium: noisy, sg, asg, ggx, reference](images/brushed.png)

From left to right: noisy, `sg`, `asg`, `ggx`, reference. Brushing makes the lobe many times wider across than along, and the highlights into
streaks. A round lobe of the same area is too wide one way and too narrow the other: it washes the streaks away. Error on the
anisotropic pixels: {tell("brushed", "sg", "asg", "ggx")}.

```bash
python benchmarks/make_gallery.py --cache ~/.cache/lobewise-quality brushed
```

## Plastic: two lobes in one radiance

![Plastic balls: noisy, sg, sg_mixture, reference](images/plastic.png)

From left to right: noisy, `sg`, `sg_mixture`, reference. Here the frame holds one radiance, diffuse and specular together, as files of many
renderers do. What the balls show is almost all diffuse; a single lobe looks at the narrow gloss, finds every neighbour unlike, and
leaves the noise. The mixture has both lobes with their true amplitudes, so it knows which one matters; at the rims, where Fresnel
makes the gloss strong, it is still careful. Error of the whole image: {tell("plastic", "sg", "sg_mixture", "normal")}. Plain normals do well
here because little depends on the gloss; where a frame has both radiances apart, each is filtered by its own lobe and the
question does not arise.

```bash
python benchmarks/make_gallery.py --cache ~/.cache/lobewise-quality plastic
```

## Measured materials: lobes from a table

![Tabulated materials: noisy, normal, sg_mixture, ggx, reference](images/measured.png)

From left to right: noisy, `normal` (untuned), `sg_mixture`, `ggx`, reference. Three materials tabulated in MERL's layout (a hazy metal with a
sharp and a wide lobe, a lacquer, a satin paint) through a BSDF that lobewise has no formula for: the renderer fits lobes to each and writes
them into the frame. The database itself may not be shipped, so these tables are computed; `--material FILE.binary`, given up to three times, takes
your own. `sg_mixture` uses the lobes of the tables, `ggx` and `asg` their equivalent alphas. The lobes keep the reflections in the bronze and the edges of the
highlights, which normals wash out, and leave more noise on the lacquer: its narrow coat decides what is alike, though most of the noise
lies in the paint below, and in a measured material the two cannot be told apart. Error on the measured pixels:
{tell("measured", "normal", "sg", "sg_mixture", "asg", "ggx")}.

```bash
python benchmarks/make_gallery.py --cache ~/.cache/lobewise-quality measured
```

## Upsampling: one of sixteen pixels shaded

![Upsampled by 4x4: bilinear, normal, ggx, reference](images/upsampling.png)

From left to right: bilinear, `normal`, the default (`ggx`), reference. Shaded was one pixel of every 4x4, the guides are there for all. Depth and
normal say nothing of the floor's inlays or of the patches on the sphere; the lobes put them where they are. Sharp reflections have no more
detail than there are samples, which shows as steps. Error: {tell("upsampling", "bilinear", "normal", "ggx")}.

```bash
python benchmarks/make_gallery.py --cache ~/.cache/lobewise-quality upsampling
```

## The paper's chain: shaded, filtered, over time, shaded again

![What was shaded, normal, ggx, with time, with adaptive pixels, reference](images/chain.png)

From left to right: what was shaded (indirect light, 4 samples at one of 4x4 pixels), `normal`, the default (`ggx`), the same with the fifteen frames before it, the
same with the least supported 5 % of the pixels shaded again, reference. Lobes bring back the edges between materials, time the detail between the
samples and quiet, and what neither can know is shaded. Error: {tell("chain", "shaded", "normal", "ggx", "with time", "with adaptive pixels")}.

```bash
python benchmarks/make_gallery.py --cache ~/.cache/lobewise-quality chain
```

## A sequence

![An orbit upsampled: each frame alone, and with history](images/sequence.webp)

Left each frame by itself, right with the frames before it; 4 samples at one of 4x4 pixels. Forth and back. Flicker: {tell("animation", "alone", "with time", key="flicker")}.

```bash
python benchmarks/make_gallery.py --cache ~/.cache/lobewise-quality animation
```
"""


def load_startup() -> dict[str, Any] | None:
    """Return what ``startup.py`` has measured, None before it has."""
    path = RESULTS / "startup.json"
    return json.loads(path.read_text()) if path.exists() else None


def main() -> None:
    """Write the pages."""
    similarities = json.loads((RESULTS / "similarities.json").read_text())
    filters = json.loads((RESULTS / "filters.json").read_text())
    upsampling = json.loads((RESULTS / "upsampling.json").read_text())
    quality = json.loads((RESULTS / "quality.json").read_text())
    readme = ROOT / "README.md"
    text = readme.read_text()
    head, rest = text.split(START)
    tail = rest.split(END)[1]
    readme.write_text(f"{head}{START}\n{make_readme_figures(quality, upsampling)}\n{END}{tail}")
    paper = json.loads((RESULTS / "paper_table.json").read_text())
    hits = json.loads((RESULTS / "hit_distance.json").read_text())
    gallery = json.loads((RESULTS / "gallery.json").read_text())
    (ROOT / "docs" / "results.md").write_text(make_results_page(similarities, filters, paper, hits, upsampling))
    (ROOT / "docs" / "gallery.md").write_text(make_gallery_page(gallery))
    measured = (json.loads((RESULTS / f"{name}.json").read_text()) for name in INTERACTIVE)
    (ROOT / "docs" / "interactive.md").write_text(make_interactive_page(*measured))
    trials, training = (json.loads((RESULTS / f"{name}.json").read_text()) for name in ("quality_trials", "training"))
    (ROOT / "docs" / "quality.md").write_text(make_trials_page(trials, training))
    (ROOT / "docs" / "quality_results.md").write_text(make_quality_page(quality))
    streamed = json.loads((RESULTS / "streaming.json").read_text())
    (ROOT / "docs" / "streaming.md").write_text(make_streaming_page(streamed))
    performance = (json.loads((RESULTS / f"{name}.json").read_text()) for name in PERFORMANCE)
    (ROOT / "docs" / "performance.md").write_text(make_performance_page(*performance))
    machines = load_machines()
    write_pictures(machines)
    (ROOT / "docs" / "bench.md").write_text(make_bench_page(load_startup(), machines))


if __name__ == "__main__":
    main()
