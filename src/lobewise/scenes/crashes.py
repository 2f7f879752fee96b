"""The sentence for a scene that ended the process which loaded or rendered it."""

from __future__ import annotations

import signal

from lobewise.errors import InputError


def describe_crash(scene: str, code: int) -> InputError:
    """Return the error for a scene whose process ended with an exit code; that of a signal is negative."""
    cause = signal.Signals(-code).name if -code in set(signal.Signals) else f"exit code {code}"
    got = f"the end of Mitsuba's process by {cause}"
    action = "leave out its meshes and textures one by one, and see what `lobewise doctor` says of Mitsuba"
    if cause == "SIGKILL":
        got += ", as where memory runs out"
        action = "free memory, or use a smaller image, smaller meshes or smaller textures"
    return InputError(f"scene {scene!r}", expected="one that Mitsuba can load and render", got=got, action=action)
