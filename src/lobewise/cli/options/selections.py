"""Files with several views, the eyes of a stereo pair: each is filtered by itself, and one copy gets all results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lobewise.interchange.replacing import PlannedResult
    from lobewise.interchange.selections import Selection
    from lobewise.io.exr.container import Container
    from lobewise.recipes.sequence import SequenceFilter, State
    from lobewise.records.frame import Result

SELECTIONS = "selections"
"""Name, in the memory of a filter, of the view and view layer that each part of the memory belongs to."""


@dataclass(frozen=True)
class FileOfSeveral:
    """A file with several views. Each is read when it is filtered, so that one is in memory at a time."""

    path: Path
    selections: tuple[Selection, ...]


@dataclass(frozen=True)
class DoneOne:
    """The result of one view.

    Parameters
    ----------
    container : Container
        The file.
    result : Result
        The result.
    planned : PlannedResult
        What the result changes in the copy of the file.
    """

    container: Container
    result: Result
    planned: PlannedResult


@dataclass(frozen=True)
class DoneSeveral:
    """The results of all views of a file, in the order of ``selections``."""

    selections: tuple[Selection, ...]
    done: tuple[DoneOne, ...]

    @property
    def first(self) -> Result:
        """The result of the first view."""
        return self.done[0].result

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the first result."""
        return self.first.settings

    def describe(self) -> dict[str, Any]:
        """Return the facts of the first result, with the time and the bad pixels of all."""
        return {**self.first.describe(), "seconds": self.seconds, "bad_pixels": self.bad_pixel_count}

    @property
    def seconds(self) -> float:
        """Wall time of all results."""
        return sum(each.result.seconds for each in self.done)

    @property
    def bad_pixel_count(self) -> int:
        """How many pixels of all views were refilled."""
        return sum(each.result.bad_pixel_count for each in self.done)


class FilterOfEach:
    """A sequence filter that gives each view a filter of its own.

    Parameters
    ----------
    make_filter : callable
        Returns a filter of files with one view.
    filter_selection : callable
        Reads one view of a file, gives it to a filter of its own, and plans the result. The last argument says whether
        the file does not continue the one before.
    """

    def __init__(
        self,
        make_filter: Callable[[], SequenceFilter[Any, Any]],
        filter_selection: Callable[[FileOfSeveral, Selection, SequenceFilter[Any, Any], bool], DoneOne],
    ) -> None:
        self._make_filter = make_filter
        self._filter_selection = filter_selection
        self._filters: dict[Selection, SequenceFilter[Any, Any]] = {}
        # The first filter is made at once: mistakes in its settings are told before a file is read.
        self._unused: SequenceFilter[Any, Any] | None = make_filter()

    def add(self, frame: Any, *, cut: bool = False) -> Any:
        """Return `DoneSeveral` for a `FileOfSeveral`, else what the filter of one view returns."""
        from lobewise.interchange.selections import Selection

        if not isinstance(frame, FileOfSeveral):
            return self._get(Selection()).add(frame, cut=cut)
        done = [self._filter_selection(frame, each, self._get(each), cut) for each in frame.selections]
        return DoneSeveral(frame.selections, tuple(done))

    def _get(self, selection: Selection) -> SequenceFilter[Any, Any]:
        if selection not in self._filters:
            self._filters[selection] = self._unused or self._make_filter()
            self._unused = None
        return self._filters[selection]

    def get_state(self) -> State:
        """Return what the filters of all views remember."""
        import numpy as np

        state: State = {SELECTIONS: np.array([[one.view, one.layer] for one in self._filters], dtype=np.str_)}
        for number, one in enumerate(self._filters.values()):
            state |= {f"{number}/{name}": value for name, value in one.get_state().items()}
        return state

    def set_state(self, state: State) -> None:
        """Restore the memory that `get_state` returned."""
        from lobewise.interchange.selections import Selection

        for number, (view, layer) in enumerate(state[SELECTIONS].reshape(-1, 2).tolist()):
            head = f"{number}/"
            own = {name.removeprefix(head): value for name, value in state.items() if name.startswith(head)}
            self._get(Selection(view, layer)).set_state(own)
