"""The weights as shader functions: one text, `weights.shader`, is translated into three languages.

The text is C-like. ``let`` declares a constant and ``var`` a variable, types stand before names, and vector types have
their names of GLSL. Operators, functions and comments are common to the three languages and stay as they are.
"""

from __future__ import annotations

import re

from lobewise.errors import require_choice
from lobewise.exporting.folder import MARK, fill_template, open_folder
from lobewise.exporting.names import SHADER_LANGUAGES
from lobewise.features.normal import LAMBERT_COEFFICIENTS
from lobewise.io.files import PathLike
from lobewise.lobes.covariance import AXIS_TURN, AXIS_TURN_PER_ALPHA, GGX_LIMIT, GGX_SHARPNESS, MIN_VIEW_COSINE
from lobewise.lobes.directions import MIN_COSINE
from lobewise.lobes.gaussian import MIN_WARP_COSINE
from lobewise.lobes.mixture import GGX_MIXTURES, MIN_SHARPNESS

_TYPES = {
    "glsl": {},
    "hlsl": {"vec2": "float2", "vec3": "float3", "vec4": "float4"},
    "wgsl": {"float": "f32", "vec2": "vec2<f32>", "vec3": "vec3<f32>", "vec4": "vec4<f32>"},
}
_WORD = re.compile(r"\b(float|vec2|vec3|vec4)\b")
_FUNCTION = re.compile(r"^(\w+) (\w+)\((.*)\) \{$")
_CONSTANT = re.compile(r"^const (\w+) (\w+) = (.*);$")
_MEMBER = re.compile(r"^    (\w+) (\w+);(.*)$")
_VALUE = re.compile(r"^(\s+)(let|var) (\w+) (\w+)(?: = (.*))?;$")


def make_shader(language: str) -> str:
    """Return the functions in "hlsl", "glsl" or "wgsl".

    Raises InputError if there is no such language.
    """
    require_choice("shader language", language, SHADER_LANGUAGES)
    lines, inside = [], False
    for line in fill_template("weights.shader", **_list_constants()).splitlines():
        if line.startswith("struct "):
            inside = True
        lines.append(_translate(line, language, inside))
        if line == "};":
            inside = False
    return "\n".join(lines) + "\n"


def _list_constants() -> dict[str, str]:
    exponents, weights = GGX_MIXTURES[3]
    *others, last = (_write(value) for value in LAMBERT_COEFFICIENTS)
    quotient = last
    for other in reversed(others):
        quotient = f"({quotient}) * x + {other}" if quotient != last else f"{last} * x + {other}"
    return {
        "MIN_COSINE": _write(MIN_COSINE),
        "MIN_WARP_COSINE": _write(MIN_WARP_COSINE),
        "MIN_VIEW_COSINE": _write(MIN_VIEW_COSINE),
        "GGX_LIMIT": _write(GGX_LIMIT),
        "AXIS_TURN": _write(AXIS_TURN),
        "AXIS_TURN_PER_ALPHA": _write(AXIS_TURN_PER_ALPHA),
        "GGX_SHARPNESS": _write(GGX_SHARPNESS),
        "MIN_SHARPNESS": _write(MIN_SHARPNESS),
        "MIXTURE_EXPONENTS": f"vec3({', '.join(map(_write, exponents))})",
        "MIXTURE_WEIGHTS": f"vec3({', '.join(map(_write, weights))})",
        "LAMBERT": quotient,
    }


def _write(value: float) -> str:
    return repr(float(value))


def _translate(line: str, language: str, inside: bool) -> str:
    """Return a line in a language; ``inside`` tells whether the line belongs to a structure."""
    code, mark, comment = line.partition("//")
    types = _TYPES[language]

    def name(word: str) -> str:
        return types.get(word, word)

    def spell(text: str) -> str:
        return _WORD.sub(lambda found: name(found[0]), text)

    def declare(kind: str, variable: str) -> str:
        return f"{variable}: {name(kind)}" if language == "wgsl" else f"{name(kind)} {variable}"

    if found := _FUNCTION.match(code):
        result, function, given = found.groups()
        parameters = ", ".join(declare(*parameter.split(" ")) for parameter in given.split(", "))
        if language == "wgsl":
            return f"fn {function}({parameters}) -> {name(result)} {{"
        return f"{name(result)} {function}({parameters}) {{"
    if found := _CONSTANT.match(code):
        kind, constant, value = found.groups()
        word = {"hlsl": "static const", "glsl": "const", "wgsl": "const"}[language]
        return f"{word} {declare(kind, constant)} = {spell(value)};"
    if inside and (found := _MEMBER.match(line)):
        kind, member, rest = found.groups()
        return f"    {declare(kind, member)}{',' if language == 'wgsl' else ';'}{rest}"
    if inside and language == "wgsl" and code == "};":
        return "}"
    if found := _VALUE.match(code):
        indent, how, kind, variable, value = found.groups()
        word = f"{how} " if language == "wgsl" else ""
        given = "" if value is None else f" = {spell(value)}"
        return f"{indent}{word}{declare(kind, variable)}{given};"
    return spell(code) + mark + comment


def export_shader(output: PathLike, language: str, *, force: bool = False) -> None:
    """Write a folder with the weights as shader functions.

    Parameters
    ----------
    output : path
        The folder, new or empty.
    language : {"hlsl", "glsl", "wgsl"}
    force : bool
        Replace an earlier export and everything in its folder.

    Raises
    ------
    InputError
        If there is no such language.
    FileError
        If the folder is not empty or cannot be written.
    """
    import json

    import lobewise
    from lobewise.exporting.readme import DOCS

    text = make_shader(language)
    version = lobewise.__version__
    with open_folder(output, force=force) as place:
        place(f"lobewise.{language}").write_text(text, encoding="utf-8")
        readme = fill_template(
            "shader_readme.md", title=language.upper(), language=language, version=version, docs=DOCS
        )
        place("README.md").write_text(readme, encoding="utf-8")
        place(MARK).write_text(json.dumps({"lobewise": version, "target": language}) + "\n", encoding="utf-8")
