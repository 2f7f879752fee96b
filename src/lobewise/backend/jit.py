"""Compiled kernels: made once on a machine, kept on disk, loaded and called.

Halide compiles a kernel to an object file, which takes a second or more; llvmlite loads that file, which takes some
milliseconds. What it was made from is part of its name: this package's sources, Halide's version, the target and the
kernel's key. Files lie in the folder that `find_cache_folder` returns; the environment variable ``LOBEWISE_CACHE``
names another one, or is ``off``. Kernels of features that were written elsewhere are compiled in every process, since
their sources are not known.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import sys
import tempfile
import threading
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any, Protocol

import halide as hl
import llvmlite.binding as llvm

from lobewise.backend.devices import VULKAN_BLOCK, VULKAN_MULTIPLE, make_target
from lobewise.errors import DeviceError, describe_problem

OLD_FILES = 4000
"""Files in the folder above which those that were not used for longest go."""
_SCALARS: dict[str, type[ctypes._SimpleCData[Any]]] = {
    "int32": ctypes.c_int32,
    "float32": ctypes.c_float,
    "float64": ctypes.c_double,
}
_CONSTRUCTORS = {
    "vulkan": ("register_vulkan_allocation_pool", "_GLOBAL__sub_I_vulkan.cpp"),
    "cuda": ("_GLOBAL__sub_I_cuda.cpp",),
    "metal": ("_GLOBAL__sub_I_metal.cpp",),
}
"""What initialises a device's part of the runtime; llvmlite runs no initialisers of object files."""
_RUNTIME_NAMES = re.compile(rb"(?<=\0)_?(halide_\w+)(?=\0)")
"""Names in an object file's table of symbols; some systems put a line before them."""
_Told = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p)


class Compilable(Protocol):
    """The scheduled functions of a kernel; ``out`` may be several."""

    @property
    def out(self) -> Any: ...

    @property
    def arguments(self) -> list[Any]: ...


@dataclass(frozen=True)
class Scheduled:
    """Scheduled functions and their parameters."""

    out: list[Any]
    arguments: list[Any]


class Kernel:
    """A loaded kernel, called with buffers and numbers in the order of its arguments, outputs last.

    Parameters
    ----------
    runtime : Runtime
        Of its device.
    address : int
        Of the function that takes one array of pointers to the arguments.
    kinds : sequence of str
        What each argument is: "buffer" or a name of Halide's types.
    notes : list
        What the maker of its functions wanted to be known of it.
    """

    def __init__(self, runtime: Runtime, address: int, kinds: Sequence[str], notes: Sequence[Any] = ()) -> None:
        self.notes = notes
        self._runtime = runtime
        self._function = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(address)
        self._kinds = tuple(kinds)

    def __call__(self, *arguments: Any) -> None:
        """Run it.

        Raises
        ------
        DeviceError
            If the device fails; what it wrote is then of no use.
        """
        if len(arguments) != len(self._kinds):
            raise TypeError(f"a kernel of {len(self._kinds)} arguments was given {len(arguments)}")
        # Held until the call has returned.
        held: list[Any] = [
            argument if kind == "buffer" else _SCALARS[kind](argument)
            for kind, argument in zip(self._kinds, arguments, strict=True)
        ]
        pointers = (ctypes.c_void_p * len(held))(
            *(
                each.address if kind == "buffer" else ctypes.addressof(each)
                for kind, each in zip(self._kinds, held, strict=True)
            )
        )
        self._runtime.call(self._function, pointers)


