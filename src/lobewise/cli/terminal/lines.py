"""JSON for programs that run this one: ``--json``, and with ``--progress json`` the lines on standard error."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from lobewise.errors import require_choice

CHOICES = ("auto", "json", "off")
_chosen = ["auto"]
"""What the command line that runs has chosen."""


def to_json(value: Any, indent: int | None = 2) -> str:
    """Return strict JSON: arrays become lists; infinities and NaN become null. Without ``indent`` it is one line."""

    def clean(item: Any) -> Any:
        if isinstance(item, Mapping):
            return {str(key): clean(part) for key, part in item.items()}
        if isinstance(item, (list, tuple)):
            return [clean(part) for part in item]
        if hasattr(item, "tolist"):
            return clean(item.tolist())
        if isinstance(item, float) and not math.isfinite(item):
            return None
        return item

    return json.dumps(clean(value), indent=indent, allow_nan=False, ensure_ascii=False) + "\n"


def choose_progress(choice: str) -> str:
    """Let all that is told on standard error follow a choice of ``--progress``, and return it.

    Raises InputError if it is unknown.
    """
    _chosen[0] = require_choice("--progress", choice, CHOICES)
    return choice


def writes_lines() -> bool:
    """Return whether everything on standard error is a line of JSON."""
    return _chosen[0] == "json"


def write_line(**fields: Any) -> None:
    """Write a line of JSON to standard error."""
    # A process can be started without standard error, and its reader may have gone.
    if sys.stderr is not None:
        with suppress(OSError):
            sys.stderr.write(to_json(fields, indent=None))
            sys.stderr.flush()
