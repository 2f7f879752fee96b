"""Choose the preset of a file, and map its channels to the images of a frame."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from lobewise.errors import InputError, require_choice
from lobewise.interchange.channels import (
    COLOR,
    COMPONENTS,
    PLANE,
    VECTOR,
    Pass,
    keep_beside,
    list_passes,
    list_unread_passes,
    list_views,
)
from lobewise.interchange.preset import (
    OWN,
    ROLES,
    SINGLE_VALUE_ROLES,
    LayerRule,
    Preset,
    Rule,
    load_presets,
    look_up_preset,
    require_conversion,
)
from lobewise.interchange.selections import (
    Selection,
    choose_view,
    keep_layer,
    lend_generic_pictures,
    list_images,
    list_selections,
)
from lobewise.io.exr.container import Container, Part, show_name
from lobewise.io.exr.layout import plan_reading, refuse_missing_image, require_beauty
from lobewise.io.exr.schema import SCHEMA
from lobewise.io.files import PathLike

ORDERS: dict[str, Sequence[str]] = {"normal": VECTOR, "position": VECTOR, "motion": PLANE}
"""Component orders by role, for roles that are not colors."""
Key = tuple[int, tuple[str, ...]]
"""Identity of an image: the index of its part and the names of its channels."""


@dataclass(frozen=True)
class Found:
    """One image of a file.

    Parameters
    ----------
    source : Pass
        The pass that holds the image.
    channels : tuple of str
        Channel names in the order of the image's last axis.
    convert : tuple of str
        Names of the conversions of its values, keys of `CONVERSIONS`.
    """

    source: Pass
    channels: tuple[str, ...]
    convert: tuple[str, ...] = ()

    @property
    def key(self) -> Key:
        """The part and channels that identify this image in its file."""
        return self.source.part.index, self.channels

    @property
    def label(self) -> str:
        """Short text for the channels, such as ``ViewLayer.DiffCol.R/G/B``."""
        head = self.channels[0].rpartition(".")[0]
        if all(name.rpartition(".")[0] == head for name in self.channels):
            words = "/".join(name.rpartition(".")[2] for name in self.channels)
            if words.lower().split("/")[0] in COMPONENTS:
                head = head or self.source.path
            return show_name(f"{head}.{words}" if head else words)
        return show_name(", ".join(self.channels))


@dataclass(frozen=True)
class FoundLayer:
    """One layer of light: the images that add up to it, and its albedo."""

    rule: LayerRule
    light: tuple[Found, ...]
    albedo: Found | None


@dataclass(frozen=True)
class ChannelMap:
    """The images of a frame that a file contains.

    Parameters
    ----------
    preset : Preset
        The preset by which the file is read.
    reason : str
        Why this preset was chosen; follows "because" in a sentence.
    roles : mapping of str to Found
        The images by role.
    layers : tuple of FoundLayer
        Layers of light.
    cryptomatte : tuple of tuple of Found
        The passes of each Cryptomatte in the order of their ranks.
    prefix : str
        Prefix of the chosen passes, such as the view layer.
    selection : Selection
        The view and view layer of the images.
    selections : tuple of Selection
        All views and view layers of the file that have an image.
    beside : tuple of Pass
        The passes of this view and view layer that have the pixels of the image.
    shown : Found or None
        The image that viewers show, if the renderer denoised it and kept the noisy image in another pass.
    refused : mapping of str to str
        Sentences by missing role or layer. They say why a pass of the file, or of the user's preset, is not used.
    """

    preset: Preset
    reason: str
    roles: Mapping[str, Found]
    layers: tuple[FoundLayer, ...]
    cryptomatte: tuple[tuple[Found, ...], ...]
    prefix: str = ""
    selection: Selection = field(default_factory=Selection)
    selections: tuple[Selection, ...] = ()
    beside: tuple[Pass, ...] = ()
    shown: Found | None = None
    refused: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_own(self) -> bool:
        """Whether the file uses lobewise's own channel names. Its roles are those of `Slot`."""
        return self.preset is OWN

    @property
    def target(self) -> Found:
        """The image that viewers show. The result replaces it."""
        return self.roles["color"] if self.shown is None else self.shown


