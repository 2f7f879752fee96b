"""Presets: the meaning of the channels of one renderer, one file per renderer (``presets/*.toml``), checked when read.

A preset says how to recognise the renderer's files, which pass holds which image, how to convert the values, and which
passes add up to a layer of light. It also advises how to switch on missing passes in the renderer. A preset may use the
words in `ROLES`, `CONVERSIONS` and `ATTRIBUTES`; any other word is an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from lobewise.errors import InputError, require_choice
from lobewise.io.documents import describe_kind, parse_toml, read_document
from lobewise.io.files import PathLike

MAX_PRESET_BYTES = 1 << 16
"""Largest size of a preset file, bytes. The largest preset of this package has a twentieth of it."""

ROLES = {
    "color": "total radiance",
    "diffuse": "radiance whose first scattering was diffuse",
    "specular": "radiance whose first scattering was specular",
    "albedo": "albedo of all lobes together",
    "diffuse_albedo": "albedo of the diffuse lobe",
    "specular_albedo": "albedo of the specular lobe",
    "normal": "shading normal",
    "denoiser_normal": "normal for denoisers, handed to Open Image Denoise as it is",
    "position": "world position",
    "depth": "distance along the ray",
    "roughness": "roughness of the specular lobe",
    "motion": "pixels to the previous frame",
    "variance": "variance of the mean",
    "alpha": "share of the pixel that shows a surface",
}
"""Roles of passes, with their meanings. Layers and Cryptomatte have their own rules."""
SINGLE_VALUE_ROLES = ("depth", "roughness", "alpha")
"""Roles with one value per pixel."""
CONVERSIONS = {
    "camera_space": "from camera space (x right, y up, z away from the camera) to the world",
    "camera_space_back": "from camera space (x right, y up, z towards the camera) to the world",
    "encoded": "from [0, 1] to [-1, 1]",
    "planar": "from the distance along the camera's axis to that along the ray",
    "square": "from perceptual roughness to alpha, its square",
    "invert": "from glossiness to roughness, 1 minus it",
    "hundredth": "from centimetres to metres",
    "negate": "the other way round",
    "y_up": "from y up to y down",
    "of_samples": "from the variance of one sample to that of their mean",
    "cycles_roughness": "from the mean over all closures, diffuse counted as 1, to the specular lobes' own",
}
"""Conversions of pixel values, with their meanings. They are applied in the order in which a rule names them."""
CONVERSIONS_OF = {
    "normal": ("camera_space", "camera_space_back", "encoded", "negate"),
    "position": ("hundredth", "negate"),
    "depth": ("planar", "invert", "hundredth", "negate"),
    "roughness": ("square", "invert", "hundredth", "cycles_roughness"),
    "motion": ("y_up", "negate"),
    "variance": ("of_samples",),
}
"""Conversions that each role allows. Roles that are not listed allow none."""
LOBES = ("diffuse", "subsurface", "volume", "glossy", "coat", "transmission", "exact")
"""Kinds of layers. The first three are filtered as diffuse light, the next three as specular light. "exact" light is
free of noise and not filtered."""
ATTRIBUTES = (
    *("name", "title", "attributes", "versions", "passes", "files", "samples", "samples_squared"),
    *("notes", "advice", "layer", "cryptomatte", "shown", "light_groups", "also"),
)
"""Keys of a preset file beside the roles."""


@dataclass(frozen=True)
class Rule:
    """One way to find an image: the pass, optionally one component of the pass, and the conversions of its values."""

    source: str
    component: str | None = None
    convert: tuple[str, ...] = ()


@dataclass(frozen=True)
class LayerRule:
    """One layer of light: the sum of some passes, times an albedo if the renderer divides the passes by it."""

    name: str
    lobe: str
    light: tuple[str, ...]
    albedo: str | None = None
    times_albedo: bool = False


@dataclass(frozen=True)
class Preset:
    """The meaning of the files of one renderer.

    Parameters
    ----------
    name, title : str
        The name in options and the name in messages.
    attributes, passes : tuple of str
        Patterns that identify the renderer: any one of the header attributes, or all of the passes together.
    versions : tuple of str
        Header attributes with the version of the renderer as text, the best first.
    roles : mapping of str to tuple of Rule
        The rules that find each role, the best first.
    shown : tuple of str
        Passes that viewers show, the best first, if the renderer denoised them and kept the noisy image in another
        pass. Results are written to these passes.
    layers : tuple of LayerRule
        Rules of the layers. Of several rules with one name, the first whose passes are all present counts.
    cryptomatte : tuple of str
        Names of Cryptomatte passes without their numbers, the finest first.
    light_groups : tuple of str
        Patterns of passes with the light of some lamps. The name of the group stands for the asterisk at the end.
    also : tuple of str
        Patterns of further noisy passes that are denoised, each by itself.
    samples, samples_squared : tuple of str
        Attributes that hold the samples per pixel, or their square root.
    files : tuple of str
        Words in the name of the image file, if the renderer writes one file per pass.
    notes : tuple of str
        Sentences for the user about every file of this renderer.
    advice : mapping of str to str
        What to switch on in the renderer, by missing role.
    is_users : bool
        Whether the preset comes from a file of the user. Then a pass that it names should be present.
    """

    name: str
    title: str
    attributes: tuple[str, ...] = ()
    versions: tuple[str, ...] = ()
    passes: tuple[str, ...] = ()
    roles: Mapping[str, tuple[Rule, ...]] = field(default_factory=dict)
    shown: tuple[str, ...] = ()
    layers: tuple[LayerRule, ...] = ()
    cryptomatte: tuple[str, ...] = ()
    light_groups: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    samples: tuple[str, ...] = ()
    samples_squared: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    advice: Mapping[str, str] = field(default_factory=dict)
    is_users: bool = False


OWN = Preset("lobewise", "lobewise", roles={"color": (Rule(""),)})
"""lobewise's own channel names (`lobewise.io.exr.schema`). Their values need no conversion; no option names them."""


