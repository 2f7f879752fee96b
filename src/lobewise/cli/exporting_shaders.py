"""The verb `export` for shaders and for the page in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lobewise.errors import InputError
from lobewise.exporting.names import WEB


def export_page(output: Path, chain: str | None, settings: dict[str, Any], name: str | None, force: bool) -> None:
    """Write the page for browsers. Refuse options that it does not have."""
    from lobewise.cli.output import print_line
    from lobewise.exporting.shaders.web import export_web

    given = {"chain": chain, "name": name, **settings}
    unused = [each for each, value in given.items() if value is not None]
    if unused:
        raise InputError(
            name_option(unused[0]),
            expected="another target beside it",
            got=f"the target {WEB}, whose page has its own settings",
            action="leave one of them out",
        )
    export_web(output, force=force)
    print_line(f"Wrote {output}: open {output / 'index.html'} in a browser with WebGPU.")


def export_shaders(
    output: Path, language: str, chain: str | None, settings: dict[str, Any], name: str | None, force: bool
) -> None:
    """Write shader functions, or the passes of a chain. Refuse options that neither has."""
    from lobewise.cli.output import print_line

    refuse_unused(language, chain, settings, name)
    if chain is None:
        from lobewise.exporting.shaders.functions import export_shader

        export_shader(output, language, force=force)
        print_line(f"Wrote {output}: lobewise.{language}, README.md.")
        return
    from lobewise.exporting.shaders.writing import DESCRIPTION, export_chain

    names = export_chain(output, language, chain, force=force, **settings)
    count = sum(each.endswith(f".{language}") for each in names)
    print_line(f"Wrote {output}: {count} passes, {DESCRIPTION}, README.md, which describes images and constants.")


def print_chain(language: str, chain: str, settings: dict[str, Any], name: str | None) -> None:
    """Print what a chain contains. Refuse options that it does not have."""
    from lobewise.cli.output import print_line
    from lobewise.exporting.shaders.chains import make_chain
    from lobewise.exporting.shaders.listing import list_chain

    refuse_unused(language, chain, settings, name)
    for line in list_chain(make_chain(chain, **settings), language):
        print_line(line)


def refuse_unused(language: str, chain: str | None, settings: dict[str, Any], name: str | None) -> None:
    """Raise an error if there is an option that shader functions, or the passes of a chain, do not have."""
    known = {"form", "similarity"} if chain is not None else set()
    unused = [*(each for each in settings if each not in known), *(["name"] if name is not None else [])]
    if unused:
        has = "whose chains have a form and a similarity, and take the radius as a constant"
        raise InputError(
            name_option(unused[0]),
            expected="a processor or device as target beside it",
            got=f"the shader language {language}, {has if chain is not None else 'whose file has all weights'}",
            action="leave one of them out",
        )


def name_option(setting: str) -> str:
    """Return the option of a setting, as users write it."""
    return "--" + setting.replace("_", "-")
