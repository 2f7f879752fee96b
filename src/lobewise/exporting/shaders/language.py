"""The language of the shader templates, and its translation into HLSL, GLSL and WGSL.

The language is C-like. ``let`` declares a constant and ``var`` a variable, types stand before names, and vector types
have their names of GLSL. ``load(image, pixel)`` reads a pixel, ``store(image, pixel, value);`` writes one, and
``bits_of(number)`` is the bit pattern of a float. ``main {`` begins the entry point. Operators, comments and all other
functions are common to the three languages and stay as they are. There is no vector comparison and no ``a ? b : c``,
because the languages differ in both.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

_TYPES = {
    "glsl": {},
    "hlsl": {"vec2": "float2", "vec3": "float3", "vec4": "float4", "ivec2": "int2"},
    "wgsl": {
        "float": "f32",
        "int": "i32",
        "uint": "u32",
        "vec2": "vec2<f32>",
        "vec3": "vec3<f32>",
        "vec4": "vec4<f32>",
        "ivec2": "vec2<i32>",
    },
}
_BITS = {"glsl": "floatBitsToUint", "hlsl": "asuint", "wgsl": "bitcast<u32>"}
_LOAD = {"glsl": r"texelFetch(\1, \2, 0)", "hlsl": r"\1.Load(int3(\2, 0))", "wgsl": r"textureLoad(\1, \2, 0)"}
_STORE = {"glsl": "imageStore({0}, {1}, {2});", "hlsl": "{0}[{1}] = {2};", "wgsl": "textureStore({0}, {1}, {2});"}
_WORD = re.compile(r"\b(float|int|uint|vec2|vec3|vec4|ivec2)\b")
_FUNCTION = re.compile(r"^(\w+) (\w+)\((.*)\) \{$")
_CONSTANT = re.compile(r"^const (\w+) (\w+) = (.*);$")
_MEMBER = re.compile(r"^    (\w+) (\w+);(.*)$")
_VALUE = re.compile(r"^(\s+)(let|var) (\w+) (\w+)(?: = (.*))?;$")
_LOOP = re.compile(r"^(\s+)for \(var int (\w+) = (.*); (.*); (.*)\) \{$")
_LOADED = re.compile(r"\bload\((\w+), (\w+)\)")
_STORED = re.compile(r"^(\s+)store\((\w+), (\w+), (.*)\);$")

SIZES = {"float": (4, 4), "int": (4, 4), "ivec2": (8, 8), "vec2": (8, 8), "vec3": (12, 16), "vec4": (16, 16)}
"""Size and alignment of the types of constants, bytes; the same in all three languages."""


@dataclass(frozen=True)
class Binding:
    """An image that a pass reads or writes.

    Parameters
    ----------
    name : str
        Name in the shader.
    comment : str
        What its channels hold.
    format : str, optional
        A name of WebGPU's formats for an image that the pass writes; None for an image that it reads.
    """

    name: str
    comment: str
    format: str | None = None


@dataclass(frozen=True)
class Field:
    """A number that a pass reads: name, type, and what it means."""

    name: str
    kind: str
    comment: str


FORMATS = {
    "rgba32float": ("rgba32f", "float4"),
}
"""The formats of written images by their names of WebGPU: the names of GLSL, and the types of HLSL."""


def spell_type(kind: str, language: str) -> str:
    """Return the name of a type in a language."""
    return _TYPES[language].get(kind, kind)


def translate_text(text: str, language: str) -> str:
    """Return declarations and functions of the template language in "hlsl", "glsl" or "wgsl"."""
    lines, inside = [], False
    for line in text.splitlines():
        inside = inside or line.startswith("struct ")
        lines.append(translate_line(line, language, inside=inside))
        inside = inside and line != "};"
    return "\n".join(lines) + "\n"


def translate_line(line: str, language: str, *, inside: bool = False) -> str:
    """Return a line in a language; ``inside`` tells whether the line belongs to a structure."""
    code, mark, comment = line.partition("//")
    gap = code[len(code.rstrip()) :] if mark and code.strip() else ""
    if gap and not inside:
        return translate_line(code.rstrip(), language) + gap + mark + comment

    def spell(text: str) -> str:
        text = _WORD.sub(lambda match: spell_type(match[0], language), text).replace("bits_of(", _BITS[language] + "(")
        return _LOADED.sub(_LOAD[language], text)

    def declare(kind: str, variable: str) -> str:
        name = spell_type(kind, language)
        return f"{variable}: {name}" if language == "wgsl" else f"{name} {variable}"

    if match := _FUNCTION.match(code):
        result, function, parameter_list = match.groups()
        parameters = ", ".join(declare(*parameter.split(" ")) for parameter in parameter_list.split(", ") if parameter)
        if language == "wgsl":
            return f"fn {function}({parameters}) -> {spell_type(result, language)} {{"
        return f"{spell_type(result, language)} {function}({parameters}) {{"
    if match := _CONSTANT.match(code):
        kind, constant, value = match.groups()
        word = {"hlsl": "static const", "glsl": "const", "wgsl": "const"}[language]
        return f"{word} {declare(kind, constant)} = {spell(value)};"
    if inside and (match := _MEMBER.match(line)):
        kind, member, rest = match.groups()
        return f"    {declare(kind, member)}{',' if language == 'wgsl' else ';'}{rest}"
    if inside and language == "wgsl" and code == "};":
        return "}"
    if match := _VALUE.match(code):
        indent, how, kind, variable, value = match.groups()
        word = f"{how} " if language == "wgsl" else ""
        assigned = "" if value is None else f" = {spell(value)}"
        return f"{indent}{word}{declare(kind, variable)}{assigned};"
    if match := _LOOP.match(code):
        indent, variable, first, last, step = match.groups()
        word = "var " if language == "wgsl" else ""
        return f"{indent}for ({word}{declare('int', variable)} = {spell(first)}; {spell(last)}; {spell(step)}) {{"
    if match := _STORED.match(code):
        indent, image, pixel, value = match.groups()
        return indent + _STORE[language].format(image, pixel, spell(value))
    return spell(code) + mark + comment


def write_bindings(fields: Sequence[Field], bindings: Sequence[Binding], language: str) -> str:
    """Return the declarations of the constants, at binding 0, and of images, from binding 1 on."""
    lines = {"glsl": ["layout(std140, set = 0, binding = 0) uniform Constants {"]}.get(language, ["struct Constants {"])
    end = "," if language == "wgsl" else ";"
    for field in fields:
        name = spell_type(field.kind, language)
        declared = f"{field.name}: {name}" if language == "wgsl" else f"{name} {field.name}"
        lines.append(f"    {declared}{end} // {field.comment}")
    lines += {
        "glsl": ["} constants;"],
        "hlsl": ["};", "[[vk::binding(0, 0)]] ConstantBuffer<Constants> constants : register(b0);"],
        "wgsl": ["}", "@group(0) @binding(0) var<uniform> constants: Constants;"],
    }[language]
    lines.append("")
    counts = {"t": 0, "u": 0}
    for number, each in enumerate(bindings, 1):
        space = "t" if each.format is None else "u"
        lines += [f"// {each.comment}", _write_image(each, number, counts[space], language)]
        counts[space] += 1
    return "\n".join(lines) + "\n"


def _write_image(image: Binding, number: int, register: int, language: str) -> str:
    """Return the declaration of an image; in HLSL it has a register of its own kind beside the number for Vulkan."""
    if language == "wgsl":
        kind = "texture_2d<f32>" if image.format is None else f"texture_storage_2d<{image.format}, write>"
        return f"@group(0) @binding({number}) var {image.name}: {kind};"
    if language == "glsl":
        if image.format is None:
            return f"layout(set = 0, binding = {number}) uniform texture2D {image.name};"
        word = FORMATS[image.format][0]
        return f"layout(set = 0, binding = {number}, {word}) writeonly uniform image2D {image.name};"
    if image.format is None:
        return f"[[vk::binding({number}, 0)]] Texture2D<float4> {image.name} : register(t{register});"
    word, kind = FORMATS[image.format]
    return f"[[vk::binding({number}, 0)]] RWTexture2D<{kind}> {image.name} : register(u{register});"


def lay_out(fields: Sequence[Field]) -> dict[str, int]:
    """Return the offset of each field in the block of constants, bytes, and the size of the block under "".

    Raises ValueError if the languages would place a field differently: HLSL does not align vectors, but moves those
    that cross a multiple of 16 bytes.
    """
    offsets, place = {}, 0
    for field in fields:
        size, alignment = SIZES[field.kind]
        if place % alignment:
            raise ValueError(f"{field.name} begins at byte {place}, which is no multiple of {alignment}")
        offsets[field.name] = place
        place += size
    offsets[""] = -(-place // 16) * 16
    return offsets
