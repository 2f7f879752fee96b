"""Run `lobewise denoise` under bad circumstances, and count how the runs end.

    python -m benchmarks.robustness.circumstances [--part NAME ...] [--runs 8]

- "cold cache": eight processes at once compile the same kernels into one empty folder.
- "bad caches": kernels on disk are damaged, exchanged, of another processor, of another user, or writable by all.
- "vanishing folder": the folder of the outputs is removed, or made read-only, at a random moment.
- "processor time": the system stops the process after some seconds of processor time (RLIMIT_CPU).
- "jumping clock": the clock jumps by years at every look, and files of other processes are of the future.
- "memory": the peak of a process over its limit, for limits that just let a frame through.
- "time": seconds between the limit of a call and its end.
- "calls": memory of one process over 2,000 calls.
- "16k": a file of 16384x16384 pixels, in bands.

A run is right if it ends with exit code 0 and the bytes of an undisturbed run, or with one sentence, exit code 2 (or
the signal of the system), and every output as it was. Each part adds its counts to benchmarks/results/robustness.json.
"""

import argparse
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.performance.streaming import run, tile
from benchmarks.robustness import kills
from lobewise.io import write_frame

OUTPUT = RESULTS / "robustness.json"
PROGRAM = [*kills.PROGRAM, "denoise"]
PROCESSES = 8
MAX_SECONDS = 300.0
CALLS, FIRST_CALLS = 2000, 200
"""Calls of one process, and after how many of them its memory is measured for the first time."""
SMALL, LARGE = (96, 128), (720, 960)
"""Rows and columns of frames; the large ones take seconds of processor time."""
SIDE_16K, COPIES_16K = 16384, 16
MEMORY_16K = "4GiB"
JUMPING_CLOCK = """
import random, time
_now, _random = time.time, random.Random(1)
time.time = lambda: _now() + _random.choice((-1.0, 0.0, 1.0)) * 1e8
"""
"""A ``sitecustomize.py``."""
STOPPED = -signal.SIGXCPU


def make_environment(**changes: str) -> dict[str, str]:
    """Return an environment without bytecode in odd places, and with changed variables."""
    return {**os.environ, **changes}


def call(words: list[str], environment: Mapping[str, str], limit: Callable[[], None] | None = None) -> tuple[int, str]:
    """Run the program; return its exit code and its standard error."""
    done = subprocess.run(
        [*PROGRAM, *words], env=environment, capture_output=True, text=True, timeout=MAX_SECONDS, preexec_fn=limit
    )
    return done.returncode, done.stderr


def judge(code: int, told: str, targets: list[Path], new: list[bytes], old: list[bytes | None]) -> str:
    """Return how a run ended: "finished", "sentence", "stopped", or what was wrong."""
    content = [path.read_bytes() if path.exists() else None for path in targets]
    if "Traceback" in told or "something went wrong inside" in told:
        return "traceback"
    if any(each not in choices for each, choices in zip(content, zip(new, old, strict=True), strict=True)):
        return "output neither old nor new"
    if code == 0:
        return "finished" if content == new else "output missing"
    sentences = [line for line in told.splitlines() if line.startswith("lobewise: ")]
    if code == STOPPED:
        return "stopped"
    return "sentence" if code == 2 and len(sentences) == 1 else f"exit code {code} with {len(sentences)} sentences"


