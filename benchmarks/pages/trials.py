"""The page that tells how the quality modes came about, from the recorded trials and the trainer's JSON."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import Any

HEAD = """# Quality: how the noise enters

`lobewise.denoise(frame, quality=...)`, `lobewise denoise --quality ...`. Guides and lobes tell which pixels reflect alike; they do not know how noisy a frame is, or how
fast what is reflected changes. Three qualities, and `auto`, the default:

| quality | what it does |
| --- | --- |
| `fast` | The paper's: one pass, weights from guides alone. Any form, radius, upsampling and histories. |
| `balanced` | Both halves of the samples are filtered narrowly by lobes, which gives a pilot and, by how far the halves are apart, its noise; then widely, by lobes times how far apart two pixels are in the pilot, over its noise. A third, sparse pass over what that gave reaches further where light is diffuse or reflected by rough lobes. |
| `high` | Thirteen such filters, from narrow to wide, and a network of two small layers that says for every pixel in which proportions they count. |
| `auto` (default) | The best that is here: `high`, mixed with the image of Open Image Denoise where that is installed (below). Forms other than the full one, upsampling and histories: `fast`. |

Each filter is a convex average of the pixels of a neighbourhood, divided by albedo before and multiplied after; what comes after it is below.

## What comes before and after

- **Halves.** Where the file has the image from one half of the samples each (`lobewise render` writes them), these are used. Else the noise is read off the image itself: second differences along both axes, squared and filtered by the weights of the image, are the noise of a pass, for they cancel slopes and edges. Where pixels share samples they are taken two pixels apart.
- **Fireflies** are bounded first: a pixel is no brighter than twice the second brightest of its 13x13 neighbours, or four times its own other half.
- **Light is kept.** A filter that knows noise loses light, with fireflies and with all that is brighter than its neighbours: without the following 27 % of a classroom that the sun lights, at 4 samples. What a layer lost is shared out over its pixels, in proportion to their light but no more than to half the
  layer's mean light: shadows stay dark, and spots that are too bright already do not grow. So the result is as bright as the noisy image: with `balanced` within 0.5 % on 76 of 80 frames of 1 to 64 samples without `mean_emission`
  (with it up to 0.6 %, for the samples of lamps are noisy themselves). The other four are interiors of 1 and 4 samples in which few pixels hold much of the light: they stay 0.7, 0.8, 2.3 and 13.5 % darker. Against what it was, on 69 of these frames, the error of log-brightness falls by 1 % in the geometric mean (of that classroom by 40 %)
  and `rel_mse` rises by 6 % (at most by 62 %, `sparks` at 1 sample), for it favours images that are too dark where noise is left. The way was chosen on these very frames. A few pixels that hold more light than all others tell nothing of the mean: of what k equal ones lost `1 - 1/k^2` is shared out, no pixel grows by more than 2 % for each of
  them by either of its two shares, and 1 % of the layer's light is shared out in any case. `Result.energy_lost` says
  what is missing after that. The command line and `Result.notes` tell where the filter took 1 % of the image's light or more and 2.5 times the standard error of its mean, which comes from the residuals: that light is in the image, but where it falls is not known.
- **Detail is taken back.** What a filter blurred away is in the noisy image still, with its noise. A small network says for every pixel how much of the noisy image enters the result of `balanced`, `high` and `auto`. It tells detail from noise as a test of residuals does: noise of neighbouring pixels is independent, so products of the
  difference between noisy image and result, a pixel or two apart, are 0 in the mean; detail's are not. It also sees the size of the difference, the noise (from halves, or from second differences without them) and the slope of the result, at three widths. It was trained on {scenes} random scenes of up to 512 samples per pixel and on {drawn} drawn textures (stripes, checks, tiles, dots, grain) under noise of any size, where halves and guides were missing at random.
  Where there are halves a formula takes back at least what they prove to be wrong, so that results tend to their input as samples grow on textures as well that are like none of the training. Without halves a texture comes back by its order alone: stripes, checks and tiles of two or three pixels do, with at most 1.1 times the error of the input (`tests/filters/test_evidence.py`). Bright dots of single pixels at random places do not, for fireflies look the same. `fast` stays a linear filter: it says in how much of the image it blurs by more than the noise. Error on random scenes kept aside, over that of the result alone and over the noisy image's:

