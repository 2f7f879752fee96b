"""The verb `render`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.common import parse_place, require_pattern
from lobewise.cli.options.spreading import complete_from, with_groups
from lobewise.cli.options.writing import Output, Picture, protect_from_pictures
from lobewise.cli.terminal.children import go_on_in_child
from lobewise.cli.terminal.help import result_option, scene_detail, sequence_option
from lobewise.cli.terminal.outcome import tell_picture
from lobewise.cli.terminal.steps import Steps
from lobewise.errors import InputError, require_choice
from lobewise.scenes import BY_THEMSELVES, list_scenes, require_scene

if TYPE_CHECKING:
    from collections.abc import Callable

    from lobewise.records.camera import Camera
    from lobewise.records.frame import Frame
    from lobewise.records.sparse_frame import SparseFrame

CAMERA_PATHS = ("orbit", "still")


@dataclass(frozen=True)
class Sampling:
    """Options that tell what to render of a scene, and with how many samples."""

    spp: Annotated[int, typer.Option(metavar="N", min=1, help="Samples per pixel.")] = 4
    width: Annotated[int | None, typer.Option(metavar="N", min=1, help="Columns; by default those of the scene.")] = (
        None
    )
    height: Annotated[int | None, typer.Option(metavar="N", min=1, help="Rows; by default those of the scene.")] = None
    seed: Annotated[int, typer.Option(metavar="N", help="The same seed gives the same image.")] = 0
    max_depth: Annotated[
        int | None,
        scene_detail(
            metavar="N",
            min=1,
            help="Longest path, in vertices after the camera.",
            show_default="the scene's, or 8 without any",
        ),
    ] = None
    light: Annotated[
        str, typer.Option(metavar="all|indirect", help="indirect: only light that was scattered more than once.")
    ] = "all"
    integrator: Annotated[
        str,
        scene_detail(
            metavar="auto|paths|scene",
            help="Who computes the light; auto: the scene's integrator, or path tracing where both agree.",
        ),
    ] = "auto"
    define: Annotated[
        list[str] | None,
        typer.Option("--define", "-D", metavar="NAME=VALUE", help="Value of $NAME in a Mitsuba XML file."),
    ] = None

    def list_settings(self) -> dict[str, Any]:
        """Return parameters of `lobewise.render.render_frame` and similar functions."""
        return {name: getattr(self, name) for name in ("spp", "seed", "max_depth", "light", "integrator")}

    def load(self, scene: str, *, merge: bool = True) -> Any:
        """Return the scene, loaded with Mitsuba; ``merge`` is that of `lobewise.render.load_scene`."""
        from lobewise.render import load_scene

        parameters = parse_definitions(self.define or [])
        return load_scene(scene, width=self.width, height=self.height, parameters=parameters, merge=merge)

    def describe_light(self, scene: Any) -> None:
        """Print who computes the light, if there is a choice, and which lobes are unknown.

        Raises
        ------
        InputError
            If the integrator is wrong.
        """
        from lobewise.cli.output import print_note
        from lobewise.render.integrators import plan_light
        from lobewise.render.materials.bsdfs import tell_attributes

        for sentence in (plan_light(scene, self.integrator, self.max_depth).sentence, tell_attributes(scene)):
            if sentence:
                print_note(sentence)


@dataclass(frozen=True)
class Contents:
    """Options that tell what the file holds."""

    aov_only: Annotated[bool, result_option("--aov-only", help="Only the G-buffer; the radiance is black.")] = False
    reference: Annotated[bool, result_option("--reference", help="Only the radiance, for many samples.")] = False
    exact: Annotated[bool, result_option("--float", help="Store everything as 32-bit floats.")] = False

    def write(self, path: Path, frame: Frame | SparseFrame, scene: str) -> None:
        """Write a frame, with the name of its scene."""
        from lobewise.io import write_frame, write_sparse_frame
        from lobewise.records.sparse_frame import SparseFrame

        if isinstance(frame, SparseFrame):
            write_sparse_frame(path, frame, half=not self.exact)
        else:
            write_frame(path, frame, half=not self.exact, attributes={"lobewise/scene": scene})


@dataclass(frozen=True)
class Sparse:
    """Options that tell which pixels are shaded."""

    scale: Annotated[
        int, scene_detail(metavar="N", help="Shade one pixel of every NxN, with guides at every pixel, for upsample.")
    ] = 1
    place: Annotated[
        str | None,
        scene_detail(metavar="ROW,COLUMN", help="With --scale: the shaded pixel of each block.", show_default="0,0"),
    ] = None

    def parse_place(self) -> tuple[int, int]:
        """Return row and column of the shaded pixel in its block."""
        return parse_place(self.place or "0,0")


@dataclass(frozen=True)
class Motion:
    """Options of a sequence."""

    frames: Annotated[
        int | None,
        sequence_option(metavar="N", min=1, help="Render so many frames, to -o out.####.exr.", show_default=False),
    ] = None
    camera_path: Annotated[
        str | None,
        sequence_option(
            metavar="orbit|still|FILE.json", help="With --frames: the path of the camera.", show_default="orbit"
        ),
    ] = None
    speed: Annotated[
        float | None,
        sequence_option(metavar="DEGREES", help="Turn of the orbit from frame to frame.", show_default="0.25"),
    ] = None
    start: Annotated[
        int | None,
        sequence_option(metavar="N", min=1, help="With --frames: first frame of the path to render.", show_default="1"),
    ] = None
    moving_objects: Annotated[
        str | None,
        sequence_option(
            metavar="[FILE.json]",
            help="With --frames: objects move too, as the file says, or as showroom and parlour do by themselves.",
            show_default=False,
        ),
    ] = None

    @property
    def objects(self) -> str | None:
        """Name of the file by which objects move, if there is one."""
        return None if self.moving_objects == BY_THEMSELVES else self.moving_objects

    @property
    def path(self) -> str:
        """``orbit``, ``still``, or the name of a file with cameras."""
        return self.camera_path or "orbit"

    def list_files(self, output: Path) -> dict[int, Path]:
        """Return the file of every frame, by the frame's number."""
        from lobewise.io.sequence import FramePattern, is_pattern

        if self.frames is None:
            if is_pattern(output):
                expected, got = "--frames beside a name with # for the number", repr(str(output))
                raise InputError("--output", expected=expected, got=got, action="say how many frames")
            return {1: output}
        if self.frames > 1:
            require_pattern("--output", output)
        first = self.start or 1
        pattern = FramePattern.parse(output) if is_pattern(output) else None
        numbers = range(first, first + self.frames)
        return {number: pattern.name(number) if pattern else output for number in numbers}


