"""What became of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lobewise.interchange.replacing import PlannedResult
from lobewise.interchange.selections import Selection
from lobewise.io.exr.container import Container
from lobewise.records.frame import FloatArray, Result

if TYPE_CHECKING:
    from lobewise.recipes.streaming.recipe import DenoisedFile


@dataclass(frozen=True)
class FileResult:
    """The results of the views and view layers of a file.

    Parameters
    ----------
    results : sequence of Result or DenoisedFile
        One of each view, the first view first; a `DenoisedFile` where the file was denoised in bands, and is written.
    selections : sequence of Selection
        The views and view layers.
    container : Container or None
        The file, where its copy is to be written.
    planned : sequence of PlannedResult
        What each result changes in the copy.
    """

    results: Sequence[Result | DenoisedFile]
    selections: Sequence[Selection] = (Selection(),)
    container: Container | None = None
    planned: Sequence[PlannedResult] = ()

    @property
    def first(self) -> Result | DenoisedFile:
        """The result of the first view."""
        return self.results[0]

    @property
    def image(self) -> FloatArray | None:
        """The image of the first view; None where the file was denoised in bands."""
        return self.first.image if isinstance(self.first, Result) else None

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the first result."""
        return self.first.settings

    @property
    def seconds(self) -> float:
        """Wall time of all results."""
        return sum(each.seconds for each in self.results)

    @property
    def bad_pixel_count(self) -> int:
        """How many pixels of all views were refilled."""
        return sum(each.bad_pixel_count for each in self.results)

    def describe(self) -> dict[str, Any]:
        """Return the facts of the first result, with the time and the bad pixels of all."""
        return {**self.first.describe(), "seconds": self.seconds, "bad_pixels": self.bad_pixel_count}
