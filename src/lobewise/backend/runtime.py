"""Loads Halide's runtime for a device into this process, and the object files of kernels that call it.

The processor's runtime comes from the library of prebuilt kernels where the package has one.
"""

from __future__ import annotations

import ctypes
import os
import re
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from typing import Any

from lobewise.backend.compiler import hl, load_llvm, look_up_version
from lobewise.backend.devices import VULKAN_BLOCK, VULKAN_MULTIPLE, make_target
from lobewise.backend.disk import fetch_object
from lobewise.backend.objects import compile_object
from lobewise.backend.prebuilt import choose_library
from lobewise.errors import DeviceError
from lobewise.work.chunks import ForkGate, make_fork_lock

_CONSTRUCTORS = {
    "vulkan": ("register_vulkan_allocation_pool", "_GLOBAL__sub_I_vulkan.cpp"),
    "cuda": ("_GLOBAL__sub_I_cuda.cpp",),
    "metal": ("_GLOBAL__sub_I_metal.cpp",),
}
"""Functions that initialise the runtime of a device: llvmlite does not run the initialisers of object files."""
_RUNTIME_NAMES = re.compile(rb"(?<=\0)_?(halide_\w+)(?=\0)")
"""Names of the runtime in an object file's symbol table; some systems put an underscore before them."""
_Told = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p)


class Runtime:
    """Halide's runtime for a device, and the kernels that call it; one per process and device."""

    def __init__(self, device: str) -> None:
        self.device = device
        self._problems = threading.local()
        if device == "vulkan":
            # The runtime reads the variable when the first kernel starts; see `lobewise.backend.devices`.
            values = ("0", str(VULKAN_BLOCK), "0", "0", str(VULKAN_MULTIPLE))
            os.environ.setdefault("HL_VK_ALLOC_CONFIG", os.pathsep.join(values))
        library = choose_library() if device == "cpu" else None
        self.find = library.find if library else partial(_look_up_function, _compile_runtime(device))
        """Returns the address of a function of the runtime; raises LookupError if there is none of this name."""
        self._loaded: list[Any] = []
        for name in _CONSTRUCTORS.get(device, ()):
            self.get("void", name)()
        self._handlers = _Told(self._keep_problem), _Told(lambda _, text: None)
        set_handler = ctypes.CFUNCTYPE(ctypes.c_void_p, _Told)
        for name, handler in zip(("halide_set_error_handler", "halide_set_custom_print"), self._handlers, strict=True):
            set_handler(self.find(name))(handler)
        self._gate = ForkGate(self.get("void", "halide_shutdown_thread_pool"))

    def _keep_problem(self, _: object, text: bytes) -> None:
        self._problems.text = text.decode("utf-8", "replace").strip()

    def load(self, content: bytes, name: str) -> int:
        """Load an object file that calls the runtime, and return the address of a function of the file.

        Each file has its own engine. It calls the runtime's functions by their addresses, so it may lie anywhere in
        memory. Within one engine a file must lie within 2 GiB of the runtime.
        """
        for symbol in set(_RUNTIME_NAMES.findall(content)):
            # Kernels may also mention names of the runtimes of other devices.
            with suppress(LookupError):
                load_llvm().add_symbol(symbol.decode(), self.find(symbol.decode()))
        engine = _load_object(content)
        self._loaded.append(engine)
        return _look_up_function(engine, name)

    def get(self, result: str, name: str, *arguments: Any) -> Callable[..., Any]:
        """Return a function of the runtime; ``result`` is "void", "int" for a code, or "pointer" for an address."""
        results = {"void": None, "int": ctypes.c_int, "pointer": ctypes.c_void_p}
        return ctypes.CFUNCTYPE(results[result], *arguments)(self.find(name))

    def call(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Call a function that returns 0 for success.

        Raises
        ------
        DeviceError
            If it returns another code or reports a problem.
        """
        self._problems.text = ""
        with self._gate.enter():
            code = function(*arguments)
        if code != 0 or self._problems.text:
            raise DeviceError(
                "device",
                expected=f"{self.device} to run a kernel",
                got=self._problems.text or f"code {code}",
                action="try a smaller image" + ("" if self.device == "cpu" else ", or --device cpu"),
            )


def _compile_runtime(device: str) -> Any:
    """Return an engine with Halide's runtime for a device, compiled on first use on a machine."""
    target = make_target(device)
    known = f"runtime {look_up_version()} {target}"

    def write(path: str) -> None:
        hl.compile_standalone_runtime(path, target)

    content, _ = fetch_object(known, lambda: (compile_object(write), {}), symbol="halide_error")
    # llvmlite's memory manager ends the process on the runtime of CUDA.
    return _load_object(content, side_by_side=device != "cuda")


def _load_object(content: bytes, *, side_by_side: bool = True) -> Any:
    """Return an engine with an object file loaded. The file must be whole: otherwise LLVM ends the process.

    With ``side_by_side`` the sections of the file are near enough to reach each other, in however large a process.
    """
    llvm = load_llvm()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine, use_lmm=side_by_side)
    engine.add_object_file(llvm.ObjectFileRef.from_data(content))
    engine.finalize_object()
    return engine


def _look_up_function(engine: Any, name: str) -> int:
    address = int(engine.get_function_address(name))
    if address == 0:
        raise LookupError(name)
    return address


_runtime_lock = make_fork_lock()


def get_runtime(device: str) -> Runtime:
    """Return the runtime of a device, started on first use."""
    with _runtime_lock:
        return _start_runtime(device)


@cache
def _start_runtime(device: str) -> Runtime:
    return Runtime(device)
