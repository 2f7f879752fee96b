"""What a file holds, whoever wrote it: every pass with its prefix, its components and the part that it lies in.

A pass is a group of channels that differ in their last word alone. One renderer writes all of them in one part
(``ViewLayer.DiffCol.R``), the next a part for each (a part ``DiffCol`` with channels ``R``, ``G``, ``B``), and the
words for components are many: all of it comes out the same here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from lobewise.io.exr.container import Container, Part

COMPONENTS = {
    "red": "r", "green": "g", "blue": "b", "alpha": "a",
    **{letter: letter for letter in "rgbaxyzuvwti"},
}  # fmt: skip
"""Last words of channel names that are components, in lower case, and what they are called here."""
COLOR, VECTOR, PLANE = ("rgb", "xyz"), ("xyz", "rgb"), ("xy", "uv", "rg")
"""Components of an image, in the order in which they are looked for."""
SINGLE = ("", "z", "v", "x", "t", "i", "u", "r", "y", "a")
"""The component that holds a pass of one value; the first that is there."""


@dataclass(frozen=True)
class Pass:
    """Channels that belong together.

    Parameters
    ----------
    part : Part
        Where they lie.
    path : str
        The pass with whatever stands before it, as in the file: ``ViewLayer.DiffCol``; empty for plain R, G and B.
    channels : dict of str to str
        Names of its channels by component, in lower case; one without a component under the empty text.
    """

    part: Part
    path: str
    channels: dict[str, str]

    def pick(self, orders: Sequence[str]) -> tuple[str, ...] | None:
        """Return the channels of the first of some orders of components, such as ``rgb``, that is complete."""
        for order in orders:
            if all(letter in self.channels for letter in order):
                return tuple(self.channels[letter] for letter in order)
        return None

    def pick_single(self, component: str | None = None) -> tuple[str, ...] | None:
        """Return the channel of one value: that of ``component``, else the first of `SINGLE`."""
        for letter in SINGLE if component is None else (component.lower(),):
            if letter in self.channels:
                return (self.channels[letter],)
        return None

    @property
    def obstacle(self) -> str:
        """Why no image can be made of its channels, as what the pass "is"; empty where one can."""
        names = set(self.channels.values())
        return next((self.part.find_obstacle(one) for one in self.part.channels if one.name in names), "")

    def matches(self, pattern: str) -> bool:
        """Return whether this is the pass of a pattern, with or without a prefix; * and ? as in file names."""
        path, wanted = self.path.lower(), pattern.lower()
        return fnmatchcase(path, wanted) or fnmatchcase(path, f"*.{wanted}")

    def get_prefix(self, pattern: str) -> str:
        """Return what stands before the pass in its path, the last dot with it."""
        if not self.path:
            return ""
        words = pattern.count(".") + 1
        kept = self.path.split(".")[:-words] if pattern else self.path.split(".")
        return "".join(f"{word}." for word in kept)


def list_passes(container: Container) -> list[Pass]:
    """Return the passes that can be read, in the order of the file."""
    return _group(container, unread=False)


def list_unread_passes(container: Container) -> list[Pass]:
    """Return the passes that cannot: deep ones, and the subsampled channels of others."""
    return _group(container, unread=True)


def _group(container: Container, *, unread: bool) -> list[Pass]:
    found: dict[tuple[int, str], Pass] = {}
    for part in container.parts:
        for channel in part.channels:
            if bool(part.find_obstacle(channel)) == unread:
                path, component = _split(channel.name, part.name if container.multipart else "")
                one = found.setdefault((part.index, path), Pass(part, path, {}))
                one.channels.setdefault(component, channel.name)
    return [*found.values(), *_join_letters(found)]


def _join_letters(found: dict[tuple[int, str], Pass]) -> list[Pass]:
    """Return passes whose channels end in x, y and z without a dot: ``Nsx``, ``Nsy``, ``Nsz`` of older pbrt files."""
    joined = []
    for (index, path), one in found.items():
        names = {letter: found.get((index, path[:-1] + letter)) for letter in "xyz"}
        if (
            path.endswith("x")
            and len(path) > 1
            and all(other and set(other.channels) == {""} for other in names.values())
        ):
            joined.append(Pass(one.part, path[:-1], {letter: path[:-1] + letter for letter in "xyz"}))
    return joined


def _split(name: str, part: str) -> tuple[str, str]:
    """Return the path and the component of a channel."""
    head, _, tail = name.rpartition(".")
    component = COMPONENTS.get(tail.lower())
    if component is None:
        head, component = name, ""
    if not head and part:
        return part, component
    if not head and component not in "rgba":
        # A lone Z at the root is a pass of its own, not a component of the image.
        return name, ""
    return head, component


def keep_beside(passes: Iterable[Pass], part: Part) -> list[Pass]:
    """Return the passes that can belong to the image of a part: of the same pixels, and of no other view."""
    return [
        one
        for one in passes
        if one.part.data_window == part.data_window and (one.part.view in ("", part.view) or not part.view)
    ]
