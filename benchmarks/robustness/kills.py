"""Kill `lobewise denoise` at any moment: is every target the old or the new file, whole, and is nothing left over?

    python -m benchmarks.robustness.kills [--kills 200] [--seed 1] [--output benchmarks/results/kills.json]

Four ways to write are killed in turn: a single file, bands of rows, a sequence, and a sequence that remembers. Half of
the kills come at a random moment of the run, the other half as soon as a temporary file is there. Afterwards the same
command runs to its end, and the folder must hold its outputs and nothing else. The seed chooses the moments.
"""

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common import RESULTS, describe_machine, write_json
from lobewise.errors import LobewiseError
from lobewise.interchange import read_image
from lobewise.io import write_frame
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance

FRAMES = 3
HEIGHT, WIDTH = 96, 128
PROGRAM = [sys.executable, "-c", "from lobewise.cli import main; main()"]
OLD = b"what was there before"
POLL_SECONDS = 0.0005


@dataclass(frozen=True)
class Way:
    """One way to write: its options, and whether it writes a sequence."""

    name: str
    options: tuple[str, ...]
    is_sequence: bool

    def list_targets(self, folder: Path) -> list[Path]:
        """Return the files that a whole run leaves."""
        return [folder / (f"out.{number}.exr" if self.is_sequence else "out.exr") for number in self.list_numbers()]

    def list_numbers(self) -> range:
        """Return the numbers of the frames that are written."""
        return range(1, FRAMES + 1 if self.is_sequence else 2)

    def make_command(self, sources: Path, folder: Path) -> list[str]:
        """Return the command line."""
        names = ("in.#.exr", "out.#.exr") if self.is_sequence else ("in.1.exr", "out.exr")
        return [*PROGRAM, "denoise", str(sources / names[0]), "-o", str(folder / names[1]), *self.options]


WAYS = (
    Way("single file", ("--quality", "fast", "--bands", "off"), False),
    Way("bands", ("--quality", "fast", "--bands", "16"), False),
    Way("sequence", ("--quality", "fast"), True),
    Way("sequence that remembers", ("--quality", "fast", "--temporal"), True),
)


def make_frame(seed: int) -> Frame:
    """Return a noisy glossy floor."""
    rng = np.random.default_rng(seed)
    camera = Camera(position=(0.0, 1.0, 4.0), forward=(0.0, -0.4, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.4)
    rays = camera.make_ray_directions(WIDTH, HEIGHT).astype(np.float64)
    depth = -1.0 / rays[..., 1]
    specular = rng.gamma(1.0, 1.0, (HEIGHT, WIDTH, 3)).astype(np.float32)
    return Frame(
        Radiance(color=specular, diffuse=np.zeros_like(specular), specular=specular),
        GBuffer(
            depth=depth,
            position=camera.position + depth[..., None] * rays,
            normal=np.broadcast_to([0.0, 1.0, 0.0], (HEIGHT, WIDTH, 3)),
            alpha_u=np.full((HEIGHT, WIDTH), 0.2),
            lobe_kind=np.ones((HEIGHT, WIDTH)),
            diffuse_albedo=np.zeros((HEIGHT, WIDTH, 3)),
            specular_albedo=np.full((HEIGHT, WIDTH, 3), 0.8),
            motion=np.zeros((HEIGHT, WIDTH, 2)),
        ),
        camera=camera,
        spp=4,
    )


def kill(command: list[str], folder: Path, moment: float | None) -> bool:
    """Run a command and kill it after some seconds, or when a temporary file is there; return whether it was alive."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    start = time.monotonic()
    while process.poll() is None:
        is_writing = moment is None and any(path.name.endswith(".part") for path in folder.iterdir())
        if is_writing or (moment is not None and time.monotonic() - start >= moment):
            process.send_signal(signal.SIGKILL)
            break
        time.sleep(POLL_SECONDS)
    return process.wait() == -signal.SIGKILL


def check_target(path: Path, new: np.ndarray) -> str:
    """Return "old" or "new", or what a target is instead."""
    content = path.read_bytes() if path.exists() else b""
    if content == OLD:
        return "old"
    try:
        return "new" if np.array_equal(read_image(path), new) else "other pixels"
    except LobewiseError:
        return "damaged" if content else "missing"


def run_kills(kills: int, seed: int) -> Iterator[tuple[str, Counter[str]]]:
    """Yield the name of each way with how many targets came out how."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as home:
        sources = Path(home, "in")
        sources.mkdir()
        for number in range(1, FRAMES + 1):
            write_frame(sources / f"in.{number}.exr", make_frame(number))
        for way in WAYS:
            clean = Path(home, way.name)
            clean.mkdir()
            command = way.make_command(sources, clean)
            # The first run compiles.
            for _ in range(2):
                start = time.monotonic()
                subprocess.run(command, check=True, capture_output=True)
                seconds = time.monotonic() - start
            new = [read_image(path) for path in way.list_targets(clean)]
            counts: Counter[str] = Counter()
            for index in range(kills // len(WAYS)):
                moment = rng.uniform(0.2, 1.0) * seconds if index % 2 else None
                counts += _kill_once(way, sources, Path(home), moment, new)
            yield way.name, counts


def _kill_once(way: Way, sources: Path, home: Path, moment: float | None, new: list[np.ndarray]) -> Counter[str]:
    """Kill one run, finish it by another, and count what the targets were and what was left over."""
    with tempfile.TemporaryDirectory(dir=home) as name:
        folder = Path(name)
        targets = way.list_targets(folder)
        for target in targets:
            target.write_bytes(OLD)
        command = way.make_command(sources, folder)
        counts = Counter({"killed" if kill(command, folder, moment) else "finished first": 1})
        counts["with something half written"] += any(path not in targets for path in folder.iterdir())
        counts.update(check_target(*each) for each in zip(targets, new, strict=True))
        subprocess.run(command, check=True, capture_output=True)
        counts["left over"] += sum(path not in targets for path in folder.iterdir())
        after = [check_target(*each) for each in zip(targets, new, strict=True)]
        counts["not new after the next run"] += sum(each != "new" for each in after)
        return counts


def main() -> None:
    """Kill, print and write what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path, default=RESULTS / "kills.json")
    options = parser.parse_args()
    found: dict[str, dict[str, int]] = {}
    for name, counts in run_kills(options.kills, options.seed):
        found[name] = dict(counts)
        print(f"{name}: {', '.join(f'{what} {count}' for what, count in counts.items())}", flush=True)
    write_json(options.output, {**describe_machine(), "seed": options.seed, "kills": options.kills, "ways": found})


if __name__ == "__main__":
    main()
