"""List the passes of an EXR file of any renderer.

A pass is a group of channels whose names differ only in the last word. Some renderers write all passes into one part
(``ViewLayer.DiffCol.R``). Others write one part per pass (a part ``DiffCol`` with channels ``R``, ``G``, ``B``). They
also name the components differently. This module gives both kinds of files the same list of `Pass`.

A file of several views (the eyes of a stereo pair) names the view of a channel in the word before the component
(``ViewLayer.DiffCol.left.R``) or in the header of the part. The path of a pass is the same in every view.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from lobewise.io.exr.container import Container, Part
from lobewise.io.exr.layout import look_up_beauty

COMPONENTS = {
    "red": "r", "green": "g", "blue": "b", "alpha": "a",
    **{letter: letter for letter in "rgbaxyzuvwti"},
}  # fmt: skip
"""Component letters by the last word of a channel name, in lower case."""
COLOR, VECTOR, PLANE = ("rgb", "xyz"), ("xyz", "rgb"), ("xy", "uv", "rg")
"""Component orders of colors, 3D vectors and 2D vectors; the first complete order counts."""
SINGLE_COMPONENTS = ("", "z", "v", "x", "t", "i", "u", "r", "y", "a")
"""Components that can hold a pass of one value; the first one present counts."""
BLENDERS_VIEW = re.compile(r".+\.Combined\.([^.]+)\.R")
"""Name of a red channel of a view in Blender's MultiLayer files, whose header does not list the views."""
WILDCARDS = frozenset("*?[")
"""Letters that `fnmatchcase` reads as patterns."""
EYES = ("left", "right")
"""Names that are views where both name a red channel, even if the header does not list them."""


@dataclass(frozen=True)
class Pass:
    """A group of channels, such as the components of one image.

    Parameters
    ----------
    part : Part
        The part of the file that holds the channels.
    path : str
        Name of the pass with its prefix and without its view: ``ViewLayer.DiffCol``; empty for plain R, G and B.
    channels : dict of str to str
        Channel names by component in lower case. A channel without a component has the empty string as key.
    view : str
        The view that the pass belongs to, one of `list_views`.
    """

    part: Part
    path: str
    channels: dict[str, str]
    view: str = ""

    @property
    def written_path(self) -> str:
        """The path as the channels of the file have it, with the view."""
        component, name = next(iter(self.channels.items()))
        return name.rpartition(".")[0] if component else name

    def pick(self, orders: Sequence[str]) -> tuple[str, ...] | None:
        """Return the channels of the first order of components, such as ``rgb``, for which no channel is missing."""
        for order in orders:
            if all(letter in self.channels for letter in order):
                return tuple(self.channels[letter] for letter in order)
        return None

    def pick_single(self, component: str | None = None) -> tuple[str, ...] | None:
        """Return the channel of ``component``; by default, of the first component in `SINGLE_COMPONENTS`."""
        for letter in SINGLE_COMPONENTS if component is None else (component.lower(),):
            if letter in self.channels:
                return (self.channels[letter],)
        return None

    @property
    def obstacle(self) -> str:
        """Why the channels cannot form an image, worded to follow "the pass is"; empty if they can."""
        names = set(self.channels.values())
        return next((self.part.describe_obstacle(one) for one in self.part.channels if one.name in names), "")

    def matches(self, pattern: str) -> bool:
        """Return whether the path, with or without its prefix, matches a pattern with the wildcards * and ?."""
        path, ending = f".{self.path.lower()}", f".{pattern.lower()}"
        # `fnmatchcase` compiles an expression for every pattern, and most patterns have no wildcard.
        return path.endswith(ending) if WILDCARDS.isdisjoint(ending) else fnmatchcase(path, f"*{ending}")

    def get_prefix(self, pattern: str) -> str:
        """Return the part of the path before the words of ``pattern``, with the last dot."""
        if not self.path:
            return ""
        words = pattern.count(".") + 1
        parts = self.path.split(".")[:-words] if pattern else self.path.split(".")
        return "".join(f"{word}." for word in parts)


