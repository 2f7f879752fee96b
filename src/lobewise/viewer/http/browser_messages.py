"""Checks of the messages of a browser: its camera and window, and changes of controls."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lobewise.errors import LobewiseError

MAX_MESSAGE_BYTES = 1 << 16
"""Largest message. A page sends about 300 bytes at a time."""
MAX_WINDOW_SIDE_PIXELS = 16384
"""Largest side of the picture area: the largest texture of most browsers."""
MAX_WINDOW_PIXELS = 1 << 25
"""Most pixels of the picture area. A screen of 7680x4320 has fewer."""
MAX_WINDOW_ASPECT = 16.0
"""Largest ratio of the sides of the picture area, long over short."""
MAX_COORDINATE = 1e9
"""Largest coordinate of a camera, in the browser's unit. The fourth power of a larger one overflows in float32."""
MIN_FOV, MAX_FOV = 1e-3, math.pi - 1e-3
"""Range of a camera's vertical angle of view, radians."""
CAMERA, UPDATE = "ViewerCameraMessage", "GuiUpdateMessage"
_VECTORS = {"wxyz": 4, "position": 3, "look_at": 3, "up_direction": 3}
_NUMBERS = ("fov", "near", "far", "image_height", "image_width")
_MAX_NAME = 100


class MessageError(LobewiseError):
    """A message that no page sends. Its sender is disconnected."""


@dataclass(frozen=True)
class Control:
    """The values that a control takes: one of ``choices``, a number from ``low`` to ``high``, or True and False."""

    choices: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Checked:
    """A message that is safe to use, or None with a remark that says why it is ignored; the remark may be empty."""

    message: dict[str, Any] | None = None
    remark: str = ""


def read_message(data: bytes | str, controls: Mapping[str, Control]) -> tuple[bytes | None, str]:
    """Return the bytes of a message that is safe to use, or None, and the remark of `check_message`.

    Raises
    ------
    MessageError
        If the bytes are no message that a page sends.
    """
    import msgspec

    if isinstance(data, str):
        raise MessageError("text instead of a message")
    if len(data) > MAX_MESSAGE_BYTES:
        raise MessageError(f"a message of more than {MAX_MESSAGE_BYTES} bytes")
    try:
        message = msgspec.msgpack.decode(data)
    except (msgspec.MsgspecError, ValueError, TypeError, OverflowError, RecursionError):
        raise MessageError("bytes that are no message") from None
    checked = check_message(message, controls)
    if checked.message is None:
        return None, checked.remark
    return (data if checked.message == message else msgspec.msgpack.encode(checked.message)), checked.remark


def check_message(message: object, controls: Mapping[str, Control]) -> Checked:
    """Return a decoded message in a form that is safe to use.

    Window sizes and numbers of sliders are moved into their ranges. These are ignored: cameras that are not finite,
    words that a list does not offer, controls that no longer exist, and kinds of messages that the page does not use.

    Parameters
    ----------
    message : object
        Decoded from msgpack.
    controls : mapping of str to Control
        The existing controls, by viser's identities.

    Raises
    ------
    MessageError
        If fields are missing or have types that a page does not send.
    """
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise MessageError("a message without a type")
    kind = message["type"]
    if kind == CAMERA:
        return _check_camera(message)
    if kind == UPDATE:
        return _check_update(message, controls)
    return Checked(None, f"a message of the kind {kind[:_MAX_NAME]!r}, which this page has no use for")


def _check_camera(message: dict[str, Any]) -> Checked:
    if set(message) != {"type", *_VECTORS, *_NUMBERS}:
        raise MessageError("a camera with other fields")
    for name, length in _VECTORS.items():
        vector = message[name]
        if not isinstance(vector, (list, tuple)) or len(vector) != length or not all(map(_is_number, vector)):
            raise MessageError(f"a camera whose {name} is not {length} numbers")
        # The comparison fails for NaN.
        if not all(abs(number) <= MAX_COORDINATE for number in vector):
            return Checked(None, f"a camera whose {name} is not finite or too large")
    for name in _NUMBERS:
        if not _is_number(message[name]):
            raise MessageError(f"a camera whose {name} is no number")
        if not abs(message[name]) < math.inf:
            return Checked(None, f"a camera whose {name} is not finite")
    if not MIN_FOV <= message["fov"] <= MAX_FOV:
        return Checked(None, "a camera whose angle of view is out of range")
    width, height = clamp_window(message["image_width"], message["image_height"])
    return Checked({**message, "image_width": width, "image_height": height})


def _check_update(message: dict[str, Any], controls: Mapping[str, Control]) -> Checked:
    updates = message.get("updates")
    if set(message) != {"type", "uuid", "updates"} or not isinstance(message["uuid"], str):
        raise MessageError("a change of a control with other fields")
    # Only the server may set other properties of a control.
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        raise MessageError("a change of something else than a control's value")
    control, value = controls.get(message["uuid"]), updates["value"]
    if control is None:
        # A page that has just reconnected may still show its old controls.
        return Checked()
    if control.choices:
        if not isinstance(value, str):
            raise MessageError("a choice that is no word")
        return Checked(message) if value in control.choices else Checked(None, "a choice that is not offered")
    if control.low is None or control.high is None:
        if not isinstance(value, bool):
            raise MessageError("a tick that is neither true nor false")
        return Checked(message)
    if not _is_number(value):
        raise MessageError("a slider's value that is no number")
    if not abs(value) < math.inf:
        return Checked(None, "a slider's value that is not finite")
    return Checked({**message, "updates": {"value": min(max(value, control.low), control.high)}})


def clamp_window(width: float, height: float) -> tuple[int, int]:
    """Return columns and rows of a picture area, moved into the range of real windows.

    >>> clamp_window(1e9, 400), clamp_window(1e9, 1e9), clamp_window(0, 0), clamp_window(1280, 720)
    ((6400, 400), (5792, 5792), (1, 1), (1280, 720))
    """
    columns, rows = (int(min(max(side, 1), MAX_WINDOW_SIDE_PIXELS)) for side in (width, height))
    most = int(MAX_WINDOW_ASPECT * min(columns, rows))
    columns, rows = min(columns, most), min(rows, most)
    factor = min(1.0, math.sqrt(MAX_WINDOW_PIXELS / (columns * rows)))
    return int(columns * factor), int(rows * factor)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
