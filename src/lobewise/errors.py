"""What can go wrong, said in one sentence: argument, expected, got, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from numbers import Integral
from typing import Any

LONGEST_NAME = 100
"""Letters of a name that sentences show."""


class LobewiseError(Exception):
    """Root of every error that a user can mend; the command line turns it into exit code 2.

    Parameters
    ----------
    what : str
        The argument, file or setting; or, without the others, the whole sentence.
    expected, got, action : str
        See `describe_problem`.
    """

    def __init__(self, what: str, *, expected: str = "", got: str = "", action: str = "") -> None:
        told = describe_problem(what, expected=expected, got=got, action=action) if expected else what
        super().__init__(told)


class InputError(LobewiseError, ValueError):
    """An argument, array or setting is not what the function takes."""


class MissingChannelError(InputError):
    """The frame lacks a channel that the chosen similarity needs."""


class FileError(LobewiseError):
    """A file cannot be read, or an output cannot be written; nothing was changed on disk."""


class MissingDependencyError(LobewiseError):
    """An optional package or a system library is absent; the message names what to install."""


class DeviceError(LobewiseError):
    """The requested device cannot run the kernels; the message says why."""


class UnsupportedBsdfError(LobewiseError):
    """A scene uses a BSDF that cannot be evaluated."""


def describe_problem(what: str, *, expected: str, got: str, action: str) -> str:
    """Return the one sentence of an error: ``what``, what was expected, what came, what to do.

    Examples
    --------
    >>> describe_problem("radius", expected="an integer from 0 to 64", got="-3", action="pass radius=8")
    'radius: expected an integer from 0 to 64, got -3; pass radius=8.'
    """
    return f"{what}: expected {expected}, got {got}; {action}{'' if action.endswith('?') else '.'}"


def require_choice(what: str, got: str, valid: Iterable[str]) -> str:
    """Return ``got`` if it is one of ``valid``; otherwise raise an error that names the nearest valid one.

    Raises
    ------
    InputError
        If ``got`` is not one of ``valid``.
    """
    options = list(valid)
    if got in options:
        return got
    # A name from a file may be as long as the file.
    short = got if len(got) <= LONGEST_NAME else f"{got[:LONGEST_NAME]}..."
    near = difflib.get_close_matches(short, options, n=1, cutoff=0.0)
    raise InputError(
        what,
        expected="one of " + ", ".join(options),
        got=repr(short),
        action=f"did you mean {near[0]!r}?" if near else "choose one of them",
    )


def require_integer(what: str, got: Any, lowest: int, highest: int) -> int:
    """Return ``got`` if it is a whole number within bounds, both included; NumPy's integers will do, truth values not.

    Raises
    ------
    InputError
        If it is not.
    """
    whole = isinstance(got, Integral) and not isinstance(got, bool)
    if not whole or not lowest <= got <= highest:
        expected = f"an integer from {lowest} to {highest}"
        raise InputError(what, expected=expected, got=repr(got), action="pass another")
    return int(got)
