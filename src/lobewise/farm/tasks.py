"""What the client and a worker send each other: plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from lobewise.recipes.ledger import Ledger, Numbered
from lobewise.recipes.sequence import cut_frames, cut_shots


@dataclass(frozen=True, kw_only=True)
class Task:
    """Frames that one worker filters one after the other: a single frame, or a shot whose frames share a history.

    Parameters
    ----------
    frames : tuple of (int, path)
        Numbers and sources.
    """

    frames: tuple[Numbered, ...]

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the frames."""
        return tuple(number for number, _ in self.frames)


@dataclass(frozen=True, kw_only=True)
class TaskLog:
    """What filtering told about the frames of a task.

    Parameters
    ----------
    remarks : tuple of (str, str)
        Remarks by key. Remarks with one key differ in figures alone, and the user reads the first of them.
    last, settings : str
        The last result and its settings, in one line each.
    """

    remarks: tuple[tuple[str, str], ...] = ()
    last: str = ""
    settings: str = ""


class Work(Protocol):
    """How frames are filtered. Instances hold plain data, because they are sent to workers."""

    def list_sources(self, number: int, path: Path) -> Sequence[Path]:
        """Return every file that the result of a frame depends on."""

    def list_outputs(self, number: int) -> Sequence[Path]:
        """Return every file that is written for a frame."""

    def filter_frames(self, numbers: Sequence[int], *, memory: float | None, ledger: Ledger) -> TaskLog:
        """Filter those of the frames that are not done into their files, and record them.

        Parameters
        ----------
        numbers : sequence of int
            Frames, in order.
        memory : float or None
            GiB that this process may take; None for no limit.
        ledger : Ledger
            The records, by which another worker can go on.

        Raises
        ------
        LobewiseError
            If a frame could not be filtered.
        """


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """A task with everything that a worker needs to do it.

    Parameters
    ----------
    work : Work
        How to filter.
    task : Task
        What to filter.
    ledger : Ledger
        Where finished frames are recorded.
    memory : float or None
        GiB that a worker may take; None for the limit that the worker was started with.
    """

    work: Work
    task: Task
    ledger: Ledger
    memory: float | None


@dataclass(frozen=True, kw_only=True)
class TaskResult:
    """What a worker did with an assignment.

    Parameters
    ----------
    log : TaskLog
        See `TaskLog`.
    problem : str
        Why a frame was not filtered, in one sentence; empty if every frame was.
    trace : str
        For a problem that is a mistake of the program: the traceback.
    is_lost : bool
        Whether the process that was to do it has ended: another one answers, which did nothing.
    """

    log: TaskLog = TaskLog()
    problem: str = ""
    trace: str = ""
    is_lost: bool = False


def cut_tasks(frames: Sequence[Numbered], *, by_shot: bool) -> list[Task]:
    """Return a task for every frame, or for every run of consecutive numbers."""
    return [Task(frames=tuple(each)) for each in (cut_shots if by_shot else cut_frames)(frames)]
