"""Frames to train on, as files: one ``scene-SSSSS-NNNN.npz`` (seed, samples per pixel) a frame, of half floats.

The program that renders them and the one that trains both go through this module. A file is written under another name
and moved, so that a reader never sees half of one.
"""

from __future__ import annotations

import argparse
import os
import re
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import ROOT
from lobewise.errors import FileError, InputError

Half = NDArray[np.float16]

LARGEST_VALUE = 60000.0
"""What is stored is clipped to plus and minus this: half floats end at 65504."""

VALIDATION_EVERY = 5
"""One seed of so many is kept aside from training."""

_FILE_NAME = re.compile(r"scene-(\d{5,})-(\d{4,})\.npz")

_SINGLE = ("depth", "alpha_u", "alpha_v", "hit_inverse", "lobe_sharpness")
"""Images of one channel, (rows, columns); all others are (rows, columns, 3)."""
_OPTIONAL = ("diffuse_a", "diffuse_b", "specular_a", "specular_b", "peer_all", "peer_plain")
_NUMBERS = ("seed", "spp", "reference_spp")


@dataclass(frozen=True, repr=False)
class Example:
    """A noisy frame, its guides and what it should look like: float16, (rows, columns, 3) unless said otherwise.

    Parameters
    ----------
    seed : int
        Of the scene, from 1.
    spp, reference_spp : int
        Samples per pixel of the noisy frame, and of the reference before it was cleaned.
    kind : str
        Which kind of scene it is, see `benchmarks.training.kinds`.
    color, diffuse, specular
        Noisy light: all of it, and by the lobe that scattered it first. Emission is in neither part.
    mean_diffuse_albedo, mean_specular_albedo, mean_normal
        Means over the pixel's area, free of the noise of samples.
    diffuse_albedo, specular_albedo, normal
        As `lobewise.GBuffer` has them: albedos averaged over the samples, the normal at the pixel's centre.
    depth, alpha_u, alpha_v : (rows, columns)
        Distance along the ray, 0 for no surface; roughness.
    hit_albedo, hit_normal
        Of the surface that the specular lobe sees.
    hit_inverse : (rows, columns)
        1 / (1 + distance to that surface), 0 where the distance is unknown or there is no surface.
    lobe_axis
        Mirror direction about the normal, 0 where there is no specular lobe.
    lobe_sharpness : (rows, columns)
        Base-2 logarithm of the band-limited sharpness of the lobe, 0 where there is none.
    reference
        Many samples, cleaned by Open Image Denoise.
    diffuse_a, diffuse_b, specular_a, specular_b : optional
        The same light from one half of the samples each; absent at 1 sample per pixel.
    peer_all, peer_plain : optional
        What Open Image Denoise makes of the noisy frame with all guides, and without the means over the pixel's area;
        both times it prefilters them. Validation frames alone have them.

    Raises
    ------
    InputError
        If an image is not float16, or has another shape than told above.
    """

    seed: int
    spp: int
    reference_spp: int
    kind: str
    color: Half
    diffuse: Half
    specular: Half
    mean_diffuse_albedo: Half
    mean_specular_albedo: Half
    diffuse_albedo: Half
    specular_albedo: Half
    mean_normal: Half
    normal: Half
    depth: Half
    alpha_u: Half
    alpha_v: Half
    hit_albedo: Half
    hit_normal: Half
    hit_inverse: Half
    lobe_axis: Half
    lobe_sharpness: Half
    reference: Half
    diffuse_a: Half | None = None
    diffuse_b: Half | None = None
    specular_a: Half | None = None
    specular_b: Half | None = None
    peer_all: Half | None = None
    peer_plain: Half | None = None

    def __post_init__(self) -> None:
        size = np.shape(self.color)[:2]
        for name in list_images():
            image = getattr(self, name)
            if image is None and name in _OPTIONAL:
                continue
            shape = size if name in _SINGLE else (*size, 3)
            if not isinstance(image, np.ndarray) or image.dtype != np.float16 or image.shape != shape:
                got = f"{getattr(image, 'dtype', type(image).__name__)} of shape {np.shape(image)}"
                raise InputError(name, expected=f"float16 of shape {shape}", got=got, action="make it with make_half")

    @property
    def has_halves(self) -> bool:
        """Whether the light of the halves of the samples is there."""
        return self.diffuse_a is not None


def list_images() -> tuple[str, ...]:
    """Return the names of all images of an `Example`, also of those that it may lack."""
    return tuple(each.name for each in fields(Example) if each.name not in (*_NUMBERS, "kind"))


def make_half(image: NDArray[np.floating]) -> Half:
    """Return an image as it is stored: clipped to `LARGEST_VALUE`, with 0 where it is not finite."""
    values = np.where(np.isfinite(image), image, 0.0)
    return np.clip(values, -LARGEST_VALUE, LARGEST_VALUE).astype(np.float16)


def open_cache(parser: argparse.ArgumentParser, path: Path) -> Path:
    """Return the folder of the option --cache, made if it is not there; inside the repository the program ends."""
    folder = path.expanduser().resolve()
    if folder.is_relative_to(ROOT):
        parser.error("--cache must lie outside the repository")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def is_validation(seed: int) -> bool:
    """Return whether the frames of a scene are kept aside from training."""
    return seed % VALIDATION_EVERY == 0


def make_file_name(seed: int, spp: int) -> str:
    """Return the name of a frame's file."""
    return f"scene-{seed:05d}-{spp:04d}.npz"


def parse_file_name(path: Path) -> tuple[int, int] | None:
    """Return seed and samples per pixel that a file's name tells, or None where it names no frame."""
    found = _FILE_NAME.fullmatch(path.name)
    return None if found is None else (int(found[1]), int(found[2]))


def list_frames(folder: Path) -> list[Path]:
    """Return the files of frames in a folder, by seed and samples per pixel; an empty list where there are none."""
    named = [(parse_file_name(path), path) for path in folder.glob("scene-*.npz")]
    return [path for _, path in sorted((key, path) for key, path in named if key is not None)]


def write_frame_file(folder: Path, example: Example) -> Path:
    """Write a frame into a folder, which is made where it is missing, and return the file's path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / make_file_name(example.seed, example.spp)
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    images = {name: getattr(example, name) for name in list_images()}
    numbers = {name: np.int32(getattr(example, name)) for name in _NUMBERS}
    with temporary.open("wb") as stream:
        there = {name: image for name, image in images.items() if image is not None}
        np.savez(stream, kind=np.array(example.kind), **numbers, **there)
    temporary.replace(path)
    return path


def read_frame_file(path: Path) -> Example:
    """Return the frame in a file.

    Raises
    ------
    FileError
        If there is no such file, or it does not hold a frame.
    """
    action = "delete it, and render it again with benchmarks.training.make_frames"
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files}
        numbers = {name: int(found.pop(name)) for name in _NUMBERS}
        return Example(**numbers, kind=str(found.pop("kind")), **found)
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, EOFError, InputError) as error:
        raise FileError(str(path), expected="a frame to train on", got=str(error), action=action) from error
