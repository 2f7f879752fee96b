"""The summary of a file: how denoising will treat it, what is missing, and the command to type next."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from itertools import takewhile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from lobewise.cli.output import make_text, open_console
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


def print_summary(found: FileDescription, method: str, options: Sequence[str]) -> None:
    """Print how denoising will treat a file.

    Parameters
    ----------
    found : FileDescription
        The file.
    method : str
        How `denoise` will make the image, a sentence without a full stop; empty for a file that it refuses.
    options : sequence of str
        Options that the user gave to `inspect` and that `denoise` takes as well, as words of a command line.
    """
    console = open_console()
    console.print(make_text(_describe_origin(found), style="bold"), soft_wrap=True)
    console.print(make_text(f"Expected quality: {describe_quality(found)}"))
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True, style="bold")
    grid.add_column(overflow="fold")
    told = {found.alone, *found.unusable, *found.refusals, *(lack.told for lack in found.lacks)}
    rows: list[tuple[str, Sequence[str]]] = [
        ("Denoised", [f"by {method}"] if method else []),
        ("Compared", [_describe_surfaces(found)] if found.outputs or found.roles else []),
        ("Light", list(_describe_light(found))),
        ("Unusable", found.unusable),
        # For a file with nothing but an image, the line of the expected quality says what to switch on.
        ("Missing", [] if found.alone else [_describe_lack(lack) for lack in found.lacks]),
        ("Noted", _shorten([note for note in found.notes if note not in told])),
        ("Result", [_describe_result(found)] if found.outputs else []),
    ]
    if found.refusals:
        # A refused file is not denoised at all.
        rows = [("Refused", found.refusals), ("Unusable", found.unusable)]
    for label, texts in rows:
        for number, text in enumerate(texts):
            grid.add_row(make_text("" if number else label), make_text(text))
    console.print(grid)
    _print_commands(console, found, options)


def describe_quality(found: FileDescription) -> str:
    """Return which quality to expect of a file, and why, in a sentence."""
    lacks = [lack.role for lack in found.lacks]
    if not _can_be_denoised(found):
        return f"none. {_say_obstacle(found)}"
    if found.alone:
        return f"weak. {found.alone}"
    if not lacks:
        return "best. The light is split, and normals, positions, roughness and colors tell surfaces apart."
    if "normal" in lacks and "camera" in lacks:
        return "weak. Only the picture itself tells surfaces apart: switch on what is missing, normals first."
    if "normal" in lacks or "albedo" in lacks:
        first = NAMES["normal" if "normal" in lacks else "albedo"]
        return f"fair. It would be good with {first}."
    return f"good. It would be best with {list_names([NAMES[role] for role in lacks])}."


def _can_be_denoised(found: FileDescription) -> bool:
    return bool(found.outputs) and not found.refusals


def _say_obstacle(found: FileDescription) -> str:
    if found.refusals:
        return "The file is refused: see below."
    return "There is no image that could be denoised."


def _describe_origin(found: FileDescription) -> str:
    """Return renderer, size in pixels, samples per pixel and size of the file."""
    titles = {"lobewise": "lobewise's own names", "an unknown renderer": "unknown renderer"}
    renderer = titles.get(found.preset, found.preset)
    if found.version:
        renderer += f" ({found.version})"
    told = [renderer]
    if found.parts:
        window = found.parts[found.image_part or 0].data_window
        told.append(f"{window.width}x{window.height} pixels")
    told.append(f"{found.spp} sample{'s' if found.spp > 1 else ''} per pixel" if found.spp else "samples unknown")
    size = found.bytes / 1e6
    told.append(f"{size:.1f} MB" if size >= 0.1 else f"{found.bytes / 1e3:.1f} kB")
    return f"{found.path}: {', '.join(told)}"


def _describe_surfaces(found: FileDescription) -> str:
    """Return the properties of surfaces that the filter compares."""
    known = [text for use, text in SURFACES.items() if use in found.uses]
    return list_names(known) if known else "the picture alone"


def _describe_light(found: FileDescription) -> Iterator[str]:
    """Yield how layers, textures and noise of the light are treated."""
    if "layers" in found.uses and found.layers:
        told = f"{list_names(found.layers)} {'is' if len(found.layers) == 1 else 'are each'} filtered by itself"
        if found.exact:
            told += f"; {list_names(found.exact)} {'stays as it is' if len(found.exact) == 1 else 'stay as they are'}"
            told += ", but for dots of lights out of focus" if "silhouettes" in found.uses else ""
        yield told
    if "albedo" in found.uses:
        yield "textures are taken out by the surface colors, so they stay sharp"
    if "halves" in found.uses:
        yield "the noise is known from two halves of the samples"


def _shorten(notes: Sequence[str]) -> list[str]:
    left = len(notes) - MAX_NOTES
    return [*notes[:MAX_NOTES], *([f"{left} more with --all."] if left > 0 else [])]


def _describe_lack(lack: Lack) -> str:
    """Return the effect of a lack, and how to have the renderer write what is missing."""
    told = f"{NAMES[lack.role]}: {COSTS[lack.role]}"
    if lack.remedy:
        return f"{told}. To have it: {lack.remedy}"
    return f"{told} ({lack.reason})" if lack.reason else told


def _describe_result(found: FileDescription) -> str:
    """Return the passes that hold the result, and the passes that are only copied."""
    layer = _find_view_layer(found)
    first, *others = found.outputs
    told = first.rpartition(".")[0].removeprefix(layer) or first
    told += f" and {len(others)} more passes of light" if others else ""
    copied = [name.removeprefix(layer) for name in list_copied(found)]
    if not copied:
        return f"into {told}, in a copy of the file"
    names = ", ".join(copied[:MAX_NAMED_PASSES]) + (", ..." if len(copied) > MAX_NAMED_PASSES else "")
    return f"into {told}, in a copy of the file; not used, and copied as they are: {names}"


def list_copied(found: FileDescription) -> list[str]:
    """Return the passes that are not used, without the numbers of Cryptomatte's ranks."""
    used: dict[str, bool] = {}
    for part in found.parts:
        for channel in part.channels:
            name = _name_pass(part, channel)
            used[name] = used.get(name, False) or bool(channel.used_as)
    targets = {label.rpartition(".")[0] for label in found.outputs}
    unused = [name.rstrip("0123456789") for name, is_used in used.items() if not is_used and name not in targets]
    return list(dict.fromkeys(unused))


def _name_pass(part: PartDescription, channel: ChannelDescription) -> str:
    return channel.name.rpartition(".")[0] or part.name or channel.name


def _find_view_layer(found: FileDescription) -> str:
    """Return the common beginning of the names of all passes, such as ``ViewLayer.``; empty where there is none."""
    heads = [_name_pass(part, channel).split(".")[:-1] for part in found.parts for channel in part.channels]
    shared = takewhile(lambda words: len(set(words)) == 1, zip(*heads, strict=False))
    return "".join(f"{words[0]}." for words in shared)


def _print_commands(console: Console, found: FileDescription, options: Sequence[str]) -> None:
    """Print the commands to type next, each on one line, to be copied."""
    path = Path(found.path)
    again = ["lobewise", "inspect", found.path, *options, "--all"]
    console.print()
    if found.outputs and _can_be_denoised(found):
        clean = str(path.with_name(f"{path.stem}_clean{path.suffix}"))
        console.print(
            make_text("Denoise it:         " + shlex.join(["lobewise", "denoise", found.path, "-o", clean, *options])),
            soft_wrap=True,
        )
    console.print(make_text("See every channel:  " + shlex.join(again)), soft_wrap=True)
