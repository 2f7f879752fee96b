"""The frames of the image tests: how each is read and denoised, and by which names their light goes."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from lobewise.errors import UnusedGuideWarning
from lobewise.records.frame import FloatArray, Frame, Radiance, Result
from lobewise.records.sparse_frame import SparseFrame

DATA = Path(__file__).parent / "data"
REFERENCES, BASELINES = DATA / "references", DATA / "baselines"
NAMES = tuple(sorted(path.stem for path in REFERENCES.glob("*.exr")))
CROPS = tuple(sorted(f"crops/{path.stem}" for path in (REFERENCES / "crops").glob("*.exr")))
"""Frames of 192x144 pixels, for mechanisms that look at larger neighbourhoods; no figures of them are committed."""
QUALITIES = ("fast", "balanced", "high", "auto")
"""What is committed for every frame; "auto" is `lobewise.denoise` as people call it, with Open Image Denoise."""
"""Passes of the frame ``groups`` that are filtered too, one for each light."""
SPARSE = "sparse"
"""The frame that is upsampled, which one quality does."""
CASES = tuple((name, quality) for name in NAMES for quality in (QUALITIES[:1] if name == SPARSE else QUALITIES))


@dataclass(frozen=True)
class View:
    """A noisy frame, and the frame of hundreds of samples per pixel."""

    noisy: Frame | SparseFrame
    reference: Frame

    @property
    def shown(self) -> FloatArray:
        """The noisy image as pictures show it; that of a sparse frame repeats each sample."""
        color = self.noisy.radiance.color
        if isinstance(self.noisy, Frame):
            return color
        return color.repeat(self.noisy.scale, axis=0).repeat(self.noisy.scale, axis=1)


@cache
def read_views(name: str) -> tuple[View, ...]:
    """Return the views of a file: one, or that of each eye."""
    path, reference = locate_file(name), REFERENCES / f"{name}.exr"
    if name == SPARSE:
        return (View(lobewise.read_sparse_frame(path), read_light(reference)),)
    from lobewise.interchange.reading import list_selections

    views = [each.view for each in list_selections(path)]
    return tuple(View(read_light(path, view), read_light(reference, view)) for view in views)


def read_light(path: Path, view: str = "") -> Frame:
    """Return the frame of one view, with all passes of light."""
    from lobewise.interchange.reading import import_file

    return import_file(path, view=view or None, light_passes=True).frame


def locate_file(name: str) -> Path:
    """Return the file of a frame; LuxCore writes a folder of files."""
    folder = DATA / name
    return folder / "RGB.exr" if folder.is_dir() else DATA / f"{name}.exr"


def denoise_view(noisy: Frame | SparseFrame, quality: str) -> Result:
    """Return the result of a quality, without warnings on guides that are not used."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnusedGuideWarning)
        if isinstance(noisy, SparseFrame):
            return lobewise.upsample(noisy)
        changes: Any = {} if quality == "auto" else {"quality": quality, "with_oidn": False}
        return lobewise.denoise(noisy, **changes)


def list_noisy_light(frame: Frame) -> dict[str, FloatArray]:
    """Return all light of a frame by the names that results have for it."""
    layers = {each.name: each.radiance for each in frame.layers}
    passes = {f"{each.name}/{part}": image for each in frame.layers for part, image in each.parts.items()}
    return {**(layers or list_halves(frame.radiance)), **passes, **frame.also, **frame.unscattered}


def list_clean_light(result: Result, frame: Frame) -> dict[str, FloatArray]:
    """Return all light of a result; what it does not name stays as it was."""
    return {**frame.unscattered, **list_filtered_light(result)}


def list_filtered_light(result: Result) -> dict[str, FloatArray]:
    """Return the light that a result has filtered."""
    return {**(result.layers or list_halves(result)), **result.also}


def list_halves(owner: Radiance | Result) -> dict[str, FloatArray]:
    """Return diffuse and specular light where they are known apart."""
    halves = {"diffuse": owner.diffuse, "specular": owner.specular}
    return {name: image for name, image in halves.items() if image is not None}


def list_sums(frame: Frame, light: Mapping[str, FloatArray]) -> dict[str, list[str]]:
    """Return which light the image, named "", and every layer are sums of."""
    scattered = [each.name for each in frame.layers] or [name for name in ("diffuse", "specular") if name in light]
    sums = {each.name: [f"{each.name}/{part}" for part in each.parts] for each in frame.layers if each.parts}
    if scattered:
        sums[""] = [*scattered, *frame.unscattered]
    if frame.also:
        sums["also"] = list(frame.also)
    return sums


def join_views(images: list[FloatArray]) -> FloatArray:
    """Return the images of the eyes side by side."""
    return np.concatenate(images, axis=1)
