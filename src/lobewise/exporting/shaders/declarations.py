"""The shader functions: the texts with their constants filled in, cut into declarations that passes pick from."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from lobewise.denoising import layers
from lobewise.exporting.folder import fill_template
from lobewise.features import ggx, normal
from lobewise.filters import cross_pass, forms
from lobewise.filters.history import accumulation, accumulation_pass, reprojection_pass
from lobewise.guides import places, surfaces
from lobewise.lobes import covariance, directions, gaussian, vectors
from lobewise.recipes.temporal import validation

_SHARED = (
    *(layers, ggx, cross_pass, accumulation, accumulation_pass, reprojection_pass, places, surfaces),
    *(covariance, directions, gaussian, validation),
)
"""The modules whose numbers the texts may name."""
_NAME = re.compile(r"\b(?:lobewise_|LOBEWISE_|Lobewise)\w+")
_DECLARED = re.compile(r"^(?:const \w+ (\w+) =|struct (\w+) \{|\w+ (\w+)\(.*\) \{$)")


@dataclass(frozen=True)
class Declaration:
    """A constant, structure or function of the shader texts, with the comment above it."""

    name: str
    text: str

    @property
    def uses(self) -> set[str]:
        """Names of other declarations that this one reads."""
        code = "\n".join(line.partition("//")[0] for line in self.text.splitlines())
        return set(_NAME.findall(code)) - {self.name}


@cache
def list_constants() -> Mapping[str, str]:
    """Return the numbers that the texts share with the library's own filters."""
    *others, last = map(write_number, normal.LAMBERT_COEFFICIENTS)
    lambert = f"{last} * x + {others.pop()}"
    for other in reversed(others):
        lambert = f"({lambert}) * x + {other}"
    named = [each for module in _SHARED for each in vars(module).items() if isinstance(each[1], (int, float))]
    numbers = dict(named)
    assert all(numbers[name] == value for name, value in named), "a name stands for two numbers"
    exponents, weights = gaussian.GGX_MIXTURES[3]
    return {
        **{name: str(value) if isinstance(value, int) else write_number(value) for name, value in numbers.items()},
        "MIXTURE_EXPONENTS": write_vector(exponents),
        "MIXTURE_WEIGHTS": write_vector(weights),
        "LUMINANCE": write_vector(vectors.LUMINANCE),
        "PROFILE": write_vector([math.log2(weight) for weight in forms.ATROUS_PROFILE]),
        "LAMBERT": lambert,
    }


def write_number(value: float) -> str:
    """Return a number that all three languages read as a float."""
    return repr(float(value))


def write_vector(values: Sequence[float]) -> str:
    """Return a vector of three numbers."""
    return f"vec3({', '.join(map(write_number, values))})"


@cache
def read_library(name: str) -> Mapping[str, Declaration]:
    """Return the declarations of a file of ``templates/shaders``, by name and in order."""
    declarations: dict[str, Declaration] = {}
    comment: list[str] = []
    body: list[str] = []
    named = ""
    for line in fill_template(f"shaders/{name}", **list_constants()).splitlines():
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
    # Constants, whose names have no small letters, come first, without gaps.
    constants = [name for name in known if name in texts and name.isupper()]
    others = [declared for name, declared in texts.items() if name not in constants]
    return "\n\n".join(["\n".join(texts[name] for name in constants), *others])