@with_groups
def render(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE",
            help=f"{', '.join(list_scenes())}, or a Mitsuba XML file.",
            show_default=False,
            autocompletion=complete_from(list_scenes()),
        ),
    ],
    output: Output,
    *,
    sampling: Sampling,
    contents: Contents,
    sparse: Sparse,
    motion: Motion,
    picture: Picture,
) -> None:
    """Render a scene with Mitsuba into one EXR file per frame, with every channel that denoising can use."""
    from lobewise.io.files import require_exr_name

    _check_speed(motion)
    # A wrong place is an error even where it is not used.
    place = sparse.parse_place()
    parse_definitions(sampling.define or [])
    require_exr_name(output)
    files = motion.list_files(output).values()
    require_scene(scene)
    go_on_in_child(scene, files)
    if motion.frames is not None:
        _render_sequence(scene, output, sampling, contents, sparse.scale, motion, picture)
    elif sparse.scale != 1:
        _render_sparse(scene, output, sampling, contents, sparse.scale, place)
    else:
        _render_whole(scene, output, sampling, contents, picture)


def give_switches_values(arguments: Sequence[str]) -> list[str]:
    """Return a command line in which --moving-objects has a value: the parser knows no value that may be missing.

    A word after it is its value if it ends in ``.json``.
    """
    end = arguments.index("--") if "--" in arguments else len(arguments)
    words = list(arguments)
    for place, word in enumerate(words[:end]):
        if word == "--moving-objects" and not (place + 1 < end and words[place + 1].lower().endswith(".json")):
            words[place] = f"--moving-objects={BY_THEMSELVES}"
    return words


def _check_speed(motion: Motion) -> None:
    """Raise InputError if the speed of a camera is no number, or the camera follows no orbit."""
    if motion.speed is not None and not math.isfinite(motion.speed):
        raise InputError("--speed", expected="a finite number", got=f"{motion.speed:g}", action="0.25 is usual")
    if motion.path != "orbit" and motion.speed is not None:
        name, expected = f"--camera-path {motion.path}", "no --speed beside it"
        raise InputError(name, expected=expected, got="both", action="leave one of them out")


def parse_definitions(words: Iterable[str]) -> dict[str, str]:
    """Return parameters of a scene by name, from ``NAME=VALUE`` each."""
    definitions: dict[str, str] = {}
    for word in words:
        name, separator, value = word.partition("=")
        if not separator or not name.isidentifier():
            raise InputError("-D", expected="NAME=VALUE, such as spp=16", got=repr(word), action="write both")
        if name in definitions:
            raise InputError("-D", expected="every name once", got=f"{name} twice", action="leave one of them out")
        definitions[name] = value
    return definitions


