"""The verb `compare`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.shared import list_files, show_progress
from lobewise.errors import InputError, LobewiseError, MissingChannelError, MissingDependencyError

if TYPE_CHECKING:
    from lobewise.camera import Camera
    from lobewise.frame import FloatArray, GBuffer
    from lobewise.io.sequence import FramePattern

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
            help="With sequences: that which holds position or depth and the camera, for ghosting.",
            show_default="the reference",
        ),
    ] = None,
    json_output: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures as JSON; - is standard output.")
    ] = None,
) -> None:
    """Measure how far images are from a reference: mse, rel_mse, smape, psnr and flip.

    Of sequences the means over the frames are shown, and beside them flicker, how unlike the changes from frame to
    frame are, and ghosting, the rel_mse of what has just come into view.
    """
    import numpy as np

    from lobewise.cli.output import print_comparison, print_note, to_json
    from lobewise.io.files import require_other_files, require_writable, write_text
    from lobewise.io.sequence import is_pattern
    from lobewise.metrics import METRICS, flip

    to_terminal = str(json_output) == "-"
    if json_output is not None and not to_terminal:
        require_writable(json_output)
        require_other_files([json_output], list_files([*images, reference, *([guides] if guides else [])]))
    patterns = [is_pattern(path) for path in (*images, reference, *([guides] if guides else []))]
    sequences = any(patterns)
    if sequences != all(patterns) or (guides is not None and not sequences):
        raise InputError(
            "sequences",
            expected="names such as a.####.exr for all that is compared",
            got="single files among them" if sequences else "--guides with single files",
            action="compare sequences with sequences",
        )
    metrics, missing = list(METRICS), ""
    try:
        flip(np.zeros((1, 1, 3)), np.zeros((1, 1, 3)))
    except MissingDependencyError as problem:
        metrics.remove("flip")
        missing = str(problem)
    if sequences:
        found = _compare_sequences(images, reference, guides, metrics)
    else:
        found = _compare_files(images, reference, metrics)
    if missing:
        print_note(missing)
    text = to_json(found)
    if to_terminal:
        typer.echo(text, nl=False)
        return
    if json_output is not None:
        write_text(json_output, text)
    title = str(reference)
    if sequences:
        metrics += ["flicker", "ghosting"]
        title += f", {len(found['frames'])} frame{'s' if len(found['frames']) > 1 else ''}"
    print_comparison(title, metrics, [(row["path"], row) for row in found["images"]])


def _compare_files(images: list[Path], reference: Path, metrics: list[str]) -> dict[str, Any]:
    from lobewise.cli.output import print_note
    from lobewise.interchange import find_noisy_pass, read_image
    from lobewise.metrics import EPSILON, evaluate

    for path in (*images, reference):
        two = find_noisy_pass(path)
        if two is not None:
            print_note(f"{path}: {two[0]}, which viewers show, is measured; {two[1]}, the noisy image, is not.")
    target = read_image(reference)
    rows = [
        {"path": str(path), **_blame(path, reference, lambda image: evaluate(image, target, metrics=metrics))}
        for path in images
    ]
    return {"reference": str(reference), "epsilon": EPSILON, "images": rows}


def _compare_sequences(images: list[Path], reference: Path, guides: Path | None, metrics: list[str]) -> dict[str, Any]:
    """Return the figures of every sequence and of its frames, reading one frame of each at a time."""
    from lobewise.io.sequence import FramePattern
    from lobewise.metrics import EPSILON

    right = FramePattern.parse(reference)
    frames = right.find()
    numbers = [number for number, _ in frames]
    sequences = [_Sequence(FramePattern.parse(path), metrics) for path in images]
    for one in sequences:
        _require_numbers(one.pattern, numbers, others=False)
    guiding = right if guides is None else FramePattern.parse(guides)
    _require_numbers(guiding, numbers, others=True)
    guided = guides is not None or _find_lacking(frames[0][1]) is None
    with show_progress() as progress:
        progress("frames", 0, len(frames))
        for done, (number, target, mask, cut) in enumerate(_read_targets(frames, guiding if guided else None), start=1):
            for one in sequences:
                one.add(number, right.name(number), target, mask, cut=cut)
            progress("frames", done, len(frames))
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
    """The figures of one sequence, which grow by a frame at a time."""

    def __init__(self, pattern: FramePattern, metrics: list[str]) -> None:
        from lobewise.metrics import Flicker

        self.pattern = pattern
        self.frames: list[dict[str, Any]] = []
        self._metrics = metrics
        self._flicker = Flicker()
        self._ghosts: list[tuple[float, int]] = []

    def add(self, number: int, reference: Path, target: FloatArray, mask: Any, *, cut: bool) -> None:
        """Measure the frame of that number; ``mask`` tells what came into view, None if nothing is known."""
        from lobewise.metrics import evaluate, ghosting

        def measure(image: FloatArray) -> dict[str, Any]:
            row: dict[str, Any] = {"number": number, **evaluate(image, target, metrics=self._metrics)}
            row["flicker"] = self._flicker.add(image, target, cut=cut)
            row["ghosting"] = None
            if mask is not None and mask.any():
                row["ghosting"] = ghosting(image, target, mask)
                self._ghosts.append((row["ghosting"], int(mask.sum())))
            return row

        self.frames.append(_blame(self.pattern.name(number), reference, measure))

    def summarize(self) -> dict[str, float | None]:
        """Return the means: over frames, over steps from frame to frame, over pixels that came into view."""
        means: dict[str, float | None] = {
            metric: math.fsum(row[metric] for row in self.frames) / len(self.frames) for metric in self._metrics
        }
        steps = [row["flicker"] for row in self.frames if row["flicker"] is not None]
        means["flicker"] = self._flicker.get_mean() if steps else None
        pixels = sum(count for _, count in self._ghosts)
        means["ghosting"] = math.fsum(value * count for value, count in self._ghosts) / pixels if pixels else None
        return means


def _blame(path: Path, reference: Path, measure: Callable[[FloatArray], dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of the image of a file; what is wrong with either is said with its name."""
    from lobewise.interchange import read_image

    image = read_image(path)
    try:
        return measure(image)
    except InputError as problem:
        whose = reference if str(problem).startswith("reference") else path
        raise type(problem)(f"{whose}: {problem}") from None


