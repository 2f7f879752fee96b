"""Memory and time of a file of 33 megapixels, denoised in bands, beside one of 2 megapixels, denoised as a whole.

The frame is the built-in showroom, 1920x1080 at 4 samples per pixel with every channel that this project renders, and
4x4 of it side by side, whose radiance has random last bits so that it compresses as a render does. Each is denoised
by a process of its own, as a user would; kernels come from the disk, so every quality runs once before it is measured.

    python -m benchmarks.performance.streaming --cache ~/.cache/lobewise/streaming
    python -m benchmarks.performance.streaming --quality high     one quality again; the others keep their figures
    python -m benchmarks.performance.streaming --foreign          a file of 16384x16384 pixels of another renderer
"""

import argparse
import json
import os
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from benchmarks.common import RESULTS, describe_machine, fetch_frame, write_json
from lobewise.io.exr.container import Chunk, Container, Part, Window
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import Pixels, decode_part, encode_part
from lobewise.io.exr.splice import write_container

RESULT = RESULTS / "streaming.json"
SIZE, COPIES = (1920, 1080), 4
SAMPLES = 4
METHODS = {
    "fast": ["--quality", "fast", "--similarity", "sg"],
    "balanced": ["--quality", "balanced"],
    "high": ["--quality", "high"],
}
FOREIGN_SIZE, FOREIGN_COPIES = 1024, 16
LIMIT = 4.0
"""GiB."""
NOISY = ("", "diffuse", "specular", "direct", "indirect")
"""Layers of radiance; those of halves and variances have the same names behind a prefix."""
RANDOM_BITS = {np.dtype(np.float16): 2, np.dtype(np.float32): 12}
"""Last bits that change, by type: noise in the third digit."""


def is_radiance(name: str) -> bool:
    """Return whether a channel holds noisy light."""
    layer, _, last = name.rpartition(".")
    return last in "RGB" and layer.removeprefix("half_a").removeprefix("half_b").lstrip(".") in NOISY


def vary(name: str, plane: Pixels, rng: np.random.Generator) -> Pixels:
    """Return a channel with other last bits where it holds light."""
    if not is_radiance(name) or plane.dtype not in RANDOM_BITS:
        return plane
    kind = np.uint16 if plane.dtype == np.float16 else np.uint32
    bits = rng.integers(0, 1 << RANDOM_BITS[plane.dtype], plane.shape, dtype=kind)
    return np.where(plane > 0, (np.ascontiguousarray(plane).view(kind) ^ bits).view(plane.dtype), plane)


