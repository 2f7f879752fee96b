"""A chain of compute passes as data: images, constants, and passes with what each reads and writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from lobewise.exporting.folder import fill_template
from lobewise.exporting.shaders.declarations import gather
from lobewise.exporting.shaders.language import Binding, Field, translate_text, write_bindings

WORKGROUP = 8, 8
"""Threads of a workgroup, across and down: 64 fit every graphics card, and a square reads few pixels twice."""
LIBRARIES = "weights.shader", "chain.shader"
"""The files of functions that every pass may read."""


class Lifetime(Enum):
    """How long an image lives, and who writes it."""

    GIVEN = "given"
    """The caller writes it before the chain runs."""
    FRAME = "frame"
    """A pass writes it; its memory is free after the last pass that reads it."""
    KEPT = "kept"
    """A pass writes it, and the next frame reads it under another name: two images that change places."""
    BEFORE = "before"
    """An image of lifetime "kept" that the frame before wrote; 0 everywhere before the first frame."""
    RESULT = "result"
    """The result."""


@dataclass(frozen=True)
class Image:
    """An image of a chain.

    Parameters
    ----------
    name : str
    comment : str
        What its channels hold, in which units.
    lifetime : Lifetime
    format : str
        A name of WebGPU's formats. For images of lifetime "given" any format with enough channels will do.
    extent : (str, str)
        Constants that are its width and height.
    before : str
        For lifetime "before": the name of the image that the frame before wrote.
    """

    name: str
    comment: str
    lifetime: Lifetime
    format: str = "rgba32float"
    extent: tuple[str, str] = ("width", "height")
    before: str = ""


@dataclass(frozen=True)
class Constant(Field):
    """A number of a chain, with the value that Python gives it."""

    python: str


@dataclass(frozen=True, kw_only=True)
class Pass:
    """A compute pass.

    Parameters
    ----------
    name : str
        Name of its file, without ending.
    comment : str
        What it computes; the first lines of its file.
    body : str
        The template of its entry point.
    parts : mapping of str to str
        What the template's ``$name`` stand for.
    libraries : sequence of str
        Names of the libraries that it reads beside those of all passes.
    reads, writes : mapping of str to str
        The chain's image for each image of the shader.
    extent : (str, str)
        Constants that are the numbers of threads across and down.
    """

    name: str
    comment: str
    body: str
    parts: Mapping[str, str] = field(default_factory=dict)
    libraries: Sequence[str] = ()
    reads: Mapping[str, str]
    writes: Mapping[str, str]
    extent: tuple[str, str] = ("width", "height")


@dataclass(frozen=True)
class Chain:
    """Passes in order, with the images and constants that they share."""

    name: str
    comment: str
    images: Sequence[Image]
    constants: Sequence[Constant]
    passes: Sequence[Pass]

    def get_image(self, name: str) -> Image:
        """Return an image by its name."""
        return next(image for image in self.images if image.name == name)

    def list_bindings(self, shader_pass: Pass) -> list[Binding]:
        """Return the images of a pass in the order of their bindings, from 1 on: those that it reads come first."""
        read = [Binding(name, self.get_image(image).comment) for name, image in shader_pass.reads.items()]
        written = [(name, self.get_image(image)) for name, image in shader_pass.writes.items()]
        return [*read, *(Binding(name, image.comment, image.format) for name, image in written)]


HEADERS = {
    "glsl": "#version 450\n#extension GL_EXT_samplerless_texture_functions : require\n\n",
    "hlsl": "",
    "wgsl": "",
}


def write_pass(chain: Chain, shader_pass: Pass, language: str) -> str:
    """Return the file of a pass: a whole program in "hlsl", "glsl" or "wgsl"."""
    body = fill_template(f"shaders/{shader_pass.body}", **shader_pass.parts)
    libraries = [*LIBRARIES, *(f"{name}.shader" for name in shader_pass.libraries)]
    functions = translate_text(gather(libraries, body), language)
    comment = "".join(f"// {line}\n" for line in shader_pass.comment.splitlines())
    first, *lines = body.splitlines()
    assert first == "main {", f"{shader_pass.body} must begin with its entry point"
    # Threads outside the image end at once.
    names = "across", "down", "columns", "rows"
    sizes = dict(zip(names, (*WORKGROUP, *shader_pass.extent), strict=True))
    main = fill_template(f"shaders/entry.{language}", **sizes) + translate_text("\n".join(lines), language)
    bindings = write_bindings(chain.constants, chain.list_bindings(shader_pass), language)
    return f"{HEADERS[language]}{comment}\n{bindings}\n{functions}\n{main}"
