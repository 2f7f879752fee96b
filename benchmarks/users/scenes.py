"""The scenes of the bench: which frames and references of each are there, and which scenes are held out."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

import lobewise
from benchmarks.foreign.files import REFERENCE, REFERENCES, RENDERERS, Renderer, list_frames
from benchmarks.quality.summary import TRAIN
from lobewise.interchange import read_image
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance

MITSUBA = Renderer("mitsuba", ("albedo", "normals"))
FOREIGN = (*RENDERERS, MITSUBA)
FACTORY = replace(RENDERERS[0], name="factory")
"""Random shots of Blender, `benchmarks/foreign/factory`: a folder for each shot."""
FACTORY_REFERENCES = (1, 2, 3)
FOREIGN_SEED = 1
OWN, INTERIORS = "own", "interiors"
GROUPS = (INTERIORS, FACTORY.name, *(renderer.name for renderer in FOREIGN), OWN)


@dataclass(frozen=True)
class Scene:
    """A scene's files.

    Parameters
    ----------
    group : str
        One of `GROUPS`.
    name : str
    frames : mapping of int to Path
        The noisy frame by samples per pixel.
    references : tuple of Path
        Independent ones, two or more.
    renderer : Renderer, optional
        Whose files they are, where they are not lobewise's own.
    """

    group: str
    name: str
    frames: Mapping[int, Path]
    references: tuple[Path, ...]
    renderer: Renderer | None = None

    @property
    def key(self) -> str:
        """Group and name."""
        return f"{self.group}/{self.name}"

    @property
    def is_held_out(self) -> bool:
        """Whether nothing was ever tuned or trained on it."""
        return self.group != OWN or self.name not in TRAIN

    @cached_property
    def reference_images(self) -> tuple[FloatArray, FloatArray]:
        """The radiance of the first reference, and the mean of all others."""
        if self.renderer is None:
            first, *others = (read_image(path) for path in self.references)
        else:
            first, *others = (lobewise.read_frame(path, light_passes=False).radiance.color for path in self.references)
        return first, np.mean(others, axis=0, dtype=np.float32)

    def read(self, spp: int) -> Frame:
        """Return the noisy frame with all that is in its file."""
        return lobewise.read_frame(self.frames[spp], light_passes=False)

    def read_peer(self, spp: int, frame: Frame) -> Frame | None:
        """Return the frame with the guides that its renderer hands to Open Image Denoise, None of our own renderer."""
        if self.renderer is None:
            return None
        albedo, normal = (self.renderer.read_guide(self.frames[spp], index) for index in (0, 1))
        return Frame(Radiance(frame.radiance.color), GBuffer(normal=normal, diffuse_albedo=albedo))


def list_scenes(folder: Path, foreign: Path | None = None) -> list[Scene]:
    """Return the scenes whose references are there: those of `benchmarks.users.render` and of `benchmarks/foreign`."""
    found = [scene for group in (INTERIORS, OWN) for scene in _list_ours(folder / group)]
    found += find_shots(foreign / FACTORY.name) if foreign else []
    for renderer in FOREIGN if foreign else ():
        place = foreign / renderer.name
        for name, frames in list_frames(renderer, place).items() if place.is_dir() else ():
            paths = {spp: seeds[FOREIGN_SEED] for spp, seeds in sorted(frames.items()) if FOREIGN_SEED in seeds}
            first, second = (renderer.find(place, f"{name}_{REFERENCE}_{half}") for half in REFERENCES)
            found.append(Scene(renderer.name, name, paths, (first, second), renderer))
    return sorted(found, key=lambda scene: GROUPS.index(scene.group))


def find_shots(folder: Path) -> list[Scene]:
    """Return the complete shots in a folder of `benchmarks/foreign/factory`."""
    found = []
    for shot in sorted(folder.glob("*/shot.json")):
        references = tuple(shot.with_name(f"{REFERENCE}_{part}.exr") for part in FACTORY_REFERENCES)
        frames = {int(path.stem): path for path in shot.parent.glob("*.exr") if path.stem.isdecimal()}
        if all(path.exists() for path in references):
            found.append(Scene(FACTORY.name, shot.parent.name, dict(sorted(frames.items())), references, FACTORY))
    return found


def _list_ours(folder: Path) -> list[Scene]:
    found = []
    for first in sorted(folder.glob("*-ref-1.exr")):
        name = first.name.removesuffix("-ref-1.exr")
        second = folder / f"{name}-ref-2.exr"
        ends = {path: path.stem.removeprefix(f"{name}-") for path in folder.glob(f"{name}-*.exr")}
        frames = {int(end): path for path, end in ends.items() if end.isdecimal()}
        if second.exists() and frames:
            found.append(Scene(folder.name, name, dict(sorted(frames.items())), (first, second)))
    return found