def choose_preset(container: Container, passes: Iterable[Pass], asked: PathLike | None = None) -> tuple[Preset, str]:
    """Return the preset of a file and the reason: an option, a header attribute, pass names, or the generic default."""
    if asked is not None:
        return look_up_preset(asked), "it was asked for"
    attributes = [item for part in container.parts for item in part.attributes]
    for preset in load_presets().values():
        for pattern in preset.attributes:
            key, _, text = pattern.partition("=")
            for item in attributes:
                if fnmatchcase(item.name, key) and fnmatchcase(item.value.decode("utf-8", "replace"), text or "*"):
                    return preset, f"the header has the attribute {show_name(item.name)!r}"
    known = list(passes)
    for preset in load_presets().values():
        if preset.passes and all(any(one.matches(name) for one in known) for name in preset.passes):
            return preset, f"there are passes named {' and '.join(preset.passes)}"
    return load_presets()[
        "generic"
    ], "neither the attributes of the file nor the names of its channels tell which renderer wrote it"


def is_own(container: Container) -> bool:
    """Return whether lobewise wrote a file: its header says so. Others use the same plain names, such as ``normal``."""
    return any(part.get(SCHEMA) is not None for part in container.parts)


def map_file(
    container: Container,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    view: str | None = None,
    layer: str | None = None,
) -> ChannelMap:
    """Map the channels of a file: in lobewise's own names as they are, unless the user says more, else `map_channels`.

    Raises
    ------
    InputError, MissingChannelError
        As `map_channels`; also if an image in lobewise's own names has only some of its channels, or the user names a
        view or a view layer of such a file.
    """
    if preset is None and not mapping and is_own(container):
        if view or layer:
            raise InputError(
                "view" if layer is None else "layer",
                expected="a file of another renderer",
                got="a file with lobewise's own channel names, of which the first view is read",
                action="leave it out",
            )
        return _map_own(container)
    return map_channels(container, preset=preset, mapping=mapping, view=view, layer=layer)


def _map_own(container: Container) -> ChannelMap:
    roles = {
        slot.role: Found(Pass(part, slot.prefix, {name: name for name in slot.channels}), slot.channels)
        for part, slots in plan_reading(container, require_beauty(container))
        for slot in slots
    }
    selections = (Selection(), *map(Selection, list_views(container)[1:]))
    return ChannelMap(OWN, "", roles, layers=(), cryptomatte=(), selections=selections)


def map_channels(
    container: Container,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    view: str | None = None,
    layer: str | None = None,
) -> ChannelMap:
    """Map the channels of a file to the images of a frame.

    Parameters
    ----------
    container : Container
        The file.
    preset : path-like, optional
        Name of a preset, or path of a preset file; by default, the preset is recognised from the file.
    mapping : mapping of str to str, optional
        Channels by role, in the syntax of `parse_mapping`. They override the preset.
    view, layer : str, optional
        The view and the view layer; by default the first ones, or those of the channels in ``mapping``.

    Raises
    ------
    InputError
        If a role, preset, channel, view or view layer is not known.
    MissingChannelError
        If there is no image.
    """
    everything, unread = list_passes(container), list_unread_passes(container)
    chosen, reason = choose_preset(container, everything, preset)
    view = choose_view(list_views(container), everything, mapping or {}, view)
    passes, unread = ([one for one in each if one.view == view] for each in (everything, unread))
    own = {role: parse_mapping(role, text, passes, unread) for role, text in (mapping or {}).items()}
    chosen = lend_generic_pictures(chosen, passes)
    images = list_images(chosen, passes)
    color, prefix = _choose_color(container, images, passes, own.get("color"), layer)
    for role, mapped in own.items():
        if apart := _compare_pixels(mapped.source.part, color.source.part):
            raise InputError(
                f"--map {role}",
                expected="a pass with the same pixels as the image",
                got=f"one that {apart}",
                action="render the pass at the size of the image",
            )
    passes = keep_layer(passes, chosen, prefix, images)
    beside = keep_beside(passes, color.source.part)
    roles = {"color": color}
    for role, rules in chosen.roles.items():
        found = own.get(role) or _look_up_role(role, rules, beside, prefix)
        if found is not None and role != "color":
            roles[role] = found
    roles |= {role: found for role, found in own.items() if role not in roles}
    layers: dict[str, FoundLayer] = {}
    for rule in chosen.layers:
        if (one := _look_up_layer(rule, beside, prefix)) is not None:
            layers.setdefault(rule.name, one)
    mattes = [_list_matte(name, beside, prefix) for name in chosen.cryptomatte]
    return ChannelMap(
        chosen,
        reason,
        roles,
        tuple(layers.values()),
        tuple(filter(None, mattes)),
        prefix=prefix,
        selection=Selection(view, prefix.removesuffix(".")),
        selections=list_selections(container, chosen, everything),
        beside=tuple(beside),
        shown=None if "color" in own else _look_up_shown(chosen, color, beside, prefix),
        refused=_list_refused_roles(chosen, roles, color, [*passes, *unread])
        | _list_refused_layers(chosen, layers, beside),
    )


