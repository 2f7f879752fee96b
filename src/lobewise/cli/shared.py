"""What several verbs share: arguments and options, words that stand for numbers, the progress bar."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.terminal.help import RESULT, SEQUENCE_DETAILS, SEQUENCES, SHADING
from lobewise.cli.terminal.steps import Steps
from lobewise.errors import InputError
from lobewise.settings import TemporalSettings, list_knobs

if TYPE_CHECKING:
    from lobewise.frame import Result
    from lobewise.reporting.picture import Pictures
    from lobewise.sparse_frame import AnyFrame

Input = Annotated[Path, typer.Argument(metavar="INPUT.exr", help="The EXR file to read.", show_default=False)]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The file to write.", show_default=False)]
Overwrite = Annotated[
    bool,
    typer.Option("--overwrite", help="Let the output replace a file that is read.", rich_help_panel=RESULT),
]

Source = Annotated[
    Path,
    typer.Argument(metavar="INPUT.exr", help="The EXR file to read; in.####.exr for a sequence.", show_default=False),
]
Verbose = Annotated[bool, typer.Option("--verbose", help="Say with which settings of the filter it was done.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Do not show what is done just now.")]
Png = Annotated[
    bool,
    typer.Option(
        "--png",
        help="Write a picture as well, of the same name with the ending .png: tone mapped, for any program. A sequence "
        "has one exposure, that of its first frame.",
        rich_help_panel=RESULT,
    ),
]
Exposure = Annotated[
    float | None,
    typer.Option(
        "--exposure",
        metavar="STOPS",
        help="With --png: multiply the light by 2^STOPS.",
        show_default="by the picture",
        rich_help_panel=RESULT,
    ),
]
MAX_STOPS = 64.0
Adaptive = Annotated[
    str,
    typer.Option(
        metavar="PERCENT",
        help="Shade so many pixels again, the least supported; needs --scene.",
        rich_help_panel=SHADING,
    ),
]
Scene = Annotated[
    str | None,
    typer.Option(
        metavar="SCENE", help="With --adaptive: what was rendered.", show_default=False, rich_help_panel=SHADING
    ),
]
AdaptiveSpp = Annotated[
    int, typer.Option(metavar="N", help="With --adaptive: samples of each pixel.", rich_help_panel=SHADING)
]
Light = Annotated[
    str,
    typer.Option(metavar="all|indirect", help="With --adaptive: the light that was rendered.", rich_help_panel=SHADING),
]
Temporal = Annotated[
    bool,
    typer.Option(
        "--temporal",
        help="With a sequence: let every frame know the ones before (quality fast).",
        rich_help_panel=SEQUENCES,
    ),
]
Memory = Annotated[
    float,
    typer.Option(
        metavar="0-1",
        help=f"With --temporal: {list_knobs(TemporalSettings)['memory'].hint}",
        rich_help_panel=SEQUENCE_DETAILS,
    ),
]


@contextmanager
def show_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on standard error for work that reports (what, done, total)."""
    with Steps() as steps:
        yield steps.tell


def plan_pictures(png: bool, stops: float | None, first: Path) -> Pictures | None:
    """Return what writes pictures beside EXR files, the first of which is ``first``; None where none are asked for.

    Raises
    ------
    InputError
        If an exposure is given without a picture, or is out of range.
    FileError
        If the first picture cannot be written.
    """
    if not png:
        if stops is not None:
            raise InputError("--exposure", expected="--png beside it", got="none", action="add --png")
        return None
    # Written so that NaN fails.
    if stops is not None and not -MAX_STOPS <= stops <= MAX_STOPS:
        raise InputError(
            "--exposure", expected=f"a number from {-MAX_STOPS:g} to {MAX_STOPS:g}", got=f"{stops:g}", action="try 0"
        )
    from lobewise.io.files import require_writable
    from lobewise.reporting.picture import Pictures, name_picture

    require_writable(name_picture(first), what="picture")
    return Pictures(stops=stops, first=first)


