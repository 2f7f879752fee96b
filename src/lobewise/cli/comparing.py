"""The verb `compare`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.options.common import output_option
from lobewise.cli.options.writing import list_files
from lobewise.cli.terminal.lines import to_json
from lobewise.cli.terminal.steps import Steps
from lobewise.errors import InputError, LobewiseError, MissingChannelError, MissingDependencyError

if TYPE_CHECKING:
    from lobewise.io.sequence import FramePattern
    from lobewise.records.camera import Camera
    from lobewise.records.frame import FloatArray, GBuffer

    Guides = tuple[GBuffer, Camera]


def compare(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE.exr...", help="The images to judge, or sequences such as a.####.exr.", show_default=False
        ),
    ],
    reference: Annotated[
        Path,
        typer.Option(
            "--reference", "-r", metavar="FILE", help="The image or sequence that is right.", show_default=False
        ),
    ],
    guides: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With sequences: the files that hold position or depth and the camera, for ghosting.",
            show_default="the reference",
        ),
    ] = None,
    json_output: Annotated[
        Path | None, output_option("--json", metavar="FILE", help="Write the figures as JSON; - is standard output.")
    ] = None,
    page: Annotated[
        Path | None,
        output_option("--html", metavar="FILE", help="Write a page to look at: a wipe, error maps, the figures."),
    ] = None,
) -> None:
    """Measure how far images are from a reference: mse, rel_mse, smape, psnr and flip.

    Images of other primaries (as the file names them, or has them as chromaticities) are converted to those of Rec. 709
    first.

    Of sequences the means over the frames are shown, and beside them flicker, how unlike the changes from frame to
    frame are, and ghosting, the rel_mse of what has just come into view.
    """
    from lobewise.cli.output import print_note
    from lobewise.cli.terminal.tables import print_comparison
    from lobewise.io.files import require_other_files, require_writable, write_text

    to_terminal = str(json_output) == "-"
    inputs = [*images, reference, *([guides] if guides else [])]
    if json_output is not None and not to_terminal:
        require_writable(json_output)
        require_other_files([json_output], list_files(inputs))
    are_sequences = _are_sequences(inputs, guides)
    if page is not None:
        _require_page(page, json_output, inputs, are_sequences=are_sequences)
    metrics, missing = _list_metrics()
    if are_sequences:
        compared = _compare_sequences(images, reference, guides, metrics)
    else:
        compared = _compare_files(images, reference, metrics)
    if missing:
        print_note(missing)
    if page is not None:
        _write_page(page, images, reference)
    text = to_json(compared)
    if to_terminal:
        typer.echo(text, nl=False)
        return
    if json_output is not None:
        write_text(json_output, text)
    title = str(reference)
    if are_sequences:
        metrics += ["flicker", "ghosting"]
        title += f", {len(compared['frames'])} frame{'s' if len(compared['frames']) > 1 else ''}"
    print_comparison(title, metrics, [(row["path"], row) for row in compared["images"]])


def _require_page(page: Path, figures: Path | None, inputs: Sequence[Path], *, are_sequences: bool) -> None:
    """Raise unless the page can be written, is neither the file of figures nor an input, and shows single files."""
    from lobewise.io.files import require_other_files, require_writable

    if are_sequences:
        raise InputError("--html", expected="single files", got="sequences", action="name one frame of each")
    if page == figures:
        raise InputError(
            "--html", expected="another file than that of --json", got=repr(str(page)), action="rename one"
        )
    require_writable(page)
    require_other_files([page], list_files(inputs))


def _write_page(page: Path, images: Sequence[Path], reference: Path) -> None:
    """Write the page that shows the images, their error maps and figures."""
    import shlex

    from lobewise.cli.output import print_note
    from lobewise.interchange import read_light
    from lobewise.io.files import write_text
    from lobewise.reporting.report import Picture, Report, make_page

    names = _shorten([*images, reference])
    pictures = [Picture(f"image-{k + 1}", names[k], read_light(path)) for k, path in enumerate(images)]
    words = ["lobewise", "compare", *map(str, images), "-r", str(reference), "--html", str(page)]
    report = Report(
        title="Comparison",
        subtitle=f"With {reference}",
        pictures=pictures,
        reference=Picture("reference", f"{names[-1]} (reference)", read_light(reference)),
        baseline=pictures[0].key,
        left=pictures[0].key,
        right=pictures[-1].key if len(pictures) > 1 else "reference",
        mask=None,
        command=shlex.join(words),
        facts={},
    )
    with Steps() as steps:
        write_text(page, make_page(report, progress=lambda done, total: steps.tell("pictures", done, total)))
    print_note(f"Wrote {page}.")


def _shorten(paths: Sequence[Path]) -> list[str]:
    """Return the names of files; their whole paths where two have one name."""
    names = [path.name for path in paths]
    return [str(path) if names.count(path.name) > 1 else path.name for path in paths]


def _are_sequences(paths: Sequence[Path], guides: Path | None) -> bool:
    """Return whether all paths are patterns; raise InputError where some are, or where single files have guides."""
    from lobewise.io.sequence import is_pattern

    patterns = [is_pattern(path) for path in paths]
    if any(patterns) != all(patterns) or (guides is not None and not any(patterns)):
        raise InputError(
            "sequences",
            expected="names such as a.####.exr for all that is compared",
            got="single files among them" if any(patterns) else "--guides with single files",
            action="compare sequences with sequences",
        )
    return all(patterns)


def _list_metrics() -> tuple[list[str], str]:
    """Return the names of the metrics, and why flip is missing, empty where it is not."""
    import numpy as np

    from lobewise.metrics import METRICS, flip

    try:
        flip(np.zeros((1, 1, 3)), np.zeros((1, 1, 3)))
    except MissingDependencyError as problem:
        return [name for name in METRICS if name != "flip"], str(problem)
    return list(METRICS), ""


def _compare_files(images: list[Path], reference: Path, metrics: list[str]) -> dict[str, Any]:
    from lobewise.cli.output import print_note
    from lobewise.interchange import name_noisy_pass, read_light
    from lobewise.metrics import EPSILON, evaluate

    for path in (*images, reference):
        passes = name_noisy_pass(path)
        if passes is not None:
            shown, noisy = passes
            print_note(f"{path}: {shown}, which viewers show, is measured; {noisy}, the noisy image, is not.")
    target = read_light(reference)
    rows = [
        {"path": str(path), **_measure_file(path, reference, lambda image: evaluate(image, target, metrics=metrics))}
        for path in images
    ]
    return {"reference": str(reference), "epsilon": EPSILON, "images": rows}


def _compare_sequences(images: list[Path], reference: Path, guides: Path | None, metrics: list[str]) -> dict[str, Any]:
    """Return the figures of every sequence and of its frames; one frame of each sequence is in memory at a time."""
    from lobewise.io.sequence import FramePattern
    from lobewise.metrics import EPSILON

    truth = FramePattern.parse(reference)
    frames = truth.find()
    numbers = [number for number, _ in frames]
    sequences = [_Sequence(FramePattern.parse(path), metrics) for path in images]
    for one in sequences:
        _require_numbers(one.pattern, numbers)
    guiding = truth if guides is None else FramePattern.parse(guides)
    _require_numbers(guiding, numbers, allow_more=True)
    guided = guides is not None or _has_guides(frames[0][1])
    with Steps() as steps:
        steps.tell("frames", 0, len(frames))
        for done, (number, target, mask, cut) in enumerate(_read_targets(frames, guiding if guided else None), start=1):
            for one in sequences:
                one.add(number, truth.name(number), target, mask, cut=cut)
            steps.tell("frames", done, len(frames))
    return {
        "reference": str(reference),
        "guides": str(guides or reference) if guided else None,
        "epsilon": EPSILON,
        "frames": numbers,
        "images": [
            {"path": str(path), **one.summarize(), "frames": one.frames}
            for path, one in zip(images, sequences, strict=True)
        ],
    }


class _Sequence:
    """The figures of one sequence."""

    def __init__(self, pattern: FramePattern, metrics: list[str]) -> None:
        from lobewise.metrics import Flicker

        self.pattern = pattern
        self.frames: list[dict[str, Any]] = []
        self._metrics = metrics
        self._flicker = Flicker()
        self._ghosts: list[tuple[float, int]] = []

    def add(self, number: int, reference: Path, target: FloatArray, mask: Any, *, cut: bool) -> None:
        """Measure the next frame.

        ``mask`` holds the pixels that came into view with this frame, None where they are unknown.
        """
        from lobewise.metrics import evaluate, ghosting

        def measure(image: FloatArray) -> dict[str, Any]:
            row: dict[str, Any] = {"number": number, **evaluate(image, target, metrics=self._metrics)}
            row["flicker"] = self._flicker.add(image, target, cut=cut)
            row["ghosting"] = None
            if mask is not None and mask.any():
                row["ghosting"] = ghosting(image, target, mask)
                self._ghosts.append((row["ghosting"], int(mask.sum())))
            return row

        self.frames.append(_measure_file(self.pattern.name(number), reference, measure))

    def summarize(self) -> dict[str, float | None]:
        """Return the means.

        The mean of flicker is over the steps between frames, of ghosting over the pixels that came into view, of every
        other metric over the frames.
        """
        means: dict[str, float | None] = {
            metric: math.fsum(row[metric] for row in self.frames) / len(self.frames) for metric in self._metrics
        }
        steps = [row["flicker"] for row in self.frames if row["flicker"] is not None]
        means["flicker"] = self._flicker.get_mean() if steps else None
        pixels = sum(count for _, count in self._ghosts)
        means["ghosting"] = math.fsum(value * count for value, count in self._ghosts) / pixels if pixels else None
        return means


def _measure_file(path: Path, reference: Path, measure: Callable[[FloatArray], dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of the image of a file. An error names the file whose image is wrong."""
    from lobewise.interchange import read_light
    from lobewise.io.exr.layout import name_file

    image = read_light(path)
    try:
        return measure(image)
    except InputError as problem:
        with name_file(reference if problem.what == "reference" else path):
            raise


