"""The text of docs/streaming.md, from what ``performance/streaming.py`` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import make_table


def make_streaming_page(measured: Mapping[str, Any]) -> str:
    """Return docs/streaming.md."""
    machine = next(iter(measured["rows"].values()))["machine"]
    width, height = measured["size"]
    small = "x".join(map(str, measured["small_size"]))
    return f"""# Files of any size: 8K and beyond

Written by `benchmarks/publish.py`; no figure is typed by hand.

```bash
lobewise denoise 8k.exr -o clean.exr               # in bands by itself, where the whole would take more than 4 GiB
lobewise denoise 8k.exr -o clean.exr --bands 256   # so many rows at a time
lobewise denoise 4k.exr -o clean.exr --bands off   # the whole frame at once
```

A large frame is filtered in bands of rows, from file to file. The file that comes out is, byte for byte, the one that the whole frame gives: the same
radiance, channels, attributes and compression. A bar on the terminal tells how far it is and how long it still takes. The output appears whole or not
at all: at Ctrl-C (exit code 130), when the disk is full or when the file turns out to be damaged, what was there before is there still, and nothing else.

```python
import lobewise

done = lobewise.denoise_file("frame.exr", "clean.exr", quality="balanced", rows=64)
print(done.bands, done.bad_pixel_count, done.energy_lost, done.settings["similarity"], done.seconds)
```

`denoise_file` takes the settings of `denoise`, `lobe_tables` as `read_frame` does, `rows` of a band (by default as many as fit `memory`, in GiB),
and `progress`, which is called with what is done, the rows that are and the rows that there are. It returns what `denoise` does, less the images.

## What it takes

{width}x{height} pixels with {measured["channels"]} channels ({measured["large_bytes"] / 1e9:.1f} GB as ZIP); per pixel, as multiples of what {small} take as a whole:

{make_rows(measured)}

Whole processes, from the command line, kernels from the disk. Peak memory is the largest resident set, program and kernels included. {machine["processor"]},
{machine["cores"]} cores, beside other work, which lengthens the time and hardly the processor time; `python -m benchmarks.performance.streaming`.

Time per pixel grows by what is done twice: the file is read once more, to measure it (`fast` need not, unless it judges noise by variances), and the rows around every band are filtered with it; it falls by what a process does
once. How many rows come along is told by the settings: 40 to each side for `fast` at radius 8, 81 for `balanced`, 127 for `high`, in proportion to the radius; 94 for the form
`atrous`. With a large radius of `high` they may fill the memory by themselves: bands then have 32 rows, and take more than 4 GiB. More memory makes taller
bands: `denoise_file(..., memory=8)`.

## What cannot be done in bands

- `--with-oidn`, because Open Image Denoise takes whole images: in bands the quality `auto` is `high` without it, and the command says so; `--bands off` denoises a large file whole.
- `--adaptive` and `--temporal`. Sequences without these go frame by frame, and each in bands.
- Features of your own, which are images of the whole frame: use `denoise`.
- Files whose image is beside subsampled channels (rows of which are not rows of the image). `--bands auto` takes such a file as a whole.

Every compression, line order, tiled files and files of several parts are read in bands. A file that is one single tile is decoded as a whole, because it
cannot be otherwise.

## How it comes to the same bits

- **Columns stay where they are.** Bands are whole rows, so vectors begin at the same pixels, and every kernel's pixel is computed by the same instructions.
- **A band brings along what can tell on it.** `lobewise.streaming.plan.find_band_reach` adds up the links: the window of the fireflies, the kernel of
  every pass and the blur of its guide, the averages that the network reads, coverage, the neighbourhoods of evidence. `tests/streaming/test_reach.py` holds each link against the
  truth: a change at its edge shows, one outside changes nothing.
- **Rays know their row.** The camera of a band (`Camera.crop_rows`) is that of the whole frame, and so are pixel angles and the band-limit.
- **Bands begin at even rows**, because without halves of the samples the colours of a checkerboard tell fireflies.
- **What is a property of the whole frame is measured first**, in a pass over the file: how bright each layer's samples are (what is dark is a share of that),
  what fireflies lose, the noise that `fast` resolves "auto" by, the number of bad pixels. Each is a sum of one number for each row, so that it does not matter how the rows
  were cut. A filter's own output tells none of it, or it would have to run twice.
- **What the filter lost is known when all bands are filtered.** They wait as floats in a second file without a name, with what each pixel takes of the light that is shared out.
- **Holes that no filter reaches** are filled from up to 186 pixels away; finished rows wait until what follows is there. What has nothing
  so near becomes the mean of the frame's samples.
- **Channels that are only copied are not kept.** Rows of all channels are in memory while they are decoded or encoded, at most 256 MiB of pixels at a time where
  a row of chunks has less. Beyond that only the channels that are filtered are held, and others of up to 200 bytes a pixel; further ones are decoded again
  for the copy. What `--bands auto` decides by counts the same channels. Whole frames are read and written in the same way.
- **Files are cut and put together by their chunks**, which are coded independently. They wait in a file without a name beside the output, and are copied in the order of
  the original when all are there: the disk needs room for the output twice, and for 13 to 45 bytes a pixel of bands that are filtered.
"""


def make_rows(measured: Mapping[str, Any]) -> str:
    """Return the table of the qualities."""
    header = ["", "peak memory", "time", "processor time", "time per pixel", "processor time per pixel", "commit"]
    rows = []
    for name, row in measured["rows"].items():
        bands = row["bands"]
        ratios = [f"{row[f'{key}_per_pixel_ratio']:.2f}" for key in ("seconds", "cpu_seconds")]
        times = [f"{bands[key]:.0f} s" for key in ("seconds", "cpu_seconds")]
        kind = f"`{name}`" + (", `sg`" if name == "fast" else "")
        rows.append([kind, f"{bands['peak_gib']:.2f} GiB", *times, *ratios, row["machine"]["commit"]])
    return make_table(header, rows)
