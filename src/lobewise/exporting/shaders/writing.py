"""Write folders of shader text: functions that compare pixels, or the passes of a chain with ``chain.json``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import lobewise
from lobewise.errors import require_choice
from lobewise.exporting.folder import DOCS, MARK, fill_template, write_folder
from lobewise.exporting.names import SHADER_LANGUAGES
from lobewise.exporting.shaders.chains import make_chain
from lobewise.exporting.shaders.declarations import list_constants
from lobewise.exporting.shaders.language import lay_out, translate_text
from lobewise.exporting.shaders.passes import WORKGROUP, Chain, Image, Lifetime, Pass, write_pass
from lobewise.io.files import PathLike

BYTES = {"rgba32float": 16, "rgba16float": 8}
"""Bytes of a pixel, by format."""


def count_bytes(chain: Chain) -> tuple[int, int]:
    """Return the bytes of each pixel that images take within a frame, at most at once, and from frame to frame.

    Images of lifetime "frame" may share memory once no later pass reads them. Samples count as pixels.
    """
    state = [image for image in chain.images if image.lifetime in (Lifetime.KEPT, Lifetime.BEFORE)]
    last_reader = {
        image: number for number, shader_pass in enumerate(chain.passes) for image in shader_pass.reads.values()
    }
    alive: set[str] = set()
    most = 0
    for number, shader_pass in enumerate(chain.passes):
        written = [chain.get_image(name) for name in shader_pass.writes.values()]
        alive |= {image.name for image in written if image.lifetime is Lifetime.FRAME}
        most = max(most, sum(BYTES[chain.get_image(name).format] for name in alive))
        alive = {name for name in alive if last_reader.get(name, -1) > number}
    return most, sum(BYTES[image.format] for image in state)


def list_chain(chain: Chain, language: str) -> Iterator[str]:
    """Yield lines that say what a chain contains."""
    yield f"lobewise chain {chain.name} in {language}. {chain.comment}"
    for title, lifetime in (("Inputs", Lifetime.GIVEN), ("Results", Lifetime.RESULT)):
        yield f"{title}:"
        for image in chain.images:
            if image.lifetime is lifetime:
                yield f"  {image.name}: {image.extent[0]} x {image.extent[1]}, {image.comment}"
    within, between = count_bytes(chain)
    memory = f"{within} bytes for each pixel within a frame, {between} from frame to frame"
    yield f"Memory: {memory}, beside inputs and result."
    yield f"Passes: {len(chain.passes)}."
    for number, shader_pass in enumerate(chain.passes, 1):
        reads, writes = (
            ", ".join(dict.fromkeys(images.values())) for images in (shader_pass.reads, shader_pass.writes)
        )
        yield f"{number}. {shader_pass.name}: {reads} -> {writes}"


def make_shader(language: str) -> str:
    """Return the functions in "hlsl", "glsl" or "wgsl".

    Raises InputError if there is no such language.
    """
    require_choice("shader language", language, SHADER_LANGUAGES)
    return translate_text(fill_template("shaders/weights.shader", **list_constants()), language)


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
    version = lobewise.__version__
    parts = {"title": language.upper(), "language": language, "version": version, "docs": DOCS}
    texts = {
        f"lobewise.{language}": make_shader(language),
        "README.md": fill_template("shaders/functions_readme.md", **parts),
        MARK: json.dumps({"lobewise": version, "target": language}) + "\n",
    }
    write_folder(output, texts, force=force)


DESCRIPTION = "chain.json"
"""The file that describes a chain to programs."""


def name_file(number: int, shader_pass: Pass, language: str) -> str:
    """Return the name of a pass's file; numbers count from 1."""
    return f"{number:02d}_{shader_pass.name}.{language}"


def describe_chain(chain: Chain, language: str) -> dict[str, Any]:
    """Return the contents of ``chain.json``."""
    offsets = lay_out(chain.constants)
    constants = [
        {"name": one.name, "type": one.kind, "offset": offsets[one.name], "meaning": one.comment, "python": one.python}
        for one in chain.constants
    ]
    return {
        "lobewise": lobewise.__version__,
        "target": language,
        "chain": chain.name,
        "meaning": chain.comment,
        "constants": {"binding": 0, "bytes": offsets[""], "fields": constants},
        "images": [_describe_image(image) for image in chain.images],
        "passes": [
            _describe_pass(chain, number, shader_pass, language) for number, shader_pass in enumerate(chain.passes, 1)
        ],
    }


