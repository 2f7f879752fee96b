"""Numbered files: ``render.####.exr`` stands for ``render.0001.exr``, ``render.0002.exr`` and so on."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from lobewise.errors import FileError, InputError, choose_nearest
from lobewise.io.files import PathLike, say_reason

# Signs for the number: #### as in Blender, @@@@ as in Shake, %04d as in C and ffmpeg, $F4 as in Houdini. Names of
# files often have a single @, and $FF is another variable of Houdini.
_RUN = re.compile(r"#+|@{2,}|%(?:0([1-9]\d?))?d|\$F([1-9]?)(?!\w)")


MAX_RUNS_NAMED = 8
"""Most runs of consecutive frames that are named."""


def name_frames(numbers: Iterable[int]) -> str:
    """Return a name such as "Frame 7" or "Frames 7, 9 to 12". Of many runs only the first are named."""
    runs: list[range] = []
    for number in numbers:
        if runs and number == runs[-1].stop:
            runs[-1] = range(runs[-1].start, number + 1)
        else:
            runs.append(range(number, number + 1))
    return _name_runs(runs)


def _name_runs(runs: Sequence[range]) -> str:
    words = [str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs[:MAX_RUNS_NAMED]]
    more = sum(map(len, runs[MAX_RUNS_NAMED:]))
    plural = "s" if sum(map(len, runs)) > 1 else ""
    return f"Frame{plural} {', '.join(words)}{f' and {more} more' if more else ''}"


def describe_gaps(numbers: Sequence[int]) -> str:
    """Return a sentence on the frames that are missing between the first and the last; empty where none is.

    ``numbers`` are those of the existing frames, in their order.
    """
    missing = [range(one + 1, other) for one, other in pairwise(numbers) if other > one + 1]
    if not missing:
        return ""
    verb = "is" if sum(map(len, missing)) == 1 else "are"
    return f"{_name_runs(missing)} of {numbers[0]} to {numbers[-1]} {verb} missing."


def is_pattern(text: PathLike) -> bool:
    """Return whether a path stands for numbered files: its name has a sign for the number, and no such file exists."""
    path = Path(text)
    # `Path.is_file` would raise an error for a name that is too long.
    return _RUN.search(path.name) is not None and not os.path.isfile(path)


@dataclass(frozen=True)
class FramePattern:
    """The name of numbered files."""

    folder: Path
    before: str
    """Text before the number."""
    width: int
    """Fewest digits of a number, a sign included. Smaller numbers begin with zeros, larger ones have more digits."""
    after: str
    """Text after the number, with the ending."""

    @classmethod
    def parse(cls, text: PathLike) -> FramePattern:
        """Return the pattern of a path such as ``out/render.####.exr``; ``@@@@``, ``%04d`` and ``$F4`` are the same.

        Raises InputError if the name of the file has no sign for a number, or more than one.
        """
        path = Path(text)
        runs = list(_RUN.finditer(path.name))
        if len(runs) != 1:
            raise InputError(
                f"sequence {str(path)!r}",
                expected="a name with one run of #, such as render.####.exr",
                got=f"{len(runs)} runs" if runs else "none",
                action="write # where the digits of the number stand",
            )
        run = runs[0]
        width = len(run[0]) if run[0][0] in "#@" else int(run[1] or run[2] or 1)
        return cls(path.parent, path.name[: run.start()], width, path.name[run.end() :])

    def __str__(self) -> str:
        return str(self.folder / f"{self.before}{'#' * self.width}{self.after}")

    def name(self, number: int) -> Path:
        """Return the file of a frame; the sign of a number below 0 counts as a digit, as in ``-007``."""
        return self.folder / f"{self.before}{number:0{self.width}d}{self.after}"

    def read_number(self, path: Path) -> int:
        """Return the number of a file that `find` or `name` returned."""
        return int(path.name[len(self.before) : len(path.name) - len(self.after)])

    def find(self, numbers: Collection[int] | None = None) -> list[tuple[int, Path]]:
        """Return the existing files with their numbers, in the order of the numbers; only those of ``numbers``.

        After a missing number a new take begins: histories of earlier frames must not be used for it.

        Raises FileError if there is no file, one of ``numbers`` has none, or the folder cannot be read.
        """
        try:
            names = [entry.name for entry in self.folder.iterdir() if entry.is_file()]
        except (OSError, ValueError) as problem:
            raise FileError(
                f"sequence {str(self)!r}",
                expected="a folder that can be read",
                got=say_reason(problem),
                action="check the path",
            ) from None
        name = re.compile(f"{re.escape(self.before)}(-?[0-9]+){re.escape(self.after)}")
        numbers_found = [int(match[1]) for match in map(name.fullmatch, names) if match]
        # Other texts of a number are not its name: 00007 and -0007 stand for nothing in a pattern of four digits.
        there = set(names)
        numbered = sorted((each, self.name(each)) for each in set(numbers_found) if self.name(each).name in there)
        # Names such as a-001 and a-002 alone have a hyphen before their numbers, and no number below 0.
        if numbered and numbered[-1][0] >= 0:
            return numbered if numbers is None else self._choose(numbered, set(numbers))
        near = self._choose_near(names)
        raise FileError(
            f"sequence {str(self)!r}",
            expected=f"files such as {self.name(1).name!r}",
            got="none",
            action=f"did you mean {near!r}?" if near else "check the path",
        )

    def _choose(self, numbered: list[tuple[int, Path]], numbers: set[int]) -> list[tuple[int, Path]]:
        """Return the files with some numbers; raise FileError where there is none, with the numbers that have none."""
        if missing := numbers.difference(number for number, _ in numbered):
            raise FileError(
                f"sequence {str(self)!r}",
                expected="every frame that is to be filtered",
                got=f"no file of {name_frames(sorted(missing)).lower()}",
                action="render what is missing, or leave it out",
            )
        return [frame for frame in numbered if frame[0] in numbers]

    def _choose_near(self, names: list[str]) -> str | None:
        """Return the pattern of other numbered files with the most similar name; None if no name is similar.

        Only letters and digits before the ending are compared, because every pattern has a run of # and the ending.
        """
        own = Path(str(self))
        patterns: dict[str, str] = {}
        for name in sorted(names):
            other = re.sub(r"[0-9]+(?!.*[0-9])", lambda run: "#" * len(run[0]), name)
            if other != name and Path(other).suffix.casefold() == own.suffix.casefold():
                patterns.setdefault(_take_letters(other), other)
        near = choose_nearest(_take_letters(own.name), patterns)
        return str(self.folder / patterns[near]) if near is not None else None


def name_pattern(path: Path) -> Path | None:
    """Return the pattern of a numbered file and its neighbours: its last run of digits is the number; None without."""
    name = re.sub(r"[0-9]+(?!.*[0-9])", lambda run: "#" * len(run[0]), path.stem)
    return path.with_name(name + path.suffix) if "#" in name and name != path.stem else None


def name_frame(source: Path, number: int) -> Path:
    """Return the file of a sequence with a number."""
    return FramePattern.parse(source).name(number)


def look_up_number(path: Path, source: Path) -> int | None:
    """Return the number of a file of the sequence ``source``; None where that is a single file."""
    return FramePattern.parse(source).read_number(path) if is_pattern(source) else None


def locate_counterpart(path: Path, source: Path, other: Path) -> Path:
    """Return the file of ``other`` that has the number of ``path`` in the sequence ``source``.

    Where ``source`` is a single file, ``other`` is returned.
    """
    number = look_up_number(path, source)
    return other if number is None else name_frame(other, number)


def _take_letters(name: str) -> str:
    """Return the letters and digits of a name before its ending, in lower case."""
    return re.sub(r"[\W_]", "", Path(name).stem).casefold()
