"""Whole-process times: what the program's help takes, and `lobewise denoise` of an EXR file beside `oidnDenoise`.

Both denoisers get the same pixels of `showroom`, 1920x1080, 1 sample per pixel: lobewise as the file that `lobewise
render` writes, `oidnDenoise` (inside the `pyoidn` wheel) as the PFM files that it reads: colour, albedo and normal,
declared clean. All candidates run in turn and the best time of each counts. "first run" has an empty cache of kernels,
"again" the cache that the first run left. The frame lies in the cache of `quality/measure.py`.

    python -m benchmarks.performance.startup -o benchmarks/results/startup.json
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.quality.frames import Bench
from benchmarks.quality.measure import CACHE
from lobewise.cli.bench.timing import time_best
from lobewise.interchange import describe_file, read_image
from lobewise.io.exr import write_frame
from lobewise.peers import has_oidn
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance

RESULT = RESULTS / "startup.json"
SIZE = (1920, 1080)
HELP = {
    "python -c pass": [sys.executable, "-c", "pass"],
    "python -c 'import typer, rich'": [sys.executable, "-c", "import typer, rich"],
    "python -c 'import numpy'": [sys.executable, "-c", "import numpy"],
    "lobewise --version": ["lobewise", "--version"],
    "lobewise --help": ["lobewise", "--help"],
    "lobewise denoise --help": ["lobewise", "denoise", "--help"],
}
PYTHON = next(iter(HELP))
METHODS: dict[str, list[str]] = {
    "fast, sg, separable": ["--quality", "fast", "--similarity", "sg", "--form", "separable"],
    "fast, sg": ["--quality", "fast", "--similarity", "sg"],
    "fast, ggx": ["--quality", "fast", "--similarity", "ggx"],
    "balanced": ["--quality", "balanced"],
    "high": ["--quality", "high"],
}
LEAN = ("fast, sg, separable", "fast, sg", "fast, ggx")
"""Those that also run on a file with nothing in it but what they look at."""
OIDN = {"oidnDenoise": "default", "oidnDenoise -q fast": "fast"}
GUIDES = ("depth", "normal", "tangent", "alpha_u", "alpha_v", "lobe_kind", "diffuse_albedo", "specular_albedo")
"""What the plain filter looks at; positions follow from depth and camera."""


def locate_oidn() -> Path:
    """Return the program `oidnDenoise` of the installed wheel."""
    spec = find_spec("pyoidn")
    name = "oidnDenoise.exe" if os.name == "nt" else "oidnDenoise"
    return next(Path(spec.origin).parent.rglob(name))


def write_pfm(path: Path, image: FloatArray) -> None:
    """Write an image as `oidnDenoise` reads it: rows from below, little-endian floats."""
    height, width, _ = image.shape
    with path.open("wb") as stream:
        stream.write(f"PF\n{width} {height}\n-1.0\n".encode("ascii"))
        stream.write(np.ascontiguousarray(image[::-1], dtype="<f4").tobytes())


def read_pfm(path: Path) -> FloatArray:
    """Return such an image."""
    with path.open("rb") as stream:
        assert stream.readline() == b"PF\n"
        width, height = map(int, stream.readline().split())
        assert float(stream.readline()) < 0.0
        return np.frombuffer(stream.read(), dtype="<f4").reshape(height, width, 3)[::-1]


def write_inputs(frame: Frame, folder: Path) -> None:
    """Write the frame without what the plain filter ignores, and the images that `oidnDenoise` takes."""
    guides = frame.gbuffer
    few = GBuffer(**{name: getattr(guides, name) for name in GUIDES})
    light = Radiance(frame.radiance.color, diffuse=frame.radiance.diffuse, specular=frame.radiance.specular)
    write_frame(folder / "lean.exr", Frame(light, few, frame.camera, spp=frame.spp))
    write_pfm(folder / "color.pfm", frame.radiance.color)
    write_pfm(folder / "albedo.pfm", np.clip(guides.diffuse_albedo + guides.specular_albedo, 0.0, 1.0))
    write_pfm(folder / "normal.pfm", guides.normal)


def describe_input(path: Path) -> dict[str, Any]:
    """Return how large a file is."""
    found = describe_file(path)
    return {"megabytes": round(1e-6 * found.bytes, 1), "channels": sum(len(part.channels) for part in found.parts)}


def run_program(command: Sequence[str], caches: Path | None = None) -> str:
    """Run a program to its end and return what it printed; ``caches`` is where it keeps its kernels."""
    environment = dict(os.environ) if caches is None else {**os.environ, "LOBEWISE_CACHE": str(caches)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed: {done.stdout}{done.stderr}")
    return done.stdout


def time_help(seconds: float) -> dict[str, Any]:
    """Return the times of the program's help, as milliseconds and over that of a Python that does nothing."""

    def make_call(command: Sequence[str]) -> Callable[[], Any]:
        return lambda: run_program(command)

    best = time_best({name: make_call(command) for name, command in HELP.items()}, seconds)
    return {
        name: {"milliseconds": round(1e3 * value, 1), "ratio_to_python": round(value / best[PYTHON], 2)}
        for name, value in best.items()
    }


