"""What lies in a folder of another renderer's frames: frames, references, single passes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR

from lobewise.records.frame import FloatArray

REFERENCE = "reference"
REFERENCES = (1, 2)


@dataclass(frozen=True)
class Renderer:
    """How a renderer's files are laid out.

    Parameters
    ----------
    name : str
        Of the folder.
    guides : tuple of str
        Passes that the renderer itself hands to Open Image Denoise: albedo and normal.
    apart : bool
        Whether every pass is a file.
    """

    name: str
    guides: tuple[str, str]
    apart: bool = False

    def find(self, folder: Path, name: str) -> Path:
        """Return the file of a frame or reference that may not be there."""
        return folder / name / "RGB.exr" if self.apart else folder / f"{name}.exr"

    def read_guide(self, path: Path, index: int) -> FloatArray:
        """Return the albedo (0) or normal (1) that the renderer hands to Open Image Denoise, as it is in the file."""
        name = self.guides[index]
        if self.apart:
            return read_pass(path.with_name(f"{name}.exr"), "", "RGB")
        return read_pass(path, name, "RGB" if index == 0 else "XYZ")


_CYCLES = "Denoising Albedo", "Denoising Normal"
RENDERERS = (
    Renderer("blender", _CYCLES),
    Renderer("blender-5.2", _CYCLES),
    Renderer("luxcore", ("ALBEDO", "AVG_SHADING_NORMAL"), apart=True),
)
"""Blender 4.5 writes one part; 5.2, in a folder of its own, a part for each pass. The programs that rendered these
scenes of Blender are kept at the tag `trials-2026-11` (docs/developers/research/trials.md)."""


def list_frames(renderer: Renderer, folder: Path) -> dict[str, dict[int, dict[int, Path]]]:
    """Return the frames of a renderer by scene, samples per pixel and seed; only scenes whose reference is there."""
    found: dict[str, dict[int, dict[int, Path]]] = {}
    for entry in sorted(folder.iterdir()):
        scene, _, rest = entry.name.removesuffix(".exr").partition("_")
        spp, _, seed = rest.partition("_")
        if not (scene and spp.isdecimal() and seed.isdecimal()):
            continue
        if all(renderer.find(folder, f"{scene}_{REFERENCE}_{half}").exists() for half in REFERENCES):
            path = renderer.find(folder, entry.name.removesuffix(".exr"))
            found.setdefault(scene, {}).setdefault(int(spp), {})[int(seed)] = path
    return found


def read_pass(path: Path, name: str, components: str) -> FloatArray:
    """Return a pass (height, width, components) of any part: ``name`` is the last word before its components."""
    found = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for channel, values in part.channels.items():
                owner, _, component = channel.rpartition(".")
                if owner.rpartition(".")[2] == name:
                    found[component] = np.asarray(values.pixels, dtype=np.float32)
    return np.stack([found[component] for component in components], axis=-1)