def _render_sparse(
    scene: str, output: Path, sampling: Sampling, contents: Contents, scale: int, place: tuple[int, int]
) -> None:
    """Render a frame of which one pixel in each block is shaded."""
    from lobewise.io.files import require_other_files, require_writable
    from lobewise.render import render_sparse_frame

    require_writable(output)
    require_other_files([output], [scene])
    loaded = sampling.load(scene)
    sampling.describe_light(loaded)
    with Steps() as steps:
        frame = render_sparse_frame(
            loaded, scale=scale, place=place, progress=_show(steps, scene), **sampling.list_settings()
        )
    contents.write(output, frame, scene)
    _tell_outcome(str(output), frame, sampling.spp, scale)


def _render_whole(scene: str, output: Path, sampling: Sampling, contents: Contents, picture: Picture) -> None:
    """Render a frame, or a reference."""
    from lobewise.io.files import require_other_files, require_writable
    from lobewise.render import render_frame, render_reference

    require_writable(output)
    require_other_files([output], [scene])
    pictures = picture.plan(output)
    if pictures is not None:
        protect_from_pictures([output], [scene])
    loaded = sampling.load(scene)
    if not contents.aov_only:
        sampling.describe_light(loaded)
    with Steps() as steps:
        settings = {**sampling.list_settings(), "progress": _show(steps, scene)}
        if contents.reference:
            frame = render_reference(loaded, **settings)
        else:
            frame = render_frame(loaded, aov_only=contents.aov_only, **settings)
    contents.write(output, frame, scene)
    if pictures is not None:
        pictures.write(output, frame.radiance.color)
    _tell_outcome(str(output), frame, sampling.spp)
    tell_picture(output, pictures)


def _render_sequence(
    scene: str, output: Path, sampling: Sampling, contents: Contents, scale: int, motion: Motion, picture: Picture
) -> None:
    """Render the frames of a camera path. Each is written as soon as it is rendered."""
    from lobewise.io.files import require_other_files, require_writable
    from lobewise.records.sparse_frame import SparseFrame
    from lobewise.render import MovingScene, PlacedScene, read_object_paths, render_sequence

    files = motion.list_files(output)
    first, last = min(files), max(files)
    require_writable(files[first])
    sources = [scene, motion.path, *([motion.objects] if motion.objects else [])]
    require_other_files(files.values(), sources)
    pictures = picture.plan(files[first])
    if pictures is not None:
        protect_from_pictures(files.values(), sources)
    paths = read_object_paths(motion.objects) if motion.objects else None
    moving: Any = None
    if motion.moving_objects and paths is None:
        moving = MovingScene(scene, sampling.width, sampling.height)
    loaded = sampling.load(scene, merge=paths is None)
    if paths is not None:
        paths.require_frames(last)
        moving = PlacedScene(loaded, paths)
    sampling.describe_light(loaded)
    cameras = _plan_cameras(loaded, motion.path, last, motion.speed)
    with Steps() as steps:
        show = _show(steps, scene)
        show(0, len(files))
        settings = {**sampling.list_settings(), "scale": scale, "reference": contents.reference}
        rendered = render_sequence(moving or loaded, cameras, first=first - 1, **settings)
        # Mitsuba would compile a second scene in memory into every kernel.
        del loaded
        for (number, file), frame in zip(files.items(), rendered, strict=True):
            contents.write(file, frame, scene)
            if pictures is not None and not isinstance(frame, SparseFrame):
                pictures.write(file, frame.radiance.color)
            show(number - first + 1, len(files))
    _tell_outcome(
        f"{files[first]} to {files[last].name}" if last > first else str(files[first]), frame, sampling.spp, scale
    )
    tell_picture(output, pictures)


def _show(steps: Steps, scene: str) -> Callable[[int, int], None]:
    """Return a function that shows how much of a scene is rendered."""
    return lambda done, total: steps.tell(f"Rendering {scene}", done, total)


def _tell_outcome(names: str, frame: Frame | SparseFrame, spp: int, scale: int = 1) -> None:
    from lobewise.cli.output import print_line

    share = f"one of {scale}x{scale} pixels shaded, " if scale != 1 else ""
    print_line(f"Wrote {names}: {frame.width}x{frame.height} pixels, {share}{spp} spp.")


def _plan_cameras(scene: Any, path: str, count: int, speed: float | None) -> list[Camera]:
    """Return the cameras of the first ``count`` frames of a path; ``speed`` is in degrees per frame."""
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