class Runtime:
    """Halide's runtime for a device, and the kernels that call it; one in a process."""

    def __init__(self, device: str) -> None:
        self.device = device
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        self._problems = threading.local()
        target = make_target(device)
        if device == "vulkan":
            # Read when the first kernel starts; see `lobewise.backend.devices`.
            values = ("0", str(VULKAN_BLOCK), "0", "0", str(VULKAN_MULTIPLE))
            os.environ.setdefault("HL_VK_ALLOC_CONFIG", os.pathsep.join(values))

        def compile_runtime(path: str) -> None:
            hl.compile_standalone_runtime(path, target)

        content, _ = fetch_object(f"runtime {target}", lambda: (_compile(compile_runtime), {}))
        self._engine = _load_object(content)
        self._loaded: list[Any] = []
        for name in _CONSTRUCTORS.get(device, ()):
            self.get("void", name)()
        self._handlers = _Told(self._keep_problem), _Told(lambda _, text: None)
        set_handler = ctypes.CFUNCTYPE(ctypes.c_void_p, _Told)
        for name, handler in zip(("halide_set_error_handler", "halide_set_custom_print"), self._handlers, strict=True):
            set_handler(self.find(name))(handler)

    def _keep_problem(self, _: object, text: bytes) -> None:
        self._problems.text = text.decode("utf-8", "replace").strip()

    def load(self, content: bytes, name: str) -> int:
        """Load an object file that calls the runtime, and return the address of a function of its own.

        Every file has an engine, and learns where the runtime's functions are as those of a foreign library, which it
        may call however far away they lie; within one engine it would have to lie within 2 GiB of them.
        """
        for told in set(_RUNTIME_NAMES.findall(content)):
            address = self._engine.get_function_address(told.decode())
            if address:
                llvm.add_symbol(told.decode(), address)
        engine = _load_object(content)
        self._loaded.append(engine)
        return _find_function(engine, name)

    def find(self, name: str) -> int:
        """Return the address of a function of the runtime."""
        return _find_function(self._engine, name)

    def get(self, result: str, name: str, *arguments: Any) -> Callable[..., Any]:
        """Return a function of the runtime that gives nothing ("void"), a code ("int") or a pointer."""
        results = {"void": None, "int": ctypes.c_int, "pointer": ctypes.c_void_p}
        return ctypes.CFUNCTYPE(results[result], *arguments)(self.find(name))

    def call(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Call a function that returns 0 if all went well.

        Raises
        ------
        DeviceError
            If it does not, or told a problem.
        """
        self._problems.text = ""
        code = function(*arguments)
        if code != 0 or self._problems.text:
            raise DeviceError(
                describe_problem(
                    "device",
                    expected=f"{self.device} to run a kernel",
                    got=self._problems.text or f"code {code}",
                    action="try a smaller image" + ("" if self.device == "cpu" else ", or --device cpu"),
                )
            )


def _load_object(content: bytes) -> Any:
    """Return an engine that holds an object file."""
    machine = llvm.Target.from_default_triple().create_target_machine()
    # llvmlite's memory manager lays the sections of a file side by side, so that they reach each other.
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine, use_lmm=True)
    engine.add_object_file(llvm.ObjectFileRef.from_data(content))
    engine.finalize_object()
    return engine


def _find_function(engine: Any, name: str) -> int:
    address = int(engine.get_function_address(name))
    if address == 0:
        raise LookupError(name)
    return address


_runtime_lock = threading.Lock()


def get_runtime(device: str) -> Runtime:
    """Return the runtime of a device, started now if it is the first time."""
    with _runtime_lock:
        return _start_runtime(device)


@cache
def _start_runtime(device: str) -> Runtime:
    return Runtime(device)


class _Kernels:
    """Kernels of this process; safe to use from several threads."""

    def __init__(self) -> None:
        self._kernels: dict[tuple[str, Hashable], Kernel] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kernels)

    def get(self, device: str, key: Hashable, make: Callable[[hl.Target], Compilable], strict: bool) -> Kernel:
        """Return the kernel of ``key``, which ``make`` gives the scheduled functions of."""
        with self._lock:
            if (device, key) not in self._kernels:
                target = make_target(device)
                if strict:
                    target = target.with_feature(hl.TargetFeature.StrictFloat)
                self._kernels[device, key] = _load(device, describe_key(key), target, make, len(self))
            return self._kernels[device, key]


_kernels = _Kernels()


def count_compiled_kernels() -> int:
    """Return how many kernels this process has loaded."""
    return len(_kernels)


def get_kernel(device: str, key: Hashable, make: Callable[[hl.Target], Compilable], *, strict: bool = False) -> Kernel:
    """Return a kernel, loaded or compiled now if it is the first of its ``key``; "strict" keeps the order of floats."""
    return _kernels.get(device, key, make, strict)


def _load(
    device: str, told: str | None, target: hl.Target, make: Callable[[hl.Target], Compilable], number: int
) -> Kernel:
    runtime = get_runtime(device)
    known = None if told is None else f"{told} {target}"
    name = "kernel_" + hashlib.sha256((known or f"{number}").encode()).hexdigest()[:24]

    def compile_kernel() -> tuple[bytes, dict[str, Any]]:
        funcs = make(target)
        outs = list(funcs.out) if isinstance(funcs.out, (list, tuple)) else [funcs.out]
        pipeline = hl.Pipeline(outs)
        bare = target.with_feature(hl.TargetFeature.NoRuntime)
        content = _compile(lambda path: pipeline.compile_to_object(path, funcs.arguments, name, bare))
        kinds = ["buffer" if isinstance(each, hl.ImageParam) else str(each.type()) for each in funcs.arguments]
        kinds += ["buffer"] * sum(len(out.output_buffers()) for out in outs)
        return content, {"kinds": kinds, "notes": getattr(funcs, "notes", [])}

    content, head = fetch_object(known, compile_kernel)
    return Kernel(runtime, runtime.load(content, f"{name}_argv"), head["kinds"], head["notes"])


def _compile(write: Callable[[str], None]) -> bytes:
    """Return the object file that ``write`` writes to a path."""
    with tempfile.TemporaryDirectory(prefix="lobewise-") as folder:
        path = Path(folder) / "kernel.o"
        write(str(path))
        return path.read_bytes()


def find_cache_folder() -> Path | None:
    """Return where compiled kernels are kept; None where nowhere."""
    named = os.environ.get("LOBEWISE_CACHE", "")
    if named == "off":
        return None
    if named:
        return Path(named)
    if sys.platform == "win32":
        root = os.environ.get("LOCALAPPDATA", "")
    elif sys.platform == "darwin":
        root = str(Path.home() / "Library" / "Caches")
    else:
        root = os.environ.get("XDG_CACHE_HOME", "") or str(Path.home() / ".cache")
    return Path(root) / "lobewise" if root else None


def fetch_object(known: str | None, make: Callable[[], tuple[bytes, dict[str, Any]]]) -> tuple[bytes, dict[str, Any]]:
    """Return an object file and what goes with it, from disk where it is there; ``known`` tells what it is made from.

    A file that cannot be read, or is not whole, is made again; one that cannot be written is done without.
    """
    folder = find_cache_folder()
    if known is None or folder is None:
        return make()
    path = folder / (hashlib.sha256(f"{_describe_sources()} {known}".encode()).hexdigest()[:40] + ".kernel")
    with suppress(OSError, ValueError, KeyError, TypeError):
        line, content = path.read_bytes().split(b"\n", 1)
        head = json.loads(line)
        if head["sha256"] == hashlib.sha256(content).hexdigest():
            os.utime(path)
            return content, head
    content, head = make()
    head = {**head, "sha256": hashlib.sha256(content).hexdigest()}
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=folder)
        with os.fdopen(handle, "wb") as file:
            file.write(json.dumps(head).encode() + b"\n" + content)
        os.replace(name, path)
        _remove_old(folder)
    return content, head


def _remove_old(folder: Path) -> None:
    """Remove the files that were not used for longest, where there are too many."""
    files = list(folder.glob("*.kernel"))
    if len(files) > OLD_FILES:
        for path in sorted(files, key=lambda path: path.stat().st_mtime)[: len(files) - OLD_FILES // 2]:
            path.unlink(missing_ok=True)


@cache
def _describe_sources() -> str:
    """Return what tells this version of everything that kernels are made from."""
    digest = hashlib.sha256(version("halide").encode())
    root = Path(__file__).parents[1]
    for path in sorted(
        path for room in ("lobes", "backend", "features", "guides", "filters") for path in (root / room).rglob("*.py")
    ):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def describe_key(key: Any) -> str | None:
    """Return a key as a text that is the same in every process; None where a part of it is not of this package."""
    if isinstance(key, (type, FunctionType)):
        named = f"{key.__module__}.{key.__qualname__}"
        return named if named.startswith("lobewise.") and "<" not in named else None
    if key is None or isinstance(key, (bool, int, float, str)):
        return repr(key)
    if isinstance(key, Enum):
        return describe_key((type(key), key.name))
    parts: list[Any]
    if isinstance(key, (tuple, list)):
        parts = list(key)
    elif is_dataclass(key):
        parts = [type(key), *(getattr(key, each.name) for each in fields(key))]
    else:
        return None
    told = [describe_key(part) for part in parts]
    return None if None in told else f"({', '.join(map(str, told))})"