@cache
def load_presets() -> dict[str, Preset]:
    """Return the presets of this package by name. "generic" knows only common pass names, so it comes last."""
    folder = files("lobewise.interchange").joinpath("presets")
    presets = {}
    for item in sorted(folder.iterdir(), key=lambda one: (one.name == "generic.toml", one.name)):
        if item.name.endswith(".toml"):
            preset = _parse(item.read_bytes(), item.name)
            presets[preset.name] = preset
    return presets


def look_up_preset(name: PathLike) -> Preset:
    """Return the preset of this name, or the preset in a file whose name ends in ``.toml``.

    Raises
    ------
    InputError
        If no preset has this name, or the file is not a valid preset.
    FileError
        If the file cannot be read.
    """
    if str(name).endswith(".toml"):
        data = read_document(name, MAX_PRESET_BYTES, what="preset", holds="a preset in TOML")
        preset = replace(_parse(data, str(name)), is_users=True)
        if not (preset.roles or preset.layers):
            raise InputError(
                f"preset {str(name)!r}",
                expected="passes for a role or a layer",
                got="none",
                action='write, for example, normal = ["N"]',
            )
        return preset
    name = SYNONYMS.get(str(name).casefold(), str(name))
    require_choice("preset", name, load_presets())
    return load_presets()[name]


def _parse(data: bytes, where: str) -> Preset:
    what = f"preset {where!r}"
    document = parse_toml(data, what=what)
    for key in document:
        require_choice(f"{what}, key", key, [*ATTRIBUTES, *ROLES])
    name = _take(document, "name", str, what, Path(where).stem)
    advice = _take(document, "advice", dict, what, {})
    return Preset(
        name=name,
        title=_take(document, "title", str, what, name),
        attributes=_take_texts(document, "attributes", what),
        versions=_take_texts(document, "versions", what),
        passes=_take_texts(document, "passes", what),
        roles={
            role: tuple(_parse_rule(role, rule, f"{what}, {role}") for rule in _take(document, role, list, what, []))
            for role in ROLES
            if role in document
        },
        shown=_take_texts(document, "shown", what),
        layers=tuple(_parse_layer(rule, f"{what}, layer") for rule in _take(document, "layer", list, what, [])),
        cryptomatte=_take_texts(document, "cryptomatte", what),
        light_groups=_take_texts(document, "light_groups", what),
        also=_take_texts(document, "also", what),
        samples=_take_texts(document, "samples", what),
        samples_squared=_take_texts(document, "samples_squared", what),
        files=_take_texts(document, "files", what),
        notes=_take_texts(document, "notes", what),
        advice={
            require_choice(f"{what}, advice", role, [*ROLES, "camera", "layers", "cryptomatte"]): _take(
                advice, role, str, f"{what}, advice"
            )
            for role in advice
        },
    )


def require_conversion(what: str, role: str, word: str) -> None:
    """Raise InputError unless the conversion exists and the role allows it."""
    require_choice(f"{what}, conversion", word, CONVERSIONS)
    fitting = CONVERSIONS_OF.get(role, ())
    if word not in fitting:
        raise InputError(
            f"{what}, conversion",
            expected=f"one for {role}: {', '.join(fitting)}" if fitting else f"none for {role}",
            got=repr(word),
            action="leave it out",
        )


def _parse_rule(role: str, value: Any, what: str) -> Rule:
    if isinstance(value, str):
        return Rule(value)
    for key in _require_table(value, what):
        require_choice(what, key, ("pass", "component", "convert"))
    convert = _take_texts(value, "convert", what)
    for word in convert:
        require_conversion(what, role, word)
    return Rule(_take(value, "pass", str, what), _take(value, "component", str, what, None), convert)


def _parse_layer(value: Any, what: str) -> LayerRule:
    for key in _require_table(value, what):
        require_choice(what, key, ("name", "lobe", "light", "albedo", "times_albedo"))
    name = _take(value, "name", str, what)
    lobe = require_choice(f"{what}, lobe", _take(value, "lobe", str, what), LOBES)
    albedo = _take(value, "albedo", str, what, None)
    return LayerRule(
        name, lobe, _take_texts(value, "light", what), albedo, _take(value, "times_albedo", bool, what, False)
    )


def _require_table(value: Any, what: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(what, expected="a table", got=describe_kind(value), action='write { pass = "..." }')
    return value


SYNONYMS = {"blender": "cycles", "prman": "renderman"}
"""Names of presets as users know the programs."""
_KINDS = {str: "a text", list: "a list", dict: "a table", bool: "true or false"}


def _take(table: Mapping[str, Any], key: str, kind: type, what: str, *default: Any) -> Any:
    if key not in table and default:
        return default[0]
    value = table.get(key)
    if not isinstance(value, kind):
        raise InputError(f"{what}, {key}", expected=_KINDS[kind], got=describe_kind(value), action="see presets/*.toml")
    return value


def _take_texts(table: Mapping[str, Any], key: str, what: str) -> tuple[str, ...]:
    texts = _take(table, key, list, what, [])
    if not all(isinstance(text, str) for text in texts):
        raise InputError(
            f"{what}, {key}", expected="a list of texts", got="something else in it", action="quote each of them"
        )
    return tuple(texts)
