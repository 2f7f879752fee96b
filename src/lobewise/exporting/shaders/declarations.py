"""The shader functions: the texts with their constants filled in, cut into declarations that passes pick from."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from string import Template

from lobewise.denoising.layers import MIN_HIT_DISTANCE
from lobewise.features.ggx import GGX_UNIT
from lobewise.features.normal import LAMBERT_COEFFICIENTS
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.forms import ATROUS_PROFILE
from lobewise.filters.history.accumulation import TRUST_RADIUS
from lobewise.filters.history.accumulation_pass import (
    FULL_TRUST_ERRORS,
    IGNORED_DIFFERENCE,
    MIN_KNOWN_FRAMES,
    MIN_WEIGHT,
    NO_TRUST_ERRORS,
)
from lobewise.filters.history.reprojection_pass import SNAP_PIXELS
from lobewise.guides.places import MIN_EDGE_RATIO, MISS_DISTANCE
from lobewise.guides.surfaces import MIN_SQUARED_NORMAL
from lobewise.lobes.covariance import AXIS_TURN, AXIS_TURN_PER_ALPHA, GGX_LIMIT, GGX_SHARPNESS, MIN_VIEW_COSINE
from lobewise.lobes.directions import MIN_COSINE
from lobewise.lobes.gaussian import MIN_WARP_COSINE
from lobewise.lobes.mixture import GGX_MIXTURES, MIN_SHARPNESS
from lobewise.lobes.vectors import LUMINANCE
from lobewise.temporal.validation import HIT_TOLERANCE, HIT_TOLERANCE_PER_LOBE

_NAME = re.compile(r"\b(?:lobewise_|LOBEWISE_|Lobewise)\w+")
_DECLARED = re.compile(r"^(?:const \w+ (\w+) =|struct (\w+) \{|\w+ (\w+)\(.*\) \{$)")


@dataclass(frozen=True)
class Declaration:
    """A constant, structure or function of the shader texts, with the comment above it."""

    name: str
    text: str

    @property
    def is_constant(self) -> bool:
        """Whether this is a constant."""
        return self.name.isupper()

    @property
    def uses(self) -> set[str]:
        """Names of other declarations that this one reads."""
        code = "\n".join(line.partition("//")[0] for line in self.text.splitlines())
        return set(_NAME.findall(code)) - {self.name}


def copy_template(name: str) -> str:
    """Return a file of this room's folder ``templates`` as it is."""
    path = files("lobewise") / "exporting" / "shaders" / "templates" / name
    return path.read_text(encoding="utf-8")


def read_template(name: str, parts: Mapping[str, str]) -> str:
    """Return a file of this room's folder ``templates`` with every ``$name`` replaced."""
    return Template(copy_template(name)).substitute(parts)


@cache
def list_constants() -> Mapping[str, str]:
    """Return the numbers that the texts share with the library's own filters."""
    exponents, weights = GGX_MIXTURES[3]
    *others, last = (write_number(value) for value in LAMBERT_COEFFICIENTS)
    quotient = last
    for other in reversed(others):
        quotient = f"({quotient}) * x + {other}" if quotient != last else f"{last} * x + {other}"
    numbers: dict[str, float] = {
        "MIN_COSINE": MIN_COSINE,
        "MIN_WARP_COSINE": MIN_WARP_COSINE,
        "MIN_VIEW_COSINE": MIN_VIEW_COSINE,
        "GGX_LIMIT": GGX_LIMIT,
        "AXIS_TURN": AXIS_TURN,
        "AXIS_TURN_PER_ALPHA": AXIS_TURN_PER_ALPHA,
        "GGX_SHARPNESS": GGX_SHARPNESS,
        "MIN_SHARPNESS": MIN_SHARPNESS,
        "ALBEDO_FLOOR": ALBEDO_FLOOR,
        "MIN_SQUARED_NORMAL": MIN_SQUARED_NORMAL,
        "GGX_UNIT": GGX_UNIT,
        "NO_TRUST_ERRORS": NO_TRUST_ERRORS,
        "FULL_TRUST_ERRORS": FULL_TRUST_ERRORS,
        "IGNORED_DIFFERENCE": IGNORED_DIFFERENCE,
        "MIN_WEIGHT": MIN_WEIGHT,
        "SNAP_PIXELS": SNAP_PIXELS,
        "MIN_KNOWN_FRAMES": MIN_KNOWN_FRAMES,
        "MIN_EDGE_RATIO": MIN_EDGE_RATIO,
        "MISS_DISTANCE": MISS_DISTANCE,
        "MIN_HIT_DISTANCE": MIN_HIT_DISTANCE,
        "HIT_TOLERANCE": HIT_TOLERANCE,
        "HIT_PER_LOBE": HIT_TOLERANCE_PER_LOBE,
    }
    return {
        **{name: write_number(value) for name, value in numbers.items()},
        "MIXTURE_EXPONENTS": write_vector(exponents),
        "MIXTURE_WEIGHTS": write_vector(weights),
        "LUMINANCE": write_vector(LUMINANCE),
        "PROFILE": write_vector([math.log2(weight) for weight in ATROUS_PROFILE]),
        "TRUST_RADIUS": str(TRUST_RADIUS),
        "LAMBERT": quotient,
    }


def write_number(value: float) -> str:
    """Return a number that all three languages read as a float."""
    return repr(float(value))


def write_vector(values: Sequence[float]) -> str:
    """Return a vector of three numbers."""
    return f"vec3({', '.join(map(write_number, values))})"


@cache
def read_library(name: str) -> Mapping[str, Declaration]:
    """Return the declarations of a file of ``templates``, by name and in order."""
    declarations: dict[str, Declaration] = {}
    comment: list[str] = []
    body: list[str] = []
    named = ""
    for line in read_template(name, list_constants()).splitlines():
        if not body and (line.startswith("//") or not line):
            comment = [*comment, line] if line else []
            continue
        if not body:
            match = _DECLARED.match(line)
            assert match is not None, f"{name}: no declaration: {line}"
            named = next(group for group in match.groups() if group)
        body.append(line)
        if line.startswith("const ") or line in ("}", "};"):
            declarations[named] = Declaration(named, "\n".join([*comment, *body]))
            comment, body = [], []
    return declarations


def gather(libraries: Sequence[str], text: str) -> str:
    """Return the declarations that a text reads, and those that they read, each after what it reads."""
    known: dict[str, Declaration] = {}
    for library in libraries:
        known |= read_library(library)
    places = {name: place for place, name in enumerate(known)}
    texts: dict[str, str] = {}

    def add(declaration: Declaration) -> None:
        for name in sorted(declaration.uses, key=places.__getitem__):
            if name not in texts:
                add(known[name])
                texts[name] = known[name].text

    add(Declaration("", text))
    # Constants come first, without gaps.
    constants = [name for name in known if name in texts and known[name].is_constant]
    others = [declared for name, declared in texts.items() if name not in constants]
    return "\n\n".join(["\n".join(texts[name] for name in constants), *others])
