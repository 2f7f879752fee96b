"""Findings of the checks of foreign frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One property of a file that differs from what was assumed.

    Parameters
    ----------
    what : str
        Name of the finding, from the table "What is checked" of ``docs/developers/checks.md``.
    sentence : str
        One sentence for the user: what was measured, and what is done about it.
    mended : bool
        Whether the frame was corrected. If not, the finding is a warning.
    """

    what: str
    sentence: str
    mended: bool


def list_names(names: Sequence[str]) -> str:
    """Return names joined for a sentence: ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
