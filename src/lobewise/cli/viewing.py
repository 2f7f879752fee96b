"""The verb `view`."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.common import parse_size
from lobewise.cli.options.reading import Reading
from lobewise.cli.options.spreading import with_groups, with_settings
from lobewise.cli.terminal.help import FILTERING, page_option
from lobewise.cli.terminal.interrupts import hold_interrupts
from lobewise.errors import InputError
from lobewise.scenes import BY_THEMSELVES, list_scenes, require_scene
from lobewise.settings import SIMILARITY_NAMES
from lobewise.viewer.scene_settings import KNOBS, SCENE_SIMILARITIES

if TYPE_CHECKING:
    from lobewise.viewer import FrameViewer, Viewer


@dataclass(frozen=True)
class Page:
    """Options of the page."""

    port: Annotated[int, page_option(metavar="N", min=0, max=65535, help="Port of the page, or the next free one.")] = (
        8080
    )
    host: Annotated[
        str, page_option(metavar="ADDRESS", help="Address of the page; 0.0.0.0 lets other machines in.")
    ] = "127.0.0.1"
    token: Annotated[
        str | None,
        page_option(
            metavar="WORD", envvar="LOBEWISE_TOKEN", help="Secret in the page's URL.", show_default="a random one"
        ),
    ] = None
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Pixels of a scene's picture.", show_default="the scene's")
    ] = None
    fixed_size: Annotated[
        bool, typer.Option("--fixed-size", help="Keep the size and aspect in every window, also in motion.")
    ] = False
    moving_objects: Annotated[
        str | None,
        typer.Option(
            metavar="[FILE.json]",
            help="Objects of a scene move, as the file says, or as showroom and parlour do by themselves.",
            show_default=False,
        ),
    ] = None
    reference: Annotated[
        Path | None,
        page_option(metavar="FILE", help="The image that a frame should be, to compare with.", show_default=False),
    ] = None
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = False


@with_settings(
    KNOBS,
    *("method", "scale", "similarity", "radius", "beta"),
    only_given=True,
    group=FILTERING,
    similarity="ggx",
    radius="2, a frame's 8",
)
@with_groups
def view(
    target: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|FRAME.exr",
            help=f"{', '.join(list_scenes())}, a Mitsuba XML file, or a finished EXR frame.",
            show_default=False,
        ),
    ],
    *,
    settings: dict[str, Any],
    page: Page,
    reading: Reading,
) -> None:
    """Show a scene or a finished frame, of any renderer, in the browser, with every setting as a slider."""
    is_frame = _is_frame(target)
    _refuse_options(is_frame, settings, page, reading)
    _check_settings(is_frame, settings)
    if page.moving_objects is not None:
        _check_motion(target, page.moving_objects)
    # Ctrl-C is the usual end of a page, and it leaves no file half written.
    with suppress(KeyboardInterrupt):
        if is_frame:
            _serve(_open_frame(target, settings, page, reading), target, page)
        else:
            _serve(_open_scene(target, settings, page), target, page)


def _open_scene(target: str, settings: dict[str, Any], page: Page) -> Viewer:
    from lobewise.cli.output import print_note
    from lobewise.viewer import Viewer

    return Viewer(
        target,
        host=page.host,
        port=page.port,
        size=None if page.size is None else parse_size(page.size),
        fixed_size=page.fixed_size,
        changes=settings,
        token=page.token,
        tell=print_note,
        moving=page.moving_objects,
    )


def _open_frame(target: str, settings: dict[str, Any], page: Page, reading: Reading) -> FrameViewer:
    """Read the frame before there is a page, so that a file that cannot be read ends the command."""
    from lobewise.cli.output import print_note
    from lobewise.viewer import FrameReading, FrameViewer

    return FrameViewer(
        target,
        host=page.host,
        port=page.port,
        changes=settings,
        token=page.token,
        tell=print_note,
        reading=FrameReading(**reading.parse(), half=reading.half),
        reference=None if page.reference is None else str(page.reference),
    )


def _refuse_options(is_frame: bool, settings: dict[str, Any], page: Page, reading: Reading) -> None:
    """Raise InputError if an option of scenes is given with a frame, or an option of frames with a scene."""
    of_scenes = [f"--{name}" for name in ("method", "scale") if name in settings]
    of_scenes += ["--size"] * (page.size is not None) + ["--fixed-size"] * page.fixed_size
    of_scenes += ["--moving-objects"] * (page.moving_objects is not None)
    if is_frame and of_scenes:
        raise InputError(of_scenes[0], expected="a scene beside it", got="a finished frame", action="leave it out")
    of_frames = "--reference" if page.reference is not None else next(iter(reading.list_words()), "")
    if of_frames and not is_frame:
        raise InputError(of_frames, expected="a finished frame beside it", got="a scene", action="leave it out")


def _check_motion(target: str, moving: str) -> None:
    """Raise an error before the page is there if nothing can move, or the file with the motion is wrong."""
    from lobewise.render import MovingScene, read_object_paths

    if moving == BY_THEMSELVES:
        MovingScene(target)
    else:
        read_object_paths(moving)


def _check_settings(is_frame: bool, settings: dict[str, Any]) -> None:
    """Raise InputError if a setting is out of range; frames and scenes have different similarities."""
    for name, value in settings.items():
        knob = KNOBS[name]
        if name == "similarity":
            knob = replace(knob, choices=("auto", *SIMILARITY_NAMES) if is_frame else SCENE_SIMILARITIES)
        knob.check(value)


def _serve(viewer: Viewer | FrameViewer, target: str, page: Page) -> None:
    """Serve the page until Ctrl-C, and print its address."""
    from lobewise.cli.output import print_line

    with ExitStack() as started:
        # Let Ctrl-C wait until everything has started, so that everything is stopped.
        with hold_interrupts():
            started.enter_context(viewer)
        reach = "only this machine can reach it" if viewer.is_private else f"other machines can reach it by {page.host}"
        print_line(f"Showing {target} at {viewer.url} ({reach}); Ctrl-C ends it.")
        if page.open_page:
            import webbrowser

            webbrowser.open(viewer.url)
        viewer.wait()


def _is_frame(target: str) -> bool:
    """Return whether the target is an EXR file rather than a scene; raise an error where it is neither."""
    from lobewise.io.files import require_readable

    if Path(target).suffix.lower() == ".exr":
        require_readable(target)
        return True
    require_scene(target)
    return False
