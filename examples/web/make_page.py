"""Write a page that runs chains in a browser on a short sequence. It needs no server: all it reads are scripts.

python -m examples.web.make_page FOLDER
"""

from __future__ import annotations

import argparse
import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from examples.web.packing import read_frames

from lobewise.denoising.automatic import resolve_settings
from lobewise.exporting.shaders.chains import make_chain
from lobewise.exporting.shaders.constants import compute_constants, pack_constants
from lobewise.exporting.shaders.passes import Chain, write_pass
from lobewise.exporting.shaders.writing import describe_chain, name_file
from lobewise.recipes.temporal.recipe import compute_own_weight
from lobewise.recipes.upsampling import DEFAULT_RADIUS
from lobewise.records.frame import Frame, Radiance
from lobewise.records.sparse_frame import AnyFrame, SparseFrame, list_places
from lobewise.settings import DenoiseSettings, TemporalSettings

HERE = Path(__file__).parent
SEQUENCE = HERE / "showroom-sequence.bin.gz"
"""The sequence, rendered by `examples/web/render_sequence.py`."""
PAGE_CHAINS = {
    "history": "with a history",
    "filter": "every frame by itself",
    "upsample": "from one pixel in four, with a history",
}
"""The chains of the page and their titles."""
PAGE_SETTINGS = {
    "history": DenoiseSettings(quality="fast", form="separable"),
    "filter": DenoiseSettings(quality="fast", form="separable"),
    "upsample": DenoiseSettings(quality="fast", radius=DEFAULT_RADIUS),
}
"""The settings of the page's filters."""
PAGE_SCALE = 2
"""Distance of the shaded pixels of the chain "upsample", pixels."""


def take_samples(frames: Sequence[Frame]) -> list[SparseFrame]:
    """Return the frames with the light of one pixel in every block, another one in every frame."""
    samples_of_frames = []
    for number, frame in enumerate(frames):
        place = list_places(PAGE_SCALE)[number % PAGE_SCALE**2]
        shaded = slice(place[0], None, PAGE_SCALE), slice(place[1], None, PAGE_SCALE)
        light = frame.radiance
        assert light.diffuse is not None
        assert light.specular is not None
        samples = Radiance(light.color[shaded], diffuse=light.diffuse[shaded], specular=light.specular[shaded])
        samples_of_frames.append(
            SparseFrame(samples, frame.gbuffer, PAGE_SCALE, place=place, camera=frame.camera, spp=frame.spp)
        )
    return samples_of_frames


def make_blocks(chain: Chain, frames: Sequence[AnyFrame]) -> list[bytes]:
    """Return the constants of each frame of a sequence, as the passes read them."""
    blocks = []
    previous = None
    for frame in frames:
        scale, place = (frame.scale, frame.place) if isinstance(frame, SparseFrame) else (1, (0, 0))
        camera = frame.require_camera("a chain")
        values = compute_constants(
            camera,
            frame.shape,
            resolve_settings(frame, PAGE_SETTINGS[chain.name], scale),
            previous=previous,
            temporal=TemporalSettings(),
            own=compute_own_weight(frame),
            scale=scale,
            place=place,
        )
        blocks.append(pack_constants(chain.constants, values))
        previous = camera
    return blocks


def _bundle_chain(name: str, title: str, frames: Sequence[Frame]) -> dict[str, Any]:
    """Return what the page needs of a chain: its description, its files and its constants."""
    settings = PAGE_SETTINGS[name]
    chain = make_chain(name, form=settings.form)
    sparse = take_samples(frames) if name == "upsample" else []
    texts = {
        name_file(number, shader_pass, "wgsl"): write_pass(chain, shader_pass, "wgsl")
        for number, shader_pass in enumerate(chain.passes, 1)
    }
    blocks = [base64.b64encode(block).decode() for block in make_blocks(chain, sparse or frames)]
    entry = {"title": title, "chain": describe_chain(chain, "wgsl"), "files": texts, "blocks": blocks}
    if not sparse:
        return {**entry, "scale": 1, "places": []}
    return {**entry, "scale": PAGE_SCALE, "places": [frame.place for frame in sparse]}


def main() -> None:
    """Write the folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    write_page(folder)
    print(f"Wrote {folder}: open {folder / 'index.html'} in a browser with WebGPU.")


def write_page(folder: Path) -> None:
    """Write a folder whose ``index.html`` denoises the sequence in the browser."""
    frames = read_frames(SEQUENCE)
    chains = [_bundle_chain(name, title, frames) for name, title in PAGE_CHAINS.items()]
    passes = json.dumps({"show": (HERE / "show.wgsl").read_text(), "chains": chains}, indent=1)
    texts = {
        "index.html": (HERE / "index.html").read_text(),
        "player.js": (HERE / "player.js").read_text(),
        "sequence.js": f'"use strict";\nconst SEQUENCE = "{base64.b64encode(SEQUENCE.read_bytes()).decode()}";\n',
        "passes.js": f'"use strict";\nconst PASSES = {passes};\n',
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
