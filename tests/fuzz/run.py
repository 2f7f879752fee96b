"""Fuzz for some minutes: ``python -m tests.fuzz.run --minutes 10 [--kind exr] [--count 1000]``.

Prints for every kind how many files were tried, opened and refused, what failed and the highest memory, and keeps each
file that failed among the regressions. Ends with 1 if any did.
"""

import argparse
import json
import secrets
import sys

from tests.fuzz.fuzzing import fuzz
from tests.fuzz.readers import READERS, can_read
from tests.fuzz.watch import Watcher

BAD = {"error": "tracebacks", "crash": "crashes", "hang": "hangs", "memory": "over 1 GB"}


def main() -> int:
    """Run, print a table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="for all kinds together; 10 by default")
    parser.add_argument("--kind", action="append", choices=list(READERS), help="one kind; again for more")
    parser.add_argument("--count", type=int, help="files of each kind, in place of the minutes")
    parser.add_argument("--seed", type=int, help="makes the same files again; by default a new one, which is printed")
    parser.add_argument("--json", help="write the figures there as well")
    told = parser.parse_args()
    start = secrets.randbelow(10**9) if told.seed is None else told.seed
    kinds = [kind for kind in told.kind or READERS if can_read(kind)]
    each = float("inf") if told.count else 60.0 * told.minutes / len(kinds)
    print(f"seed {start}")
    print(
        f"{'kind':12} {'files':>6} {'opened':>6} {'refused':>7} " + " ".join(f"{word:>10}" for word in BAD.values()),
        end="",
    )
    print(f" {'peak MB':>8} {'seconds':>8}")
    failed, figures = False, {}
    for kind in kinds:
        with Watcher() as watcher:
            tally = fuzz(kind, watcher, seconds=each, count=told.count, start=start)
        bad = " ".join(f"{tally.outcomes[name]:10}" for name in BAD)
        counts = f"{tally.files:6} {tally.outcomes['opened']:6} {tally.outcomes['refused']:7}"
        print(f"{kind:12} {counts} {bad} {tally.peak / 1e6:8.0f} {tally.seconds:8.0f}", flush=True)
        for signature, finding in tally.findings.items():
            print(f"-- {signature}\n{finding}", flush=True)
        failed = failed or bool(tally.findings)
        figures[kind] = {"files": tally.files, **tally.outcomes, "peak": tally.peak, "findings": list(tally.findings)}
    if told.json:
        with open(told.json, "w") as out:
            json.dump({"seed": start, "kinds": figures}, out, indent=1)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
