"""Which preset a file follows and why, and which of its channels are which image of a frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from lobewise.errors import InputError, MissingChannelError, require_choice
from lobewise.interchange.channels import COLOR, COMPONENTS, PLANE, VECTOR, Pass, keep_beside, list_passes
from lobewise.interchange.preset import CONVERSIONS, ROLES, SINGLES, LayerRule, Preset, Rule, find_preset, load_presets
from lobewise.io.exr.container import Container, show_name
from lobewise.io.exr.layout import find_beauty
from lobewise.io.files import PathLike

ORDERS: dict[str, Sequence[str]] = {"normal": VECTOR, "position": VECTOR, "motion": PLANE}
"""Components of the roles that are no color."""


@dataclass(frozen=True)
class Found:
    """One image of a file.

    Parameters
    ----------
    source : Pass
        Where it stands.
    channels : tuple of str
        Its channels in the order of the image's last axis.
    convert : tuple of str
        What becomes of its values.
    """

    source: Pass
    channels: tuple[str, ...]
    convert: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The channels in short: ``ViewLayer.DiffCol.R/G/B``, whether the pass is a part of its own or not."""
        head = self.channels[0].rpartition(".")[0]
        if all(name.rpartition(".")[0] == head for name in self.channels):
            words = "/".join(name.rpartition(".")[2] for name in self.channels)
            if words.lower().split("/")[0] in COMPONENTS:
                head = head or self.source.path
            return show_name(f"{head}.{words}" if head else words)
        return show_name(", ".join(self.channels))


@dataclass(frozen=True)
class FoundLayer:
    """One layer of light: what is added up, and its albedo."""

    rule: LayerRule
    light: tuple[Found, ...]
    albedo: Found | None


@dataclass(frozen=True)
class ChannelMap:
    """What a file holds of a frame.

    Parameters
    ----------
    preset : Preset
        By which it was read.
    reason : str
        What told.
    roles : mapping of str to Found
        The images by role.
    layers : tuple of FoundLayer
        Layers of light.
    cryptomatte : tuple of tuple of Found
        For each Cryptomatte of the file its passes, in the order of their ranks.
    prefix : str
        What stands before the passes that were taken: the view layer.
    others : tuple of str
        Prefixes of further images of the same kind.
    shown : Found or None
        The image that people look at, where it is another pass than the noisy image: the renderer denoised it.
    """

    preset: Preset
    reason: str
    roles: Mapping[str, Found]
    layers: tuple[FoundLayer, ...]
    cryptomatte: tuple[tuple[Found, ...], ...]
    prefix: str = ""
    others: tuple[str, ...] = ()
    shown: Found | None = None

    @property
    def target(self) -> Found:
        """The image that people look at, into which results are written."""
        return self.roles["color"] if self.shown is None else self.shown


def choose_preset(container: Container, passes: Iterable[Pass], asked: PathLike | None = None) -> tuple[Preset, str]:
    """Return the preset of a file and what told it: an option, an attribute, the names of its passes, or nothing."""
    if asked is not None:
        return find_preset(asked), "it was asked for"
    attributes = [item for part in container.parts for item in part.attributes]
    for preset in load_presets().values():
        for pattern in preset.attributes:
            wanted, _, text = pattern.partition("=")
            for item in attributes:
                if fnmatchcase(item.name, wanted) and fnmatchcase(item.value.decode("utf-8", "replace"), text or "*"):
                    return preset, f"the header has the attribute {show_name(item.name)!r}"
    known = list(passes)
    for preset in load_presets().values():
        if preset.passes and all(any(one.matches(name) for one in known) for name in preset.passes):
            return preset, f"there are passes named {' and '.join(preset.passes)}"
    return load_presets()["generic"], "neither attributes nor names tell the renderer"


def map_channels(
    container: Container, *, preset: PathLike | None = None, mapping: Mapping[str, str] | None = None
) -> ChannelMap:
    """Return which channels of a file are which image of a frame.

    Parameters
    ----------
    container : Container
        The file.
    preset : path-like, optional
        Name of a preset or a file of one; by default that which the file tells.
    mapping : mapping of str to str, optional
        For some roles the channels, as `parse_mapping` takes them; they go before those of the preset.

    Raises
    ------
    InputError
        If a role, preset or channel is not known.
    MissingChannelError
        If there is no image.
    """
    passes = list_passes(container)
    chosen, reason = choose_preset(container, passes, preset)
    own = {role: parse_mapping(role, text, passes) for role, text in (mapping or {}).items()}
    color, prefix, others = _find_color(container, chosen, passes, own.get("color"))
    beside = keep_beside(passes, color.source.part)
    roles = {"color": color}
    for role, rules in chosen.roles.items():
        found = own.get(role) or _find_role(role, rules, beside, prefix)
        if found is not None and role != "color":
            roles[role] = found
    roles |= {role: found for role, found in own.items() if role not in roles}
    layers: dict[str, FoundLayer] = {}
    for rule in chosen.layers:
        layer = _find_layer(rule, beside, prefix)
        if layer is not None:
            layers.setdefault(rule.name, layer)
    mattes = [_find_matte(name, beside, prefix) for name in chosen.cryptomatte]
    shown = None if "color" in own else _find_shown(chosen, color, beside, prefix)
    return ChannelMap(chosen, reason, roles, tuple(layers.values()), tuple(filter(None, mattes)), prefix, others, shown)


