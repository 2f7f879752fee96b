"""The text of docs/gallery.md."""

from __future__ import annotations

from typing import Any


def make_gallery_page(gallery: dict[str, Any]) -> str:
    """Return docs/gallery.md."""

    def tell(name: str, *columns: str, key: str = "rel_mse") -> str:
        errors = gallery[name]["errors"]
        return ", ".join(f"`{each}` {errors[each][key]:.4f}" for each in columns)

    return f"""# Gallery

Written by `benchmarks/publish.py`; the pictures and their errors by `benchmarks/pictures/gallery.py`, with default settings on frames of
{gallery["brushed"]["spp"]} samples per pixel ({gallery["measured"]["spp"]} for the measured materials and the upsampling). Under each stands the command that makes it; the frames are rendered on first use into the folder after
`--cache`.

## Brushed metal: a lobe has a direction

![Brushed copper and aluminium: noisy, sg, asg, ggx, reference](images/brushed.png)

From left to right: noisy, `sg`, `asg`, `ggx`, reference. Brushing makes the lobe many times wider across than along, and the highlights into
streaks. A round lobe of the same area is too wide one way and too narrow the other: it washes the streaks away. Error on the
anisotropic pixels: {tell("brushed", "sg", "asg", "ggx")}.

```bash
python -m benchmarks.pictures.gallery --cache ~/.cache/lobewise-quality brushed
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
python -m benchmarks.pictures.gallery --cache ~/.cache/lobewise-quality plastic
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
python -m benchmarks.pictures.gallery --cache ~/.cache/lobewise-quality measured
```

## Upsampling: one of sixteen pixels shaded

![Upsampled by 4x4: bilinear, normal, ggx, reference](images/upsampling.png)

From left to right: bilinear, `normal`, the default (`ggx`), reference. Shaded was one pixel of every 4x4, the guides are there for all. Depth and
normal say nothing of the floor's inlays or of the patches on the sphere; the lobes put them where they are. Sharp reflections have no more
detail than there are samples, which shows as steps. Error: {tell("upsampling", "bilinear", "normal", "ggx")}.

```bash
python -m benchmarks.pictures.gallery --cache ~/.cache/lobewise-quality upsampling
```

## The paper's chain: shaded, filtered, over time, shaded again

![What was shaded, normal, ggx, with time, with adaptive pixels, reference](images/chain.png)

From left to right: what was shaded (indirect light, 4 samples at one of 4x4 pixels), `normal`, the default (`ggx`), the same with the fifteen frames before it, the
same with the least supported 5 % of the pixels shaded again, reference. Lobes bring back the edges between materials, time the detail between the
samples and quiet, and what neither can know is shaded. Error: {tell("chain", "shaded", "normal", "ggx", "with time", "with adaptive pixels")}.

```bash
python -m benchmarks.pictures.gallery --cache ~/.cache/lobewise-quality chain
```

## A sequence

![An orbit upsampled: each frame alone, and with history](images/sequence.webp)

Left each frame by itself, right with the frames before it; 4 samples at one of 4x4 pixels. Forth and back. Flicker: {tell("animation", "alone", "with time", key="flicker")}.

```bash
python -m benchmarks.pictures.gallery --cache ~/.cache/lobewise-quality animation
```
"""
