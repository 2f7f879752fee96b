"""Compiles the kernels of the catalogue ahead of time into one library per level of processors, with an index.

``python -m releasing.libraries build/kernels`` makes those of this machine's system; ``--system`` names another one.
The folder then holds what `lobewise.backend.prebuilt` reads. Object files are kept in the cache of kernels, so a second
run compiles only what has changed.

Libraries are linked by Zig's C compiler (the wheel ``ziglang``), which links for every system and for old versions of
glibc, or with ``--linker cc`` by the system's compiler for this system alone.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import string
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import halide as hl

from lobewise.backend import jit, prebuilt
from lobewise.backend.disk import fetch_object
from lobewise.backend.objects import compile_object
from lobewise.backend.sources import digest_definitions
from releasing.catalogue import list_kernels
from releasing.recording import Wanted
from releasing.systems import SYSTEMS, Level, System

PROCESSOR = Path(__file__).with_name("processor.c")
PROCESSES = 2
"""Kernels that are compiled at once."""
RUNTIME = "runtime"
"""Name of the runtime's object file; the others are named by kernels."""
RUNTIME_FUNCTIONS = ("halide_set_error_handler", "halide_set_custom_print", "halide_shutdown_thread_pool")
"""Functions of the runtime that Python calls (`lobewise.backend.runtime`)."""
_RUNTIME_NAME = re.compile(rb"(?<=\0)halide_\w+(?=\0)")
Described = tuple[str, list[Any]]
"""Name and packed parameters of a kernel."""
Compile = Callable[[str, Path], dict[str, Described]]


def name_target(system: System, level: Level) -> str:
    """Return the target of a level, as Halide writes it."""
    return str(hl.Target(system.make_target(level)))


def compile_for(wanted: Wanted, identity: str, target: str) -> tuple[bytes, Described]:
    """Return the object file of a kernel for a target, and its description."""
    chosen = hl.Target(target)
    if wanted.strict:
        chosen = chosen.with_feature(hl.TargetFeature.StrictFloat)
    symbol = prebuilt.name_symbol(identity)
    known = jit.describe_kernel(wanted.key, wanted.make)
    content, told = fetch_object(
        known and f"library {known} {chosen} {symbol}",
        lambda: jit.compile_kernel(wanted.make, chosen, symbol),
        symbol=f"{symbol}_argv",
    )
    # Through JSON and back: lists, as the index holds them.
    return content, (told["name"], json.loads(json.dumps(told["parameters"])))


def compile_runtime(target: str) -> bytes:
    """Return the object file of Halide's runtime for a target."""
    chosen = hl.Target(target)
    known = f"library runtime {version('halide')} {target}"
    content, _ = fetch_object(
        known, lambda: (compile_object(lambda path: hl.compile_standalone_runtime(path, chosen)), {})
    )
    return content


def compile_kernels(kernels: Mapping[str, Wanted], target: str, folder: Path) -> dict[str, Described]:
    """Write object files of kernels into a folder, and return the descriptions of the kernels."""
    found: dict[str, Described] = {}
    for identity, wanted in kernels.items():
        content, found[identity] = compile_for(wanted, identity, target)
        (folder / f"{identity}.o").write_bytes(content)
    return found


@cache
def _list_catalogue() -> dict[str, Wanted]:
    """Return the catalogue; each process records its own, because kernels hold functions that cannot be sent."""
    return list_kernels()


def _compile_share(target: str, folder: Path, share: int) -> dict[str, Described]:
    chosen = sorted(_list_catalogue().items())[share::PROCESSES]
    return compile_kernels(dict(chosen), target, folder)


def compile_catalogue(target: str, folder: Path) -> dict[str, Described]:
    """Write object files of the whole catalogue into a folder, by several processes."""
    _list_catalogue()
    with ProcessPoolExecutor(PROCESSES) as pool:
        shares = [pool.submit(_compile_share, target, folder, share) for share in range(PROCESSES)]
        return {identity: told for share in shares for identity, told in share.result().items()}


def link(system: System, level: Level, objects: Sequence[Path], output: Path, linker: Sequence[str]) -> None:
    """Link object files of kernels and runtime into a library that shows its kernels and its runtime."""
    is_zig = "ziglang" in linker
    command = [*linker, *(["-target", system.zig] if is_zig else []), f"-DLEVEL={level.number}", "-O2", "-shared", "-s"]
    sources = [PROCESSOR]
    if system.name.startswith("windows"):
        sources.append(write_exports(objects, output.with_suffix(".c")))
    else:
        command.append("-fPIC")
    if system.name.startswith("linux"):
        # A library's own functions call its own runtime, whatever else the process has loaded.
        command += ["-Wl,-Bsymbolic", "-Wl,-z,now", "-lpthread", "-ldl", "-lm"]
    listed = output.with_suffix(".rsp")
    listed.write_text("\n".join(f'"{each.as_posix()}"' for each in objects))
    try:
        subprocess.run([*command, "-o", str(output), *map(str, sources), f"@{listed}"], check=True)
    finally:
        for ending in ("rsp", "c", "pdb", "lib"):
            for rest in output.parent.glob(f"*.{ending}"):
                rest.unlink()