def _require_numbers(pattern: FramePattern, numbers: list[int], *, allow_more: bool = False) -> None:
    """Raise InputError unless a sequence has the frames of these numbers, and without ``allow_more`` no others."""
    here = {number for number, _ in pattern.find()}
    missing, surplus = sorted(set(numbers) - here), sorted(here - set(numbers))
    if missing or (surplus and not allow_more):
        raise InputError(
            f"sequence {str(pattern)!r}",
            expected="the frame numbers of the reference",
            got=f"no {pattern.name(missing[0]).name!r}" if missing else f"{pattern.name(surplus[0]).name!r} as well",
            action="compare the same frames of both",
        )


def _read_targets(
    frames: list[tuple[int, Path]], guiding: FramePattern | None
) -> Iterator[tuple[int, FloatArray, Any, bool]]:
    """Yield number, image, mask of the pixels that came into view or None, and whether the frame begins a new take."""
    from lobewise.interchange import read_light
    from lobewise.io.exr.layout import name_file
    from lobewise.metrics import find_disoccluded

    before: Guides | None = None
    last: int | None = None
    for number, path in frames:
        cut = number - 1 != last
        target = read_light(path)
        now = mask = None
        if guiding is not None:
            now = _read_guides(guiding.name(number))
            with name_file(guiding.name(number)):
                if before is not None and not cut:
                    mask = find_disoccluded(*now, *before)
                _require_size(now[0], target)
        yield number, target, mask, cut
        before, last = now, number


def _require_size(gbuffer: GBuffer, target: FloatArray) -> None:
    """Raise InputError unless the guides have the size of the reference."""
    if gbuffer.shape != target.shape[:2]:
        height, width = gbuffer.shape or (0, 0)
        raise InputError(
            "guides",
            expected=f"the size of the reference, {target.shape[1]}x{target.shape[0]} pixels",
            got=f"{width}x{height}",
            action="give those of the same frames",
        )


def _has_guides(path: Path) -> bool:
    """Return whether the surfaces of a file can be found in another frame."""
    try:
        _read_guides(path)
    except LobewiseError:
        return False
    return True


def _read_guides(path: Path) -> Guides:
    """Return G-buffer and camera of a file, which may be a sparse frame."""
    from lobewise.io.exr import read_whole
    from lobewise.io.exr.parsing import read_container

    frame = read_whole(path, read_container(path))
    if not frame.is_placed:
        raise MissingChannelError(
            f"guides {str(path)!r}",
            expected="position or depth, and a camera in the header",
            got="no camera" if frame.gbuffer.is_placed else "neither position nor depth",
            action="render them with the frames",
        )
    return frame.gbuffer, frame.require_camera("ghosting")
