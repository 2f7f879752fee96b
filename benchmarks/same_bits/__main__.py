"""A table of SHA-256 of results on the bundled frame: a change that should change no bit is held against it.

``python -m benchmarks.same_bits --write`` makes the table of this processor; without ``--write`` every result is
computed again and compared. Results that may differ in the last bits are told with how far they are apart, which needs
``--keep DIRECTORY``, where both runs leave their arrays. Bits are those of one kind of processor: vectors of another
width add in another order.
"""

import argparse
import hashlib
import json
import sys
from pathlib import Path

import halide as hl
import numpy as np

from benchmarks.same_bits.cases import Arrays, list_cases

TABLE = Path(__file__).parents[1] / "results" / "same_bits.json"
LARGEST_DIFFERENCE = 1e-6
"""Of the mean of a result: what two texts of a formula that became one may differ by."""


def digest(arrays: Arrays) -> str:
    """Return the SHA-256 of arrays, their names, types and shapes."""
    found = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        found.update(f"{name} {array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def compute_difference(old: Arrays, new: Arrays) -> float:
    """Return the largest relative difference of two results: of a pixel, over its value or the mean of its image."""
    if old.keys() != new.keys():
        return float("inf")
    largest = 0.0
    for name, before in old.items():
        a, b = before.astype(np.float64), new[name].astype(np.float64)
        if a.shape != b.shape or not np.array_equal(np.isfinite(a), np.isfinite(b)):
            return float("inf")
        good = np.isfinite(a)
        scale = np.maximum(np.abs(a[good]), np.abs(a[good]).mean() if good.any() else 1.0)
        gap = np.abs(a - b)[good] / np.maximum(scale, 1e-30)
        largest = max(largest, float(gap.max(initial=0.0)))
    return largest


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="make the table of this processor anew")
    parser.add_argument("--keep", type=Path, help="where arrays are left, and compared if they differ")
    parser.add_argument("--only", default="", help="cases whose name has this in it")
    options = parser.parse_args()
    target = hl.get_host_target()
    processor = f"{target.arch.name.lower()}, {target.natural_vector_size(hl.Float(32))} lanes of float32"
    tables = json.loads(TABLE.read_text()) if TABLE.exists() else {}
    table = tables.get(processor, {})
    if not options.write and not table:
        print(f"{TABLE.name} has no results of a processor with {processor}; make them with --write of an old version")
        return 2
    failed = 0
    for name, run in list_cases():
        if options.only not in name:
            continue
        arrays = run()
        found = digest(arrays)
        path = options.keep and options.keep / f"{name.replace(' ', '_').replace(',', '')}.npz"
        if options.write:
            table[name] = found
            if path:
                path.parent.mkdir(parents=True, exist_ok=True)
                np.savez_compressed(path, **arrays)
            print(f"{found[:12]} {name}", flush=True)
            continue
        if found == table.get(name):
            print(f"same      {name}", flush=True)
            continue
        gap = compute_difference(dict(np.load(path)), arrays) if path and path.exists() else float("nan")
        failed += not gap <= LARGEST_DIFFERENCE
        print(f"{gap:9.2e} {name}", flush=True)
    if options.write:
        # Not at the top: the table can be made by an older version, which has other modules.
        from benchmarks.common import write_json

        write_json(TABLE, {**tables, processor: table})
    print(f"{failed} results differ by more than {LARGEST_DIFFERENCE}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
