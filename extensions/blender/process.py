"""Runs `lobewise denoise` in a process of its own. Nothing here imports Blender."""

from __future__ import annotations

import glob
import importlib.util
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SECONDS_TO_STOP = 2.0
"""Time in which an interrupted process removes its unfinished files, before it is killed."""
SUFFIX = "_clean"
PASSES = {"REPLACE": [], "BESIDE": ["--suffix", SUFFIX], "ONLY": ["--only"]}
"""Options of `lobewise denoise`, by the setting where the results go."""


def list_options(*, quality: str, passes: str, window: int, light_groups: bool, all_layers: bool) -> list[str]:
    """Return the options of `lobewise denoise` for the settings of the panel."""
    options = ["--quality", quality.lower(), *PASSES[passes]]
    options += ["--also", "Combined_*"] if light_groups else []
    options += ["--all-layers"] if all_layers else []
    return options + (["--window", str(window)] if window else [])


def name_pattern(first: str, far: str) -> str:
    """Return the pattern ``shot_####.exr`` from the names of frame 1 and of frame 999999."""
    before, _, after = far.rpartition("999999")
    return before + "#" * (len(first) - len(before) - len(after)) + after


def list_frames(pattern: Path) -> list[Path]:
    """Return the files of a pattern, in the order of their names; a name without ``#`` has one file."""
    name = re.sub("#+", "*", glob.escape(pattern.name))
    return sorted(pattern.parent.glob(name))


def name_output(source: Path) -> Path:
    """Return the path of a result: the same name, in the folder ``clean`` beside the noisy file."""
    return source.parent / "clean" / source.name


def locate_package() -> Path:
    """Return the folder that holds the package lobewise, which Blender's own process need not import."""
    spec = importlib.util.find_spec("lobewise")
    if spec is None or spec.origin is None:
        raise FileNotFoundError(
            "The package lobewise is missing: install the extension's file for this system and version of Blender."
        )
    return Path(spec.origin).parents[1]


class Denoising:
    """A process that denoises a file, or every file of a pattern.

    Parameters
    ----------
    source, output : Path
        Two files, or two patterns such as ``noisy.####.exr``. The output's folder is made.
    options : list of str
        Further options of `lobewise denoise`.
    """

    def __init__(self, source: Path, output: Path, options: list[str]) -> None:
        self.source, self.output = source, output
        self.total = len(list_frames(source))
        self.is_cancelled = False
        self._begin = time.time()
        output.parent.mkdir(parents=True, exist_ok=True)
        folders = [str(locate_package()), os.environ.get("PYTHONPATH", "")]
        # A file, because a pipe that nobody reads would stop the process. `take_messages` closes it.
        self._log = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "lobewise", "denoise", str(source), "-o", str(output), *options],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, folders))},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._log,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )

    def is_done(self) -> bool:
        """Return whether the process has ended."""
        return self._process.poll() is not None

    def wait(self) -> None:
        """Wait until the process has ended."""
        self._process.wait()

    def describe(self) -> tuple[str, float]:
        """Return how far the work is, in words and as a share from 0 to 1."""
        words = f"{time.time() - self._begin:.0f} s"
        if "#" not in self.source.name:
            return words, 0.0
        done = sum(path.stat().st_mtime >= self._begin for path in list_frames(self.output))
        return f"{done} of {self.total} frames, {words}", done / max(self.total, 1)

    def cancel(self) -> None:
        """Stop the process: frames that are written stay, an unfinished file is removed."""
        self.is_cancelled = True
        if os.name == "nt":
            self._process.terminate()
        else:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(SECONDS_TO_STOP)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def take_messages(self) -> tuple[bool, list[str]]:
        """Return whether the work was done, and the remarks of the program; the last tells why it was not."""
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").splitlines()
        self._log.close()
        return self._process.returncode == 0, [line.removeprefix("lobewise: ") for line in lines if line.strip()]
