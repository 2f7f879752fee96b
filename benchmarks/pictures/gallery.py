"""Draw the gallery: whole shots, noisy, by Open Image Denoise, `high`, `auto`, `best`, and the reference.

    python -m benchmarks.pictures.gallery FOLDER

``FOLDER`` holds a folder for each shot, with ``16.exr`` and ``reference_1.exr``: the page has the commands that render
them, by Blender Cycles (``benchmarks/foreign/factory``) or by our own renderer. Writes docs/_static/gallery,
benchmarks/results/gallery_shots.json and the part of docs/developers/gallery.md between its marks. Shots that are not
in the folder stay as they are.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from PIL import Image

import lobewise
from benchmarks.common import RESULTS, ROOT, write_json
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.peers import denoise_oidn
from lobewise.records.frame import FloatArray

PAGE, PICTURES = ROOT / "docs" / "developers" / "gallery.md", ROOT / "docs" / "_static" / "gallery"
START, END, HEADING = "<!-- shots:start -->\n", "<!-- shots:end -->\n", "### "
PAIRS = (
    ("noisy", "auto"),
    ("Open Image Denoise", "auto"),
    ("Open Image Denoise", "best"),
    ("Open Image Denoise", "high"),
    ("best", "reference"),
)
ENDS = ("-o clean.exr", "-o clean.exr --quality best", "-o clean.exr --quality high")
"""Ends of the commands that denoise a shot."""
REFERENCE_SPP = 2048
"""Samples of the reference of a built-in scene."""
EPSILON = 0.01
"""Added to the squared reference, below the squared error."""
SHARE_LEFT_OUT = 0.001
"""Share of the pixels, the worst ones, that the second error leaves out: the reference has fireflies of its own."""


def list_commands(kind: str, seed: str, frame: lobewise.Frame) -> list[str]:
    """Return the commands that render a shot: of the factory of Blender's files, or without a seed a built-in scene."""
    if seed:
        return [f"python3.11 benchmarks/foreign/factory . --kinds {kind} --seeds {seed} --width {frame.width}"]
    line = f"lobewise render {kind} --width {frame.width} --height {frame.height}"
    return [
        f"{line} --spp 16 -o {kind}/16.exr",
        f"{line} --spp {REFERENCE_SPP} --seed 7 --reference -o {kind}/reference_1.exr",
    ]


def draw_wipe(shot: str, first: str, second: str) -> str:
    """Return HTML of two pictures with a movable edge between them; see docs/_static/wipe.js."""
    left, right = (f'src="../_static/gallery/{shot}-{name.split()[0].lower()}.webp"' for name in (first, second))
    return (
        f'<div class="wipe" style="max-width:640px"><img {right} alt="{second}"><img class="over" {left} alt="{first}">'
        f'<span class="left">{first}</span><span class="right">{second}</span><input type="range" min="0" max="100" '
        'value="50" aria-label="Move the edge between the pictures"></div>'
    )


def measure(image: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Return the mean squared error over the squared reference, of all pixels, and without the worst."""
    errors = np.sort(((image - reference) ** 2 / (reference**2 + EPSILON)).mean(axis=-1), axis=None)
    most = errors[: errors.size - round(SHARE_LEFT_OUT * errors.size)]
    return round(float(errors.mean()), 4), round(float(most.mean()), 4)


def main() -> None:
    """Draw all shots of a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    PICTURES.mkdir(parents=True, exist_ok=True)
    before, rest = PAGE.read_text().split(START)
    drawn, after = rest.split(END)
    rows = json.loads((RESULTS / "gallery_shots.json").read_text())["errors"]
    titles = [f"{HEADING}{part}".rstrip() for part in drawn.split(HEADING)[1:]]
    blocks = dict(zip(sorted(rows), titles, strict=True))
    for path in sorted(parser.parse_args().folder.glob("*/reference_1.exr")):
        shot, frame = path.parent.name, lobewise.read_frame(path.with_name("16.exr"))
        reference = lobewise.read_frame(path).radiance.color
        images = {
            "noisy": frame.radiance.color,
            "Open Image Denoise": denoise_oidn(frame)[0],
            "high": lobewise.denoise(frame, quality="high").image,
            "auto": lobewise.denoise(frame).image,
            "best": lobewise.denoise(frame, quality="best").image,
            "reference": reference,
        }
        exposure = choose_exposure(reference)
        for name, image in images.items():
            picture = Image.fromarray(map_tones(image, exposure))
            picture.save(PICTURES / f"{shot}-{name.split()[0].lower()}.webp", quality=88, method=6)
        errors = {name: measure(image, reference) for name, image in images.items() if name != "reference"}
        rows[shot] = errors
        told = ", ".join(f"{name} {every:g} ({most:g})" for name, (every, most) in errors.items())
        wipes = "\n".join(draw_wipe(shot, *pair) for pair in PAIRS)
        kind, _, seed = shot.partition("_")
        commands = "\n".join(
            [*list_commands(kind, seed, frame), *(f"lobewise denoise {shot}/16.exr {end}" for end in ENDS)]
        )
        by = "Blender Cycles" if seed else "our own renderer"
        title = f"{HEADING}{kind.capitalize()}, by {by}, 16 samples"
        blocks[shot] = f"{title}\n\nErrors: {told}.\n\n```bash\n{commands}\n```\n\n```{{raw}} html\n{wipes}\n```"
    write_json(RESULTS / "gallery_shots.json", {"spp": 16, "errors": dict(sorted(rows.items()))})
    whole = "\n\n".join(blocks[shot] for shot in sorted(blocks))
    PAGE.write_text(f"{before}{START}\n{whole}\n\n{END}{after}")


if __name__ == "__main__":
    main()