def tile(source: Path, target: Path, copies: int = COPIES) -> None:
    """Write ``copies`` times ``copies`` of an image side by side, some rows at a time."""
    container = read_container(source)
    (part,) = container.parts
    pixels = decode_part(container, part)
    window = Window(0, 0, copies * part.data_window.width - 1, copies * part.data_window.height - 1)
    box = struct.pack("<4i", window.x_min, window.y_min, window.x_max, window.y_max)
    header = [
        replace(item, value=box) if item.name in ("dataWindow", "displayWindow") else item for item in part.attributes
    ]
    count = -(-window.height // part.rows_per_chunk)
    whole = replace(part, data_window=window, display_window=window, chunks=(Chunk(0, 0, 0),) * count)
    temporary = target.with_suffix(".part")
    with temporary.open("wb") as out, source.open("rb") as stream:
        chunks = encode_bands(container, whole, pixels, copies)
        write_container(out, replace(container, parts=(whole,)), stream, [header], {0: chunks})
    temporary.replace(target)


def encode_bands(
    container: Container, whole: Part, pixels: dict[str, Pixels], copies: int
) -> Iterator[tuple[int, bytes]]:
    """Yield the chunks of the large image."""
    rng = np.random.default_rng(1)
    window, rows = whole.data_window, whole.rows_per_chunk
    for top in range(0, window.height, 4 * rows):
        bottom = min(top + 4 * rows, window.height)
        at = np.arange(top, bottom) % (window.height // copies)
        band = replace(whole, data_window=replace(window, y_min=top, y_max=bottom - 1))
        wide = {name: vary(name, np.tile(plane[at], (1, copies)), rng) for name, plane in pixels.items()}
        for index, data in encode_part(container, band, wide):
            yield top // rows + index, data


def run(arguments: list[str]) -> dict[str, float]:
    """Return the times and the largest memory of a run of the program, in a process of its own."""
    command = [sys.executable, "-c", "from lobewise.cli import main; main()", *arguments]
    start = time.perf_counter()
    process = os.spawnv(os.P_NOWAIT, sys.executable, command)
    _, status, used = os.wait4(process, 0)
    seconds = time.perf_counter() - start
    if status != 0:
        raise SystemExit(f"{' '.join(arguments)} ended with status {status}")
    return {
        "seconds": round(seconds, 2),
        "cpu_seconds": round(used.ru_utime + used.ru_stime, 2),
        # Kilobytes on Linux.
        "peak_gib": round(used.ru_maxrss / 2**20, 3),
    }


def measure(name: str, small: Path, large: Path, output: Path) -> dict[str, Any]:
    """Return the row of one quality."""
    options = METHODS[name]
    alone = ["denoise", str(small), "-o", str(output), *options, "--bands", "off"]
    run(alone)
    row: dict[str, Any] = {"whole": run(alone)}
    row["bands"] = run(["denoise", str(large), "-o", str(output), *options])
    for key in ("seconds", "cpu_seconds"):
        row[f"{key}_per_pixel_ratio"] = round(row["bands"][key] / row["whole"][key] / COPIES**2, 3)
    row["within_limit"] = row["bands"]["peak_gib"] < LIMIT
    return row


def measure_foreign(cache: Path) -> dict[str, Any]:
    """Return the row of a file of 16384x16384 pixels of another renderer, with the quality "fast"."""
    from lobewise.render import load_scene, render_frame

    small, large = cache / "foreign.exr", cache / "foreign-tiled.exr"
    if not large.exists():
        frame = render_frame(load_scene("showroom", width=FOREIGN_SIZE, height=FOREIGN_SIZE), spp=SAMPLES, seed=1)
        guides = frame.gbuffer
        images = {"": frame.radiance.color, "albedo.": guides.diffuse_albedo + guides.specular_albedo}
        planes = {f"{name}{'RGB'[k]}": image[..., k] for name, image in images.items() for k in range(3)}
        planes |= {f"N.{'XYZ'[k]}": guides.normal[..., k] for k in range(3)}
        planes["Z"] = np.where(guides.depth > 0.0, guides.depth, np.float32(1e4))
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        halves = {name: np.ascontiguousarray(plane, np.float16) for name, plane in planes.items()}
        OpenEXR.File(header, halves).write(str(small))
        tile(small, large, FOREIGN_COPIES)
    row: dict[str, Any] = run(["denoise", str(large), "-o", str(cache / "out.exr"), "--quality", "fast"])
    size = [FOREIGN_SIZE * FOREIGN_COPIES] * 2
    channels = len(read_container(large).parts[0].channels)
    return {**row, "size": size, "channels": channels, "machine": describe_machine()}


def main() -> None:
    """Measure and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, default=Path("~/.cache/lobewise/streaming"))
    parser.add_argument("--quality", choices=METHODS, action="append")
    parser.add_argument("--foreign", action="store_true", help="the large file of another renderer alone")
    arguments = parser.parse_args()
    cache = arguments.cache.expanduser()
    cache.mkdir(parents=True, exist_ok=True)
    if arguments.foreign:
        write_json(RESULT, {**json.loads(RESULT.read_text()), "foreign": measure_foreign(cache)})
        (cache / "out.exr").unlink(missing_ok=True)
        return
    small, large = cache / "showroom.exr", cache / "showroom-tiled.exr"

    def render() -> Any:
        from lobewise.render import load_scene, render_frame

        return render_frame(load_scene("showroom", width=SIZE[0], height=SIZE[1]), spp=SAMPLES, seed=1)

    fetch_frame(small, render)
    if not large.exists():
        tile(small, large)
    found = json.loads(RESULT.read_text()) if RESULT.exists() else {"rows": {}}
    rows = found["rows"]
    for name in arguments.quality or METHODS:
        rows[name] = {**measure(name, small, large, cache / "out.exr"), "machine": describe_machine()}
        print(f"{name}: {rows[name]}", flush=True)
        channels = len(read_container(large).parts[0].channels)
        sizes = {"small_bytes": small.stat().st_size, "large_bytes": large.stat().st_size}
        size = [COPIES * extent for extent in SIZE]
        found |= {"size": size, "small_size": list(SIZE), "channels": channels, **sizes, "rows": rows}
        write_json(RESULT, found)
    (cache / "out.exr").unlink(missing_ok=True)


if __name__ == "__main__":
    main()
