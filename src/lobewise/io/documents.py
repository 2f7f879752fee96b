"""Read JSON and TOML from untrusted files. Limits are checked before the parser runs, and errors are one sentence.

A parser alone is not enough: nested brackets exhaust its stack, a number of 400 digits fits no float, a few megabytes
of empty lists take a gigabyte as Python objects, and of two equal keys the last wins silently.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import FileError, InputError
from lobewise.io.files import PathLike, refusing, require_readable

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_DEPTH = 64
"""Deepest nesting of lists and objects. Files of this package have 6 levels, glTF files about 10."""
MAX_VALUES = 1 << 21
"""Most values in one document: they take at most 400 MB as Python objects."""
MAX_DIGITS = 308
"""Most digits of an integer: an integer of 308 digits is finite as a 64-bit float."""
MAX_DOTS_IN_LINE = 256
"""Most dots in a line of TOML. The parser stores every prefix of a dotted key, so memory grows with their square."""

_STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*(?:"|\\?\Z)', re.DOTALL)
_HALF_OF_PAIR = re.compile(r"\\u[dD][89a-fA-F]")
# Where tomllib stopped; at the end of the document it gives no line.
_PLACE = re.compile(r"\(at (?:(line \d+, column \d+)|end of document)\)")
_BESIDE_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


class _Refused(ValueError):
    """The reason why a document is refused. The public functions add its name."""


def read_document(path: PathLike, limit: int, *, what: str, holds: str) -> bytes:
    """Return the bytes of a file of at most ``limit`` bytes. ``what`` and ``holds`` name it and its content in errors.

    Raises FileError as `lobewise.io.files.require_readable`, or if the file is larger.
    """
    file = require_readable(path, what=what, holds=holds)
    with refusing(f"{what} {str(path)!r}", "a readable file", "check the disk"), file.open("rb") as stream:
        data = stream.read(limit + 1)
    if len(data) > limit:
        raise FileError(
            f"{what} {str(path)!r}",
            expected=f"{holds}, in a file of at most {limit} bytes",
            got=f"{file.stat().st_size} bytes",
            action="pass another file",
        )
    return data


def parse_json(data: bytes | str, *, what: str, action: str = "mend the file") -> Any:
    """Return the value of a JSON document; ``what`` names its source in errors.

    The limits are `MAX_DEPTH`, `MAX_VALUES` and `MAX_DIGITS`. Every key of an object must be unique, and NaN and
    Infinity, which JSON does not have, are refused. A fraction such as 1e999 is read as infinity: callers must check
    that numbers are finite.

    Raises
    ------
    FileError
        If it is no such document.
    """

    def parse() -> Any:
        raw = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
        _check_nesting(raw)
        text = _decode(raw) if isinstance(data, bytes) else data
        value = json.loads(
            text, parse_int=_parse_whole, parse_constant=_refuse_constant, object_pairs_hook=_make_object
        )
        if _HALF_OF_PAIR.search(text):
            _check_letters(value)
        return value

    return _parse(parse, "JSON", what, action)


def parse_toml(data: bytes, *, what: str, action: str = "mend the file") -> dict[str, Any]:
    """Return the value of a TOML document, within the limits of `parse_json`; ``what`` names its source in errors.

    Raises
    ------
    FileError
        If it is no such document.
    """

    def parse() -> Any:
        text = _decode(data)
        if any(line.count(".") > MAX_DOTS_IN_LINE for line in text.splitlines()):
            raise _Refused(f"a line with more than {MAX_DOTS_IN_LINE} dots")
        value = tomllib.loads(text)
        _check_depth(value)
        return value

    document: dict[str, Any] = _parse(parse, "TOML", what, action)
    return document


def _parse(parse: Callable[[], Any], kind: str, what: str, action: str) -> Any:
    try:
        return parse()
    except RecursionError:
        got = f"lists or objects more than {MAX_DEPTH} deep"
    except _Refused as problem:
        got = str(problem)
    except ValueError as problem:
        # The parsers' own messages change from version to version: tell only the place.
        got = f"text that is no {kind}{_read_place(problem)}"
    except MemoryError:
        got = "more than there is memory for"
    raise FileError(what, expected=kind, got=_make_printable(got), action=action)


def _read_place(problem: ValueError) -> str:
    """Return where a parser stopped, such as " from line 1, column 20 on"; empty if it does not tell."""
    if isinstance(problem, json.JSONDecodeError):
        if not problem.doc[problem.pos :].strip():
            return f": it ends too soon, in line {problem.lineno}"
        return f" from line {problem.lineno}, column {problem.colno} on"
    place = _PLACE.search(str(problem))
    if place is None:
        return ""
    return f" from {place[1]} on" if place[1] else ": it ends too soon"


def _decode(data: bytes) -> str:
    """Decode UTF-8, with or without a byte order mark."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise _Refused(f"text that is not UTF-8: byte {problem.start + 1} is {data[problem.start]:#04x}") from None


def _make_printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _check_nesting(data: bytes) -> None:
    """Raise `_Refused` if brackets are nested too deep or there are too many values, before any value is made."""
    # Every value but the first follows a comma or an opening bracket, so count these outside strings.
    if data.count(b"[") + data.count(b"{") + data.count(b",") <= MAX_DEPTH:
        return
    plain = _STRING.sub(b"", data)
    brackets = np.frombuffer(plain.translate(None, _BESIDE_BRACKETS), np.uint8)
    opens = (brackets == ord("[")) | (brackets == ord("{"))
    if int(np.count_nonzero(opens)) + plain.count(b",") > MAX_VALUES:
        raise _Refused(f"more than {MAX_VALUES} values")
    if brackets.size and int(np.cumsum(np.where(opens, 1, -1).astype(np.int32)).max()) > MAX_DEPTH:
        raise _Refused(f"lists or objects more than {MAX_DEPTH} deep")


def _parse_whole(text: str) -> int:
    if len(text.lstrip("-")) > MAX_DIGITS:
        raise _Refused(f"a whole number of {len(text.lstrip('-'))} digits")
    return int(text)


def _refuse_constant(name: str) -> Any:
    raise _Refused(f"{name}, which JSON does not have")


def _make_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in members if names.count(name) > 1)
        raise _Refused(f"the key {twice[:40]!r} twice")
    return members