def parse_mapping(role: str, text: str, passes: Sequence[Pass]) -> Found:
    """Return the image that ``channel,channel,...`` or a pass stands for; ``:conversion`` may stand behind.

    Raises
    ------
    InputError
        If the role, a channel or a conversion is unknown, or their number is not that of the role.
    """
    require_choice("--map", role, ROLES)
    given, *convert = text.split(":")
    for word in convert:
        require_choice(f"--map {role}, conversion", word, CONVERSIONS)
    names = [name.strip() for name in given.split(",")]
    count = 1 if role in SINGLES else 2 if role == "motion" else 3
    known = {channel: one for one in passes for channel in one.channels.values()}
    if len(names) == 1 and (count > 1 or names[0] not in known):
        for one in passes:
            channels = _pick(role, one) if one.matches(names[0]) else None
            if channels:
                return Found(one, channels, tuple(convert))
    for name in names:
        require_choice(f"--map {role}, channel", name, known)
    if len(names) != count:
        raise InputError(
            f"--map {role}", expected=f"{count} channels", got=repr(given), action="separate them by commas"
        )
    return Found(known[names[0]], tuple(names), tuple(convert))


def _pick(role: str, one: Pass, component: str | None = None) -> tuple[str, ...] | None:
    if role in SINGLES:
        return one.pick_single(component)
    return one.pick(ORDERS.get(role, COLOR))


def _find_color(
    container: Container, preset: Preset, passes: Sequence[Pass], own: Found | None
) -> tuple[Found, str, tuple[str, ...]]:
    """Return the image, the prefix of its path and those of others like it."""
    if own is not None:
        return own, own.source.get_prefix(own.source.path.rpartition(".")[2]), ()
    first = find_beauty(container.parts) or container.parts[0]
    views = [one for one in passes if one.part.view in ("", first.view)]
    for rule in preset.roles.get("color", (Rule(""),)):
        alike = [one for one in views if one.matches(rule.source) and one.pick(COLOR)]
        if alike:
            channels = alike[0].pick(COLOR)
            assert channels is not None
            prefixes = [one.get_prefix(rule.source) for one in alike]
            return Found(alike[0], channels, rule.convert), prefixes[0], tuple(prefixes[1:])
    for one in views:
        # Whatever the renderer calls it: the image is the first with R, G and B alone at the root, or the only color.
        if one.path in ("", one.part.name) and (channels := one.pick(COLOR[:1])):
            return Found(one, channels), "", ()
    names = [show_name(channel.name) for part in container.parts for channel in part.channels]
    raise MissingChannelError(
        f"input {str(container.path)!r}",
        expected="channels R, G and B, or an image by one of the names that renderers use",
        got="only " + ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else ""),
        action="say which it is with --map color=PASS",
    )


def _find_shown(preset: Preset, color: Found, passes: Sequence[Pass], prefix: str) -> Found | None:
    """Return the image that people look at, if it is another pass than the noisy image."""
    for pattern in preset.shown:
        for one in passes:
            channels = one.pick(COLOR) if one.matches(pattern) and one.get_prefix(pattern) == prefix else None
            if channels:
                return None if channels == color.channels and one.part == color.source.part else Found(one, channels)
    return None


def _find_pass(pattern: str, passes: Sequence[Pass], prefix: str) -> list[Pass]:
    """Return the passes of a pattern, those with the image's prefix first."""
    alike = [one for one in passes if one.matches(pattern)]
    return sorted(alike, key=lambda one: one.get_prefix(pattern) != prefix)


def _find_role(role: str, rules: Iterable[Rule], passes: Sequence[Pass], prefix: str) -> Found | None:
    for rule in rules:
        for one in _find_pass(rule.source, passes, prefix):
            channels = _pick(role, one, rule.component)
            if channels is not None:
                return Found(one, channels, rule.convert)
    return None


def _find_layer(rule: LayerRule, passes: Sequence[Pass], prefix: str) -> FoundLayer | None:
    light = [_find_role("color", [Rule(name)], passes, prefix) for name in rule.light]
    albedo = _find_role("color", [Rule(rule.albedo)], passes, prefix) if rule.albedo else None
    if None in light or not light or (rule.times_albedo and albedo is None):
        return None
    return FoundLayer(rule, tuple(found for found in light if found), albedo)


def _find_matte(name: str, passes: Sequence[Pass], prefix: str) -> tuple[Found, ...]:
    """Return the passes of one Cryptomatte, two ranks each: pairs of an id and a share."""
    ranks: dict[str, Found] = {}
    for number in range(16):
        for one in _find_pass(f"{name}{number:02d}", passes, prefix):
            channels = one.pick(("rgba",))
            if channels is not None:
                ranks.setdefault(f"{number}", Found(one, channels))
    return tuple(ranks.values())
