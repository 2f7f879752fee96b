"""A progress bar for the ``progress`` arguments of this package, in notebooks and in terminals."""

from __future__ import annotations

import html
import sys
from importlib import import_module
from typing import Any

from lobewise.errors import InputError
from lobewise.work.progress import Progress

MIN_STEP_SHARE = 0.005
"""A bar is drawn again when it has grown by this share."""
_BAR = "height:10px;border-radius:5px;background:rgba(128,128,128,.25);max-width:420px;overflow:hidden"


class ProgressBar:
    """A bar that grows while a function of this package works.

    In a notebook it is a part of the cell's output; in a terminal it is a line, which vanishes at the end. Elsewhere it
    prints nothing.

    Parameters
    ----------
    title : str
        What is done; functions that name their steps add the step.

    Examples
    --------
    >>> import lobewise
    >>> from lobewise.render import load_scene, render_frame
    >>> bar = lobewise.ProgressBar("rendering")
    >>> frame = render_frame(load_scene("showroom"), spp=64, progress=bar)  # doctest: +SKIP
    """

    def __init__(self, title: str = "") -> None:
        if not isinstance(title, str):
            raise InputError("title", expected="a text", got=type(title).__name__, action="pass a text")
        self.title = title
        self._shown: tuple[str, float] | None = None
        self._handle: Any = None
        self._terminal: Any = None

    def __call__(self, *told: Any) -> None:
        """Show how far the work is: a `lobewise.Progress`, ``(done, total)``, or ``(what, done, total)``.

        Raises InputError if the values are none of these.
        """
        if len(told) == 1 and isinstance(told[0], Progress):
            told = (told[0].stage, told[0].share, 1.0)
        if len(told) not in (2, 3):
            raise InputError(
                "progress", expected="done and total", got=f"{len(told)} values", action="pass it as progress="
            )
        *names, done, total = told
        text = ": ".join(filter(None, [self.title, *map(str, names)]))
        share = min(max(done / total, 0.0), 1.0) if total else 1.0
        if self._shown is not None and share < 1.0:
            before, last = self._shown
            if before == text and 0.0 <= share - last < MIN_STEP_SHARE:
                return
        self._shown = (text, share)
        if _is_in_notebook():
            self._draw_in_notebook(text, share)
        elif sys.stderr is not None and sys.stderr.isatty():
            self._draw_in_terminal(text, share)

    def _draw_in_notebook(self, text: str, share: float) -> None:
        shell: Any = import_module("IPython.display")

        bar = (
            f'<div>{html.escape(text)} {100.0 * share:.0f} %<div style="{_BAR}">'
            f'<div style="width:{100.0 * share:.1f}%;height:100%;background:#3f7fbf"></div></div></div>'
        )
        if self._handle is None:
            self._handle = shell.display(shell.HTML(bar), display_id=True)
        else:
            self._handle.update(shell.HTML(bar))

    def _draw_in_terminal(self, text: str, share: float) -> None:
        from rich.console import Console
        from rich.progress import Progress as Display

        if self._terminal is None:
            # A redirected standard error says that it is no terminal, and both streams belong to the program.
            console = Console(stderr=True)
            self._terminal = Display(console=console, transient=True, redirect_stdout=False, redirect_stderr=False)
            self._terminal.add_task(text, total=1.0)
            self._terminal.start()
        self._terminal.update(self._terminal.task_ids[0], description=text, completed=share, refresh=True)
        if share >= 1.0:
            self._terminal.stop()
            self._terminal = None


def _is_in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    running: Any = sys.modules.get("IPython")
    shell = running.get_ipython() if running is not None else None
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"
