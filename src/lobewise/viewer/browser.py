"""The state of one browser, and its next request: fewer pixels while frames take too long."""

from __future__ import annotations

import math
import time
from collections import deque
from typing import Any

from lobewise.viewer.cameras import CameraMap, Pose
from lobewise.viewer.messages import Description, Picture, Request, Window
from lobewise.viewer.panel import Panel

STILL_AFTER = 0.3
"""Seconds without a camera event after which a camera stands still."""
MAX_ACCUMULATED = 256
"""Largest number of frames in the mean of a camera that stands still."""
_RATE_SPAN = 3.0
"""Time over which pictures per second are counted, seconds."""
TARGET = 0.2
"""Seconds that a frame may take while the camera moves."""
STEPS = (1.0, 0.84, 0.71, 0.59, 0.5)
"""Factors of width and height. Every second step halves the number of pixels, about. With less than half of the columns
and rows a picture is too coarse to steer by."""
_MAX_LOAD = 0.6
"""Largest expected time of a larger picture, relative to the target, at which the larger picture is tried."""
_SMOOTHING = 0.5
"""Weight of the newest time in the mean of times."""


class Browser:
    """One browser: viser's handle, its camera and its pictures.

    With ``fixed_size`` resolution and aspect do not depend on the window.
    """

    def __init__(self, client: Any, pose: Pose, fixed_size: bool) -> None:
        self.client = client
        self.pose = pose
        self.panel: Panel | None = None
        self.status: Any = None
        self.pace = Pace(fixed=fixed_size)
        self.picture: Picture | None = None
        self.moved_at = 0.0
        self.reported_at = 0.0
        self.shown = 0
        self.note = ""
        self.expose = True
        self._fixed_size = fixed_size
        self._number = 0
        self._kept: Picture | None = None
        self._factors: dict[int, float] = {}
        self._times: deque[float] = deque(maxlen=256)

    @property
    def is_moving(self) -> bool:
        """Whether the camera moved a moment ago, or objects move."""
        return time.monotonic() - self.moved_at < STILL_AFTER or self._speed > 0.0

    @property
    def _speed(self) -> float:
        """Frames of the objects' motion from picture to picture."""
        return self.panel.speed if self.panel is not None else 0.0

    @property
    def is_resting(self) -> bool:
        """Whether the last picture was sent without loss."""
        return self.picture is not None and self.picture is self._kept

    def make_request(self, description: Description, cameras: CameraMap, *, fresh: bool) -> Request | None:
        """Return the request for the browser's next picture; None if it has no controls or no valid camera.

        ``fresh`` tells whether a new frame is rendered, or the last frame is shown again.
        """
        panel, camera = self.panel, self.client.camera
        if panel is None:
            return None
        placed = cameras.to_camera(self.pose)
        if placed is None:
            return None
        # Sizes are multiples of 8, so aspects differ by a few pixels: crop them.
        window = Window(max(camera.image_width, 1), max(camera.image_height, 1), fill=not self._fixed_size)
        self.pace.fixed = self._fixed_size or not panel.adapt
        factor = self.pace.factor if self.is_moving else 1.0
        size = self._choose_size(description, window, factor)
        if not fresh and self.picture is not None:
            size = self.picture.size
        self._factors = {number: value for number, value in self._factors.items() if number > self._number - 8}
        self._factors[self._number + 1] = factor if self.is_moving else 0.0
        self._number += 1
        wiped = panel.wipe
        return Request(
            client=self.client.client_id,
            number=self._number,
            window=window,
            settings=panel.left.get_settings(),
            other=None if wiped is None else panel.right.get_settings(),
            wipe=0.5 if wiped is None else wiped,
            view=panel.view,
            stops=None if self.expose else panel.stops,
            camera=placed,
            size=size,
            fresh=fresh,
            accumulate=panel.accumulate,
            speed=self._speed,
        )

    def add_picture(self, picture: Picture) -> None:
        """Count a picture that is shown."""
        self.picture = picture
        self.shown += 1
        self.note = ""
        self._times.append(time.monotonic())
        factor = self._factors.pop(picture.number, 0.0)
        if factor:
            self.pace.add(picture.seconds.get("total", 0.0) + picture.seconds.get("picture", 0.0), factor)

    def needs_more(self, description: Description) -> bool:
        """Return whether objects move, or a camera that stands still needs more frames or a frame of the full size."""
        picture, panel = self.picture, self.panel
        if picture is None or panel is None:
            return False
        if self.is_moving:
            # Moving cameras ask by themselves.
            return self._speed > 0.0
        window = Window(self.client.camera.image_width, self.client.camera.image_height)
        unfinished = panel.accumulate and picture.accumulated < MAX_ACCUMULATED
        return unfinished or picture.size != self._choose_size(description, window, 1.0)

    def get_last(self) -> Picture | None:
        """Return the last picture if it is older than `STILL_AFTER` and was not yet sent without loss, else None."""
        picture = self.picture
        if picture is None or picture is self._kept or time.monotonic() - self._times[-1] < STILL_AFTER:
            return None
        return picture

    def keep(self, picture: Picture) -> None:
        """Remember that a picture was sent without loss."""
        self._kept = picture

    def drop_pictures(self) -> None:
        """Free the pictures of a browser that has gone. Its handles refer to each other and stay in memory longer."""
        self.picture = self._kept = None

    def get_rate(self, last: int | None = None) -> float | None:
        """Return pictures per second, over the last ``last`` pictures or `_RATE_SPAN`; None for fewer than three."""
        now = time.monotonic()
        times = list(self._times)
        times = [moment for moment in times if now - moment < _RATE_SPAN] if last is None else times[-last - 1 :]
        if len(times) < 3 or times[-1] <= times[0]:
            return None
        return (len(times) - 1) / (times[-1] - times[0])

    def _choose_size(self, description: Description, window: Window, factor: float) -> tuple[int, int]:
        if self._fixed_size:
            return description.width, description.height
        return fit_size(description.width * description.height, window.width / window.height, factor)


