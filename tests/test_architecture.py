"""docs/developers/architecture.md is true: it names every room, and the files that each recipe goes through."""

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
from tests.test_house import ROOMS, SOURCE, get_room, list_imports, list_modules

PAGE = Path(__file__).parents[1] / "docs" / "developers" / "architecture.md"
PICTURE = PAGE.parents[1] / "images" / "rooms.svg"
MAX_ROOMS, MAX_FLOORS = 32, 12
WIDTH, HEIGHT, STEP = 120, 26, 58
"""Size of a room of the picture, and from floor to floor."""
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


def list_arrows() -> dict[str, set[str]]:
    """Return the rooms that each room imports from."""
    arrows: dict[str, set[str]] = {room: set() for room in ROOMS}
    for path in list_modules():
        rooms = {name.split(".")[1] for name in list_imports(path) if name.startswith("lobewise.")}
        arrows[get_room(path)] |= (rooms & set(ROOMS)) - {get_room(path)}
    return arrows


def compute_floors(arrows: dict[str, set[str]]) -> dict[str, int]:
    """Return the floor of every room, 1 for one that imports from none: it stands above all that it imports from."""
    floors: dict[str, int] = {}
    for room in ROOMS:  # a room imports only from rooms before it
        floors[room] = 1 + max((floors[other] for other in arrows[room]), default=0)
    return floors


def draw_rooms() -> str:
    """Return the picture of the page: a row for each floor, and the arrows that no longer way tells."""
    arrows = list_arrows()
    floors = compute_floors(arrows)
    reach: dict[str, set[str]] = {}
    for room in ROOMS:
        reach[room] = arrows[room].union(*(reach[other] for other in arrows[room]))
    rows = [[room for room in ROOMS if floors[room] == floor] for floor in range(1, max(floors.values()) + 1)]
    width, height = 20 + (WIDTH + 20) * max(map(len, rows)), 20 + STEP * len(rows)
    places = {
        room: (width / 2 + (WIDTH + 20) * (number - len(row) / 2) + 10, height - STEP * floor - STEP + HEIGHT)
        for floor, row in enumerate(rows)
        for number, room in enumerate(row)
    }
    lines = []
    for room, (x, y) in places.items():
        direct = arrows[room] - set().union(*(reach[other] for other in arrows[room]))
        ends = [places[other] for other in sorted(direct)]
        lines += [f'<path d="M{x + WIDTH / 2:g} {y + HEIGHT}L{a + WIDTH / 2:g} {b:g}"/>' for a, b in ends]
    for room, (x, y) in places.items():
        lines.append(f'<rect x="{x:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="4"/>')
        lines.append(f'<text x="{x + WIDTH / 2:g}" y="{y + 17:g}">{room}</text>')
    style = "rect{fill:#eef2f6;stroke:#6b7a89}path{stroke:#9aa7b4;fill:none}text{fill:#222;text-anchor:middle}"
    box = f'viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {box}>'
    white = f'<rect width="{width}" height="{height}" style="fill:#fff;stroke:none"/>'
    return "\n".join([head, f"<style>{style}</style>", white, *lines, "</svg>"]) + "\n"


def test_the_picture_shows_the_rooms_on_few_floors() -> None:
    assert len(ROOMS) <= MAX_ROOMS
    assert max(compute_floors(list_arrows()).values()) <= MAX_FLOORS
    assert PICTURE.read_text() == draw_rooms()


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
    PICTURE.write_text(draw_rooms())
    text = PAGE.read_text()
    start, end = text.index("<!-- ways:start -->\n") + len("<!-- ways:start -->\n"), text.index("<!-- ways:end -->")
    PAGE.write_text(f"{text[:start]}{describe_ways()}\n{text[end:]}")