def list_files(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield every path that is a file's, and of every pattern the files that exist."""
    from lobewise.io.sequence import FramePattern, is_pattern

    for path in paths:
        if is_pattern(path):
            yield from (found for _, found in FramePattern.parse(path).find())
        else:
            yield path


def protect_inputs(
    source: Path, output: Path, others: Iterable[Path | str | None], *, overwrite: bool, png: bool = False
) -> None:
    """Raise InputError where a result would replace a file that is read: an input, or one of its passes beside it.

    Parameters
    ----------
    source, output : Path
        A file each, or a pattern each.
    others : iterable of path or None
        What is read besides, files or patterns.
    overwrite : bool
        Whether that is wanted, which it can be of files alone: a sequence that was stopped halfway would begin again
        with frames that are denoised already.
    png : bool
        Whether a picture is written beside each result, which never replaces a file that is read.
    """
    from lobewise.interchange.siblings import list_family
    from lobewise.io.files import require_other_files
    from lobewise.io.sequence import FramePattern, is_pattern

    if is_pattern(source) and overwrite:
        raise InputError(
            "--overwrite",
            expected="a single file",
            got=f"the sequence {str(source)!r}, which could not go on after a stop",
            action="write to other names",
        )
    besides = list_files(Path(path) for path in others if path is not None)
    if is_pattern(source):
        frames = FramePattern.parse(source).find()
        pattern = FramePattern.parse(output)
        outputs, inputs = [pattern.name(number) for number, _ in frames], [*(path for _, path in frames), *besides]
        action = "choose another name"
    else:
        outputs, inputs = [output], [*list_family(source), *besides]
        action = "choose another name, or add --overwrite to replace it"
    if not overwrite:
        require_other_files(outputs, inputs, action=action)
    if png:
        protect_from_pictures(outputs, inputs)


def protect_from_pictures(outputs: Iterable[Path], inputs: Iterable[Path | str]) -> None:
    """Raise InputError where the picture beside an output would replace a file that is read."""
    from lobewise.io.files import require_other_files
    from lobewise.reporting.picture import name_picture

    require_other_files(map(name_picture, outputs), inputs, what="picture", action="choose another name for -o")


def parse_place(text: str) -> tuple[int, int]:
    """Return row and column of ``ROW,COLUMN``."""
    words = text.split(",")
    if len(words) == 2 and all(word.strip().isdecimal() for word in words):
        return int(words[0]), int(words[1])
    raise InputError("--place", expected="ROW,COLUMN, such as 1,2", got=repr(text), action="write two numbers")


def parse_size(text: str) -> tuple[int, int]:
    """Return columns and rows of ``WxH``.

    Raises
    ------
    InputError
        If it is none, or out of 8 to 8192.
    """
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip().lower())
    if found and min(map(int, found.groups())) >= 8 and max(map(int, found.groups())) <= 8192:
        return int(found[1]), int(found[2])
    raise InputError(
        "--size",
        expected="columns x rows from 8 to 8192, such as 512x512",
        got=repr(text),
        action="write two numbers",
    )


def find_first(source: Path, output: Path) -> Path:
    """Return the first file that is written: the output itself, or of a sequence that with the first number."""
    from lobewise.io.sequence import FramePattern, is_pattern

    if not is_pattern(source) or not is_pattern(output):
        return output
    return FramePattern.parse(output).name(FramePattern.parse(source).find()[0][0])


def make_recomputing(scene: str | None, adaptive: str, spp: int, light: str) -> Callable[[Result, AnyFrame], Result]:
    """Return what shades the least supported pixels of a result again; the scene is loaded when it is first needed."""
    budget = parse_percent(adaptive)
    if budget == 0.0:
        return lambda result, frame: result
    if scene is None:
        raise InputError("--adaptive", expected="--scene beside it", got="none", action="say what was rendered")
    loaded: list[Any] = []

    def improve(result: Result, frame: AnyFrame) -> Result:
        from lobewise.adaptive import recompute
        from lobewise.cli.output import print_line
        from lobewise.render import load_scene, render_pixels, set_camera

        if not loaded:
            loaded.append(load_scene(scene, width=frame.width, height=frame.height))
        if frame.camera is not None:
            set_camera(loaded[0], frame.camera)
        better = recompute(
            result,
            lambda rows, columns: render_pixels(loaded[0], rows, columns, spp=spp, seed=1, light=light),
            samples=spp / (frame.spp or 1),
            frame=frame,
            budget=budget,
        )
        print_line(f"Shaded {better.settings['recomputed']} pixels again, {spp} spp.")
        return better

    return improve


def parse_percent(text: str) -> float:
    """Return the share that ``5%`` or ``5`` stands for."""
    try:
        percent = float(text.removesuffix("%"))
    except ValueError:
        percent = -1.0
    if 0.0 <= percent <= 100.0:
        return percent / 100.0
    raise InputError("--adaptive", expected="0% to 100%", got=repr(text), action="5% is usual")
