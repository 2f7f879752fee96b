"""docs/developers/architecture.md is true: it names every room, and the files that each recipe goes through."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import lobewise
from tests.streaming.frames import make_scene
from tests.test_house import ROOMS, SOURCE

PAGE = Path(__file__).parents[1] / "docs" / "developers" / "architecture.md"
SHAPE = (24, 40)


def list_files(run: Callable[[], Any]) -> list[str]:
    """Return the files of the package that a warm call goes through, in the order in which they are entered."""
    run()
    seen: list[str] = []

    def look(frame: FrameType, event: str, _: Any) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(SOURCE) and frame.f_code.co_name != "<module>":
            name = str(path.relative_to(SOURCE))
            if name not in seen:
                seen.append(name)

    before = sys.getprofile()
    sys.setprofile(look)
    try:
        run()
    finally:
        sys.setprofile(before)
    return seen


def describe_ways() -> str:
    """Return the part of the page that lists the files of each recipe."""
    frame = make_scene(SHAPE)
    history = lobewise.TemporalFilter(device="cpu")
    ways = {
        "high": lambda: lobewise.denoise(frame, quality="high", device="cpu"),
        "a history": lambda: history.add(frame),
    }
    history.add(frame)
    lines = []
    for name, run in ways.items():
        found = list_files(run)
        lines.append(f"- **{name}** ({len(found)} files): " + ", ".join(f"`{each}`" for each in found))
    return "\n".join(lines)


def test_every_room_is_named() -> None:
    rooms = PAGE.read_text().split("## Rooms")[1].split("\n## ")[0]
    told = re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in rooms.splitlines() if line.startswith("|")))
    assert sorted(told) == sorted(ROOMS)


@pytest.mark.nightly
def test_ways_are_those_that_frames_go() -> None:
    told = PAGE.read_text().split("<!-- ways:start -->\n")[1].split("\n<!-- ways:end -->")[0]
    assert told == describe_ways()


if __name__ == "__main__":
    np.seterr(all="ignore")
    text = PAGE.read_text()
    start, end = text.index("<!-- ways:start -->\n") + len("<!-- ways:start -->\n"), text.index("<!-- ways:end -->")
    PAGE.write_text(f"{text[:start]}{describe_ways()}\n{text[end:]}")