def has_moved(before: Pose, after: Pose) -> bool:
    """Return whether two poses differ."""
    pairs = ((before.position, after.position), (before.look_at, after.look_at), (before.up, after.up))
    return before.fov != after.fov or any((one != two).any() for one, two in pairs)


class Pace:
    """Chooses one of the `STEPS` for a browser, so that its frames take at most `TARGET` seconds.

    With ``fixed`` every frame has all pixels.
    """

    def __init__(self, fixed: bool = False) -> None:
        self.fixed = fixed
        self._step = 0
        self._seconds: float | None = None

    @property
    def factor(self) -> float:
        """Factor of width and height while the camera moves."""
        return 1.0 if self.fixed else STEPS[self._step]

    def add(self, seconds: float, factor: float) -> None:
        """Take the time of a frame that was rendered at a factor while the camera moved."""
        if self.fixed or factor != self.factor:
            return
        before = seconds if self._seconds is None else self._seconds
        self._seconds = before + _SMOOTHING * (seconds - before)
        # A single slow frame may have compiled a kernel: wait for the second.
        if min(self._seconds, seconds) > TARGET and self._step + 1 < len(STEPS):
            self._go(self._step + 1)
        elif self._step > 0:
            larger = (STEPS[self._step - 1] / STEPS[self._step]) ** 2
            if max(self._seconds, seconds) * larger < _MAX_LOAD * TARGET:
                self._go(self._step - 1)

    def _go(self, step: int) -> None:
        self._step, self._seconds = step, None


def fit_size(pixels: int, aspect: float, factor: float = 1.0) -> tuple[int, int]:
    """Return columns and rows, multiples of 8, of a picture with an aspect and about ``pixels * factor**2`` pixels.

    >>> fit_size(512 * 512, 1.0)
    (512, 512)
    >>> fit_size(512 * 512, 16 / 9, 0.5)
    (344, 192)
    """
    height = math.sqrt(pixels / aspect) * factor
    return tuple(max(8 * round(value / 8), 8) for value in (height * aspect, height))  # type: ignore[return-value]
