"""What changed in a scene since each stream of frames was last rendered: places of shapes, and lights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from lobewise.camera import Camera
from lobewise.interactive.methods import Methods
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

    def add_motion(self, hits: FirstHits, seen: Seen | None) -> FirstHits:
        """Return first hits with the motion since an earlier frame, if shapes have moved since."""
        moves = self._places.find_moves(seen.transforms) if seen is not None else {}
        # Without motion the filter takes all surfaces for still ones, which costs less.
        return self._stages.add_motion(hits, seen.camera, moves) if seen is not None and moves else hits
