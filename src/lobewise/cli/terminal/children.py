"""Does the work of a verb in a child process, so that a crash of Mitsuba ends in a sentence."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import FrameType

import typer

from lobewise.cli.terminal.steps import erase_steps
from lobewise.scenes.crashes import describe_crash

_CHILD_VARIABLE = "LOBEWISE_IS_CHILD"
"""Set for the child process of a system that cannot fork."""
_MAX_EXIT_CODE = 255
"""Largest exit code of a program that ended by itself. Windows has larger ones for crashes."""
_PARENT_GONE = 3
"""Exit code of a child whose parent has ended."""
_is_allowed = False


def allow_children() -> None:
    """Let `go_on_in_child` start a child. Only a process that does nothing but run lobewise may call this."""
    global _is_allowed
    _is_allowed = os.environ.pop(_CHILD_VARIABLE, None) is None and threading.active_count() == 1


def go_on_in_child(scene: str, outputs: Iterable[Path] = ()) -> None:
    """Return in a child process, which loads and renders a scene. This process waits, and ends as the child does.

    Nothing happens unless `allow_children` was called. Call this before anything heavy is imported: the child takes
    over what is in memory, without other threads.

    Parameters
    ----------
    scene : str
        Name or path of the scene, for the sentence.
    outputs : iterable of Path
        Files that the child may have begun to write when it crashes.

    Raises
    ------
    typer.Exit
        With the exit code of the child.
    InputError
        If the child crashed.
    """
    global _is_allowed
    if not _is_allowed:
        return
    _is_allowed = False
    code = _fork() if hasattr(os, "fork") else _start_anew()
    if code is None:
        return
    if 0 <= code <= _MAX_EXIT_CODE:
        raise typer.Exit(code)
    from lobewise.io.replacing import remove_leftovers

    erase_steps()
    for output in outputs:
        remove_leftovers(Path(os.path.realpath(output)))
    raise describe_crash(scene, code)


def _fork() -> int | None:
    """Return the exit code of a child, which is negative after a signal; in the child return None at once.

    A terminal sends Ctrl-C to both processes, ``kill`` to the parent alone. So the child blocks Ctrl-C, and the parent
    passes each on as another signal: the child hears of it once.
    """
    is_ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    receive, send = os.pipe()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    signal.signal(signal.SIGUSR1, _interrupt_here)
    child = os.fork()
    if child == 0:
        os.close(send)
        threading.Thread(target=_follow_parent, args=(receive,), daemon=True).start()
        return None
    os.close(receive)

    def pass_on(number: int, frame: FrameType | None) -> None:
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGUSR1)

    if not is_ignored:
        signal.signal(signal.SIGINT, pass_on)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code == -signal.SIGUSR1:
        # The interpreter of the child was ending, and had given up its handlers.
        raise KeyboardInterrupt
    return code


def _interrupt_here(number: int, frame: FrameType | None) -> None:
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(signal.SIGINT, frame)


def _follow_parent(receive: int) -> None:
    """End this process as soon as its parent has ended, even if the parent was killed: that closes the pipe."""
    os.read(receive, 1)
    os._exit(_PARENT_GONE)


def _start_anew() -> int:
    """Return the exit code of a process that runs the same command line. A console sends Ctrl-C to both processes."""
    signal.signal(signal.SIGINT, lambda number, frame: None)
    command = [sys.executable, *sys.orig_argv[1:]]
    return subprocess.call(command, env={**os.environ, _CHILD_VARIABLE: "1"})
