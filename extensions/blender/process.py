"""Runs `lobewise denoise` in a process of its own. Nothing here imports Blender."""

from __future__ import annotations

import glob
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from threading import Thread

SECONDS_TO_STOP = 2.0
"""Time in which an interrupted process removes its unfinished files, before it is killed."""
SUFFIX = "_clean"
PASSES = {"REPLACE": [], "BESIDE": ["--suffix", SUFFIX], "ONLY": ["--only"]}
"""Options of `lobewise denoise`, by the setting where the results go."""


def list_options(*, quality: str, passes: str, window: int, light_groups: bool, all_layers: bool) -> list[str]:
    """Return the options of `lobewise denoise` for the settings of the panel."""
    options = ["--quality", quality.lower(), *PASSES[passes]]
    options += [] if light_groups else ["--no-light-groups"]
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
        self.is_cancelled = False
        self._record = {"stage": "starting", "share": 0.0}
        self._messages = []
        output.parent.mkdir(parents=True, exist_ok=True)
        folders = [str(locate_package()), os.environ.get("PYTHONPATH", "")]
        command = [sys.executable, "-m", "lobewise", "denoise", str(source), "-o", str(output), "--progress", "json"]
        self._process = subprocess.Popen(
            [*command, *options],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, folders))},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        """Keep the last record of the progress, and all remarks."""
        with self._process.stderr as lines:
            for line in lines:
                try:
                    told = dict(json.loads(line))
                except (ValueError, TypeError):
                    # Python itself writes so.
                    told = {"error": line.decode(errors="replace").strip()}
                if "share" in told:
                    self._record = told
                else:
                    self._messages += filter(None, told.values())

    def is_done(self) -> bool:
        """Return whether the process has ended."""
        return self._process.poll() is not None

    def wait(self) -> None:
        """Wait until the process has ended."""
        self._process.wait()

    def describe(self) -> tuple[str, float]:
        """Return how far the work is, in words and as a share from 0 to 1."""
        record = self._record
        words = f"{record['stage']}, {100 * record['share']:.0f} %"
        if record.get("frames", 1) > 1:
            words = f"{record.get('done', record['frames'])} of {record['frames']} frames, {words}"
        if record.get("seconds_left"):
            words += f", {record['seconds_left']:.0f} s left"
        return words, record["share"]

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
        self._reader.join(SECONDS_TO_STOP)
        return self._process.returncode == 0, self._messages
