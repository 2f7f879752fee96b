"""The section of docs/results.md on upsampling and on sequences."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import describe_run, make_table


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

`benchmarks/upsampling/measure.py`, {describe_run(data)}. `showroom`, 4 samples per shaded pixel, one of 4x4 pixels shaded.

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
