"""The summary of a file: how denoising will treat it, what is missing, and the command to type next."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from itertools import takewhile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from lobewise.cli.options.naming import name_clean
from lobewise.cli.terminal.tables import make_text, open_console
from lobewise.interchange.checks.finding import list_names
from lobewise.io import FileDescription
from lobewise.io.exr.describe import ChannelDescription, Lack, PartDescription

MAX_NOTES = 6
"""Most notes in the summary; `inspect --all` prints all of them."""
MAX_NAMED_PASSES = 6
"""Most names of passes that are only copied; `inspect --all` prints all of them."""
SURFACES = {"normal": "which way surfaces face", "camera": "where they are", "roughness": "how rough they are"}
NAMES = {
    "normal": "normals",
    "roughness": "roughness",
    "camera": "positions",
    "layers": "split light",
    "albedo": "surface colors",
}
"""Names, as in the menus of renderers, of the images and facts that a frame can lack."""
COSTS = {
    "normal": "edges and bumps must be guessed from the picture",
    "roughness": "mirrors and rough surfaces are treated alike",
    "camera": "places and reflections cannot be compared",
    "layers": "diffuse light and reflections are filtered together, which blurs reflections",
    "albedo": "textures are blurred with the noise",
}
"""Visible effect of each lack."""


def print_summary(description: FileDescription, method: str, options: Sequence[str]) -> None:
    """Print how denoising will treat a file.

    Parameters
    ----------
    description : FileDescription
        The file.
    method : str
        How `denoise` will make the image, a sentence without a full stop; empty for a file that it refuses.
    options : sequence of str
        Options that the user gave to `inspect` and that `denoise` takes as well, as words of a command line.
    """
    console = open_console()
    console.print(make_text(_describe_origin(description), style="bold"), soft_wrap=True)
    console.print(make_text(f"Expected quality: {describe_quality(description)}"))
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True, style="bold")
    grid.add_column(overflow="fold")
    said = {description.alone, *description.unusable, *description.refusals, *(lack.told for lack in description.lacks)}
    rows: list[tuple[str, Sequence[str]]] = [
        ("Denoised", [f"by {method}"] if method else []),
        ("Compared", [_describe_surfaces(description)] if description.outputs or description.roles else []),
        ("Light", list(_describe_light(description))),
        ("Unusable", description.unusable),
        # For a file with nothing but an image, the line of the expected quality says what to switch on.
        ("Missing", [] if description.alone else [_describe_lack(lack) for lack in description.lacks]),
        ("Noted", _shorten([note for note in description.notes if note not in said])),
        ("Result", [_describe_result(description)] if description.outputs else []),
    ]
    if description.refusals:
        # A refused file is not denoised at all.
        rows = [("Refused", description.refusals), ("Unusable", description.unusable)]
    for label, texts in rows:
        for number, text in enumerate(texts):
            grid.add_row(make_text("" if number else label), make_text(text))
    console.print(grid)
    _print_commands(console, description, options)


def describe_quality(description: FileDescription) -> str:
    """Return which quality to expect of a file, and why, in a sentence."""
    lacks = [lack.role for lack in description.lacks]
    if not description.can_be_denoised:
        return f"none. {_say_obstacle(description)}"
    if description.alone:
        return f"weak. {description.alone}"
    if not lacks:
        return "best. The light is split, and normals, positions, roughness and colors tell surfaces apart."
    if "normal" in lacks and "camera" in lacks:
        return "weak. Only the picture itself tells surfaces apart: switch on what is missing, normals first."
    if "normal" in lacks or "albedo" in lacks:
        first = NAMES["normal" if "normal" in lacks else "albedo"]
        return f"fair. It would be good with {first}."
    return f"good. It would be best with {list_names([NAMES[role] for role in lacks])}."


def _say_obstacle(description: FileDescription) -> str:
    if description.refusals:
        return "The file is refused: see below."
    return "There is no image that could be denoised."


def _describe_origin(description: FileDescription) -> str:
    """Return renderer, size in pixels, samples per pixel and size of the file."""
    titles = {"lobewise": "lobewise's own names", "an unknown renderer": "unknown renderer"}
    renderer = titles.get(description.preset, description.preset)
    if description.version:
        renderer += f" ({description.version})"
    facts = [renderer]
    if description.parts:
        window = description.parts[description.image_part or 0].data_window
        facts.append(f"{window.width}x{window.height} pixels")
    facts.append(
        f"{description.spp} sample{'s' if description.spp > 1 else ''} per pixel"
        if description.spp
        else "samples unknown"
    )
    size = description.bytes / 1e6
    facts.append(f"{size:.1f} MB" if size >= 0.1 else f"{description.bytes / 1e3:.1f} kB")
    return f"{description.path}: {', '.join(facts)}"


def _describe_surfaces(description: FileDescription) -> str:
    """Return the properties of surfaces that the filter compares."""
    known = [text for use, text in SURFACES.items() if use in description.uses]
    return list_names(known) if known else "the picture alone"


def _describe_light(description: FileDescription) -> Iterator[str]:
    """Yield how layers, textures and noise of the light are treated."""
    if "layers" in description.uses and description.layers:
        verb = "is" if len(description.layers) == 1 else "are each"
        sentence = f"{list_names(description.layers)} {verb} filtered by itself"
        if description.exact:
            stay = "stays as it is" if len(description.exact) == 1 else "stay as they are"
            sentence += f"; {list_names(description.exact)} {stay}, but at the edges of lamps and out of focus"
        yield sentence
    if "albedo" in description.uses:
        yield "textures are taken out by the surface colors, so they stay sharp"
    if "halves" in description.uses:
        yield "the noise is known from two halves of the samples"


def _shorten(notes: Sequence[str]) -> list[str]:
    left = len(notes) - MAX_NOTES
    return [*notes[:MAX_NOTES], *([f"{left} more with --all."] if left > 0 else [])]


def _describe_lack(lack: Lack) -> str:
    """Return the effect of a lack, and how to have the renderer write what is missing."""
    sentence = f"{NAMES[lack.role]}: {COSTS[lack.role]}"
    if lack.remedy:
        return f"{sentence}. To have it: {lack.remedy}"
    return f"{sentence} ({lack.reason})" if lack.reason else sentence


def _describe_result(description: FileDescription) -> str:
    """Return the passes that hold the result, and the passes that are only copied."""
    layer = _name_view_layer(description)
    first, *others = description.outputs
    pass_name = first.rpartition(".")[0].removeprefix(layer) or first
    pass_name += f" and {len(others)} more passes of light" if others else ""
    copied = [name.removeprefix(layer) for name in list_copied(description)]
    if not copied:
        return f"into {pass_name}, in a copy of the file"
    names = ", ".join(copied[:MAX_NAMED_PASSES]) + (", ..." if len(copied) > MAX_NAMED_PASSES else "")
    return f"into {pass_name}, in a copy of the file; not used, and copied as they are: {names}"


def list_copied(description: FileDescription) -> list[str]:
    """Return the passes that are not used, without the numbers of Cryptomatte's ranks."""
    used: dict[str, bool] = {}
    for part in description.parts:
        for channel in part.channels:
            name = _name_pass(part, channel)
            used[name] = used.get(name, False) or bool(channel.used_as)
    targets = {label.rpartition(".")[0] for label in description.outputs}
    unused = [name.rstrip("0123456789") for name, is_used in used.items() if not is_used and name not in targets]
    return list(dict.fromkeys(unused))


def _name_pass(part: PartDescription, channel: ChannelDescription) -> str:
    return channel.name.rpartition(".")[0] or part.name or channel.name


def _name_view_layer(description: FileDescription) -> str:
    """Return the common beginning of the names of all passes, such as ``ViewLayer.``; empty where there is none."""
    heads = [_name_pass(part, channel).split(".")[:-1] for part in description.parts for channel in part.channels]
    shared = takewhile(lambda words: len(set(words)) == 1, zip(*heads, strict=False))
    return "".join(f"{words[0]}." for words in shared)


def _print_commands(console: Console, description: FileDescription, options: Sequence[str]) -> None:
    """Print the commands to type next, each on one line, to be copied."""
    path = Path(description.path)
    again = ["lobewise", "inspect", description.path, *options, "--all"]
    console.print()
    if description.can_be_denoised:
        clean = str(name_clean(path))
        console.print(
            make_text(
                "Denoise it:         " + shlex.join(["lobewise", "denoise", description.path, "-o", clean, *options])
            ),
            soft_wrap=True,
        )
    console.print(make_text("See every channel:  " + shlex.join(again)), soft_wrap=True)