def _describe_image(image: Image) -> dict[str, Any]:
    description: dict[str, Any] = {"name": image.name, "format": image.format, "lifetime": image.lifetime.value}
    description |= {"width": image.extent[0], "height": image.extent[1], "meaning": image.comment}
    return {**description, "before": image.before} if image.before else description


def _describe_pass(chain: Chain, number: int, shader_pass: Pass, language: str) -> dict[str, Any]:
    images = {**shader_pass.reads, **shader_pass.writes}
    return {
        "name": shader_pass.name,
        "file": name_file(number, shader_pass, language),
        "entry": "main",
        "meaning": shader_pass.comment.splitlines()[0],
        "workgroup": [*WORKGROUP, 1],
        "dispatch": [
            *(f"ceil({side} / {count})" for side, count in zip(shader_pass.extent, WORKGROUP, strict=True)),
            "1",
        ],
        "bindings": [
            {
                "binding": place,
                "name": binding.name,
                "image": images[binding.name],
                "access": "read" if binding.format is None else "write",
            }
            for place, binding in enumerate(chain.list_bindings(shader_pass), 1)
        ],
    }


def write_readme(chain: Chain, language: str) -> str:
    """Return the README of a chain: the tables of its description."""
    description = describe_chain(chain, language)
    images = [
        "| `{name}` | {lifetime} | {format} | {width} x {height} | {meaning} |".format(**image)
        for image in description["images"]
    ]
    constants = [
        "| {offset} | `{name}` | {type} | {meaning} | {python} |".format(**field)
        for field in description["constants"]["fields"]
    ]
    passes = []
    for each in description["passes"]:
        bindings = ", ".join(
            f"{bound['binding']} `{bound['name']}`"
            + ("" if bound["name"] == bound["image"] else f" = `{bound['image']}`")
            for bound in each["bindings"]
        )
        groups = ", ".join(each["dispatch"][:2])
        passes.append(f"| `{each['file']}` | {each['meaning']} | {groups} | {bindings} |")
    within, stays = count_bytes(chain)
    state = ", ".join(f"`{image.before}`" for image in chain.images if image.before)
    return fill_template(
        "shaders/chain_readme.md",
        name=chain.name,
        title=language.upper(),
        meaning=chain.comment,
        images="\n".join(images),
        constants="\n".join(constants),
        bytes=description["constants"]["bytes"],
        within=within,
        kept=stays,
        passes="\n".join(passes),
        binding=fill_template(f"shaders/bindings_{language}.md").strip(),
        swap=fill_template("shaders/swap.md", names=state) if state else "",
        version=lobewise.__version__,
        docs=DOCS,
    )


def export_chain(
    output: PathLike,
    language: str,
    chain: str,
    *,
    form: str | None = None,
    similarity: str = "ggx",
    force: bool = False,
) -> list[str]:
    """Write a folder with the compute passes of a chain, and return the names of its files.

    Parameters
    ----------
    output : path
        The folder, new or empty.
    language : {"hlsl", "glsl", "wgsl"}
    chain : str
        A name in `lobewise.exporting.names.CHAINS`.
    form : {"full", "separable", "atrous"}, optional
        Which neighbours the filter sums over; by default a row and then a column. "upsample" has "full" alone.
    similarity : {"ggx", "sg"}
        How specular lobes are compared; "sg" needs one image less.
    force : bool
        Replace an earlier export and everything in its folder.

    Raises
    ------
    InputError
        If there is no such language, chain or form.
    FileError
        If the folder is not empty or cannot be written.
    """
    require_choice("shader language", language, SHADER_LANGUAGES)
    made = make_chain(chain, form=form, similarity=similarity)
    description = describe_chain(made, language)
    texts = {
        name_file(number, shader_pass, language): write_pass(made, shader_pass, language)
        for number, shader_pass in enumerate(made.passes, 1)
    }
    texts[DESCRIPTION] = json.dumps(description, indent=2) + "\n"
    texts["README.md"] = write_readme(made, language)
    texts[MARK] = json.dumps({"lobewise": lobewise.__version__, "target": language, "chain": chain}) + "\n"
    write_folder(output, texts, force=force)
    return list(texts)
