"""Sequences that upsampling is measured on: their frames and references, rendered on first use."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.frame import FloatArray
from lobewise.io.exr import read_frame, read_image, write_frame, write_image
from lobewise.io.exr.sparse import read_sparse_frame, write_sparse_frame
from lobewise.metrics import rel_mse
from lobewise.render import (
    MovingScene,
    find_orbit_centre,
    get_camera,
    load_scene,
    make_orbit,
    render_sequence,
)
from lobewise.sparse_frame import AnyFrame, SparseFrame

Mask = NDArray[np.bool_]

SCENE = "showroom"
SPP = 4
SCALE = 4
REFERENCE_SEED = 100_000


@dataclass(frozen=True)
class HurriedScene(MovingScene):
    """A scene whose objects are ``pace`` times as fast."""

    pace: float = 1.0

    def load(self, time: float = 0.0) -> Any:
        """Return the scene at a time."""
        return super().load(self.pace * time)

    def compute_moves(self, time: float, before: float) -> dict[str, NDArray[np.float64]]:
        """Return where the moving shapes came from."""
        return super().compute_moves(self.pace * time, self.pace * before)


@dataclass(frozen=True)
class Shot:
    """A sequence: an orbit of the camera, or at some pace moving objects before a camera that stands still.

    Parameters
    ----------
    size : int
        Pixels a side.
    frames : int
        How many.
    light : str
        As `render_frame` takes it.
    pace : float
        Of the objects; 0 is an orbit instead.
    """

    size: int
    frames: int
    light: str = "all"
    pace: float = 0.0

    @property
    def name(self) -> str:
        """Name of its files."""
        if self.pace:
            return f"moving-{self.size}-{self.pace:g}"
        return f"orbit-{self.size}-{self.light}"

    def open(self) -> tuple[Any, list[Camera]]:
        """Return scene and cameras."""
        scene = load_scene(SCENE, width=self.size, height=self.size)
        start = get_camera(scene)
        if self.pace:
            return HurriedScene(SCENE, self.size, self.size, self.pace), [start] * self.frames
        return scene, make_orbit(start, find_orbit_centre(scene), self.frames)


ORBIT = {light: Shot(512, 16, light) for light in ("indirect", "all")}
SLOW, FAST = Shot(256, 17, pace=1.0), Shot(256, 17, pace=3.0)
FLICKERING = Shot(256, 32)
GHOST_SHOTS = (SLOW, FAST)
PIECE_SPP = {"indirect": 2048, "all": 512}
"""Samples of a piece of the orbit's references; indirect light alone has more noise."""
GHOST_SPP, FLICKER_SPP = 128, 64
"""Samples of each of the two halves of the other references, whose noise is measured and taken off."""


class Cache:
    """Frames and references by their files, rendered on first use.

    Parameters
    ----------
    folder : Path
        Where.
    pieces : int
        Of how many renders the references of `ORBIT` are the mean.
    """

    def __init__(self, folder: Path, pieces: int) -> None:
        self.folder = folder / "upsampling"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.pieces = pieces

    def fetch_shot(self, shot: Shot, scale: int) -> list[AnyFrame]:
        """Return the frames of a shot, whole ones (scale 1) or sparse ones."""
        paths = [self.folder / f"{shot.name}-x{scale}-{index:02d}.exr" for index in range(shot.frames)]
        missing = [index for index, path in enumerate(paths) if not path.exists()]
        if missing:
            scene, cameras = shot.open()
            options: dict[str, Any] = {"spp": SPP, "scale": scale, "light": shot.light, "seed": 100}
            for index, frame in enumerate(
                render_sequence(scene, cameras, first=missing[0], **options), start=missing[0]
            ):
                if isinstance(frame, SparseFrame):
                    write_sparse_frame(paths[index], frame, half=False)
                else:
                    write_frame(paths[index], replace(frame, half_a=None, half_b=None), half=False)
        return [read_frame(path) if scale == 1 else read_sparse_frame(path) for path in paths]

    def fetch_reference(self, shot: Shot, index: int, spp: int, piece: int) -> FloatArray:
        """Return one piece of the reference of a frame; pieces have random numbers of their own."""
        path = self.folder / f"{shot.name}-{index:02d}-{spp}-{piece}.exr"
        if not path.exists():
            print(f"rendering {path.name}", file=sys.stderr)
            scene, cameras = shot.open()
            options: dict[str, Any] = {"light": shot.light, "seed": REFERENCE_SEED + 1000 * piece}
            frame = next(iter(render_sequence(scene, cameras, spp=spp, first=index, reference=True, **options)))
            write_image(path, frame.radiance.color)
        return read_image(path)

    def fetch_pair(self, shot: Shot, index: int, spp: int) -> tuple[FloatArray, FloatArray]:
        """Return the reference of a frame, of twice as many samples, and an image that is as noisy before it.

        That image is as far from the reference as the reference is from the truth, by figures that are mean squares.
        """
        first, second = (self.fetch_reference(shot, index, spp, piece) for piece in (0, 1))
        return np.float32(0.5) * (first + second), first

    def fetch_mean(self, shot: Shot, index: int) -> tuple[FloatArray, dict[str, Any]]:
        """Return the reference of a frame from all pieces, and what to say of it."""
        spp = PIECE_SPP[shot.light]
        pieces = [self.fetch_reference(shot, index, spp, piece) for piece in range(self.pieces)]
        mean = np.mean(pieces, axis=0, dtype=np.float64).astype(np.float32)
        row: dict[str, Any] = {"reference_spp": spp * self.pieces}
        if self.pieces > 1:
            # A piece is off the mean of n by n - 1 times the variance of that mean.
            apart = [rel_mse(piece, mean) for piece in pieces]
            row["reference_error"] = float(np.mean(apart)) / (self.pieces - 1)
        return mean, row
