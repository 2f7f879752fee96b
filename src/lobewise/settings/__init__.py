"""Every setting, declared once: its meaning, its values and its default.

Validation, docstrings, the options of the program, the controls of the viewer and the settings of exports are made from
these declarations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from textwrap import fill
from typing import Annotated, Any, Literal, TypedDict, get_args, get_origin, get_type_hints

from lobewise.errors import InputError, name_value, require_choice
from lobewise.settings.choices import FORM_NAMES as FORM_NAMES
from lobewise.settings.choices import FormName as FormName
from lobewise.settings.choices import QualityName as QualityName
from lobewise.settings.choices import SimilarityName as SimilarityName
from lobewise.settings.choices import get_quality

Auto = Literal["auto"]

QUALITY_NAMES: tuple[QualityName, ...] = get_args(QualityName)
SIMILARITY_NAMES: tuple[SimilarityName, ...] = get_args(SimilarityName)
OIDN_QUALITY: QualityName = "balanced"
"""The quality of our own image that is mixed with the image of Open Image Denoise, where none is named. The network of
"high" made the mixture no better (docs/developers/decisions.md)."""
LARGEST_RADIUS = 64
MAX_WINDOW = 8
"""Most frames to each side of a window."""
MAX_LOBES = 4
"""Largest number of spherical Gaussians in a mixture."""


@dataclass(frozen=True)
class Knob:
    """The declaration of a setting.

    Parameters
    ----------
    text : str
        Its meaning. The first sentence alone is the hint of a control.
    low, high : float, optional
        Ends of the range of a number, both included. Without ``high`` the number is above ``low``.
    usual : str
        Advice for a value that is refused.
    label : str
        Its name beside a control.
    unit : str
        Unit of a number.
    opposite : str
        Name of the option that turns a switch off.
    """

    text: str
    low: float = 0.0
    high: float = math.inf
    usual: str = "leave it out if unsure"
    label: str = ""
    unit: str = ""
    opposite: str = ""
    # Read from the annotated field.
    name: str = ""
    default: Any = None
    kind: type = str
    choices: tuple[str, ...] = ()
    """Words that the setting takes; for a number or a switch "auto", or none."""
    optional: bool = False

    @property
    def hint(self) -> str:
        """The first sentence of the text."""
        return self.text.replace("`", "").split(". ")[0].removesuffix(".") + "."

    @property
    def meaning(self) -> str:
        """The first sentence without its full stop, and the unit."""
        return self.hint.removesuffix(".") + (f" ({self.unit})" if self.unit else "")

    @property
    def expected(self) -> str:
        """The values that it takes, in words."""
        if self.kind is bool:
            words = "True, False" if self.choices else "True or False"
        elif self.high < math.inf:
            words = f"{'an integer' if self.kind is int else 'a number'} from {self.low:g} to {self.high:g}"
        else:
            words = f"a finite number above {self.low:g}"
        auto = "".join(f'"{word}"' for word in self.choices)
        if self.kind is bool and auto:
            return f"{words} or {auto}"
        return f"{auto} or {words}" if auto else words

    def check(self, value: Any) -> None:
        """Raise InputError unless ``value`` is one that the setting takes."""
        if self.kind is str:
            if self.choices and not (isinstance(value, str) and value in self.choices):
                require_choice(self.name, value, self.choices)
        elif not (value is None and self.optional) and not self._takes(value):
            raise InputError(self.name, expected=self.expected, got=name_value(value), action=self.usual)

    def _takes(self, value: Any) -> bool:
        if isinstance(value, str):
            return value in self.choices
        if getattr(value, "shape", ()) != () or isinstance(value, bytes):
            # Arrays compare element by element, and bytes can be made a number.
            return False
        if self.kind is bool:
            return value in (True, False)
        if self.kind is int and (isinstance(value, bool) or not isinstance(value, int)):
            return False
        try:
            # Written so that NaN fails.
            return bool(self.low <= value <= self.high if self.high < math.inf else self.low < float(value) < math.inf)
        except (TypeError, OverflowError):
            return False


@cache
def list_knobs(kind: type) -> Mapping[str, Knob]:
    """Return the declarations of a class of settings by the names of its fields."""
    found: dict[str, Knob] = {}
    for owner in reversed(kind.__mro__):
        # Read the annotations of each class alone: a subclass that narrows a type declares nothing else.
        hints = get_type_hints(owner, include_extras=True) if "__annotations__" in vars(owner) else {}
        for name, hint in hints.items():
            declared = [each for each in getattr(hint, "__metadata__", ()) if isinstance(each, Knob)]
            if declared and get_origin(hint) is Annotated:
                default = getattr(owner, name, MISSING)
                found[name] = replace(declared[0], name=name, default=default, **_read_type(get_args(hint)[0]))
    return found


def _read_type(kind: Any) -> dict[str, Any]:
    """Return the fields of `Knob` that a type tells: the type of values, the words, and whether None is a value."""
    parts = [kind] if get_origin(kind) is Literal or isinstance(kind, type) else list(get_args(kind))
    words = [word for part in parts if get_origin(part) is Literal for word in get_args(part)]
    kinds = [part for part in parts if part in (bool, int, float)]
    return {
        "kind": kinds[0] if kinds else str,
        "choices": tuple(sorted(words, key=lambda word: word != "auto")),
        "optional": type(None) in parts,
    }


class Declared:
    """The base of classes of settings: values are checked, and the docstring lists the fields."""

    def __post_init__(self) -> None:
        kind: type = type(self)
        for name, knob in list_knobs(kind).items():
            knob.check(getattr(self, name))


def document(kind: type) -> None:
    """Add the parameters of a class of settings to its docstring, from their declarations."""
    lines = [f"{kind.__doc__}", "", "    Parameters", "    ----------"]
    for name, knob in list_knobs(kind).items():
        words = ", ".join(f'"{word}"' for word in knob.choices)
        shown = f"{{{words}}}" if knob.kind is str and words else knob.kind.__name__
        if knob.kind in (int, float):
            shown += f" from {knob.low:g} to {knob.high:g}" if knob.high < math.inf else f" > {knob.low:g}"
        if knob.kind is not str:
            shown += f" or {words}" if words else " or None" if knob.optional else ""
        shown += f", {knob.unit}" if knob.unit else ""
        text = fill(knob.text, 118, initial_indent=" " * 8, subsequent_indent=" " * 8)
        lines += [f"    {name} : {shown}", text]
    kind.__doc__ = "\n".join([*lines, "    "])


@dataclass(frozen=True)
class DenoiseSettings(Declared):
    """Parameters of `denoise`."""

    quality: Annotated[
        QualityName | Auto,
        Knob(
            'How much work goes into the noise: "fast" little, "balanced" more, "high" much, "best" most, "auto" '
            'what pays here. "fast" weighs by guides alone, in one pass, as the paper does. "balanced" filters two '
            'halves of the samples narrowly, and then widely by what that tells of light and noise; "high" also '
            'refines the image by a network. "auto" mixes "balanced" with Open Image Denoise where it is installed, '
            'and takes "high" where it is not; "best" needs it, and takes half as much time again. For the other '
            'forms, upsampling and histories "auto" takes "fast", the only quality they have.',
            label="Quality",
        ),
    ] = "auto"
    similarity: Annotated[
        SimilarityName | Auto,
        Knob(
            "What two pixels must share to be averaged. Compared on specular pixels are shading normals, one spherical "
            "Gaussian per lobe, a sum of them, or the GGX covariance of the lobe. "
            'Where the frame has roughness and camera, "auto" takes "sg", with quality "fast" "ggx"; else "normal".',
            label="Similarity",
        ),
    ] = "auto"
    form: Annotated[
        FormName,
        Knob(
            "Which neighbours count: all (2r+1)^2, a row and then a column, or five 5x5 levels of doubling step "
            "(radius 62). Full is best; separable and atrous, of quality fast, take less time.",
            label="Kernel",
        ),
    ] = "full"
    radius: Annotated[
        int,
        Knob(
            'Pixels from the centre to the edge of the kernel (samples, where few pixels are shaded). "atrous" does '
            "not use it.",
            high=LARGEST_RADIUS,
            usual="8 is usual; form atrous reaches further",
            label="Radius",
            unit="pixels",
        ),
    ] = 8
    beta: Annotated[
        float | Auto,
        Knob(
            'Exponent of the similarity of lobes: larger keeps more detail and more noise. "auto" follows the noise.',
            label="Beta",
        ),
    ] = "auto"
    diffuse_beta: Annotated[float | Auto, Knob("Exponent of the similarity of diffuse lobes.")] = "auto"
    device: Annotated[str, Knob('Where the kernels run; see `list_devices`, or "lobewise devices".')] = "auto"
    screen_sigma: Annotated[
        float | Auto,
        Knob(
            'Standard deviation of the screen distance; not used by "atrous". "auto" follows radius and noise.',
            unit="pixels",
        ),
    ] = "auto"
    position_sigma: Annotated[
        float, Knob("Standard deviation of the distance in the scene.", unit="pixel footprints")
    ] = 16.0
    tau: Annotated[
        float | Auto,
        Knob(
            "Band-limit of the lobes, from 1e-5 to 1: what makes a mirror's lobe finite (see `lobewise.lobes`). "
            '"auto" follows the noise, down to the angle of a pixel.',
            label="Band-limit",
            unit="radians",
        ),
    ] = "auto"
    normal_exponent: Annotated[
        float, Knob('Sharpness with which "normal" compares normals.', label="Normal exponent")
    ] = 64.0
    band_limit: Annotated[
        float | None,
        Knob('With "normal": scale of the screen-space band-limit by BRDF parameter; None for none.'),
    ] = None
    lobes: Annotated[
        int,
        Knob(
            'With "sg_mixture": spherical Gaussians that stand for a GGX lobe; where diffuse and specular radiance '
            "are not apart 1 to 3, and one more is the diffuse lobe.",
            low=1,
            high=MAX_LOBES,
            usual="3 is usual",
        ),
    ] = 3
    with_oidn: Annotated[
        bool | Auto,
        Knob(
            'Whether the result is mixed with that of Intel Open Image Denoise (lobewise[best]): "auto" does so where '
            'it is installed and no quality but "best" is named. With the quality "balanced" unless another is named.',
            opposite="offline",
        ),
    ] = "auto"

    def __post_init__(self) -> None:
        super().__post_init__()
        quality = OIDN_QUALITY if self.asks_for_oidn and self.quality == "auto" else self.quality
        if quality != "auto" and self.form not in get_quality(quality).forms:
            raise InputError(
                "form",
                expected=f"'full' with quality {quality!r}",
                got=repr(self.form),
                action="use quality 'fast' for the other forms",
            )
        if self.with_oidn is False and self.needs_oidn:
            raise InputError(
                "quality",
                expected="'high' without Open Image Denoise",
                got=repr(self.quality),
                action="take another quality, or let Open Image Denoise take part",
            )
        if self.asks_for_oidn and self.quality != "auto" and not get_quality(self.quality).reads_halves:
            raise InputError(
                "quality",
                expected="'balanced' or 'high' with Open Image Denoise",
                got=repr(self.quality),
                action="leave the quality out",
            )

    @property
    def needs_oidn(self) -> bool:
        """Whether the quality is one that Open Image Denoise takes part in."""
        return self.quality != "auto" and get_quality(self.quality).needs_oidn

    @property
    def asks_for_oidn(self) -> bool:
        """Whether Open Image Denoise is named, or the quality needs it; it is not left to "auto"."""
        return self.needs_oidn or (self.with_oidn != "auto" and bool(self.with_oidn))


@dataclass(frozen=True, kw_only=True)
class ResolvedSettings(DenoiseSettings):
    """`DenoiseSettings` with every "auto" replaced for a frame. Only `lobewise.denoising.automatic` makes them."""

    quality: QualityName
    similarity: SimilarityName
    beta: float
    diffuse_beta: float
    screen_sigma: float
    tau: float
    with_oidn: bool

    def __post_init__(self) -> None:
        super().__post_init__()
        left = [item.name for item in fields(self) if getattr(self, item.name) == "auto"]
        if left:
            raise ValueError(f"settings {left} are not resolved")


@dataclass(frozen=True)
class TemporalSettings(Declared):
    """Parameters of `TemporalFilter` beside `DenoiseSettings`."""

    memory: Annotated[
        float,
        Knob(
            "Share of its history that a frame keeps for the next, 0 for none; with m a history is worth at most "
            "1 / (1 - m) frames.",
            high=1.0,
        ),
    ] = 0.95
    beta: Annotated[float, Knob("Exponent of the similarity between a pixel's lobe and what it was a frame ago.")] = 1.0
    plane_sigma: Annotated[
        float,
        Knob(
            "How far a surface point may lie off its plane of a frame ago, a standard deviation.",
            unit="pixel footprints",
        ),
    ] = 2.0
    strictness: Annotated[
        float,
        Knob(
            "How the kernel narrows as the history grows, 0 for not: weights are raised to the power "
            "frames**strictness of the frames that a pixel's history is worth.",
            high=1.0,
        ),
    ] = 0.5
    history_radius: Annotated[
        int,
        Knob(
            "Radius of the kernel where a pixel of a sparse frame has a history; never above the radius of the others.",
            unit="samples",
        ),
    ] = 2
    cut_share: Annotated[
        float,
        Knob(
            "Share of pixels that must find their history within a quarter of the image; where fewer do it is a "
            "camera cut and all is dropped.",
            high=1.0,
        ),
    ] = 0.4


for _kind in (DenoiseSettings, TemporalSettings):
    document(_kind)


class DenoiseChanges(TypedDict, total=False):
    """Fields of `DenoiseSettings` as keyword arguments, written out for type checkers."""

    quality: QualityName | Auto
    similarity: SimilarityName | Auto
    form: FormName
    radius: int
    beta: float | Auto
    diffuse_beta: float | Auto
    device: str
    screen_sigma: float | Auto
    position_sigma: float
    tau: float | Auto
    normal_exponent: float
    band_limit: float | None
    lobes: int
    with_oidn: bool | Auto


class TemporalChanges(DenoiseChanges, total=False):
    """Fields of both classes of settings as keyword arguments; ``beta`` is that of `DenoiseSettings`."""

    memory: float
    plane_sigma: float
    strictness: float
    history_radius: int
    cut_share: float