MIN_LIKENESS = 0.4
"""Share of common letters (`difflib`) from which a name is proposed: a name without its view layer has more."""
MAX_NEAREST = 3
"""Channels that are named where one is not in the file."""


def parse_mapping(role: str, text: str, passes: Sequence[Pass], unread: Sequence[Pass] = ()) -> Found:
    """Return the image for a text ``channel,channel,...`` or ``pass``; either may end in ``:conversion``.

    Raises
    ------
    InputError
        If the role, a channel or a conversion is unknown, the conversion does not fit the role, a channel belongs to
        the unreadable passes ``unread``, or the number of channels does not fit the role.
    """
    pass_name, convert = split_mapping(role, text)
    names = [name.strip() for name in pass_name.split(",")]
    count = 1 if role in SINGLE_VALUE_ROLES else 2 if role == "motion" else 3
    known = {channel: one for one in passes for channel in one.channels.values()}
    if len(names) == 1 and (count > 1 or names[0] not in known):
        for one in passes:
            channels = _pick(role, one) if one.matches(names[0]) or one.written_path == names[0] else None
            if channels:
                return Found(one, channels, tuple(convert))
    kept_out = {channel: one for one in unread for channel in one.channels.values()}
    for name in names:
        if name in kept_out and name not in known:
            expected, got = "a channel with one value for each pixel", f"one that is {kept_out[name].obstacle}"
            raise InputError(
                f"--map {role}, channel {name!r}",
                expected=expected,
                got=got,
                action="save the channel with one value for each pixel",
            )
        if name not in known:
            candidates = [*known, *(one.written_path for one in passes)]
            near = difflib.get_close_matches(name, candidates, n=MAX_NEAREST, cutoff=MIN_LIKENESS)
            nearest = f"the nearest are {', '.join(map(repr, near))}; " if near else ""
            raise InputError(
                f"--map {role}",
                expected="channels or a pass of the file",
                got=repr(name),
                action=f"{nearest}`lobewise inspect --all` lists them",
            )
    if len(names) != count:
        raise InputError(
            f"--map {role}", expected=f"{count} channels", got=repr(pass_name), action="separate them by commas"
        )
    if any(known[name].part.index != known[names[0]].part.index for name in names):
        raise InputError(
            f"--map {role}", expected="channels of one part", got=repr(pass_name), action="put them into one part"
        )
    return Found(known[names[0]], tuple(names), tuple(convert))


def split_mapping(role: str, text: str) -> tuple[str, list[str]]:
    """Return the channels or the pass of a mapped role, and its conversions; raise InputError if a word is unknown."""
    require_choice("--map", role, ROLES)
    pass_name, *convert = text.split(":")
    for word in convert:
        require_conversion(f"--map {role}", role, word)
    return pass_name, convert


def _pick(role: str, one: Pass, component: str | None = None) -> tuple[str, ...] | None:
    if role in SINGLE_VALUE_ROLES:
        return one.pick_single(component)
    return one.pick(ORDERS.get(role, COLOR))


def _choose_color(
    container: Container,
    images: Mapping[str, tuple[Pass, Rule]],
    passes: Sequence[Pass],
    own: Found | None,
    layer: str | None,
) -> tuple[Found, str]:
    """Return the color image and its prefix: that of the user, of the view layer asked for, or the first one."""
    if own is not None:
        images = {own.source.get_prefix(own.source.path.rpartition(".")[2]): (own.source, Rule(""))}
    if layer is not None:
        require_choice("layer", layer, [prefix.removesuffix(".") for prefix in images])
    for prefix, (one, rule) in images.items():
        if layer in (None, prefix.removesuffix(".")):
            return own or Found(one, one.pick(COLOR) or (), rule.convert), prefix
    pictures = [one.written_path or one.path for one in passes if one.pick(COLOR[:1])]
    raise refuse_missing_image(
        container,
        expected="channels R, G and B, or an image by one of the names that renderers use",
        action=f"name the image with --map color={'PASS' if pictures else 'RED,GREEN,BLUE'}",
        passes=pictures,
    )


def _look_up_shown(preset: Preset, color: Found, passes: Sequence[Pass], prefix: str) -> Found | None:
    """Return the image that viewers show, if it is not the noisy image itself."""
    for pattern in preset.shown:
        for one in passes:
            channels = one.pick(COLOR) if one.matches(pattern) and one.get_prefix(pattern) == prefix else None
            if channels:
                return None if channels == color.channels and one.part == color.source.part else Found(one, channels)
    return None


