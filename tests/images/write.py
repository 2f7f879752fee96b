"""Measure all frames and commit to the figures: ``python -m tests.images.write``.

Run it after a deliberate change, with Open Image Denoise installed, and read the difference of ``figures.json`` before
you commit it: every figure that rose wants a reason in the message of the commit.
"""

import json
import re

from tests.images.frames import CASES
from tests.images.measuring import FIGURES, compare_figures, measure_case, read_figures
from tests.images.pictures import locate_baseline, write_baseline

SHOWN = ("balanced", "high")
"""Qualities of which a picture is committed."""


def main() -> None:
    """Write figures and pictures, and tell which figures left their bounds."""
    before = read_figures() if FIGURES.exists() else {}
    figures: dict[str, dict[str, dict[str, float]]] = {}
    for name, quality in CASES:
        measured = measure_case(name, quality)
        figures.setdefault(name, {})[quality] = dict(measured.figures)
        committed = before.get(name, {}).get(quality, {})
        for told in compare_figures(measured.figures, committed, quality) if committed else []:
            print(f"{name}, {quality}: {told}")
        if quality in SHOWN:
            write_baseline(locate_baseline(name, quality), measured)
    text = re.sub(r"\{[^{}]*\}", lambda cell: re.sub(r"\s*\n\s*", " ", cell[0]), json.dumps(figures, indent=1))
    FIGURES.write_text(text + "\n")


if __name__ == "__main__":
    main()
