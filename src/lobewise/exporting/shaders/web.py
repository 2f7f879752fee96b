"""Write a page that runs chains in a browser on a short sequence. It needs no server: all it reads are scripts."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lobewise
from lobewise.denoising.automatic import resolve_settings
from lobewise.errors import FileError
from lobewise.exporting.folder import DOCS, MARK, open_folder
from lobewise.exporting.names import WEB
from lobewise.exporting.shaders.bundle import read_frames
from lobewise.exporting.shaders.chains import make_chain
from lobewise.exporting.shaders.constants import compute_constants, pack_constants
from lobewise.exporting.shaders.declarations import copy_template, read_template
from lobewise.exporting.shaders.passes import Chain, write_pass
from lobewise.exporting.shaders.writing import describe_chain, name_file
from lobewise.frame import Frame, Radiance
from lobewise.io.files import PathLike
from lobewise.settings import DenoiseSettings, TemporalSettings
from lobewise.sparse_frame import AnyFrame, SparseFrame, list_places
from lobewise.temporal.recipe import compute_own_weight
from lobewise.upsampling import DEFAULT_RADIUS

SEQUENCE = Path(lobewise.__file__).parents[2] / "examples" / "web" / "showroom-sequence.bin.gz"
"""The sequence in a clone, rendered by `examples/web/render_sequence.py`. Wheels do not hold it."""
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
        assert light.diffuse is not None and light.specular is not None
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


def export_web(output: PathLike, *, force: bool = False) -> list[str]:
    """Write a folder whose ``index.html`` denoises a sequence in the browser, and return the names of its files.

    Parameters
    ----------
    output : path
        The folder, new or empty.
    force : bool
        Replace an earlier export and everything in its folder.

    Raises
    ------
    FileError
        If the folder is not empty or cannot be written, or the package was not installed from a clone with ``-e``.
    """
    if not SEQUENCE.is_file():
        raise FileError(
            f"target {WEB!r}",
            expected=f"the sequence examples/web/{SEQUENCE.name} of the repository",
            got="a package without it",
            action="run the command from an installation of a clone, as pip install -e makes it",
        )
    frames, packed = read_frames(SEQUENCE), SEQUENCE.read_bytes()
    chains = [_bundle_chain(name, title, frames) for name, title in PAGE_CHAINS.items()]
    first = frames[0]
    spp = f"{first.spp} sample" + ("" if first.spp == 1 else "s")
    parts = {"spp": spp, "width": first.width, "height": first.height, "frames": len(frames)}
    values = {**{name: str(value) for name, value in parts.items()}, "version": lobewise.__version__, "docs": DOCS}
    show = copy_template("web/show.wgsl")
    texts = {
        "index.html": read_template("web/index.html", values),
        "player.js": copy_template("web/player.js"),
        "sequence.js": f'"use strict";\nconst SEQUENCE = "{base64.b64encode(packed).decode()}";\n',
        "passes.js": f'"use strict";\nconst PASSES = {json.dumps({"show": show, "chains": chains}, indent=1)};\n',
        "passes/show.wgsl": show,
        MARK: json.dumps({"lobewise": lobewise.__version__, "target": WEB}) + "\n",
    }
    for chain in chains:
        folder = f"passes/{chain['chain']['chain']}"
        texts |= {f"{folder}/{name}": text for name, text in chain["files"].items()}
        texts[f"{folder}/chain.json"] = json.dumps(chain["chain"], indent=2) + "\n"
    with open_folder(output, force=force) as place:
        for name, text in texts.items():
            place(name).parent.mkdir(parents=True, exist_ok=True)
            place(name).write_text(text, encoding="utf-8")
    return list(texts)
