"""The process that reads: ``python -m tests.fuzz.worker LOG READERS``, started and ended by `tests.fuzz.watch`.

It takes cases from its standard input, each a line of JSON (kind, whether that is all, size) and the bytes, and answers
with lines of JSON on its standard output. What the libraries print goes nowhere.
"""

import faulthandler
import importlib
import json
import os
import resource
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

ADDRESS_SPACE = 1 << 30
"""Bytes that reading may ask for beyond what the libraries and their threads have mapped."""


def read_status(name: str) -> int:
    """Return a figure of this process, bytes: ``VmHWM`` is the most memory that it held, ``VmSize`` what is mapped."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    raise LookupError(name)


def main() -> None:
    """Read cases until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    log = open(sys.argv[1], "w")  # noqa: SIM115  # held until the process ends
    faulthandler.enable(log)
    os.dup2(nowhere, 2)
    warnings.simplefilter("error")
    # A file that lobewise leaves open is the worker's own temporary folder's to remove.
    warnings.simplefilter("ignore", ResourceWarning)
    readers = importlib.import_module(sys.argv[2]).READERS

    def answer(**told: object) -> None:
        answers.write(json.dumps(told) + "\n")
        answers.flush()

    with tempfile.TemporaryDirectory() as folder:
        ready: set[str] = set()
        while line := sys.stdin.buffer.readline():
            case = json.loads(line)
            data = sys.stdin.buffer.read(case["size"])
            reader = readers[case["kind"]]
            if case["kind"] not in ready:
                # Libraries are loaded, kernels compiled and thread pools started before anything is measured.
                resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
                reader.prepare(Path(folder))
                ready.add(case["kind"])
                resource.setrlimit(resource.RLIMIT_AS, (read_status("VmSize") + ADDRESS_SPACE, resource.RLIM_INFINITY))
            path = Path(folder) / f"case{reader.ending}"
            path.write_bytes(data)
            Path("/proc/self/clear_refs").write_text("5")
            try:
                told = reader.read(path, answer)
                answer(outcome="refused" if told else "opened", told=told, peak=read_status("VmHWM"))
            except BaseException:
                answer(outcome="error", told=traceback.format_exc(), peak=read_status("VmHWM"))
            for left in Path(folder).iterdir():
                if left.is_file():
                    left.unlink()


if __name__ == "__main__":
    main()