def list_views(container: Container) -> tuple[str, ...]:
    """Return the names of the views; one empty name for a file without views.

    The first view is the default one: channels and parts that name no view belong to it. Source: "Storing Multi-View
    Images in OpenEXR Files", the attributes ``multiView`` and ``view``. In Blender's MultiLayer files the names of the
    channels alone tell the views.
    """
    declared = [name for part in container.parts for name in part.views]
    of_parts = [part.view for part in container.parts if part.view]
    if of_parts and not declared:
        beauty = look_up_beauty(container.parts)
        declared = [beauty.view if beauty else of_parts[0]]
    names = [channel.name for part in container.parts for channel in part.channels]
    of_names = [match[1] for name in names if (match := BLENDERS_VIEW.fullmatch(name))]
    ends = {name.split(".")[-2] for name in names if name.endswith(".R")}
    eyes = EYES if ends.issuperset(EYES) else ()
    views = [*declared, *of_parts] or of_names or eyes or [""]
    return tuple(dict.fromkeys(views))


def list_passes(container: Container) -> list[Pass]:
    """Return the readable passes of all views in the order of the file."""
    return _group(container, unread=False)


def list_unread_passes(container: Container) -> list[Pass]:
    """Return the passes of all views that cannot be read, because they are deep or subsampled."""
    return _group(container, unread=True)


def _group(container: Container, *, unread: bool) -> list[Pass]:
    views = list_views(container)
    names = frozenset(views)
    passes: dict[tuple[int, str, str], Pass] = {}
    for part in container.parts:
        for channel in part.channels:
            if bool(part.describe_obstacle(channel)) == unread:
                view, name = _take_view(channel.name, names)
                view = view or part.view or views[0]
                path, component = _split(name, _name_part(part, view) if container.multipart else "")
                one = passes.setdefault((part.index, path, view), Pass(part, path, {}, view))
                one.channels.setdefault(component, channel.name)
    return [*passes.values(), *_join_letters(passes)]


def _take_view(name: str, views: frozenset[str]) -> tuple[str, str]:
    """Return the view in a channel's name, empty if there is none, and the name without it."""
    *words, component = name.split(".")
    if words and words[-1] and words[-1] in views:
        return words[-1], ".".join([*words[:-1], component])
    return "", name


def _name_part(part: Part, view: str) -> str:
    """Return the name of a part without its view: ``depth`` for ``depth_left`` or ``depth.left``."""
    for ending in (f".{view}", f"_{view}"):
        if view and part.name.endswith(ending):
            return part.name.removesuffix(ending)
    return part.name


def _join_letters(passes: dict[tuple[int, str, str], Pass]) -> list[Pass]:
    """Return vector passes whose channel names have no dot, such as ``Nsx``, ``Nsy``, ``Nsz`` of older pbrt files."""
    joined = []
    for (index, path, view), one in passes.items():
        names = {letter: passes.get((index, path[:-1] + letter, view)) for letter in "xyz"}
        if (
            path.endswith("x")
            and len(path) > 1
            and all(other and set(other.channels) == {""} for other in names.values())
        ):
            letters = {letter: other.channels[""] for letter, other in names.items() if other}
            joined.append(Pass(one.part, path[:-1], letters, view))
    return joined


def _split(name: str, part: str) -> tuple[str, str]:
    """Return the path and the component of a channel, given the name of its part."""
    head, _, tail = name.rpartition(".")
    component = COMPONENTS.get(tail.lower())
    if component is None:
        head, component = name, ""
    if not head and part:
        return part, component
    if not head and component not in "rgba":
        # A channel Z without a path is a separate depth pass, not a component of the image.
        return name, ""
    return head, component


def keep_beside(passes: Iterable[Pass], part: Part) -> list[Pass]:
    """Return the passes that have the same data window as ``part``."""
    return [one for one in passes if one.part.data_window == part.data_window]
