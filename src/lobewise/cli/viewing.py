"""The verb `view`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from lobewise.cli.options import with_settings
from lobewise.cli.reading import CameraFile, Half, Maps, Preset, Reading
from lobewise.cli.shared import parse_size
from lobewise.cli.terminal.help import FILTERING, PAGE
from lobewise.errors import InputError, require_choice
from lobewise.scenes import list_scenes
from lobewise.viewer.looks import FRAME_SIMILARITIES, KNOBS, SCENE_SIMILARITIES


@with_settings(
    KNOBS,
    *("method", "scale", "similarity", "radius", "beta"),
    only_given=True,
    group=FILTERING,
    similarity="ggx",
    radius="2, a frame's 8",
)
def view(
    target: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|FRAME.exr",
            help=f"{', '.join(list_scenes())}, a Mitsuba XML file, or a finished EXR frame.",
            show_default=False,
        ),
    ],
    settings: dict[str, Any],
    port: Annotated[
        int, typer.Option(metavar="N", min=0, max=65535, help="Of the page; the next free one.", rich_help_panel=PAGE)
    ] = 8080,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Where the page is; 0.0.0.0 lets other machines in.", rich_help_panel=PAGE
        ),
    ] = "127.0.0.1",
    token: Annotated[
        str | None,
        typer.Option(
            metavar="WORD",
            envvar="LOBEWISE_TOKEN",
            help="Secret in the page's URL.",
            show_default="a random one",
            rich_help_panel=PAGE,
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Pixels of a scene's picture.", show_default="the scene's"),
    ] = None,
    fixed_size: Annotated[
        bool,
        typer.Option("--fixed-size", help="Keep that size and its aspect whatever the window, also in motion."),
    ] = False,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = False,
    preset: Preset = None,
    maps: Maps = None,
    camera: CameraFile = None,
    half: Half = None,
) -> None:
    """Show a scene or a finished frame, of any renderer, in the browser, with every setting as a slider."""
    is_frame, reading = _is_frame(target), Reading(preset, maps, camera, half)
    given = [f"--{name}" for name in ("method", "scale") if name in settings]
    given += ["--size"] * (size is not None) + ["--fixed-size"] * fixed_size
    if is_frame and given:
        raise InputError(given[0], expected="a scene beside it", got="a finished frame", action="leave it out")
    if reading.option and not is_frame:
        raise InputError(reading.option, expected="a finished frame beside it", got="a scene", action="leave it out")
    from lobewise.cli.output import print_line, print_note
    from lobewise.viewer import FrameReading, Viewer

    for name, value in settings.items():
        knob = KNOBS[name]
        if name == "similarity":
            knob = replace(knob, choices=FRAME_SIMILARITIES if is_frame else SCENE_SIMILARITIES)
        knob.check(value)
    viewer = Viewer(
        target,
        is_frame=is_frame,
        host=host,
        port=port,
        size=None if size is None else parse_size(size),
        fixed_size=fixed_size,
        changes=settings,
        token=token,
        tell=print_note,
        reading=FrameReading(**reading.parse(), half=half),
    )
    try:
        with viewer:
            if is_frame:
                # A scene takes longer, which its page shows.
                viewer.wait_until_open()
            reach = "only this machine can reach it" if viewer.is_private else f"other machines can reach it by {host}"
            print_line(f"Showing {target} at {viewer.url} ({reach}); Ctrl-C ends it.")
            if open_page:
                import webbrowser

                webbrowser.open(viewer.url)
            viewer.wait()
    except KeyboardInterrupt:
        # The usual end of a page, and nothing was written that could be half done.
        return


def _is_frame(target: str) -> bool:
    """Return whether the target is an EXR file, and not a scene; raise where it cannot be either."""
    from lobewise.io.files import require_readable

    path = Path(target)
    if target in list_scenes():
        return False
    if path.suffix.lower() == ".exr":
        require_readable(path)
        return True
    if path.suffix.lower() != ".xml" and path.name == target and not path.exists():
        require_choice("scene", target, list_scenes())
    require_readable(path, what="scene")
    return False
