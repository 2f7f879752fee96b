"""The weights as shader functions: one text, `weights.shader`, is translated into three languages."""

from __future__ import annotations

import json

import lobewise
from lobewise.errors import require_choice
from lobewise.exporting.folder import DOCS, MARK, write_folder
from lobewise.exporting.names import SHADER_LANGUAGES
from lobewise.exporting.shaders.declarations import list_constants, read_template
from lobewise.exporting.shaders.language import translate_text
from lobewise.io.files import PathLike


def make_shader(language: str) -> str:
    """Return the functions in "hlsl", "glsl" or "wgsl".

    Raises InputError if there is no such language.
    """
    require_choice("shader language", language, SHADER_LANGUAGES)
    return translate_text(read_template("weights.shader", list_constants()), language)


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
        "README.md": read_template("functions_readme.md", parts),
        MARK: json.dumps({"lobewise": version, "target": language}) + "\n",
    }
    write_folder(output, texts, force=force)
