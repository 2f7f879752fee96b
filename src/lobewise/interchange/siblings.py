"""Read the files of renderers that write one file per pass as if they were the parts of one file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path

from lobewise.errors import LobewiseError
from lobewise.interchange.preset import Preset, load_presets
from lobewise.io.exr.container import MULTIPART, Attribute, Container, Part, show_name
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import Pixels, decode_part
from lobewise.io.exr.schema import SCHEMA

FIRST_SIBLING_INDEX = 1 << 16
"""Smallest part index that stands for a part of another file."""


MIN_NAME_LETTERS = 3
"""Fewest letters of a pass by which a file's name shows that the file holds this pass."""


@dataclass(frozen=True)
class Family:
    """An image file and the files of its other passes.

    Parameters
    ----------
    container : Container
        The parts of all files, each named by its pass.
    homes : mapping of int to (Container, Part)
        File and original part by part index, for the parts of other files.
    """

    container: Container
    homes: Mapping[int, tuple[Container, Part]] = field(default_factory=dict)

    def decode(self, part: Part, names: frozenset[str]) -> dict[str, Pixels]:
        """Return channels of a part from the file that holds it; see `lobewise.io.exr.pixels.decode_part`."""
        return decode_part(*self.homes.get(part.index, (self.container, part)), names)


def look_up_family(container: Container) -> Family:
    """Return a file with the files of its other passes: ``beach_RGB.exr`` with ``beach_ALBEDO.exr`` and so on.

    Neighbouring files are used only if the file holds one plain RGB(A) image, they have its data window, and they
    include all passes that identify a preset.
    """
    names = {channel.name for part in container.parts for channel in part.channels}
    if len(container.parts) != 1 or names - set("RGBA") or container.parts[0].get(SCHEMA) is not None:
        return Family(container)
    for preset in load_presets().values():
        for word in preset.files:
            siblings = _look_up_parts(container, preset, word) if word in container.path.stem else {}
            if siblings and all(any(fnmatchcase(name, wanted) for name in siblings) for wanted in preset.passes):
                main = _name_part(container.parts[0], 0, word)
                homes = {FIRST_SIBLING_INDEX + number: home for number, home in enumerate(siblings.values())}
                parts = [
                    _name_part(home[1], index, name)
                    for (index, home), name in zip(homes.items(), siblings, strict=True)
                ]
                whole = replace(container, version=container.version | MULTIPART, parts=(main, *parts))
                return Family(whole, homes)
    return Family(container)


def describe_family(family: Family) -> tuple[str, ...]:
    """Return sentences on the files whose passes are read with a file, and on the picture that a file is a pass of."""
    path = family.container.path
    if family.homes:
        names = ", ".join(show_name(other.path.name) for other, _ in family.homes.values())
        return (f"Passes are read from the files beside it: {names}.",)
    picture = _look_up_picture(path)
    if picture is None:
        return ()
    return (f"By its name, {show_name(path.name)} is a pass of {show_name(picture.name)}, and no picture.",)


def _look_up_picture(path: Path) -> Path | None:
    """Return the picture of which a file holds a pass: ``beach_RGB.exr`` for ``beach_ALBEDO.exr``."""
    for preset in load_presets().values():
        for name in dict.fromkeys(_list_passes(preset) if preset.files else ()):
            head, found, tail = path.stem.rpartition(name)
            # Names of one or two letters are in many words.
            for word in preset.files if found and len(name) >= MIN_NAME_LETTERS else ():
                picture = path.with_name(f"{head}{word}{tail}{path.suffix}")
                if picture != path and picture.is_file() and path in list_family(picture):
                    return picture
    return None


def list_family(path: Path) -> list[Path]:
    """Return the paths of a file and of the files read with it; the file alone if it cannot be read."""
    container = _read(path)
    homes = () if container is None else look_up_family(container).homes.values()
    return [path, *(other.path for other, _ in homes)]


def _look_up_parts(container: Container, preset: Preset, word: str) -> dict[str, tuple[Container, Part]]:
    """Return the neighbouring files of a preset's passes. Their names have the pass in place of ``word``."""
    parts = {}
    head, _, tail = container.path.stem.rpartition(word)
    for name in dict.fromkeys(_list_passes(preset)):
        path = container.path.with_name(f"{head}{name}{tail}{container.path.suffix}")
        if name != word and path.is_file():
            other = _read(path)
            if other is not None and other.parts[0].data_window == container.parts[0].data_window:
                parts[name] = (other, other.parts[0])
    return parts


def _read(path: Path) -> Container | None:
    try:
        return read_container(path)
    except LobewiseError:
        return None


def _list_passes(preset: Preset) -> Iterator[str]:
    """Yield the names of passes beside the picture. Other files may hold the picture again by another of its names."""
    for role, rules in preset.roles.items():
        yield from (rule.source for rule in rules if rule.source and rule.component is None and role != "color")
    for layer in preset.layers:
        yield from (*layer.light, *([layer.albedo] if layer.albedo else []))


def _name_part(part: Part, index: int, name: str) -> Part:
    attributes = tuple(item for item in part.attributes if item.name != "name")
    return replace(part, index=index, attributes=(*attributes, Attribute("name", "string", name.encode())))
