"""The files of an export as templates: text with ``${name}`` for what differs."""

from __future__ import annotations

from importlib.resources import files
from string import Template


def fill_template(file: str, **parts: object) -> str:
    """Return a file of the folder ``templates`` with every ``${name}`` replaced."""
    path = files("lobewise") / "exporting" / "templates" / file
    return Template(path.read_text(encoding="utf-8")).substitute(parts)
