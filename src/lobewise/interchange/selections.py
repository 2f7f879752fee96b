"""Select a view (an eye of a stereo pair) and a view layer of a file: the passes of which a frame is made."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace

from lobewise.errors import hide_numbers, require_choice
from lobewise.interchange.channels import COLOR, Pass, list_views
from lobewise.interchange.preset import Preset, Rule, load_presets
from lobewise.io.exr.container import Container, show_name


@dataclass(frozen=True)
class Selection:
    """A view and a view layer, whose passes make a frame.

    Parameters
    ----------
    view : str
        The view, such as ``left``; empty in a file without views.
    layer : str
        The view layer, the beginning of the names of its passes; empty where names have no such beginning.
    """

    view: str = ""
    layer: str = ""

    @property
    def label(self) -> str:
        """The names as a user reads them: ``view 'left'``, or ``view layer 'Trees', view 'left'``."""
        named = (("view layer", self.layer), ("view", self.view))
        return ", ".join(f"{what} {show_name(name)!r}" for what, name in named if name)

    def begin_note(self, note: str, first: Selection) -> str:
        """Return a note with the names before it that differ from those of ``first``."""
        label = Selection(
            *("" if own == its else own for own, its in zip(astuple(self), astuple(first), strict=True))
        ).label
        return f"{label[:1].upper()}{label[1:]}: {note}"

    def name_kind(self, note: str) -> str:
        """Return a note without figures and without the names, which differ where the same is true of several views."""
        for name in filter(None, (self.layer, self.view)):
            note = note.replace(f"{name}.", "").replace(f".{name}", "")
        return hide_numbers(note)


def count_selections(selections: Collection[Selection]) -> str:
    """Return how many there are, in words: ``2 views``, ``3 view layers`` or ``3 view layers in 2 views``."""
    counts = {what: len({getattr(each, what) for each in selections}) for what in ("layer", "view")}
    counted = [
        f"{counts[what]} {name}" for what, name in (("layer", "view layers"), ("view", "views")) if counts[what] > 1
    ]
    return " in ".join(counted)


def choose_view(
    views: Sequence[str], passes: Iterable[Pass], mapping: Mapping[str, str], asked: str | None = None
) -> str:
    """Return the view to read: the one asked for, else the one whose channels the user mapped, else the first.

    Raises
    ------
    InputError
        If the file has no view of the name that was asked for.
    """
    if asked is not None:
        return require_choice("view", asked, views)
    return look_up_mapped_view(passes, mapping) or views[0]


def look_up_mapped_view(passes: Iterable[Pass], mapping: Mapping[str, str]) -> str:
    """Return the view of the first channel or pass that the user mapped by its name in one view; empty for none."""
    names = {name.strip() for text in mapping.values() for name in text.partition(":")[0].split(",")}
    for one in passes:
        own = {*one.channels.values(), *([one.written_path] if one.written_path != one.path else [])}
        if own & names:
            return one.view
    return ""


def lend_generic_pictures(preset: Preset, passes: Sequence[Pass]) -> Preset:
    """Return a preset with the names that any renderer gives to the picture, if none of its own names is there.

    An attribute tells which program wrote a file, but users choose the names: Blender's File Output node calls the
    picture ``Image``.
    """
    own = preset.roles.get("color", ())
    if any(one.matches(rule.source) and one.pick(COLOR) for rule in own for one in passes):
        return preset
    return replace(preset, roles={**preset.roles, "color": (*own, *load_presets()["generic"].roles["color"])})


def list_images(preset: Preset, passes: Sequence[Pass]) -> dict[str, tuple[Pass, Rule]]:
    """Return the color images of the passes of one view by their prefixes, the one to take by default first.

    Passes without a prefix have one image. The images of view layers have a prefix each, such as ``ViewLayer.``.
    """
    images: dict[str, tuple[Pass, Rule]] = {}
    for rule in preset.roles.get("color", (Rule(""),)):
        for one in passes:
            if one.matches(rule.source) and one.pick(COLOR):
                prefix, first = one.get_prefix(rule.source), next(iter(images), None)
                # After an image without a prefix only images by the same name are its like.
                if first is None or (first and prefix) or images[first][1] is rule:
                    images.setdefault(prefix, (one, rule))
    for one in passes if not images else ():
        # No rule matches: take the first pass with R, G and B that has no path, or whose path is the name of its part.
        if (one.path in ("", one.part.name) or not one.written_path) and one.pick(COLOR[:1]):
            return {"": (one, Rule(""))}
    return images


def list_selections(container: Container, preset: Preset, passes: Iterable[Pass]) -> tuple[Selection, ...]:
    """Return the views and view layers of a file that have an image, in each view the default one first."""
    views: dict[str, list[Pass]] = {view: [] for view in list_views(container)}
    for one in passes:
        views[one.view].append(one)
    return tuple(
        Selection(view, prefix.removesuffix(".")) for view, own in views.items() for prefix in list_images(preset, own)
    )


def keep_layer(passes: Sequence[Pass], preset: Preset, prefix: str, prefixes: Iterable[str]) -> list[Pass]:
    """Return the passes without those of other view layers.

    An image that has no other passes of its own, such as that of Blender's compositor, may take the passes of a layer.
    """
    known = {prefix, *prefixes}

    def name_owner(one: Pass) -> str:
        return max((each for each in known if one.path.startswith(each)), key=len, default="")

    images = [rule.source for rule in preset.roles.get("color", ())]
    own = [one for one in passes if name_owner(one) == prefix]
    if all(any(map(one.matches, images)) for one in own):
        return list(passes)
    return [one for one in passes if name_owner(one) in ("", prefix)]
