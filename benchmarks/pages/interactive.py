"""The text of docs/interactive.md, from what ``bench interactive``, ``interactive/chain.py`` and ``interactive/viewer.py`` have measured."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import make_table

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
TARGET_RATE = {"paths": 5.0, "voxel_cones": 3.0}
"""Frames per second that were set as the goal, on two cores at 512x512."""
TARGET_RATIO = 0.6
TARGET_START = 15.0


def describe_machine(data: dict[str, Any]) -> str:
    """Return where a measurement was made."""
    machine = data["machine"]
    return f"{machine['processor']}, {machine['threads']} threads, commit {machine['commit']}"


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


def find_ratios(quality: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return by scene the error of `ggx` over time, 5 % computed again, over geometry-aware and over tuned."""
    found = {}
    for scene, kinds in quality["scenes"].items():
        rows = kinds["over time"]
        ours = rows["ggx"]["rel_mse"]
        found[scene] = ours / rows["normal"]["rel_mse"], ours / rows["normal, tuned"]["rel_mse"]
    return found


def say_target(reached: bool) -> str:
    """Return whether a goal was reached, in a word."""
    return "reached" if reached else "missed"


def make_rate_table(viewer: dict[str, Any]) -> str:
    """Return frames per second by method, with and without a browser that draws on the same cores."""
    lines = []
    for name, cell in viewer["pace"].items():
        rate, goal = cell["frames_per_second"], TARGET_RATE.get(name)
        told = "" if goal is None else f"{goal:g}: {say_target(rate >= goal)}"
        drawn = viewer["motion"][name]["frames_per_second"]
        lines.append([name.replace("_", " "), f"{rate:.1f}", told, f"{drawn:.1f}"])
    header = ["512x512, one of 4x4 pixels", "frames per second", "goal", "with the browser's software GL beside it"]
    return make_table(header, lines)