{noisy}

  ![A lit window, a mirror and a textured box: noisy, high alone, high, the default, reference](images/detail.png)

  With one albedo, normal and depth alone: noisy (64, 16 and 1024 samples per pixel), `high` before detail is taken back, `high`, the default, reference (`benchmarks/pictures/detail.py`).

- **Highlights** are kept: where all pixels of a 2x2 block are eight times as bright as the surroundings (or three of them sixteen times; with one sample per pixel all twelve times; or two neighbours ten times, in both halves alike), the light above the surroundings is taken off the samples and added to the
  result. Noise strikes single pixels; a lamp in a mirror or in a lacquer's coat lights several. Where pixels share samples the block is 3x3. Before, a filter spread such a lamp as wide as its kernel.
- **Mirrors.** From one pixel of a small or bumpy mirror to the next the lobe's axis turns by more than the lobe is wide, so that no two lobes overlapped and all noise stayed. Twice the square of that turn, to the neighbour that is nearest in it, is added to a lobe's variance.
- **Edges of lamps and of the background.** Emission and background have no noise where a pixel shows one thing; at their edges they are as noisy as the choice of what a sample meets: dots and saw teeth, each as bright as the lamp.
  Where the frame has `mean_emission` (`lobewise render` traces 16 rays for it, spread evenly over the pixel), the emission of the samples is averaged with it; it counts as 16 samples.
- **Lights out of focus.** Emission and background pass as they are, for they have no noise where a pixel shows one object. Where Cryptomatte or alpha tells that depth of field or motion mixes objects over an area, dots beside such a
  light are shared out among their neighbours; the sum of the light stays.
- **What reflections see.** Where the frame has albedo and normal of what its lobes hit (`hit_albedo`, `hit_normal`), specular pixels must agree in them too.
- **Edges.** Filters work with the surface at a pixel's centre. Where the frame has `coverage` (`lobewise render` does), the light that falls on the surfaces around is mixed over the
  pixel's area at the end, so that silhouettes and textures are smooth; without it they are as the guides are.

## Tried, kept, dropped

One at a time, on the scenes that are tuned on alone. `rel_mse` in units of 1e-5, noise of the references subtracted; rows compare within a table, differences of a few percent mean little.

"""

TAIL = """
## The networks of `high`

Inputs, all of them relative, so that neither exposure nor sample count enters: the variance of every candidate (how far its halves are apart), how far it is from the middle one, slope and brightness, each averaged over
5x5 pixels and once more over some 17x17; what the narrow and the middle candidate are worth in samples, the variance of both guides, albedo, roughness and anisotropy. Two hidden layers, a softmax over the candidates; one network for
diffuse, one for specular light. Trained on {scenes} scenes made at random (`benchmarks/training/scenes.py`), none of which is a scene that results are judged on; {weights} weights, 3 networks.
Every fifth scene was kept aside once, to see that the networks do not learn their scenes by heart (error of the mixture over that of the middle candidate, geometric mean over scenes):

{ratios}

```sh
python -m benchmarks.training.scenes --cache DIR --count 24 --size 384 --reference-spp 256
python -m benchmarks.training.train --cache DIR
```

## Together with Open Image Denoise

Where it is installed (`lobewise[best]`) and no quality is named; `with_oidn=True` or `--with-oidn` asks for it, `with_oidn=False` or `--offline` leaves it out. `Result.method`, `denoise` and `inspect` say what was used. `high`, then a mixture with what Open Image Denoise makes of the frame,
pixel by pixel. It gets albedo and normal, each prefiltered: the means over the pixel's area where the frame has them. Without an albedo it gets the normal beside a white one; normals that are the same everywhere,
as readers make them up, are left out. In which proportions both are mixed a network tells: it sees, at three widths, how far both are apart, how noisy the image is and which of them the samples are nearer to. It was trained on {shared_scenes} random scenes, a fifth of them kept aside, with guides missing at random
(`benchmarks/training/shares.py`). A frame that has neither albedo nor normals gets Open Image Denoise's image. At the end detail is taken back as above. Without halves, as in the files of most other renderers, our share is three quarters of what the network says, unless neighbouring pixels share samples. Where neighbouring pixels share samples, Open Image Denoise leaves most of the noise, and ours is taken instead. Error of the mixture over that of Open Image Denoise with the same guides, and over ours, on scenes kept aside:

{peer}

## Goals that are missed

Two of the goals of error in [quality_results.md](quality_results.md) are: near-mirrors and anisotropic metal no worse than Open Image Denoise at 16 and 64 samples. What was tried, each measured above:

