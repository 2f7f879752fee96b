"""Break the product in 47 ways, and see which test notices: what a smaller set of tests must not cost.

``python -m benchmarks.mutations`` copies the tree for every fault of `benchmarks.mutations.faults`, breaks the copy and
runs the tests that should notice first, then the whole quick tier, then all others, until one fails. The unbroken tree
runs first: it must pass, or failures tell nothing. The result is ``benchmarks/results/mutations.json``. It is written
after every fault, and the next run goes on from there. All of them take hours.
"""

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, ROOT, write_json
from benchmarks.mutations.faults import MUTATIONS, Mutation

NAMED, QUICK, NIGHTLY, NONE = STEPS = ("named files", "quick", "nightly", "none")
"""Where a fault is noticed."""
LIMIT_MINUTES = {NAMED: 20.0, QUICK: 90.0, NIGHTLY: 240.0}
"""Time after which a step counts as hanging, on a machine that other work shares."""
UNBROKEN = "nothing is broken"
OWN_TEST = "benchmarks/tests/test_mutations.py"
"""It notices every fault, as the text to replace is gone."""
PASSED = (0, 5)
"""Exit codes of pytest: all passed, no test was chosen."""
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", flags=re.M)


def apply(mutation: Mutation, root: Path) -> None:
    """Break a tree. Raise ValueError if the text that is replaced is not in its file exactly once."""
    path = root / "src" / "lobewise" / mutation.file
    text = path.read_text()
    if (count := text.count(mutation.old)) != 1:
        raise ValueError(f"{mutation.name!r} no longer applies: {mutation.file} holds its text {count} times, not once")
    path.write_text(text.replace(mutation.old, mutation.new))


@contextmanager
def copy_tree(tree: Path) -> Iterator[Path]:
    """Copy the tracked files of a working tree, as they are now, into a temporary folder."""
    listed = subprocess.run(["git", "-C", tree, "ls-files", "-z"], check=True, capture_output=True, text=True).stdout
    with tempfile.TemporaryDirectory(prefix="lobewise-mutation-") as folder:
        for name in filter(None, listed.split("\0")):
            if (tree / name).exists():
                (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(tree / name, Path(folder) / name, follow_symlinks=False)
        yield Path(folder)


def run_tests(root: Path, options: Sequence[str], minutes: float) -> str:
    """Return the first test that fails, "hang" after some minutes, "crash" if there is no answer; empty for none."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", "-p", "no:cacheprovider", f"--ignore={OWN_TEST}"]
    environment = {**os.environ, "PYTHONPATH": f"{root / 'src'}{os.pathsep}{root}", "HL_NUM_THREADS": "1"}
    # Not through a pipe: a process that a test leaves behind would hold it open.
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(
            [*command, *options], cwd=root, env=environment, stdout=output, stderr=output, start_new_session=True
        )
        try:
            process.wait(60.0 * minutes)
        except subprocess.TimeoutExpired:
            return "hang"
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        output.seek(0)
        told = output.read()
    if process.returncode in PASSED:
        return ""
    failed = FAILED.search(told)
    if failed is None and process.returncode > 0:
        raise RuntimeError(f"pytest did not run the tests:\n{told[-2000:]}")
    return failed[1] if failed else "crash"


def run_until_notice(root: Path, named: Sequence[str], tier: str, steps: Sequence[str]) -> tuple[str, str]:
    """Return the first of some steps that notices that a tree is broken, and the test; "none" if no step does."""
    others = f"not ({tier})"
    options = {NAMED: ["-m", tier, *(f"tests/{name}" for name in named)], QUICK: ["-m", tier], NIGHTLY: ["-m", others]}
    for step in steps:
        if test := run_tests(root, options[step], LIMIT_MINUTES[step]):
            return step, test
    return NONE, ""


def main() -> None:
    """Break, run the tests, and write what noticed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tier", default="not nightly", help="what pytest -m takes for the quick tier")
    parser.add_argument("--only", action="append", metavar="NAME", help="a fault, or several")
    parser.add_argument("--named", action="store_true", help="run the named files alone, and write nothing")
    parser.add_argument("--again", action="store_true", help="run the faults too that the result holds already")
    parser.add_argument("--tree", type=Path, default=ROOT, help="a checkout whose tests run instead of this one's")
    parser.add_argument("--output", type=Path, default=RESULTS / "mutations.json")
    options = parser.parse_args()
    if unknown := set(options.only or ()) - {each.name for each in MUTATIONS}:
        parser.error(f"no faults {sorted(unknown)}")
    chosen = [each for each in MUTATIONS if not options.only or each.name in options.only]
    found: dict[str, dict[str, Any]] = {}
    if options.output.exists() and not options.again and not options.named:
        found = json.loads(options.output.read_text())["mutations"]
    if not options.named and not options.only:
        chosen = [Mutation(UNBROKEN, "", "", "", ()), *chosen]
    for mutation in chosen:
        if mutation.name in found:
            continue
        start = time.monotonic()
        with copy_tree(options.tree) as root:
            if mutation.name != UNBROKEN:
                apply(mutation, root)
            steps = STEPS[:1] if options.named else STEPS[not mutation.tests : -1]
            step, test = run_until_notice(root, mutation.tests, options.tier, steps)
        seconds = round(time.monotonic() - start, 1)
        print(f"{mutation.name}: {step} {test} ({seconds:.0f} s)", flush=True)
        if options.named:
            continue
        if mutation.name == UNBROKEN and step != NONE:
            sys.exit(f"{test} fails although {UNBROKEN}: mend it first, else nothing can be told of the faults.")
        name = test.rpartition("/")[2]
        found[mutation.name] = {"file": mutation.file, "noticed": step, "test": name, "seconds": seconds}
        counts = Counter(each["noticed"] for name, each in found.items() if name != UNBROKEN)
        told = {"tier": options.tier, "counts": {step: counts[step] for step in STEPS}, "mutations": found}
        write_json(options.output, told)


if __name__ == "__main__":
    main()