def time_denoising(source: Path, folder: Path, rounds: int) -> dict[str, Any]:
    """Return the times of every method on the whole file and on the lean one, and those of `oidnDenoise`."""
    caches, empty = folder / "caches", folder / "empty"
    inside: dict[str, float] = {}

    def make_call(name: str, file: Path, options: Sequence[str], *, first: bool) -> Callable[[], Any]:
        command = ["lobewise", "denoise", str(file), "-o", str(folder / f"{name}.exr"), *options]

        def call() -> None:
            if first:
                shutil.rmtree(empty, ignore_errors=True)
            told = run_program(command, empty if first else caches)
            found = re.search(r"([\d.]+) s[.;]", told)
            assert found is not None, told
            inside[name] = min(inside.get(name, float("inf")), float(found[1]))

        return call

    calls: dict[str, Callable[[], Any]] = {}
    for name, options in METHODS.items():
        for first in (True, False):
            title = f"{name}, {'first run' if first else 'again'}"
            calls[title] = make_call(title, source, options, first=first)
        if name in LEAN:
            title = f"{name}, again, lean file"
            calls[title] = make_call(title, folder / "lean.exr", options, first=False)
    if has_oidn():
        for name, quality in OIDN.items():
            calls[name] = make_oidn_call(folder, quality)
    best = time_best(calls, 0.0, rounds=rounds)
    check_outputs(folder, source)
    found = {name: {"seconds": round(value, 3)} for name, value in best.items()}
    for name, row in found.items():
        if name in inside:
            row["seconds_filtering"] = inside[name]
        for peer in OIDN:
            if peer in best:
                row[f"times {peer}"] = round(best[peer] / best[name], 3)
    return found


def make_oidn_call(folder: Path, quality: str) -> Callable[[], Any]:
    """Return what runs `oidnDenoise` at a quality."""
    command = [str(locate_oidn()), "-q", quality, "--clean_aux", "-o", str(folder / f"oidn-{quality}.pfm")]
    for option, name in (("--hdr", "color"), ("--alb", "albedo"), ("--nrm", "normal")):
        command += [option, str(folder / f"{name}.pfm")]
    return lambda: run_program(command)


def check_outputs(folder: Path, source: Path) -> None:
    """Stop where a program has not denoised the same pixels: all must be near each other, and off the input."""
    noisy = read_image(source)
    outputs = {path.name: read_image(path) for path in folder.glob("*, again*.exr")}
    outputs |= {path.name: read_pfm(path) for path in folder.glob("oidn-*.pfm")}
    for name, image in outputs.items():
        assert image.shape == noisy.shape, name
        # Totals of light agree to some percent, pixels do not.
        assert abs(image.mean() / noisy.mean() - 1.0) < 0.1, name
        assert np.abs(image - noisy).mean() > 0.05 * noisy.mean(), name


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    parser.add_argument("--cache", type=Path, default=CACHE, help=f"folder of the frame ({CACHE})")
    parser.add_argument("--seconds", type=float, default=20.0, help="least time for the help (20)")
    parser.add_argument("--rounds", type=int, default=2, help="rounds of denoising (2)")
    chosen = parser.parse_args(arguments)
    cache = chosen.cache.expanduser()
    cache.mkdir(parents=True, exist_ok=True)
    bench = Bench(cache)
    frame = bench.fetch_wide(*SIZE)
    result: Mapping[str, Any] = {
        "what": "best wall time of a whole process; all candidates of a table in turn",
        "version": lobewise.__version__,
        "machine": describe_machine(),
        "help": time_help(chosen.seconds),
    }
    for name, row in result["help"].items():
        print(f"{name:32} {row['milliseconds']:7.1f} ms  {row['ratio_to_python']:6.2f}", flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_inputs(frame, folder)
        source = cache / f"showroom-1-1-{SIZE[0]}x{SIZE[1]}.exr"
        times = time_denoising(source, folder, chosen.rounds)
        files = {"whole": describe_input(source), "lean": describe_input(folder / "lean.exr")}
    for name, row in times.items():
        print(f"{name:40} {row['seconds']:7.2f} s  {row}", flush=True)
    write_json(chosen.output, {**result, "width": SIZE[0], "height": SIZE[1], "files": files, "denoise": times})


if __name__ == "__main__":
    main()
