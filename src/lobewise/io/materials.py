"""Files of materials: MERL tables in, lobe tables in and out.

A lobe file is JSON: an object with ``"format": "lobewise lobes"``, ``"version": 1`` and the fields of a `LobeTable`,
arrays as nested lists. Every number has as many digits as its float32 needs, so that reading gives the same bits.
"""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lobewise.errors import FileError, InputError
from lobewise.io.documents import describe_kind, parse_json, read_document, require_arrays, show_value
from lobewise.io.files import PathLike, read_bytes, write_text
from lobewise.records.lobe_table import LobeTable

if TYPE_CHECKING:
    from lobewise.fitting.merl import MerlBrdf

FORMAT = "lobewise lobes"
VERSION = 1
_MAX_BYTES = 1 << 26
"""Largest lobe file, far above that of 4 lobes for a thousand views."""
_FIELDS = tuple(item.name for item in fields(LobeTable))


def read_merl(path: PathLike) -> MerlBrdf:
    """Return the BRDF of a MERL file, with the file's name.

    Raises
    ------
    FileError
        If it cannot be read, or is not a whole MERL file with measurements; see `parse_merl`.
    """
    from lobewise.fitting.merl import FILE_BYTES, parse_merl

    # Read one byte more than a MERL file has, to detect larger files.
    data = read_bytes(path, FILE_BYTES + 1, holds="a MERL table")
    try:
        return parse_merl(data, Path(path).stem)
    except FileError as problem:
        raise problem.place_in(str(path), FileError) from None


def read_lobe_table(path: PathLike) -> LobeTable:
    """Return the lobe table of a ``.lobes`` file.

    Raises
    ------
    FileError
        If it cannot be read, is no lobe file, is of another version, or holds values that no table can have.
    """
    data = read_document(path, _MAX_BYTES, what="lobe file", holds="a lobe table")
    return lobe_table_from_json(data, what=f"lobe file {str(path)!r}")


def write_lobe_table(path: PathLike, table: LobeTable) -> None:
    """Write a ``.lobes`` file, whole or not at all.

    Raises
    ------
    FileError
        If the path cannot be written.
    """
    write_text(path, lobe_table_to_json(table))


def lobe_table_to_json(table: LobeTable) -> str:
    """Return the text of a lobe file. Headers of images hold it too."""
    values: dict[str, Any] = {"format": FORMAT, "version": VERSION}
    for name in _FIELDS:
        value = getattr(table, name)
        values[name] = value if isinstance(value, str) else _to_lists(value)
    lines = [f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in values.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def lobe_table_from_json(text: str | bytes, *, what: str = "lobe table") -> LobeTable:
    """Return the table that `lobe_table_to_json` wrote; ``what`` names the source of the text in errors.

    Raises FileError if it is no lobe table, is of another version, or holds values that no table can have.
    """
    values = parse_json(text, what=what, action="pass a file that `lobewise fit` wrote")
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise FileError(
            what,
            expected=f"JSON with the format {FORMAT!r}",
            got="another format" if isinstance(values, dict) else describe_kind(values),
            action="pass a file that `lobewise fit` wrote",
        )
    version = values.get("version")
    if version != VERSION or type(version) is not int:
        raise FileError(
            what,
            expected=f"version {VERSION}",
            got="none" if version is None else f"version {show_value(version)}",
            action="update lobewise or fit the material again",
        )
    lost = [name for name in _FIELDS if name not in values]
    if lost:
        raise FileError(
            what, expected=f"all of {', '.join(_FIELDS)}", got=f"no {lost[0]}", action="fit the material again"
        )
    unknown = [name for name in values if name not in ("format", "version", *_FIELDS)]
    if unknown:
        raise FileError(
            what, expected=f"no fields but {', '.join(_FIELDS)}", got=repr(unknown[0][:40]), action="leave it out"
        )
    for name in ("name", "kind"):
        if not isinstance(values[name], str):
            got = describe_kind(values[name])
            raise FileError(f"{what}, {name}", expected="a text", got=got, action="fit the material again")
    try:
        arrays = [name for name in _FIELDS if name not in ("name", "kind")]
        require_arrays("lobe table", values, arrays, action="fit the material again")
        return LobeTable(**{name: values[name] for name in _FIELDS})
    except InputError as problem:
        raise problem.place_in(what, FileError) from None


def _to_lists(array: Any) -> Any:
    """Return nested lists of floats with the fewest digits that give the same float32."""
    if array.ndim == 0:
        return float(str(array))
    return [_to_lists(part) for part in array]
