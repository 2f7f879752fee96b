"""Count how a warm frame goes through the code: functions, and changes from one file to another.

    python -m benchmarks.performance.way -o benchmarks/results/way.json [--list fast]

A reader who follows a frame turns to another file at every change. The frame is the bundled one, 512x512; ``--list``
prints which files follow each other most often.
"""

import argparse
import itertools
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import lobewise
from benchmarks.common import RESULTS, SAMPLE, write_json

SOURCE = Path(lobewise.__file__).parent


@contextmanager
def trace_calls() -> Iterator[list[tuple[str, str]]]:
    """Collect the file and the function of every call of this package inside the context, and where each returns to."""
    found: list[tuple[str, str]] = []

    def look(frame: FrameType, event: str, _: Any) -> None:
        path, code = Path(frame.f_code.co_filename), frame.f_code.co_name
        if event == "call" and path.is_relative_to(SOURCE) and not code.startswith("<"):
            found.append((str(path.relative_to(SOURCE)), code))

    before = sys.getprofile()
    sys.setprofile(look)
    try:
        yield found
    finally:
        sys.setprofile(before)


def list_recipes() -> dict[str, Callable[[], Any]]:
    """Return the recipes by name, each as a call on the bundled frame."""
    frame = lobewise.read_frame(SAMPLE)
    sparse, history = lobewise.make_sparse(frame, 4), lobewise.TemporalFilter(device="cpu")
    return {
        "fast": lambda: lobewise.denoise(frame, quality="fast", device="cpu"),
        "balanced": lambda: lobewise.denoise(frame, quality="balanced", device="cpu"),
        "high": lambda: lobewise.denoise(frame, quality="high", device="cpu"),
        "upsampling": lambda: lobewise.upsample(sparse, device="cpu"),
        "history": lambda: history.add(frame),
    }


def count_way(calls: list[tuple[str, str]]) -> dict[str, int]:
    """Return how many calls, functions and files a way has, and how often the file changes from call to call."""
    changes = sum(first[0] != second[0] for first, second in itertools.pairwise(calls))
    return {
        "calls": len(calls),
        "functions": len(set(calls)),
        "files": len({name for name, _ in calls}),
        "changes_of_file": changes,
    }


def main() -> None:
    """Count, print and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "way.json")
    parser.add_argument("--list", default="", help="a recipe whose changes are printed")
    asked = parser.parse_args()
    rows = {}
    for name, run in list_recipes().items():
        run()
        run()
        with trace_calls() as calls:
            run()
        rows[name] = count_way(calls)
        print(f"{name:<12}", rows[name], flush=True)
        if name == asked.list:
            pairs = Counter(itertools.pairwise(calls))
            for (first, second), count in pairs.most_common(40):
                if first[0] != second[0]:
                    print(f"{count:6}  {':'.join(first)} -> {':'.join(second)}")
    write_json(asked.output, rows)


if __name__ == "__main__":
    main()