def _walk(value: Any) -> Iterable[tuple[int, Any]]:
    """Yield every value and key of a document with its depth, without recursion."""
    waiting = [(1, value)]
    while waiting:
        depth, one = waiting.pop()
        yield depth, one
        if isinstance(one, dict):
            waiting += [(depth + 1, part) for pair in one.items() for part in pair]
        elif isinstance(one, list):
            waiting += [(depth + 1, part) for part in one]


def _check_depth(value: Any) -> None:
    for depth, one in _walk(value):
        if depth > MAX_DEPTH + 1:
            raise _Refused(f"lists or tables more than {MAX_DEPTH} deep")
        if isinstance(one, int) and abs(one) >= 10**MAX_DIGITS:
            raise _Refused(f"a whole number of more than {MAX_DIGITS} digits")


def _check_letters(value: Any) -> None:
    """Raise `_Refused` if a text holds half of a surrogate pair, which cannot be encoded."""
    for _, one in _walk(value):
        if isinstance(one, str) and any("\ud800" <= letter <= "\udfff" for letter in one):
            raise _Refused(f"a text with half a letter in it: {one[:40]!r}")


def describe_kind(value: Any) -> str:
    """Return the kind of a value in a document, such as ``a list``, ``a number`` or ``nothing``."""
    kinds = (
        (bool, "true or false"),
        ((int, float), "a number"),
        (str, "a text"),
        (list, "a list"),
        (dict, "an object"),
    )
    return next((word for kind, word in kinds if isinstance(value, kind)), "nothing" if value is None else "a date")


def require_number(
    what: str, value: Any, *, expected: str = "a finite number", action: str = "write a number"
) -> float:
    """Return a value of a document as a float.

    Raises InputError unless it is a finite number. True and false are no numbers.
    """
    if not _is_number(value):
        raise InputError(what, expected=expected, got=show_value(value), action=action)
    return float(value)


def require_numbers(what: str, value: Any, count: int, *, action: str = "") -> NDArray[np.float64]:
    """Return a list of ``count`` finite numbers of a document as an array, shape (count,); else raise InputError."""
    if not isinstance(value, list) or len(value) != count or not all(map(_is_number, value)):
        words = {2: "two", 3: "three", 4: "four"}.get(count, str(count))
        action = action or f"write [{', '.join('xyzw'[:count])}]"
        raise InputError(what, expected=f"a list of {words} numbers", got=show_value(value), action=action)
    return np.array(value, dtype=np.float64)


def require_arrays(what: str, values: Mapping[str, Any], names: Iterable[str], *, action: str) -> None:
    """Raise InputError unless each of the named values is a number or nested lists of numbers.

    NumPy alone would accept texts too, and give every element the size of the longest text.
    """
    for name in names:
        for _, one in _walk(values[name]):
            if not isinstance(one, list) and not _is_number(one):
                expected = "lists of finite numbers"
                raise InputError(f"{what}, {name}", expected=expected, got=f"{show_value(one)} in it", action=action)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < float("inf")


def show_value(value: Any) -> str:
    """Return a value as text, abbreviated if it is long."""
    if isinstance(value, (list, dict)) and (len(value) > 8 or any(isinstance(one, (list, dict)) for one in value)):
        return f"{describe_kind(value)} of {len(value)}"
    text = json.dumps(value, default=str)
    return text if len(text) <= 80 else f"{text[:70]}..."
