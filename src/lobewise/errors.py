"""What can go wrong, said in one sentence: argument, expected, got, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

MAX_SHOWN_LETTERS = 40
"""Length of a value that a message shows instead of naming its type."""
MAX_GOT_LETTERS = 300
"""Length of what a message shows of a wrong value."""
MAX_NAME_LETTERS = 100
"""Letters of a name that sentences show."""
MIN_LIKENESS = 0.65
"""Share of the letters that two names must have in common, in one order, for one to be suggested in place of the other
(`difflib.SequenceMatcher.ratio`). A wrong suggestion is worse than none: at 0.6 blender would be renderman."""


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


def make_printable(text: str) -> str:
    """Return a text that any terminal can show and none obeys: escapes in place of control characters and odd bytes.

    Lines and tabs stay.
    """
    return "".join(letter if letter.isprintable() or letter in "\n\t" else ascii(letter)[1:-1] for letter in text)


def describe_problem(what: str, *, expected: str, got: str, action: str) -> str:
    """Return the one sentence of an error: ``what``, what was expected, what came, what to do.

    Examples
    --------
    >>> describe_problem("radius", expected="an integer from 0 to 64", got="-3", action="pass radius=8")
    'radius: expected an integer from 0 to 64, got -3; pass radius=8.'
    """
    return f"{what}: expected {expected}, got {_shorten(got)}; {action}{'' if action.endswith('?') else '.'}"


def _shorten(got: str) -> str:
    """Return what came on one line: an array would fill the screen."""
    line = " ".join(got.split()) if "\n" in got else got
    return line if len(line) <= MAX_GOT_LETTERS else f"{line[: MAX_GOT_LETTERS - 3]}..."


def require_kind(what: str, got: Any, *kinds: type) -> None:
    """Raise an error unless ``got`` is of one of some classes.

    Raises
    ------
    InputError
        If it is not.
    """
    if not isinstance(got, kinds):
        expected = " or ".join(f"a {kind.__name__}" for kind in kinds)
        raise InputError(what, expected=expected, got=f"a {type(got).__name__}", action="pass another")


def require_number(what: str, got: Any) -> float:
    """Return ``got`` as a float if it is one real number, which may be infinite or NaN; truth values are none.

    Raises
    ------
    InputError
        If it is not.
    """
    try:
        if isinstance(got, Real) and not isinstance(got, bool):
            return float(got)
    except OverflowError:
        pass
    raise InputError(what, expected="a number", got=name_value(got), action="pass another")


def name_value(got: Any, max_letters: int = MAX_SHOWN_LETTERS) -> str:
    """Return a short value as it is written, and of a long one its type; numbers of NumPy as Python writes them.

    Examples
    --------
    >>> import numpy as np
    >>> name_value((np.float64(0.5), np.int32(2)))
    '(0.5, 2)'
    """
    shown = repr(_to_plain(got))
    return shown if len(shown) <= max_letters and "\n" not in shown else f"a {type(got).__name__}"


def _to_plain(value: Any) -> Any:
    """Return a value in which NumPy's numbers and short arrays, also inside tuples and lists, are Python's."""
    if type(value) in (tuple, list):
        return type(value)(map(_to_plain, value))
    # Told by the name of the module: this room imports nothing.
    is_numpy = type(value).__module__ == "numpy" and hasattr(value, "tolist")
    return value.tolist() if is_numpy and value.size <= MAX_SHOWN_LETTERS else value


def find_nearest(name: str, options: Iterable[str]) -> str | None:
    """Return the option that is most like a name, whatever the case of the letters; None where none is much like it.

    Examples
    --------
    >>> find_nearest("hihg", ["fast", "balanced", "high"])
    'high'
    >>> find_nearest("best", ["fast", "balanced", "high"])
    """
    by_letters = {option.casefold(): option for option in options}
    near = difflib.get_close_matches(name.casefold(), list(by_letters), n=1, cutoff=MIN_LIKENESS)
    return by_letters[near[0]] if near else None


def require_choice(what: str, got: str, valid: Iterable[str]) -> str:
    """Return ``got`` if it is one of ``valid``; otherwise raise an error that names the nearest valid one.

    Raises
    ------
    InputError
        If ``got`` is not one of ``valid``.
    """
    options = list(valid)
    if not isinstance(got, str):
        raise InputError(
            what, expected="one of " + ", ".join(options), got=f"a {type(got).__name__}", action="name one of them"
        )
    if got in options:
        return got
    # A name from a file may be as long as the file.
    short = got if len(got) <= MAX_NAME_LETTERS else f"{got[:MAX_NAME_LETTERS]}..."
    near = find_nearest(short, options)
    raise InputError(
        what,
        expected="one of " + ", ".join(options),
        got=repr(short),
        action=f"did you mean {near!r}?" if near else "choose one of them",
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
        raise InputError(what, expected=expected, got=name_value(got), action="pass another")
    return int(got)