class Bench:
    """A noisy frame, a sequence of it, and what undisturbed runs make of them."""

    def __init__(self, home: Path, runs: int, seed: int) -> None:
        self.home, self.runs, self.rng = home, runs, random.Random(seed)
        self.sources = home / "in"
        self.sources.mkdir()
        for number in range(1, kills.FRAMES + 1):
            write_frame(self.sources / f"in.{number}.exr", kills.make_frame(number))
        self.cache = home / "cache"
        self.environment = make_environment(LOBEWISE_CACHE=str(self.cache))
        self.new: dict[str, list[bytes]] = {}
        self.seconds: dict[str, float] = {}
        for way in kills.WAYS:
            clean = home / f"clean {way.name}"
            clean.mkdir()
            for _ in range(2):
                start = time.monotonic()
                code, told = call(self.make_words(way, clean), self.environment)
                self.seconds[way.name] = time.monotonic() - start
                assert code == 0, told
            self.new[way.name] = [path.read_bytes() for path in way.list_targets(clean)]

    def make_words(self, way: kills.Way, folder: Path) -> list[str]:
        """Return the arguments of a way to write."""
        return way.make_command(self.sources, folder)[len(PROGRAM) :]

    def run_once(self, way: kills.Way, environment: Mapping[str, str], limit: Callable[[], None] | None = None) -> str:
        """Run a way into a folder of old outputs; return how it ended."""
        with tempfile.TemporaryDirectory(dir=self.home) as name:
            folder = Path(name)
            targets = way.list_targets(folder)
            for target in targets:
                target.write_bytes(kills.OLD)
            code, told = call(self.make_words(way, folder), environment, limit)
            found = judge(code, told, targets, self.new[way.name], [kills.OLD] * len(targets))
            left = [path for path in folder.iterdir() if path not in targets]
            # The system leaves a stopped process no time to tidy; the next run does.
            return f"{found}, files left over" if left and found != "stopped" else found