1. What reflections see, compared: as it comes it is noise itself at few samples; averaged over 5x5 pixels by the lobes it gained 6 to 11 % on near-mirrors, over 3x3 by place alone no less; that is in `balanced` and `high`.
2. Narrower and stricter candidates for the network, down to a sigma of 2 pixels, and inputs at two scales (what the networks gain on scenes kept aside from training is below).
3. A pilot guided by the samples themselves, so that a lamp seen in a mirror does not leak into its surroundings: an order of magnitude on `corridor` at 64 samples.

A third goal is `balanced` at 1920x1080 in less time than Open Image Denoise with its `fast` quality. Three attempts: one guide for both halves with smaller pilots and a diffuse similarity without root
and logarithm; no copies or sums in NumPy between the passes; single lobes in the pilot, a mean of what is seen over 3x3 pixels, a last pass that averages all samples at once. At 384x384 both take as long as
each other; at 1920x1080 part of what is left is memory that the system hands out anew after another method has run.

What remains of the error is mostly glass (reflected and refracted light are one radiance with one lobe) and edges inside a reflection, which no guide knows before the noise is gone.

## What is not settled

- Samples of pixels that two surfaces share count as samples of the one at the centre. Leaving them out made things worse.
- Emission and background pass through as they came where the frame has no `mean_emission`.
- Radius and sigmas are those of images of some 400 to 1100 rows; scale `radius` with the resolution.
"""


def make_table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table, figures to the right."""
    align = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [header, align, *rows])


def make_trials(trials: list[dict[str, Any]]) -> str:
    """Return a table for each group of trials."""
    parts = []
    for group, members in groupby(trials, key=lambda trial: trial["group"]):
        rows = list(members)
        header = [group, *rows[0]["columns"], ""]
        table = [
            [row["name"], *map(str, row["values"]), ": ".join(word for word in (row["verdict"], row["note"]) if word)]
            for row in rows
        ]
        parts.append(make_table(header, table))
    return "\n\n".join(parts) + "\n"


def make_ratios(ratios: dict[str, dict[str, float]]) -> str:
    """Return the trainer's table."""
    names = list(next(iter(ratios.values())))
    rows = [[f"{spp} spp", *(f"{row[name]:.2f}" for name in names)] for spp, row in ratios.items()]
    return make_table(["samples", *names], rows)


SETS = {
    "all": "all",
    "passes": "split light, albedos, normal, depth, roughness; no halves",
    "plain": "color, one albedo, normal, depth; no halves",
    "shared": "all, no halves, and a pixel filter that shares samples",
}


HALVES = {"all": "all guides and halves", "less": "fewer, no halves", "drawn": "drawn textures"}
RESULTS_NAMED = {"balanced": "`balanced`", "high": "`high`", "peer": "Open Image Denoise"}


def make_shares(ratios: dict[str, dict[str, float]], image: str, other: str) -> str:
    """Return the table of a network that mixes another image into an image: its errors over those of both."""
    names = [f"over {image}", "largest", f"over {other}", "largest"]
    keys = ("over_image", "over_image_largest", "over_other", "over_other_largest")
    rows = [[name, str(row["images"]), *(f"{row[key]:.2f}" for key in keys)] for name, row in ratios.items()]
    return make_table(["frames", "count", *names], rows)


def rename(ratios: dict[str, dict[str, float]], sets: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """Return the rows of the trainer with names in words: what was mixed, its guides, its samples."""
    named = {}
    for group, row in ratios.items():
        first, guides, samples = group.split(" ", 2)
        words = [sets[guides], samples] if sets is SETS else [RESULTS_NAMED[first], sets[guides], samples]
        # Drawn textures have no samples.
        named[", ".join(word for word in words if word != "0 spp")] = row
    return named


def make_trials_page(trials: dict[str, Any], training: dict[str, Any], share: dict[str, Any]) -> str:
    """Return docs/quality.md."""
    tail = TAIL.format(
        scenes=len(training["scenes"]),
        weights=training["weights"],
        ratios=make_ratios(training["ratios"]),
        shared_scenes=share["scenes"],
        peer=make_shares(rename(share["peer"]["kept aside"], SETS), "Open Image Denoise", "ours"),
    )
    first = make_shares(rename(share["noisy"]["kept aside"], HALVES), "the result", "the noisy image")
    return (
        HEAD.format(noisy=first, scenes=share["scenes"], drawn=share["drawn_frames"])
        + make_trials(trials["trials"])
        + tail
    )
