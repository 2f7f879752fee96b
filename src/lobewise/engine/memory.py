"""Share memory out among the images of a pipeline: images that are not needed at the same time lie in one place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

from lobewise.engine.graph import Graph, GraphImage, group_bands


@dataclass(frozen=True)
class MemoryPlan:
    """Where the images of a pipeline lie.

    Parameters
    ----------
    slots : dict of str to int
        Number of the place of each image that the pipeline makes, by the image's name.
    count : int
        Number of places.
    made_bytes, kept_bytes : float
        Bytes for each pixel of the image: of the places, and of the state.
    """

    slots: dict[str, int]
    count: int
    made_bytes: float
    kept_bytes: float


def plan_memory(graph: Graph, share: float) -> MemoryPlan:
    """Return the places of the images of a pipeline.

    An image occupies a place as long as `list_spans` says. A free place that holds as many bytes, or else the largest
    free one, is taken first.

    Parameters
    ----------
    graph : Graph
    share : float
        Share of the pixels that have a sample.
    """
    spans = list_spans(graph)
    sizes: list[float] = []
    free_from: list[int] = []
    slots: dict[str, int] = {}
    for image, (first, last) in sorted(spans.items(), key=lambda span: span[1][0]):
        need = image.count_bytes(share)
        free = [slot for slot, start in enumerate(free_from) if start <= first]
        fitting = [slot for slot in free if sizes[slot] >= need]
        if fitting:
            slot = min(fitting, key=lambda span: sizes[span])
        elif free:
            slot = max(free, key=lambda span: sizes[span])
            sizes[slot] = need
        else:
            slot = len(sizes)
            sizes.append(need)
            free_from.append(0)
        free_from[slot] = last + 1
        slots[image.name] = slot
    check_places(graph, slots)
    state_bytes = sum(span.count_bytes(share) for pair in graph.state_pairs for span in pair)
    return MemoryPlan(slots, len(sizes), sum(sizes), state_bytes)


def list_spans(graph: Graph) -> dict[GraphImage, tuple[int, int]]:
    """Return the numbers of the first and of the last step that need each image that the pipeline makes.

    Steps of a group run again for the next band of rows. So an image that one of them names is needed until the group
    ends.
    """
    spans: dict[str, tuple[GraphImage, int, int]] = {}
    start = 0
    for group in group_bands(graph.operations):
        end = start + len(group) - 1
        for number, operation in enumerate(group, start):
            for memory in _list_made(operation.reads, operation.writes):
                if memory.name not in spans:
                    is_written = any(image.memory.name == memory.name for image in operation.writes)
                    assert is_written or operation.when, f"{operation.function} reads {memory.name} too early"
                    spans[memory.name] = memory, number, end
                spans[memory.name] = memory, spans[memory.name][1], end
        start = end + 1
    return {image: (first, last) for image, first, last in spans.values()}


def check_places(graph: Graph, slots: dict[str, int]) -> None:
    """Raise AssertionError if a step reads an image whose place another image has taken since it was written."""
    holders: dict[int, str] = {}
    for group in group_bands(graph.operations):
        # Two bands are enough: the second one reads what the first one may have overwritten.
        for operation in group * 2:
            for memory in _list_made(operation.reads):
                holder = holders.setdefault(slots[memory.name], memory.name)
                assert holder == memory.name, f"{operation.function} reads {memory.name} from the place of {holder}"
            holders |= {slots[memory.name]: memory.name for memory in _list_made(operation.writes)}


def _list_made(*images: Iterable[GraphImage]) -> list[GraphImage]:
    """Return the memory of those images that the pipeline makes itself."""
    return [image.memory for image in chain(*images) if image.memory.source == "made"]
