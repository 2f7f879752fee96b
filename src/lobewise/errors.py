"""Errors whose message is one sentence: the argument, what was expected, what came, and what to do."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typing_extensions import Self

MAX_SHOWN_LETTERS = 40
"""Longest value, in letters, that a message shows as it is. Of longer values it names the type."""
MAX_GOT_LETTERS = 300
"""Longest description of a wrong value in a message, in letters."""
MAX_NAME_LETTERS = 100
"""Longest name in a message, in letters."""
MIN_LIKENESS = 0.65
"""Smallest similarity, by `difflib.SequenceMatcher.ratio`, at which a message suggests a name. A wrong suggestion is
worse than none: with 0.6 "renderman" would be suggested for "blender"."""


class LobewiseError(Exception):
    """Base of every error that a user can correct. The command line exits with code 2.

    It prints as one sentence of its parameters, which are attributes of the same names.

    Parameters
    ----------
    what : str
        The argument, file or setting. Without ``expected``, what is wrong; without ``action`` too, the whole sentence.
    expected, got : str
        What was expected, and what came: shown in one line of at most `MAX_GOT_LETTERS`.
    action : str
        What to do, without a full stop.
    holder : str
        The file or object that holds ``what``, if its name is needed to find it.

    Examples
    --------
    >>> raise LobewiseError("radius", expected="an integer from 0 to 64", got="-3", action="pass radius=8")
    Traceback (most recent call last):
    lobewise.errors.LobewiseError: radius: expected an integer from 0 to 64, got -3; pass radius=8.
    """

    def __init__(self, what: str, *, expected: str = "", got: str = "", action: str = "", holder: str = "") -> None:
        self.what, self.expected, self.got, self.action, self.holder = what, expected, _shorten(got), action, holder
        super().__init__(f"{self.fault}; {action}{'' if action.endswith('?') else '.'}" if action else self.fault)

    @property
    def fault(self) -> str:
        """What is wrong: the sentence without what to do."""
        name = f"{self.holder}: {self.what}" if self.holder else self.what
        return f"{name}: expected {self.expected}, got {self.got}" if self.expected else name

    @property
    def fields(self) -> dict[str, str]:
        """The parameters that make the same error, by their names."""
        return {name: getattr(self, name) for name in ("what", "expected", "got", "action", "holder")}

    def change(self, **fields: str) -> Self:
        """Return the same error with some fields changed."""
        return type(self)(**(self.fields | fields))

    def place_in(self, holder: str, kind: type[LobewiseError] | None = None) -> LobewiseError:
        """Return this error, as one of ``kind`` if given, about something that ``holder`` holds."""
        holder = f"{holder}: {self.holder}" if self.holder else holder
        return (kind or type(self))(**(self.fields | {"holder": holder}))


class InputError(LobewiseError, ValueError):
    """An argument, array or setting is invalid."""


class MissingChannelError(InputError):
    """The frame lacks a channel that the chosen similarity needs."""


class FileError(LobewiseError):
    """A file cannot be read, or an output cannot be written; nothing was changed on disk."""


class MissingDependencyError(LobewiseError):
    """An optional package or a system library is absent; the message names what to install."""


class DeviceError(LobewiseError):
    """The requested device cannot run the kernels; the message says why."""


class LimitError(LobewiseError):
    """A call would take more memory or time than it may; see `lobewise.limit_call`."""


class TimeLimitError(LimitError):
    """The time of a call is over; no file is to blame."""


class CancelledError(LobewiseError):
    """The function that was given as ``progress`` has returned False; nothing was written."""


class UnsupportedBsdfError(LobewiseError):
    """A scene uses a BSDF that cannot be evaluated."""


class UnusedGuideWarning(UserWarning):
    """A guide is given and not used; the message names it and says why. `lobewise.Result.notes` has it as well."""


def make_printable(text: str) -> str:
    """Return a text that is safe to print: control characters and undecodable bytes become escapes.

    Line breaks and tabs stay.
    """
    return "".join(letter if letter.isprintable() or letter in "\n\t" else ascii(letter)[1:-1] for letter in text)


def _shorten(got: str) -> str:
    """Return a description in one line of at most `MAX_GOT_LETTERS`: a printed array has many lines."""
    line = " ".join(got.split()) if "\n" in got else got
    return line if len(line) <= MAX_GOT_LETTERS else f"{line[: MAX_GOT_LETTERS - 3]}..."


def require_kind(what: str, got: Any, *kinds: type) -> None:
    """Raise InputError unless ``got`` is an instance of one of ``kinds``."""
    if not isinstance(got, kinds):
        expected = " or ".join(f"a {kind.__name__}" for kind in kinds)
        raise InputError(what, expected=expected, got=f"a {type(got).__name__}", action="pass another")


def require_number(what: str, got: Any) -> float:
    """Return ``got`` as a float; raise InputError unless it is a real number. True and False are no numbers.

    Infinite numbers and NaN are accepted.
    """
    try:
        if isinstance(got, Real) and not isinstance(got, bool):
            return float(got)
    except OverflowError:
        pass
    raise InputError(what, expected="a number", got=name_value(got), action="pass another")


def name_value(got: Any, max_letters: int = MAX_SHOWN_LETTERS) -> str:
    """Return a short value as Python writes it, or the type of a long one. NumPy's numbers look like Python's.

    Examples
    --------
    >>> import numpy as np
    >>> name_value((np.float64(0.5), np.int32(2)))
    '(0.5, 2)'
    """
    shown = repr(_to_plain(got))
    return shown if len(shown) <= max_letters and "\n" not in shown else f"a {type(got).__name__}"


def _to_plain(value: Any) -> Any:
    """Return a value whose NumPy numbers and short arrays, also in tuples and lists, are Python numbers and lists."""
    if type(value) in (tuple, list):
        return type(value)(map(_to_plain, value))
    # Recognise NumPy by its name: this module must not import it.
    is_numpy = type(value).__module__ == "numpy" and hasattr(value, "tolist")
    return value.tolist() if is_numpy and value.size <= MAX_SHOWN_LETTERS else value


def choose_nearest(name: str, options: Iterable[str]) -> str | None:
    """Return the option that is most similar to a name, ignoring case; None if no option is similar enough.

    Examples
    --------
    >>> choose_nearest("hihg", ["fast", "balanced", "high"])
    'high'
    >>> choose_nearest("best", ["fast", "balanced", "high"])
    """
    by_letters = {option.casefold(): option for option in options}
    near = difflib.get_close_matches(name.casefold(), list(by_letters), n=1, cutoff=MIN_LIKENESS)
    return by_letters[near[0]] if near else None


def hide_numbers(note: str) -> str:
    """Return a note without its figures, which differ from frame to frame: only the first frame's are printed."""
    return re.sub(r"\d+(\.\d+)?", "#", note)


def require_choice(what: str, got: str, valid: Iterable[str]) -> str:
    """Return ``got``; raise InputError with the nearest valid name unless it is one of ``valid``."""
    options = list(valid)
    if not isinstance(got, str):
        raise InputError(
            what, expected="one of " + ", ".join(options), got=f"a {type(got).__name__}", action="name one of them"
        )
    if got in options:
        return got
    # A name that was read from a file can have any length.
    short = got if len(got) <= MAX_NAME_LETTERS else f"{got[:MAX_NAME_LETTERS]}..."
    near = choose_nearest(short, options)
    raise InputError(
        what,
        expected="one of " + ", ".join(options),
        got=repr(short),
        action=f"did you mean {near!r}?" if near else "choose one of them",
    )


def require_integer(what: str, got: Any, lowest: int, highest: int) -> int:
    """Return ``got`` as an int; raise InputError unless it is an integer from ``lowest`` to ``highest``.

    NumPy's integers are accepted, True and False are not.
    """
    whole = isinstance(got, Integral) and not isinstance(got, bool)
    if not whole or not lowest <= got <= highest:
        expected = f"an integer from {lowest} to {highest}"
        raise InputError(what, expected=expected, got=name_value(got), action="pass another")
    return int(got)