def _list_matching(pattern: str, passes: Sequence[Pass], prefix: str) -> list[Pass]:
    """Return the passes that match a pattern, sorted so that the given prefix comes first."""
    alike = [one for one in passes if one.matches(pattern)]
    return sorted(alike, key=lambda one: one.get_prefix(pattern) != prefix)


def _look_up_role(role: str, rules: Iterable[Rule], passes: Sequence[Pass], prefix: str) -> Found | None:
    for rule in rules:
        for one in _list_matching(rule.source, passes, prefix):
            channels = _pick(role, one, rule.component)
            if channels is not None:
                return Found(one, channels, rule.convert)
    return None


def _look_up_layer(rule: LayerRule, passes: Sequence[Pass], prefix: str) -> FoundLayer | None:
    light = [_look_up_role("color", [Rule(name)], passes, prefix) for name in rule.light]
    albedo = _look_up_role("color", [Rule(rule.albedo)], passes, prefix) if rule.albedo else None
    if None in light or not light or (rule.times_albedo and albedo is None):
        return None
    return FoundLayer(rule, tuple(found for found in light if found), albedo)


def _list_refused_roles(
    preset: Preset, roles: Mapping[str, Found], color: Found, passes: Sequence[Pass]
) -> dict[str, str]:
    """Return by missing role why a pass is not used, or that the file has none of the passes in the user's preset."""
    refused = {}
    for role, rules in preset.roles.items():
        if role in roles or role == "color":
            continue
        # A rule without a source, or for one component, refers to the color image and names no separate pass.
        named = [rule for rule in rules if rule.source and rule.component is None]
        near = [one for rule in named for one in passes if one.matches(rule.source)]
        reason = next(filter(None, (_explain_refusal(role, one, color) for one in near)), None)
        if reason is not None:
            refused[role] = reason
        elif preset.is_users and rules:
            names = " or ".join(repr(rule.source) for rule in rules)
            refused[role] = f"The preset names {names} for {role}, and the file has no such pass."
    return refused


def _explain_refusal(role: str, one: Pass, color: Found) -> str | None:
    """Return why a pass cannot have a role; None if nothing prevents it."""
    apart = _compare_pixels(one.part, color.source.part)
    letters = "X, Y and Z" if role in ("normal", "position") else "X and Y" if role == "motion" else "R, G and B"
    if one.obstacle:
        reason = f"it is {one.obstacle}"
    elif apart:
        reason = f"it {apart}"
    elif _pick(role, one) is None:
        reason = f"{letters} are needed"
    else:
        return None
    return f"{Found(one, tuple(one.channels.values())).label} is not used as {role}: {reason}."


def _compare_pixels(part: Part, image: Part) -> str:
    """Return how the pixels of a part differ from those of the image, as a predicate; empty if they are the same."""
    window, whole = part.data_window, image.data_window
    if window == whole:
        return ""
    if (window.width, window.height) == (whole.width, whole.height):
        return "covers other pixels than the image"
    return f"has {window.width}x{window.height} pixels, the image {whole.width}x{whole.height}"


def _list_refused_layers(preset: Preset, layers: Mapping[str, FoundLayer], passes: Sequence[Pass]) -> dict[str, str]:
    """Return by missing layer which passes it lacks, if the file has some of them or the user's preset names it."""
    refused: dict[str, str] = {}
    for rule in preset.layers:
        needed = [*rule.light, *([rule.albedo] if rule.albedo and rule.times_albedo else [])]
        missing = [name for name in needed if _look_up_role("color", [Rule(name)], passes, "") is None]
        if rule.name in layers or rule.name in refused or not (preset.is_users or len(missing) < len(needed)):
            continue
        words = "passes" if len(missing) > 1 else "pass"
        refused[rule.name] = f"The layer {rule.name} is left out: the file has no {words} {' and '.join(missing)}."
    return refused


def _list_matte(name: str, passes: Sequence[Pass], prefix: str) -> tuple[Found, ...]:
    """Return the passes of one Cryptomatte. Each pass holds two ranks, each an id and a coverage."""
    ranks: dict[str, Found] = {}
    for number in range(16):
        for one in _list_matching(f"{name}{number:02d}", passes, prefix):
            channels = one.pick(("rgba",))
            if channels is not None:
                ranks.setdefault(f"{number}", Found(one, channels))
    return tuple(ranks.values())
