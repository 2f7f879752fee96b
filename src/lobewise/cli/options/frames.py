"""The option ``--frames``: which frames of a sequence are filtered."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

from lobewise.cli.options.common import require_pattern
from lobewise.cli.options.writing import Picture
from lobewise.cli.terminal.help import sequence_option
from lobewise.errors import InputError

MAX_FRAMES_CHOSEN = 1_000_000
_RANGE = re.compile(r"([0-9]{1,9})(?:(-)([0-9]{1,9})?(?:x([1-9][0-9]{0,8}))?)?")
"""Number, or first and last number with a hyphen between them, and the step; the last number may be left out."""

Frames = Annotated[
    str | None,
    sequence_option(
        "--frames",
        metavar="RANGES",
        help="Filter only these, such as 10-50x2, 1,5-9 or 20-. --window still reads the frames around them. With "
        "upsample --temporal the history begins at the first of them, and anew after a gap.",
        show_default=False,
    ),
]


def parse_frames(text: str, list_there: Callable[[], Sequence[int]]) -> list[int]:
    """Return the frames of a text such as ``1,5,10-20x2`` in their order, each once; raise InputError for another.

    ``list_there`` returns the numbers of the sequence: ``20-`` stands for those from 20 on.
    """
    matches = [_RANGE.fullmatch(part.strip()) for part in text.split(",")]
    runs: list[Sequence[int]] = []
    for one in filter(None, matches):
        first, step = int(one[1]), int(one[4] or 1)
        if one[2] and not one[3]:
            runs.append([number for number in list_there() if number >= first and (number - first) % step == 0])
        else:
            runs.append(range(first, int(one[3] or first) + 1, step))
    if len(runs) == len(matches) and all(runs) and sum(map(len, runs)) <= MAX_FRAMES_CHOSEN:
        return sorted(set[int]().union(*runs))
    raise InputError(
        "--frames",
        expected=f"at most {MAX_FRAMES_CHOSEN} frames, such as 1001-1050, 1001-1050x2 or 1,5,10-20",
        got=repr(text),
        action="write whole numbers, and the first frame of a range before its last",
    )


def choose_numbers(frames: str | None, source: Path, picture: Picture) -> list[int] | None:
    """Return the frames that ``--frames`` names, None where it is not given.

    Raises InputError if it names none, ``source`` is a single file, or pictures have no exposure.
    """
    if frames is None:
        return None
    from lobewise.io.sequence import FramePattern

    require_pattern("--frames", source)
    if picture.png and picture.exposure is None and not picture.has_view:
        raise InputError(
            "--png",
            expected="--exposure beside --frames, so that all pictures of the sequence have the same",
            got="none",
            action="add --exposure 0 or another number",
        )
    return parse_frames(frames, lambda: [number for number, _ in FramePattern.parse(source).find()])
