"""The smallest files that show what an artist's do, for tests: each shot of 64x36 pixels and 4 samples.

    python -m benchmarks.foreign.render_tiny FOLDER --bpy-4.5 PYTHON --bpy-5.2 PYTHON --pyluxcore PYTHON

Each renderer wants a Python of its own; those that are not named are left out. Mitsuba is this Python's.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
SMALL = ("--spp", "4", "--seeds", "1", "--reference", "0", "--size", "64x36")
ARTIST = ("--passes", "artist", "--denoise")
RUNS: dict[str, dict[str, tuple[str, ...]]] = {
    "bpy-4.5": {
        "blender_4.5": ("--scenes", "product,closeup,interior,moving,blurred"),
        "blender_4.5_denoised": ("--scenes", "product,moving", *ARTIST),
    },
    "bpy-5.2": {
        "blender_5.2": ("--scenes", "product,closeup,interior,moving,blurred", "--passes", "artist", "--multipart"),
        "blender_5.2_denoised": ("--scenes", "product,moving", "--multipart", *ARTIST),
        "blender_5.2_denoised_dwaa": ("--scenes", "product", "--multipart", "--codec", "DWAA", *ARTIST),
        "blender_5.2_sequence": ("--scenes", "moving", "--multipart", "--passes", "artist", "--frames", "3"),
    },
    "pyluxcore": {
        "luxcore_average": ("--scenes", "sparks", "--without", "SHADING_NORMAL"),
        "luxcore_single": ("--scenes", "sparks", "--without", "AVG_SHADING_NORMAL"),
    },
    "mitsuba": {"mitsuba": ()},
}
"""By interpreter and folder, what differs between the runs."""
SCRIPTS = {
    "bpy-4.5": "render_blender.py",
    "bpy-5.2": "render_blender.py",
    "pyluxcore": "render_luxcore.py",
    "mitsuba": "render_mitsuba.py",
}


def main() -> None:
    """Render all whose interpreter is given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    for name in RUNS:
        parser.add_argument(f"--{name}", dest=name, default=sys.executable if name == "mitsuba" else None)
    asked = vars(parser.parse_args())
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    for name, runs in RUNS.items():
        if asked[name] is None:
            print(f"left out: {name}, of which no Python is given", flush=True)
            continue
        for folder, options in runs.items():
            command = [asked[name], str(HERE / SCRIPTS[name]), str(asked["folder"] / folder), *SMALL, *options]
            subprocess.run(command, check=True, env=clean)


if __name__ == "__main__":
    main()