def try_cold_cache(bench: Bench) -> dict[str, Counter[str]]:
    """Start processes at once, each with an empty cache that they share."""
    way, counts = kills.WAYS[0], Counter[str]()
    for number in range(max(bench.runs // 4, 1)):
        cache = bench.home / f"cold {number}"
        environment = make_environment(LOBEWISE_CACHE=str(cache))
        folders = [bench.home / f"out {number} {index}" for index in range(PROCESSES)]
        for folder in folders:
            folder.mkdir()
        processes = [
            subprocess.Popen(
                [*PROGRAM, *bench.make_words(way, folder)],
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            for folder in folders
        ]
        for process, folder in zip(processes, folders, strict=True):
            _, told = process.communicate(timeout=MAX_SECONDS)
            counts[judge(process.returncode, told, way.list_targets(folder), bench.new[way.name], [None])] += 1
        counts["temporary files in the cache"] += len(list(cache.glob(".lobewise-*")))
    return {f"{PROCESSES} processes": counts}


def damage(path: Path, other: bytes, rng: random.Random) -> dict[str, Callable[[], object]]:
    """Return ways to spoil a kernel on disk; ``other`` is the content of another kernel."""
    content = path.read_bytes()
    head, _, code = content.partition(b"\n")
    code = code or bytes(20)
    at = rng.randrange(len(code))
    flipped = code[:at] + bytes([code[at] ^ 255]) + code[at + 1 :]
    # The processor of an ELF file is its 19th byte: 183 is ARM.
    foreign = code[:18] + bytes([183 if code[18] != 183 else 62]) + code[19:]

    def write(new: bytes) -> Callable[[], object]:
        return lambda: path.write_bytes(new)

    return {
        "empty": write(b""),
        "cut": write(content[: rng.randrange(len(content))]),
        "one byte changed": write(head + b"\n" + flipped),
        "of another kernel": write(other),
        "of another processor": write(head + b"\n" + foreign),
        "random bytes": write(rng.randbytes(len(content))),
        "writable by all": lambda: path.chmod(0o666),
        "a folder": lambda: (path.unlink(), path.mkdir()),
        "a link to nothing": lambda: (path.unlink(), path.symlink_to("nothing")),
        **({"of another user": lambda: os.chown(path, 65534, 65534)} if os.geteuid() == 0 else {}),
    }


def try_bad_caches(bench: Bench) -> dict[str, Counter[str]]:
    """Spoil every kernel of a cache in one way, and run with it."""
    found: dict[str, Counter[str]] = {}
    kernels = sorted(bench.cache.iterdir())
    assert len(kernels) > 2, "no kernel was compiled: is this a wheel?"
    for kind in damage(kernels[0], b"", bench.rng):
        counts: Counter[str] = Counter()
        for _ in range(max(bench.runs // 4, 1)):
            with tempfile.TemporaryDirectory(dir=bench.home) as name:
                cache = Path(name, "cache")
                shutil.copytree(bench.cache, cache)
                for path, other in zip(kernels, [*kernels[1:], kernels[0]], strict=True):
                    damage(cache / path.name, other.read_bytes(), bench.rng)[kind]()
                counts[bench.run_once(kills.WAYS[0], make_environment(LOBEWISE_CACHE=str(cache)))] += 1
        found[kind] = counts
    return found


def try_vanishing_folder(bench: Bench) -> dict[str, Counter[str]]:
    """Remove the folder of the outputs while the program runs."""
    found: dict[str, Counter[str]] = {}
    for way in kills.WAYS:
        counts: Counter[str] = Counter()
        for _ in range(bench.runs):
            folder = bench.home / "vanishing"
            folder.mkdir()
            words = bench.make_words(way, folder)
            process = subprocess.Popen(
                [*PROGRAM, *words], env=bench.environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
            )
            time.sleep(bench.rng.uniform(0.1, 1.0) * bench.seconds[way.name])
            targets = way.list_targets(folder)
            # A run that has written everything is right to end well.
            has_written = all(path.exists() for path in targets)
            shutil.rmtree(folder, ignore_errors=True)
            _, told = process.communicate(timeout=MAX_SECONDS)
            if has_written:
                counts["finished before"] += 1
            else:
                counts[judge(process.returncode, told, targets, bench.new[way.name], [None] * len(targets))] += 1
            shutil.rmtree(folder, ignore_errors=True)
        found[way.name] = counts
    return found


def try_processor_time(bench: Bench) -> dict[str, Counter[str]]:
    """Let the system stop the program after a second or more of processor time."""
    found: dict[str, Counter[str]] = {}
    for way in kills.WAYS:
        counts: Counter[str] = Counter()
        for number in range(bench.runs):
            seconds = 1 + number % 3

            def limit(seconds: int = seconds) -> None:
                resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))

            counts[bench.run_once(way, bench.environment, limit)] += 1
        found[way.name] = counts
    return found


def try_jumping_clock(bench: Bench) -> dict[str, Counter[str]]:
    """Let the clock jump, beside files whose time is in the future."""
    site = bench.home / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(JUMPING_CLOCK)
    path = os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH", "")]))
    future = time.time() + 1e8
    for file in (*bench.sources.iterdir(), *bench.cache.iterdir()):
        os.utime(file, (future, future))
    environment = {**bench.environment, "PYTHONPATH": path}
    return {
        way.name: Counter(bench.run_once(way, environment) for _ in range(max(bench.runs // 2, 1)))
        for way in kills.WAYS
    }


def measure_memory(bench: Bench) -> dict[str, Any]:
    """Return the peak of processes over the smallest limit that lets a frame through."""
    rows = {}
    kills.HEIGHT, kills.WIDTH = 1200, 1600
    source = bench.home / "large.exr"
    write_frame(source, kills.make_frame(1))
    for quality in ("fast", "balanced", "high", "auto"):
        words = ["denoise", str(source), "-o", str(bench.home / "out.exr"), "--quality", quality, "--bands", "off"]
        told = call([*words[1:], "--max-memory", "1GiB"], bench.environment)[1]
        needed = float(told.split("got one that needs ")[1].split(" GiB")[0])
        used = run([*words, "--progress", "off", "--max-memory", f"{needed}GiB"])
        rows[quality] = {"limit_gib": needed, "peak_gib": used["peak_gib"]}
    return rows


def measure_time(bench: Bench) -> dict[str, Any]:
    """Return how long after its limit a call ends, at its worst."""
    kills.HEIGHT, kills.WIDTH = 1200, 1600
    frame = kills.make_frame(1)
    rows = {}
    for quality in ("fast", "balanced", "high", "auto"):
        lobewise.denoise(frame, quality=quality)
        start = time.monotonic()
        lobewise.denoise(frame, quality=quality)
        whole = time.monotonic() - start
        late = []
        for number in range(bench.runs):
            limit = (number + 0.5) / bench.runs * whole
            start = time.monotonic()
            try:
                with lobewise.limit_call(max_seconds=limit):
                    lobewise.denoise(frame, quality=quality)
            except lobewise.LobewiseError:
                late.append(time.monotonic() - start - limit)
        rows[quality] = {"whole_seconds": round(whole, 2), "most_seconds_late": round(max(late, default=0.0), 2)}
    return rows


def measure_calls(bench: Bench) -> dict[str, Any]:
    """Return the memory of this process after some calls and after all, and its open files."""
    kills.HEIGHT, kills.WIDTH = SMALL
    source, target = bench.home / "small.exr", bench.home / "out.exr"
    write_frame(source, kills.make_frame(1))
    rows = {}
    for number in range(1, CALLS + 1):
        quality = ("fast", "balanced", "high", "auto")[number % 4]
        frame = lobewise.read_frame(source)
        lobewise.write_result(target, lobewise.denoise(frame, quality=quality), source=source)
        if number in (FIRST_CALLS, CALLS):
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            held = {"resident_mib": round(pages * resource.getpagesize() / 2**20, 1)}
            rows[str(number)] = {**held, "open_files": len(os.listdir("/proc/self/fd"))}
    return rows


def measure_16k(bench: Bench) -> dict[str, Any]:
    """Return time and memory of a file of 16384x16384 pixels in bands."""
    side = SIDE_16K // COPIES_16K
    kills.HEIGHT = kills.WIDTH = side
    part, source = bench.home / "part.exr", bench.home / "16k.exr"
    write_frame(part, kills.make_frame(1))
    tile(part, source, COPIES_16K)
    words = ["denoise", str(source), "-o", str(bench.home / "out.exr"), "--quality", "fast", "--progress", "off"]
    used = run([*words, "--max-memory", MEMORY_16K])
    head = lobewise.io.exr.parsing.read_container(bench.home / "out.exr").parts[0]
    window = head.data_window
    assert (window.width, window.height) == (SIDE_16K, SIDE_16K)
    return {"file": {"side": SIDE_16K, "channels": len(head.channels), "limit": MEMORY_16K, **used}}


PARTS: dict[str, Callable[[Bench], Mapping[str, Any]]] = {
    "cold cache": try_cold_cache,
    "bad caches": try_bad_caches,
    "vanishing folder": try_vanishing_folder,
    "processor time": try_processor_time,
    "jumping clock": try_jumping_clock,
    "memory": measure_memory,
    "time": measure_time,
    "calls": measure_calls,
    "16k": measure_16k,
}


def main() -> None:
    """Run the parts, print and write what came of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=list(PARTS))
    parser.add_argument("--runs", type=int, default=8, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path, default=OUTPUT)
    options = parser.parse_args()
    for name in options.part or PARTS:
        with tempfile.TemporaryDirectory() as home:
            kills.HEIGHT, kills.WIDTH = LARGE if name == "processor time" else SMALL
            found = {
                key: dict(value) for key, value in PARTS[name](Bench(Path(home), options.runs, options.seed)).items()
            }
        print(f"{name}: {json.dumps(found)}", flush=True)
        before = json.loads(options.output.read_text()) if options.output.exists() else {}
        parts = {**before.get("parts", {}), name: {"commit": describe_machine().get("commit"), "found": found}}
        write_json(options.output, {**describe_machine(), "parts": parts})


if __name__ == "__main__":
    main()
