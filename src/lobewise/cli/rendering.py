"""The verb `render`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.shared import Exposure, Output, Png, parse_place, plan_pictures, protect_from_pictures, show_progress
from lobewise.cli.terminal.help import RESULT, SCENE_DETAILS, SEQUENCES
from lobewise.cli.terminal.outcome import tell_picture
from lobewise.errors import InputError, require_choice
from lobewise.scenes import list_scenes

if TYPE_CHECKING:
    from lobewise.camera import Camera

CAMERA_PATHS = ("orbit", "still")

Scene = Annotated[
    str,
    typer.Argument(metavar="SCENE", help=f"{', '.join(list_scenes())}, or a Mitsuba XML file.", show_default=False),
]
Place = Annotated[
    str | None,
    typer.Option(
        metavar="ROW,COLUMN",
        help="With --scale: which pixel of the block.",
        show_default="0,0",
        rich_help_panel=SCENE_DETAILS,
    ),
]
Scale = Annotated[
    int,
    typer.Option(
        metavar="N",
        help="Shade one pixel of every NxN; guides everywhere, for upsample.",
        rich_help_panel=SCENE_DETAILS,
    ),
]
Frames = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=1,
        help="Render so many frames, to -o out.####.exr.",
        show_default=False,
        rich_help_panel=SEQUENCES,
    ),
]
CameraPath = Annotated[
    str | None,
    typer.Option(
        metavar="orbit|still|FILE.json",
        help="With --frames: where the camera goes.",
        show_default="orbit",
        rich_help_panel=SEQUENCES,
    ),
]
Speed = Annotated[
    float | None,
    typer.Option(
        metavar="DEGREES", help="Of an orbit, from frame to frame.", show_default="0.25", rich_help_panel=SEQUENCES
    ),
]
Start = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=1,
        help="With --frames: first frame of the path to render.",
        show_default="1",
        rich_help_panel=SEQUENCES,
    ),
]
MovingObjects = Annotated[
    bool,
    typer.Option(
        "--moving-objects",
        help="With --frames: objects move too; showroom and parlour have some.",
        rich_help_panel=SEQUENCES,
    ),
]
Light = Annotated[str, typer.Option(metavar="all|indirect", help="indirect: only what was scattered more than once.")]
Integrator = Annotated[
    str,
    typer.Option(
        metavar="auto|paths|scene",
        help="Whose light; auto: the scene's integrator, by paths where they equal it.",
        rich_help_panel=SCENE_DETAILS,
    ),
]
MaxDepth = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Longest path, in vertices after the camera.",
        show_default="the scene's, or 8 without any",
        rich_help_panel=SCENE_DETAILS,
    ),
]
Define = Annotated[
    list[str] | None,
    typer.Option("--define", "-D", metavar="NAME=VALUE", help="What stands for $NAME in a Mitsuba XML file."),
]
AovOnly = Annotated[
    bool, typer.Option("--aov-only", help="Only the G-buffer; the radiance is black.", rich_help_panel=RESULT)
]
Reference = Annotated[
    bool, typer.Option("--reference", help="Only the radiance, for many samples.", rich_help_panel=RESULT)
]


def render(
    scene: Scene,
    output: Output,
    spp: Annotated[int, typer.Option(metavar="N", help="Samples per pixel.")] = 4,
    width: Annotated[int | None, typer.Option(metavar="N", help="Columns; by default those of the scene.")] = None,
    height: Annotated[int | None, typer.Option(metavar="N", help="Rows; by default those of the scene.")] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="The same seed gives the same image.")] = 0,
    max_depth: MaxDepth = None,
    light: Light = "all",
    integrator: Integrator = "auto",
    define: Define = None,
    aov_only: AovOnly = False,
    reference: Reference = False,
    scale: Scale = 1,
    place: Place = None,
    frames: Frames = None,
    camera_path: CameraPath = None,
    speed: Speed = None,
    start: Start = None,
    moving_objects: MovingObjects = False,
    exact: Annotated[
        bool, typer.Option("--float", help="Store everything as 32-bit floats.", rich_help_panel=RESULT)
    ] = False,
    png: Png = False,
    exposure: Exposure = None,
) -> None:
    """Render a scene with Mitsuba, with all that denoising needs, in one EXR file, or one for each frame."""
    on_path = (
        ("--camera-path", camera_path is not None),
        ("--speed", speed is not None),
        ("--start", start is not None),
        ("--moving-objects", moving_objects),
    )
    if frames is None:
        _require_beside("--frames", on_path, "say how many frames")
    else:
        _refuse_beside("--frames", (("--aov-only", aov_only), ("--place", place is not None)))
    if scale != 1:
        _refuse_beside("--scale", (("--aov-only", aov_only), ("--reference", reference), ("--png", png)))
    if aov_only:
        _refuse_beside("--aov-only", (("--reference", reference), ("--png", png)))
    if speed is not None and camera_path not in (None, "orbit"):
        _refuse_beside(f"--camera-path {camera_path}", (("--speed", True),))
    common: dict[str, Any] = {
        "spp": spp,
        "seed": seed,
        "max_depth": max_depth,
        "light": light,
        "integrator": integrator,
    }
    picture = png, exposure
    size: dict[str, Any] = {"width": width, "height": height, "parameters": parse_definitions(define or [])}
    if frames is not None:
        path = {"camera_path": camera_path or "orbit", "speed": speed, "moving_objects": moving_objects}
        many: dict[str, Any] = {**common, **size, **path, "scale": scale, "reference": reference}
        _render_sequence(scene, output, frames=frames, start=start or 1, half=not exact, picture=picture, **many)
    elif scale != 1:
        _render_sparse(scene, output, size, {**common, "scale": scale, "place": parse_place(place or "0,0")}, not exact)
    else:
        # A place that is none is told, whether it is used or not.
        parse_place(place or "0,0")
        _render_whole(
            scene, output, size, common, half=not exact, aov_only=aov_only, reference=reference, picture=picture
        )


def parse_definitions(words: Iterable[str]) -> dict[str, str]:
    """Return parameters of a scene by name, from ``NAME=VALUE`` each."""
    found: dict[str, str] = {}
    for word in words:
        name, separator, value = word.partition("=")
        if not separator or not name.isidentifier():
            raise InputError("-D", expected="NAME=VALUE, such as spp=16", got=repr(word), action="write both")
        if name in found:
            raise InputError("-D", expected="every name once", got=f"{name} twice", action="leave one of them out")
        found[name] = value
    return found


def _tell_light(scene: Any, settings: dict[str, Any], *, aov_only: bool = False) -> None:
    """Say whose light is rendered, where there is a choice; refuse what cannot be."""
    from lobewise.cli.output import print_note
    from lobewise.render.integrators import plan_light

    if not aov_only:
        told = plan_light(scene, settings["integrator"], settings["max_depth"]).told
        if told:
            print_note(told)


def _render_sparse(scene: str, output: Path, size: dict[str, Any], settings: dict[str, Any], half: bool) -> None:
    """Render a frame at some of its pixels only."""
    from lobewise.cli.output import print_line
    from lobewise.io import write_sparse_frame
    from lobewise.io.files import require_other_files, require_writable
    from lobewise.render import load_scene, render_sparse_frame

    require_writable(output)
    require_other_files([output], [scene])
    loaded = load_scene(scene, **size)
    if settings["integrator"] == "paths":
        _tell_light(loaded, settings)
    with show_progress() as advance:
        settings["progress"] = lambda done, total: advance(f"Rendering {scene}", done, total)
        frame = render_sparse_frame(loaded, **settings)
    write_sparse_frame(output, frame, half=half)
    scale, spp = settings["scale"], settings["spp"]
    share = f"one of {scale}x{scale} pixels shaded"
    print_line(f"Wrote {output}: {frame.width}x{frame.height} pixels, {share}, {spp} spp.")


def _render_whole(
    scene: str,
    output: Path,
    size: dict[str, Any],
    settings: dict[str, Any],
    *,
    half: bool,
    aov_only: bool,
    reference: bool,
    picture: tuple[bool, float | None],
) -> None:
    """Render a frame, or a reference."""
    from lobewise.cli.output import print_line
    from lobewise.io import write_frame
    from lobewise.io.files import require_other_files, require_writable
    from lobewise.render import load_scene, render_frame, render_reference

    require_writable(output)
    require_other_files([output], [scene])
    pictures = plan_pictures(*picture, output)
    if pictures is not None:
        protect_from_pictures([output], [scene])
    loaded = load_scene(scene, **size)
    _tell_light(loaded, settings, aov_only=aov_only)
    with show_progress() as advance:
        settings["progress"] = lambda done, total: advance(f"Rendering {scene}", done, total)
        frame = (
            render_reference(loaded, **settings) if reference else render_frame(loaded, aov_only=aov_only, **settings)
        )
    write_frame(output, frame, half=half, attributes={"lobewise/scene": scene})
    if pictures is not None:
        pictures.write(output, frame.radiance.color)
    print_line(f"Wrote {output}: {frame.width}x{frame.height} pixels, {settings['spp']} spp.")
    tell_picture(output, pictures)


def _render_sequence(
    scene: str,
    output: Path,
    *,
    frames: int,
    start: int,
    camera_path: str,
    speed: float | None,
    moving_objects: bool,
    width: int | None,
    height: int | None,
    parameters: dict[str, str],
    half: bool,
    picture: tuple[bool, float | None],
    **settings: Any,
) -> None:
    """Render frames ``start`` to ``start + frames - 1`` of a path, each to its file as soon as it is there."""
    from lobewise.cli.output import print_line
    from lobewise.io import write_frame, write_sparse_frame
    from lobewise.io.files import require_other_files, require_writable
    from lobewise.io.sequence import FramePattern, is_pattern
    from lobewise.render import MovingScene, load_scene, render_sequence
    from lobewise.sparse_frame import SparseFrame

    pattern = FramePattern.parse(output) if frames > 1 or is_pattern(output) else None
    last = start + frames - 1
    files = {number: pattern.name(number) if pattern else output for number in range(start, last + 1)}
    require_writable(files[start])
    require_other_files(files.values(), [scene, camera_path])
    pictures = plan_pictures(*picture, files[start])
    if pictures is not None:
        protect_from_pictures(files.values(), [scene, camera_path])
    moving = MovingScene(scene, width, height) if moving_objects else None
    loaded = load_scene(scene, width=width, height=height, parameters=parameters)
    _tell_light(loaded, settings)
    cameras = _plan_cameras(loaded, camera_path, last, speed)
    wide = high = 0
    with show_progress() as advance:
        advance(f"Rendering {scene}", 0, frames)
        rendered = render_sequence(moving or loaded, cameras, first=start - 1, **settings)
        # A second scene in memory would be compiled into every kernel.
        del loaded
        for (number, file), frame in zip(files.items(), rendered, strict=True):
            if isinstance(frame, SparseFrame):
                write_sparse_frame(file, frame, half=half)
            else:
                write_frame(file, frame, half=half, attributes={"lobewise/scene": scene})
                if pictures is not None:
                    pictures.write(file, frame.radiance.color)
            wide, high = frame.width, frame.height
            advance(f"Rendering {scene}", number - start + 1, frames)
    scale, spp = settings["scale"], settings["spp"]
    share = f"one of {scale}x{scale} pixels shaded, " if scale != 1 else ""
    names = f"{files[start]} to {files[last].name}" if frames > 1 else f"{files[start]}"
    print_line(f"Wrote {names}: {wide}x{high} pixels, {share}{spp} spp.")
    tell_picture(output, pictures)


def _plan_cameras(scene: Any, path: str, count: int, speed: float | None) -> list[Camera]:
    """Return the cameras of the first ``count`` frames of a path."""
    from lobewise.render import find_orbit_centre, get_camera, make_orbit, read_camera_path

    camera = get_camera(scene)
    if path == "still":
        return [camera] * count
    if path == "orbit":
        turn = {} if speed is None else {"degrees_per_frame": speed}
        return make_orbit(camera, find_orbit_centre(scene), count, **turn)
    if not Path(path).suffix and not Path(path).exists():
        require_choice("--camera-path", path, CAMERA_PATHS)
    cameras = read_camera_path(path, camera)
    if len(cameras) < count:
        raise InputError(
            f"camera path {path!r}",
            expected=f"at least {count} cameras, one for each frame",
            got=str(len(cameras)),
            action="ask for fewer frames",
        )
    return cameras[:count]


def _refuse_beside(name: str, others: Iterable[tuple[str, bool]]) -> None:
    """Raise InputError if another option is given that makes no sense beside this one."""
    for other, given in others:
        if given:
            raise InputError(name, expected=f"no {other} beside it", got="both", action="leave one of them out")


def _require_beside(name: str, others: Iterable[tuple[str, bool]], action: str) -> None:
    """Raise InputError if another option is given that needs this one, which is not."""
    for other, given in others:
        if given:
            raise InputError(other, expected=f"{name} beside it", got="none", action=action)
