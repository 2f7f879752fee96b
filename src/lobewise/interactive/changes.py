"""What changed in a scene since each stream of frames was last rendered: places of shapes, and lights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.interactive.methods import Methods
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray
from lobewise.render.gbuffer import number_moves
from lobewise.render.moving.shapes import Matrix, ShapePlaces
from lobewise.render.stages import FirstHits, Stages


@dataclass(frozen=True)
class Seen:
    """A scene as a frame showed it: its camera, the places of its shapes, and the number of changes until then."""

    camera: Camera
    transforms: dict[str, Matrix] = field(repr=False)
    changes: int


class SceneChanges:
    """The changes of one scene, which all sessions of the scene share."""

    def __init__(self, stages: Stages, methods: Methods) -> None:
        self._stages = stages
        self._methods = methods
        self._places = ShapePlaces(stages.scene)
        self.count = 0
        """Number of changes so far."""

    def move(self, transforms: Mapping[str, ArrayLike]) -> None:
        """Move shapes; see `lobewise.interactive.Session.set_transforms`."""
        moved = self._places.place(transforms)
        if moved:
            self.count += 1
            self._methods.note_move([box for boxes in moved.values() for box in boxes])
            if not self._places.keeps_addresses:
                self._stages.forget_recordings()

    def note_lights(self) -> None:
        """Note that lights changed."""
        self.count += 1
        self._methods.note_lights()

    def note_scene(self) -> None:
        """Note that anything may have changed."""
        self.count += 1
        self._methods.note_scene()
        self._stages.forget_recordings()

    def look(self, camera: Camera) -> Seen:
        """Return the scene as a frame of this moment shows it."""
        return Seen(camera, dict(self._places.transforms), self.count)

    def is_same(self, seen: Seen, camera: Camera) -> bool:
        """Return whether nothing has changed since an earlier frame, and its camera was the same."""
        names = ("position", "forward", "up", "fov_y")
        still = all(np.array_equal(getattr(seen.camera, name), getattr(camera, name)) for name in names)
        return seen.changes == self.count and still

    def mark_moved(self, seen: Seen, shapes: FloatArray) -> NDArray[np.bool_]:
        """Return which of some shapes have moved since an earlier frame; ``shapes`` are numbers as in `FirstHits`."""
        moves = self._places.compute_moves(seen.transforms)
        return np.isin(shapes, [number for number, _ in number_moves(self._stages.scene, moves)])

    def add_motion(self, hits: FirstHits, seen: Seen | None) -> FirstHits:
        """Return first hits with the motion since an earlier frame, also of reflections, if shapes have moved since."""
        moves = self._places.compute_moves(seen.transforms) if seen is not None else {}
        # Without motion the filter takes all surfaces for still ones, which costs less.
        return self._stages.add_motion(hits, seen.camera, moves) if seen is not None and moves else hits
