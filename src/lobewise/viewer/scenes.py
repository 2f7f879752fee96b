"""A scene that is rendered while browsers look at it. Every browser has its own histories."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from lobewise.frame import Frame, Radiance
from lobewise.interactive import InteractiveFrame, InteractiveSettings, Session
from lobewise.interactive.settings import METHODS
from lobewise.interactive.views import VIEWS
from lobewise.io.exr import write_frame
from lobewise.render import find_orbit_centre
from lobewise.render.integrators import tell_unseen
from lobewise.viewer.looks import SCENE_SIMILARITIES, Look
from lobewise.viewer.messages import Description, Request
from lobewise.viewer.shots import Shot


class SceneTarget:
    """A scene, named as for `lobewise.render.load_scene`.

    ``size`` is columns and rows, by default those of the scene. ``progress`` is called with ``(done, total)`` while a
    method prepares the scene. Raises LobewiseError as `lobewise.interactive.Session`.
    """

    def __init__(self, name: str, size: tuple[int, int] | None, progress: Callable[[int, int], None]) -> None:
        self._name = name
        width, height = size or (None, None)
        self._first = Session(name, width=width, height=height, progress=progress)
        self._sessions: dict[int, Session] = {}
        self._last: dict[int, list[InteractiveFrame]] = {}
        self._warm = False

    def describe(self) -> Description:
        """Return the properties of the scene."""
        width, height = self._first.size
        centre = find_orbit_centre(self._first.scene)
        return Description(
            look=InteractiveSettings(),
            width=width,
            height=height,
            camera=self._first.camera,
            look_at=(float(centre[0]), float(centre[1]), float(centre[2])),
            methods=METHODS,
            similarities=SCENE_SIMILARITIES,
            views=VIEWS,
            unseen=tell_unseen(self._first.scene),
        )

    def is_slow(self, request: Request) -> bool:
        """Return whether no frame was rendered yet, so that kernels must be compiled."""
        return not self._warm

    def show_input(self, request: Request) -> list[Shot]:
        """Return a frame without filters, for which few kernels must be compiled."""
        plain = InteractiveSettings(
            similarity="none", temporal=False, adaptive=0.0, filter_direct=False, accumulate=False
        )
        session = self._first.make_sibling()
        session.resize(*request.size)
        return [_to_shot(session.render(request.camera, plain))]

    def render(self, request: Request) -> list[Shot]:
        """Return the next frame of a browser, or its last frame if the request needs no new one.

        Raises LobewiseError if the scene has nothing for the method to work with, or the camera is invalid.
        """
        looks = [
            _to_settings(look, accumulate=request.accumulate)
            for look in (request.look, request.other)
            if look is not None
        ]
        last = self._last.get(request.client, [])
        if request.fresh or [frame.settings for frame in last] != looks:
            session = self._sessions.get(request.client)
            if session is None:
                session = self._sessions[request.client] = self._first.make_sibling()
            if session.size != request.size:
                session.resize(*request.size)
            if len(looks) == 2:
                last = list(session.render_pair(request.camera, looks[0], looks[1]))
            else:
                last = [session.render(request.camera, looks[0])]
            self._last[request.client] = last
            self._warm = True
        return [_to_shot(frame) for frame in last]

    def forget(self, client: int) -> None:
        """Drop a browser's histories."""
        self._sessions.pop(client, None)
        self._last.pop(client, None)

    def write(self, client: int, folder: Path) -> Path:
        """Write a browser's last image with its guides into an EXR file in ``folder``; return its path."""
        frame = self._last[client][0]
        noisy = frame.make_frame()
        whole = Frame(Radiance(frame.image), noisy.gbuffer, noisy.camera, lobe_tables=noisy.lobe_tables)
        path = folder / f"{Path(self._name).stem}.exr"
        write_frame(path, whole, half=False, attributes={"lobewise/scene": self._name})
        return path


def _to_settings(look: Look, *, accumulate: bool) -> InteractiveSettings:
    assert isinstance(look, InteractiveSettings)
    return replace(look, accumulate=accumulate)


def _to_shot(frame: InteractiveFrame) -> Shot:
    height, width = frame.image.shape[:2]
    return Shot(frame.image, frame.get_view, (width, height), frame.seconds, frame.accumulated, frame.recomputed)
