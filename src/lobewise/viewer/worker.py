"""The worker: the process that renders, one command at a time.

Compilers hold Python's lock for seconds, and a renderer may abort its process. In a process of its own neither stops
the page.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import time
from multiprocessing import connection, parent_process
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lobewise.display.hushing import hush_libraries
from lobewise.errors import InputError, LobewiseError
from lobewise.viewer.messages import (
    Command,
    Forget,
    Opened,
    Picture,
    Problem,
    Progress,
    Report,
    Request,
    Save,
    SavedFile,
    Target,
    describe_failure,
)

if TYPE_CHECKING:
    from lobewise.interactive import InteractiveFrame
    from lobewise.viewer.scene_target import SceneTarget

_PARENT_GONE = 3
"""Exit code of a worker whose parent has ended."""


def run_worker(pipe: connection.Connection, target: Target) -> None:
    """Open the target, then answer commands until the pipe is closed or the parent has ended, in an own process."""
    # Ctrl-C reaches every process of the terminal; the parent decides when this one ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    hush_libraries()
    threading.Thread(target=_follow_parent, daemon=True).start()
    try:
        Worker(pipe, target).serve()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


def _follow_parent() -> None:
    """End this process as soon as its parent has ended, even if the parent was killed."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(_PARENT_GONE)


class Worker:
    """Answers commands over a pipe with reports. None follows the last report of a command."""

    def __init__(self, pipe: connection.Connection, target: Target) -> None:
        self._pipe = pipe
        self._target = target
        self._shown: dict[int, Any] = {}
        self._reported_at = 0.0

    def serve(self) -> None:
        """Open the target and answer commands until None comes."""
        try:
            opened = self._open(self._target)
            self._send(Opened(opened.describe()))
        except LobewiseError as problem:
            self._send(Problem(problem))
            return
        except Exception as problem:
            self._send(Problem(RuntimeError(describe_failure(problem))))
            return
        while (command := self._pipe.recv()) is not None:
            self._answer(opened, command)
            self._pipe.send(None)

    def _send(self, report: Report) -> None:
        self._pipe.send(report)

    def _open(self, target: Target) -> SceneTarget:
        from lobewise.viewer.scene_target import SceneTarget

        return SceneTarget(target.name, target.size, self._tell_preparing, target.moving)

    def _tell_preparing(self, done: int, total: int) -> None:
        now = time.monotonic()
        if now - self._reported_at > 0.2 or done == total:
            self._reported_at = now
            self._send(Progress(f"Preparing the scene, {100 * done // max(total, 1)} %"))

    def _answer(self, opened: SceneTarget, command: Command) -> None:
        """Execute one command. An error is reported to its browser, and the worker goes on."""
        try:
            if isinstance(command, Forget):
                self._shown.pop(command.client, None)
                opened.forget(command.client)
            elif isinstance(command, Save):
                self._send(self._save(opened, command))
            else:
                if not opened.is_warm:
                    self._send(self._draw(opened, command, opened.show_input(command), final=False))
                self._send(self._draw(opened, command, opened.render(command), final=True))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            raise
        except LobewiseError as problem:
            self._send(Problem(problem, command.client))
        except Exception as problem:
            self._send(Problem(RuntimeError(describe_failure(problem)), command.client))

    def _draw(self, opened: SceneTarget, command: Request, frames: list[InteractiveFrame], *, final: bool) -> Picture:
        from lobewise.viewer.pictures import choose_stops, fit_window, paint, wipe
        from lobewise.viewer.scene_settings import name_sides

        first = frames[0]
        stops = choose_stops(first.image) if command.stops is None else command.stops
        start = time.perf_counter()
        plain = [paint(command.view, frame.get_view(command.view), 2.0**stops) for frame in frames]
        pictures = [fit_window(picture, command.window) for picture in plain]
        two = len(pictures) == 2
        labels = name_sides(command.settings, command.other or command.settings)
        pixels = wipe(pictures[0], pictures[1], command.wipe, labels) if two else pictures[0]
        if final:
            # Keep the whole picture, without bars, for a file.
            whole = pictures[0] is plain[0]
            wiped = pixels if whole or not two else wipe(plain[0], plain[1], command.wipe, labels)
            self._shown[command.client] = wiped if two else plain[0]
        return Picture(
            client=command.client,
            number=command.number,
            pixels=pixels,
            size=(first.image.shape[1], first.image.shape[0]),
            stops=stops if command.stops is None else None,
            seconds={**first.seconds, "picture": time.perf_counter() - start},
            accumulated=first.accumulated,
            recomputed=first.recomputed,
            moment=opened.moments.get(command.client),
            memory=measure_memory(),
            final=final,
        )

    def _save(self, opened: SceneTarget, command: Save) -> SavedFile:
        if command.client not in self._shown:
            raise InputError("save", expected="a picture", got="none yet", action="wait until there is one")
        if command.kind == "exr":
            with tempfile.TemporaryDirectory() as folder:
                path = opened.write(command.client, Path(folder))
                return SavedFile(command.client, path.name, path.read_bytes())
        from lobewise.io.png import encode_png

        name = f"{Path(self._target.name).stem}.png"
        return SavedFile(command.client, name, encode_png(self._shown[command.client]))


def measure_memory() -> int:
    """Return the memory of this process, bytes; 0 on systems that do not tell it."""
    if sys.platform == "linux":
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0
