"""Share memory out among the images of a pipeline: images that are not needed at the same time lie in one place."""

from __future__ import annotations

from dataclasses import dataclass

from lobewise.engine.graph import Graph, GraphImage


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

    An image occupies a place from the first step that writes it to the last step that names it. A free place that holds
    as many bytes, or else the largest free one, is taken first.

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
    state_bytes = sum(span.count_bytes(share) for pair in graph.state_pairs for span in pair)
    return MemoryPlan(slots, len(sizes), sum(sizes), state_bytes)


def list_spans(graph: Graph) -> dict[GraphImage, tuple[int, int]]:
    """Return the numbers of the first and of the last step that name each image that the pipeline makes."""
    spans: dict[str, tuple[GraphImage, int, int]] = {}
    for number, operation in enumerate(graph.operations):
        for image in (*operation.reads, *operation.writes):
            memory = image.memory
            if memory.source != "made":
                continue
            if memory.name not in spans:
                assert image in operation.writes or operation.when, (
                    f"{operation.function} reads {memory.name} too early"
                )
                spans[memory.name] = memory, number, number
            spans[memory.name] = memory, spans[memory.name][1], number
    return {image: (first, last) for image, first, last in spans.values()}