def make_interactive_page(quality: dict[str, Any], stages: dict[str, Any], viewer: dict[str, Any]) -> str:
    """Return docs/interactive.md."""
    ratios = find_ratios(quality)
    told = "; ".join(
        f"`{scene}` {plain:.2f} ({say_target(plain <= TARGET_RATIO)}), and {tuned:.2f} of that of the chain tuned on this very frame"
        for scene, (plain, tuned) in ratios.items()
    )
    first = viewer["first_picture"]["paths"]
    rates = make_rate_table(viewer)
    orbit = viewer["orbit"]
    tables = "\n\n".join(
        f"Rays on {'the CPU' if device == 'cpu' else device}:\n\n{make_stage_table(stages, device)}"
        for device in stages["devices"]
    )
    return f"""# Interactive indirect illumination

The system of the paper's slides: deferred shading whose indirect light is computed at one of 4x4 pixels, brought to all of them over
space and time by reflection lobes, and computed again where no sample fits. Without a GPU of any maker.

```sh
lobewise view showroom                      # in the browser; see viewer.md
lobewise bench interactive                  # what each stage takes here
```

From a script, without a window:

```python
from lobewise.interactive import InteractiveSettings, Session
from lobewise.render import find_orbit_centre, make_orbit

session = Session("showroom", width=128, height=128)
path = make_orbit(session.camera, find_orbit_centre(session.scene), frames=3, degrees_per_frame=1.0)
settings = InteractiveSettings(method="paths", similarity="ggx", scale=4, adaptive=0.05)
images = [frame.image for frame in session.frames(path, settings)]  # (128, 128, 3), linear
```

`frame.get_view(name)` shows what happens inside (`noisy`, `direct`, `indirect`, `sharpness`, `weight_sum`, `history`, `recomputed`, `hit_distance`,
`normal`, `albedo`), `frame.seconds` the time of every stage.

## The chain

1. **Guides** of every pixel's centre, albedos and the hit of the mirror ray included: one surface, no averages.
2. **Direct light** with shadows at every pixel, in the same pass: one sample of the lights, and where the lobe is narrow one of the BSDF. The 16 pixels of a 4x4 block
   draw samples that are stratified together, so that a small lobe-aware filter (5x5, `sg`) makes soft shadows of them.
3. **Indirect light** at one pixel of every block; which one changes from frame to frame (`scale`, `spp`). Three methods with one interface
   (`lobewise.render.tracing.points.IndirectMethod`): `paths` (right in expectation, noisy), `voxel_cones` (smooth, as coarse as its voxels),
   `virtual_lights` (see [virtual_lights.md](virtual_lights.md)). A method says what its samples are worth in noise, and the filter is as strict as that allows.
4. **Upsampling** over space and time: `lobewise.TemporalFilter` ([temporal.md](temporal.md)); with `temporal=False` `lobewise.upsample`, with
   `similarity="none"` interpolation on the screen.
5. **Re-computation** of the pixels that nothing supports, at most 5 % of all (`adaptive`).
6. **Composite**. While camera and settings stay, twice as dense samples are taken per axis, and the mean of a pixel's own samples takes over from what the filter
   gave it: what stands still converges to what the method computes without any filter.

All light transport is Dr.Jit code whose kernels are recorded once and replayed, the filters are Halide code.

## Time

{tables}

`lobewise bench interactive -o benchmarks/results/interactive.json`, median of {stages["frames"]} frames of an orbit of `{stages["scene"]}`, one degree each;
{describe_machine(stages)}. The slides' frame took 32.1 ms on a GPU of 2011, at a resolution that they do not tell.

In the viewer the first picture stands in the browser {first:.1f} s after the command (goal {TARGET_START:g}: {say_target(first <= TARGET_START)}). Frames per second while
the camera moves:

{rates}

The first column is that of a client that speaks the page's protocol, moves the camera thirty times a second and draws nothing, as if the browser had
its own processor. A machine without any GPU has the last one: headless Chromium drags the camera, and its software GL takes about a core of the two.
An orbit of {orbit["frames"]} frames: {orbit["dropped_connections"]} dropped connections, {len(orbit["console_errors"])} errors on the page's console,
memory of the process that renders {100.0 * orbit["growth"]:+.1f} % over the second half (`python -m benchmarks.interactive.viewer`; {describe_machine(viewer)}).

## Voxel cones, upsampled

Left to right: the samples of one frame, one of 4x4 pixels; the geometry-aware chain, tuned; `ggx`; voxel cones at every pixel. Indirect light alone.

![showroom: samples, geometry-aware, ggx, every pixel](images/interactive-showroom.png)

What re-computation does: before, the pixels that are shaded again, after, voxel cones at every pixel.

![showroom: before, shaded again, after, every pixel](images/interactive-showroom-adaptive.png)

`rel_mse` (epsilon 0.01) of indirect light against the same voxel cones at every pixel ({quality["reference_samples"]} jittered sets each). "8 frames" is the last frame
of an orbit of {quality["degrees_per_frame"]:g} degrees a frame, with its history. The tuned chain had the best of 48 settings for each scene and column against the reference; ours ran with their defaults.

{make_quality_table(quality)}

With history and re-computation `ggx` has, of the error of the geometry-aware chain (goal {TARGET_RATIO:g}): {told}. Lobes tell reflections apart; where dim
diffuse light is the noise, as in `parlour`, they have nothing to say, and a wider kernel than the default is what helps.

```sh
python -m benchmarks.interactive.chain --output benchmarks/results/interactive_quality.json
python -m benchmarks.interactive.chain --results benchmarks/results/interactive_quality.json --pictures docs/images
```

{describe_machine(quality)}.

## What it cannot do

- Voxel cones show what their voxels are: 128 along the longest side. Mirrors show them, walls thinner than a voxel or two may leak, and surfaces in
  voxels reflect as if diffuse.
- Paths with one sample at one of 16 pixels are noisy; fireflies stay as blotches until the picture rests.
- Guides are of pixel centres, so that edges are not smoothed.
- The path from a method to the page is one frame long: nothing of a frame is shown before all of it is there.
"""
