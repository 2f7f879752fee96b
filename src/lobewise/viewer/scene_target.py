"""A scene that is rendered while browsers look at it. Every browser has its own histories."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lobewise.interactive import InteractiveFrame, InteractiveSettings, Session
from lobewise.io.exr import write_frame
from lobewise.records.frame import Frame, Radiance
from lobewise.render import MovingScene, PlacedScene, find_orbit_centre, load_scene, read_object_paths
from lobewise.render.integrators import tell_unseen
from lobewise.render.moving.shapes import Matrix
from lobewise.scenes import BY_THEMSELVES
from lobewise.viewer.messages import Description, Request


@dataclass(frozen=True)
class Motion:
    """The places of moving shapes at every moment."""

    compute_places: Callable[[float], dict[str, Matrix]]
    """Returns the matrix from each shape's place in the loaded scene to its place at a moment, frames from 0."""
    length: float | None
    """The moment after which the motion begins again, frames; None for a motion that goes on."""

    def advance(self, moment: float, frames: float) -> float:
        """Return the moment that is so many frames after another one."""
        after = moment + frames
        return after if self.length is None else after % max(self.length, 1.0)


def load_moving(name: str, size: tuple[int | None, int | None], moving: str | None) -> tuple[Any, Motion | None]:
    """Return a scene, ready to be moved, and its motion; None for a scene that stands still.

    Parameters
    ----------
    name : str
        As for `lobewise.render.load_scene`.
    size : (int, int) or (None, None)
        Columns and rows.
    moving : str, optional
        A file for `lobewise.render.read_object_paths`, or `BY_THEMSELVES`.

    Raises
    ------
    InputError, FileError, MissingDependencyError
        As `lobewise.render.load_scene`, `read_object_paths`, `MovingScene` and `PlacedScene`.
    """
    width, height = size
    if moving is None:
        return load_scene(name, width=width, height=height), None
    if moving == BY_THEMSELVES:
        scene = MovingScene(name, width, height)
        # The matrices lead from any moment to any other.
        return scene.load(), Motion(lambda moment: scene.compute_moves(0.0, moment), None)
    paths = read_object_paths(moving)
    loaded = load_scene(name, width=width, height=height, merge=False)
    PlacedScene(loaded, paths)  # refuses places that a shape cannot take
    return loaded, Motion(lambda moment: paths.compute_places(1.0 + moment), float(paths.last_frame))


class SceneTarget:
    """A scene, named as for `lobewise.render.load_scene`.

    ``size`` is columns and rows, by default those of the scene. ``progress`` is called with ``(done, total)`` while a
    method prepares the scene. ``moving`` is that of `Target`. Every browser has its own moment of the motion. Raises
    LobewiseError as `lobewise.interactive.Session` and `load_moving`.
    """

    def __init__(
        self,
        name: str,
        size: tuple[int, int] | None,
        progress: Callable[[int, int], None],
        moving: str | None = None,
    ) -> None:
        self._name = name
        loaded, self._motion = load_moving(name, size or (None, None), moving)
        width, height = size or (None, None)
        self._first = Session(loaded, width=width, height=height, progress=progress)
        self.moments: dict[int, float] = {}
        """Moment of the motion in each browser's last frame, frames from 0; none if nothing moves."""
        self._sessions: dict[int, Session] = {}
        self._last: dict[int, list[InteractiveFrame]] = {}
        self.is_warm = False
        """Whether a frame was rendered, so that kernels need not be compiled."""

    def describe(self) -> Description:
        """Return the properties of the scene."""
        width, height = self._first.size
        centre = find_orbit_centre(self._first.scene)
        return Description(
            settings=InteractiveSettings(),
            width=width,
            height=height,
            camera=self._first.camera,
            look_at=(float(centre[0]), float(centre[1]), float(centre[2])),
            moves=self._motion is not None,
            unseen=tell_unseen(self._first.scene),
        )

    def show_input(self, request: Request) -> list[InteractiveFrame]:
        """Return a frame without filters, for which few kernels must be compiled."""
        plain = InteractiveSettings(
            similarity="none", temporal=False, adaptive=0.0, filter_direct=False, accumulate=False
        )
        session = self._first.make_sibling()
        session.resize(*request.size)
        return [session.render(request.camera, plain)]

    def render(self, request: Request) -> list[InteractiveFrame]:
        """Return the next frame of a browser, or its last frame if the request needs no new one; two for a wipe.

        Raises LobewiseError if the scene has nothing for the method to work with, or the camera is invalid.
        """
        sides = [
            replace(side, accumulate=request.accumulate)
            for side in (request.settings, request.other)
            if side is not None
        ]
        last = self._last.get(request.client, [])
        if request.fresh or [frame.settings for frame in last] != sides:
            session = self._sessions.get(request.client)
            if session is None:
                session = self._sessions[request.client] = self._first.make_sibling()
            if session.size != request.size:
                session.resize(*request.size)
            self._move(session, request)
            if len(sides) == 2:
                last = list(session.render_pair(request.camera, sides[0], sides[1]))
            else:
                last = [session.render(request.camera, sides[0])]
            self._last[request.client] = last
            self.is_warm = True
        return last

    def _move(self, session: Session, request: Request) -> None:
        """Move the objects to the moment of a browser's next picture. The first picture shows the beginning."""
        if self._motion is None:
            return
        before = self.moments.get(request.client)
        moment = 0.0 if before is None else self._motion.advance(before, request.speed)
        session.set_transforms(self._motion.compute_places(moment))
        self.moments[request.client] = moment

    def forget(self, client: int) -> None:
        """Drop a browser's histories."""
        self._sessions.pop(client, None)
        self._last.pop(client, None)
        self.moments.pop(client, None)

    def write(self, client: int, folder: Path) -> Path:
        """Write a browser's last image with its guides into an EXR file in ``folder``; return its path."""
        frame = self._last[client][0]
        noisy = frame.make_frame()
        whole = Frame(Radiance(frame.image), noisy.gbuffer, noisy.camera, lobe_tables=noisy.lobe_tables)
        path = folder / f"{Path(self._name).stem}.exr"
        write_frame(path, whole, half=False, attributes={"lobewise/scene": self._name})
        return path