def _require_numbers(pattern: FramePattern, numbers: list[int], *, others: bool) -> None:
    """Raise InputError unless a sequence has the frames of these numbers, with ``others`` allowed or not."""
    here = {number for number, _ in pattern.find()}
    missing, more = sorted(set(numbers) - here), sorted(here - set(numbers))
    if missing or (more and not others):
        raise InputError(
            f"sequence {str(pattern)!r}",
            expected="the frame numbers of the reference",
            got=f"no {pattern.name(missing[0]).name!r}" if missing else f"{pattern.name(more[0]).name!r} as well",
            action="compare the same frames of both",
        )


def _read_targets(
    frames: list[tuple[int, Path]], guiding: FramePattern | None
) -> Iterator[tuple[int, FloatArray, Any, bool]]:
    """Yield number, image, mask of what came into view or None, and whether the frame follows no other."""
    from lobewise.interchange import read_image
    from lobewise.metrics import find_disoccluded

    before: Guides | None = None
    last: int | None = None
    for number, path in frames:
        cut = number - 1 != last
        target = read_image(path)
        now = mask = None
        if guiding is not None:
            holder = guiding.name(number)
            now = _read_guides(holder)
            try:
                if before is not None and not cut:
                    mask = find_disoccluded(*now, *before)
                if now[0].shape != target.shape[:2]:
                    height, width = now[0].shape or (0, 0)
                    raise InputError(
                        "guides",
                        expected=f"the size of the reference, {target.shape[1]}x{target.shape[0]} pixels",
                        got=f"{width}x{height}",
                        action="give those of the same frames",
                    )
            except LobewiseError as problem:
                raise type(problem)(f"{holder}: {problem}") from None
        yield number, target, mask, cut
        before, last = now, number


def _find_lacking(path: Path) -> str | None:
    """Return what a file lacks to follow its surfaces to another frame, None if nothing."""
    from lobewise.io import describe_file

    found = describe_file(path)
    if not any(image.found and image.label in ("depth.Z", "position.X/Y/Z") for image in found.images):
        return "neither position nor depth"
    return "no camera" if found.camera is None else None


def _read_guides(path: Path) -> Guides:
    """Return G-buffer and camera of a file, whether it was shaded sparsely or not."""
    from lobewise.io.exr import read_whole
    from lobewise.io.exr.parsing import read_container

    lacking = _find_lacking(path)
    if lacking is not None:
        raise MissingChannelError(
            f"guides {str(path)!r}",
            expected="position or depth, and a camera in the header",
            got=lacking,
            action="render them with the frames",
        )
    frame = read_whole(path, read_container(path))
    return frame.gbuffer, frame.require_camera("ghosting")
