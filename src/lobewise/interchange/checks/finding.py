"""What was measured in a frame and is not what it was taken for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One convention of a file that is another than it was taken for.

    Parameters
    ----------
    what : str
        Its name, one of those in the table "What is checked" of ``docs/renderers.md``.
    told : str
        One sentence for the user: what was seen, and what becomes of it.
    mended : bool
        Whether the frame was changed for it; else it is a warning.
    """

    what: str
    told: str
    mended: bool


def list_names(names: Sequence[str]) -> str:
    """Return names as a sentence has them: ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