def write_exports(objects: Sequence[Path], path: Path) -> Path:
    """Write a C file that makes a library on Windows show its kernels and what they and Python call of the runtime."""
    names = set(RUNTIME_FUNCTIONS)
    for each in objects:
        if each.stem != RUNTIME:
            names |= {name.decode() for name in _RUNTIME_NAME.findall(each.read_bytes())}
            names.add(f"{prebuilt.name_symbol(each.stem)}_argv")
    lines = [rf'__asm__(".section .drectve,\"yn\"\n.ascii \" -export:{name}\"\n");' for name in sorted(names)]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def build_level(
    system: System, level: Level, folder: Path, linker: Sequence[str], compile_all: Compile
) -> dict[str, Described]:
    """Make the library of one level, and return the descriptions of its kernels."""
    target = name_target(system, level)
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        found = compile_all(target, work)
        (work / f"{RUNTIME}.o").write_bytes(compile_runtime(target))
        link(system, level, sorted(work.glob("*.o")), folder / f"{level.name}{system.suffix}", linker)
    return dict(sorted(found.items()))


def list_sources(kernels: Mapping[str, Wanted]) -> dict[str, str]:
    """Return the digests of all modules that define a part of a kernel, by their paths in the package."""
    names = {name for each in kernels.values() for name in jit.list_definitions(each.key, each.make)}
    root = prebuilt.PACKAGE_ROOT
    modules = {root.joinpath(*name.split(".")[1:-1]) for name in digest_definitions(names)}
    found = {each / "__init__.py" if each.is_dir() else each.with_suffix(".py") for each in modules}
    return {path.relative_to(root).as_posix(): prebuilt.digest_source(path) for path in sorted(found)}


def build(
    system: System,
    folder: Path,
    linker: Sequence[str],
    kernels: Mapping[str, Wanted],
    compile_all: Compile,
) -> None:
    """Make the libraries of a system and their index in a folder, which is emptied before.

    ``compile_all`` writes the object files of ``kernels`` for a target into a folder and returns their descriptions.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    levels: list[dict[str, Any]] = []
    described: dict[str, Described] = {}
    for level in system.levels:
        found = build_level(system, level, folder, linker, compile_all)
        described = described or found
        if found.keys() != described.keys():
            raise SystemExit(f"{level.name}: it has other kernels than {levels[0]['file']}")
        path = folder / f"{level.name}{system.suffix}"
        # Kernels that count by lanes have an entry for each lane.
        other = {identity: told for identity, told in found.items() if told != described[identity]}
        levels.append({"file": path.name, "target": name_target(system, level), "lanes": level.lanes, "kernels": other})
        print(f"{path}: {len(found)} kernels, {path.stat().st_size / 1e6:.1f} MB", flush=True)
    index = {
        "halide": version("halide"),
        "llvm": read_llvm_version(),
        "linker": f"ziglang {version('ziglang')}" if "ziglang" in linker else linker[0],
        "system": system.name,
        "wheel": system.tag,
        "levels": levels,
        "sources": list_sources(kernels),
        "kernels": described,
    }
    (folder / prebuilt.INDEX_NAME).write_text(json.dumps(index, separators=(",", ":")), encoding="utf-8")


def read_llvm_version() -> str:
    """Return the version of the LLVM that is part of Halide, from bitcode that it writes.

    Bitcode begins with the name of its producer: its length in 6 bits, then 6 bits for each letter (LLVM Bitcode File
    Format, "IDENTIFICATION_BLOCK" and "Char6").
    """
    x, kernel = hl.Var("x"), hl.Func("kernel")
    kernel[x] = x
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "kernel.bc")
        kernel.compile_to_bitcode(str(path), [], "kernel")
        bits = int.from_bytes(path.read_bytes()[:256], "little")
    letters = string.ascii_lowercase + string.ascii_uppercase + string.digits + "._"
    name = sum(letters.index(letter) << 6 * place for place, letter in enumerate("LLVM"))
    start = next(at for at in range(6, 2048) if bits >> at & 0xFFFFFF == name)
    length = bits >> start - 6 & 63
    return "".join(letters[bits >> start + 6 * place & 63] for place in range(4, length))


def choose_linker(name: str) -> list[str]:
    """Return the command of a linker: "zig" or the name of a C compiler."""
    return [sys.executable, "-m", "ziglang", "cc"] if name == "zig" else [name]


def main() -> None:
    """Make the libraries of one system."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the libraries; emptied before")
    parser.add_argument("--system", choices=sorted(SYSTEMS), default=prebuilt.name_system())
    parser.add_argument("--linker", default="zig", help='"zig", or a C compiler of this system')
    options = parser.parse_args()
    linker = choose_linker(options.linker)
    build(SYSTEMS[options.system], options.folder, linker, _list_catalogue(), compile_catalogue)


if __name__ == "__main__":
    main()
