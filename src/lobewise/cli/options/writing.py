"""Options of verbs that write results, and checks that no result replaces a file that the verb reads."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lobewise.cli.options.common import output_option, require_pattern
from lobewise.cli.terminal.help import file_detail, result_option
from lobewise.errors import InputError

if TYPE_CHECKING:
    from lobewise.display.views import View
    from lobewise.reporting.picture import Pictures

MAX_EXPOSURE_STOPS = 64.0
"""Largest size of ``--exposure``, in stops of either sign."""

Output = Annotated[Path, output_option("--output", "-o", metavar="FILE", help="The file to write.", show_default=False)]
Overwrite = Annotated[bool, result_option("--overwrite", help="Let the output replace a file that is read.")]


@dataclass(frozen=True)
class Writing:
    """Options that tell which channels a denoised file has."""

    suffix: Annotated[
        str,
        result_option(metavar="TEXT", help="Put results beside the noisy passes, in passes whose names end with TEXT."),
    ] = ""
    only: Annotated[bool, result_option("--only", help="Write the results alone, no other channel.")] = False
    confidence: Annotated[
        bool,
        result_option(
            "--confidence", help="Add channels that tell how far to trust the result, and which pixels to render again."
        ),
    ] = False


@dataclass(frozen=True)
class Picture:
    """Options of the PNG picture beside each EXR file."""

    png: Annotated[
        bool,
        result_option(
            "--png",
            help="Write a tone mapped picture (.png) as well. A sequence has one exposure.",
        ),
    ] = False
    exposure: Annotated[
        float | None,
        result_option(
            metavar="STOPS",
            help="With --png: multiply the light by 2^STOPS.",
            show_default="by the picture; 0 with a view",
        ),
    ] = None
    display: Annotated[
        str | None, file_detail(metavar="NAME", help="With --png: the display of OpenColorIO to show it on.")
    ] = None
    view: Annotated[
        str | None, file_detail(metavar="NAME", help="With --png: the view of the display, such as AgX or Filmic.")
    ] = None
    ocio: Annotated[
        Path | None,
        file_detail(
            metavar="FILE",
            help="With --png: the configuration of OpenColorIO, such as Blender's config.ocio.",
            show_default="$OCIO",
        ),
    ] = None

    @property
    def has_view(self) -> bool:
        """Whether OpenColorIO makes the picture."""
        return any(word is not None for word in (self.display, self.view, self.ocio))

    def check(self) -> float | None:
        """Return the exposure in stops, None for one by the picture.

        Raises InputError if the exposure is out of range, and the errors of `lobewise.display.views.open_view`.
        """
        self.open_view()
        stops = 0.0 if self.exposure is None and self.has_view else self.exposure
        # Written so that NaN fails.
        if stops is not None and not -MAX_EXPOSURE_STOPS <= stops <= MAX_EXPOSURE_STOPS:
            raise InputError(
                "--exposure",
                expected=f"a number from {-MAX_EXPOSURE_STOPS:g} to {MAX_EXPOSURE_STOPS:g}",
                got=f"{stops:g}",
                action="try 0",
            )
        return stops

    def open_view(self) -> View | None:
        """Return the view that makes the picture, None where there is no picture or no view."""
        if not (self.png and self.has_view):
            return None
        from lobewise.display.views import open_view

        return open_view(self.ocio, self.display, self.view)

    def plan(self, first: Path) -> Pictures | None:
        """Return the writer of pictures, None where none are asked for; ``first`` is the first EXR file to be written.

        Raises the errors of `check`, and FileError if the first picture cannot be written.
        """
        stops = self.check()
        if not self.png:
            return None
        from lobewise.io.files import require_writable
        from lobewise.reporting.picture import Pictures, name_picture

        require_writable(name_picture(first), what="picture")
        return Pictures(exposure=None if stops is None else 2.0**stops, view=self.open_view())


def name_first_output(source: Path, output: Path, numbers: Collection[int] | None) -> Path:
    """Return the first file that will be written: the output itself, or the first file of an output sequence.

    Raises FileError if one of ``numbers`` has no file.
    """
    from lobewise.io.sequence import FramePattern, is_pattern

    if not is_pattern(source) or not is_pattern(output):
        return output
    return FramePattern.parse(output).name(FramePattern.parse(source).find(numbers)[0][0])


def list_files(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield every path of a single file, and for every pattern its files that exist."""
    from lobewise.io.sequence import FramePattern, is_pattern

    for path in paths:
        if is_pattern(path):
            yield from (path_of_number for _, path_of_number in FramePattern.parse(path).find())
        else:
            yield path


def protect_inputs(
    source: Path, output: Path, others: Iterable[Path | str | None], *, overwrite: bool, png: bool
) -> None:
    """Raise InputError where a result would replace an input, or a pass of the input in a file beside it.

    Parameters
    ----------
    source, output : Path
        Two files, or two patterns.
    others : iterable of path or None
        Other files and patterns that the verb reads.
    overwrite : bool
        Whether a single file may be replaced. A sequence never replaces its input: after a stop it would denoise its
        own results.
    png : bool
        Whether a picture is written beside each result. A picture never replaces a file that is read.
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
        require_pattern("--output", output)
        frames = FramePattern.parse(source).find()
        pattern = FramePattern.parse(output)
        outputs, inputs = [pattern.name(number) for number, _ in frames], [*(path for _, path in frames), *besides]
        action = "choose another name"
    elif is_pattern(output):
        raise InputError(
            "--output",
            expected=f"the name of one file for the one input {str(source)!r}",
            got=f"{str(output)!r}, which stands for a sequence",
            action="leave out the # or other sign for the number",
        )
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
