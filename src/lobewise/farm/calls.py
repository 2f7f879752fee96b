"""Calls of functions on workers, whoever carries them: processes of this machine, or Dask."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol


class ConnectionLostError(Exception):
    """The scheduler does not answer any more."""


class CallLostError(Exception):
    """A call was lost with its scheduler; it may be made again."""


class WorkerLostError(CallLostError):
    """A call was lost because the process of its worker has ended."""


class CallFailedError(Exception):
    """The function of a call raised an error, or could not be loaded by the worker."""


class Call(Protocol):
    """A function that runs on a worker."""

    @property
    def key(self) -> str:
        """A name that no other call has."""

    @property
    def has_ended(self) -> bool:
        """Whether the function has returned or failed, or the call was lost."""

    def fetch(self) -> Any:
        """Return what the function returned; raise `CallLostError` or `CallFailedError`."""

    def drop(self) -> None:
        """Forget the call; a function that does not run yet never will."""


class Connection(Protocol):
    """The workers that run calls."""

    @property
    def address(self) -> str:
        """What connects them, as users know it."""

    def list_workers(self) -> dict[str, int]:
        """Return the threads of each worker by its name; raise `ConnectionLostError` if the scheduler is gone."""

    def call(self, worker: str, function: Callable[..., Any], *arguments: Any) -> Call:
        """Let a worker call a function; raise `ConnectionLostError` if the scheduler is gone."""

    def wait_for_finished(self, seconds: float) -> list[str]:
        """Return the keys of calls that have ended, however they ended; wait at most some seconds for the first."""
