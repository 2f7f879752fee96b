"""Kernels: compiled once per machine, cached on disk, loaded, and called with named arguments.

The kernels that come with the package are used where they are there (`lobewise.backend.prebuilt`). Others are compiled:
Halide compiles a kernel to an object file, which takes a second or more; llvmlite loads that file, which takes some
milliseconds. The name of a kernel's file tells what it was made from: the definitions that its maker refers to
(`lobewise.backend.sources`), Halide's version, the target and the kernel's key. Kernels of features that other packages
define are compiled in every process, because their code is not known.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields, is_dataclass
from enum import Enum
from functools import cache, partial
from numbers import Integral
from types import FunctionType, MappingProxyType
from typing import Any

from lobewise.backend.buffers import Image, lend, make_output
from lobewise.backend.compiler import has_compiler, hl, look_up_version, refuse_compiling
from lobewise.backend.devices import make_target
from lobewise.backend.disk import fetch_object
from lobewise.backend.objects import compile_object
from lobewise.backend.prebuilt import choose_library, name_symbol
from lobewise.backend.runtime import Runtime, get_runtime
from lobewise.backend.signature import (
    Parameter,
    Signature,
    check_call,
    list_axis_lengths,
    list_outputs,
    unpack_parameters,
)
from lobewise.backend.sources import PACKAGE, describe_definitions
from lobewise.backend.watching import tell_compiling
from lobewise.work.chunks import make_fork_lock
from lobewise.work.limits import check_limits

_SCALARS: dict[str, type[ctypes._SimpleCData[Any]]] = {
    "int32": ctypes.c_int32,
    "float32": ctypes.c_float,
    "float64": ctypes.c_double,
}


@dataclass(frozen=True)
class Scheduled:
    """The scheduled functions of a kernel, in the order of its signature's outputs, and its signature."""

    out: list[Any]
    signature: Signature


class Kernel:
    """A loaded kernel.

    Parameters
    ----------
    runtime : Runtime
        Runtime of the kernel's device.
    address : int
        Address of the function, which takes one array of pointers to the arguments.
    name : str
        Name for messages.
    parameters : sequence of Parameter
        Parameters in the order of the function's arguments.
    """

    def __init__(self, runtime: Runtime, address: int, name: str, parameters: Sequence[Parameter]) -> None:
        self._runtime = runtime
        self._function = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(address)
        self.name = name
        self.parameters = tuple(parameters)
        self.outputs = list_outputs(parameters)
        self._accepted: set[Hashable] = set()

    def list_shapes(self, **sizes: int) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the output images by name; ``sizes`` are the lengths of named axes."""
        return {
            each.name: tuple(sizes[axis] if isinstance(axis, str) else axis for axis in each.axes)
            for each in self.outputs
        }

    def __call__(self, **arguments: Any) -> None:
        """Run the kernel with buffers (`lobewise.backend.buffers`) and numbers.

        Raises
        ------
        TypeError
            If a name is missing or unknown, or an image is not of the type, size or layout that the kernel relies on.
        DeviceError
            If the device fails. The outputs are then undefined.
        """
        check_limits()
        # Everything that `check_call` examines: calls of one description have one result.
        layout = tuple(
            (name, getattr(value, "layout", None) or (value if isinstance(value, Integral) else type(value)))
            for name, value in arguments.items()
        )
        if layout not in self._accepted:
            check_call(self.name, self.parameters, arguments)
            self._accepted.add(layout)
        # Keep all arguments alive until the call has returned.
        held: list[Any] = [
            _SCALARS[each.type](arguments[each.name]) if each.role == "number" else arguments[each.name]
            for each in self.parameters
        ]
        pointers = (ctypes.c_void_p * len(held))(
            *(
                ctypes.addressof(argument) if each.role == "number" else argument.address
                for each, argument in zip(self.parameters, held, strict=True)
            )
        )
        self._runtime.call(self._function, pointers)


_kernels: dict[tuple[str, Hashable], Kernel] = {}
_kernels_lock = make_fork_lock()


def count_compiled_kernels() -> int:
    """Return the number of kernels that this process has loaded."""
    return len(_kernels)


def get_kernel(device: str, key: Hashable, make: Callable[[hl.Target], Scheduled], *, strict: bool = False) -> Kernel:
    """Return the kernel of a key, loaded or compiled on first use; ``strict`` forbids reordering of float operations.

    Several threads may call at once.
    """
    with _kernels_lock:
        if (device, key) not in _kernels:
            bundled = _look_up_prebuilt(key, make, strict=strict) if device == "cpu" else None
            _kernels[device, key] = bundled or _compile_or_load(device, key, make, strict=strict)
        return _kernels[device, key]


def _look_up_prebuilt(key: Hashable, make: Callable[..., Any], *, strict: bool) -> Kernel | None:
    """Return a kernel of the library that came with the package; None if it must be compiled here.

    Raises MissingDependencyError if it must be compiled and no compiler is installed.
    """
    library, identity = choose_library(), identify_kernel(key, make, strict=strict)
    if library is not None and identity is not None and identity in library.kernels:
        name, parameters = library.kernels[identity]
        address = library.find(f"{name_symbol(identity)}_argv")
        return Kernel(get_runtime("cpu"), address, name, unpack_parameters(parameters))
    if has_compiler():
        return None
    parts = sorted(name.removeprefix(f"{PACKAGE}.") for name in list_definitions(key, make) - {_OWN_PART})
    raise refuse_compiling(f"one of {' and '.join(parts)}")


def _compile_or_load(device: str, key: Hashable, make: Callable[..., Any], *, strict: bool) -> Kernel:
    target = make_target(device)
    if strict:
        target = target.with_feature(hl.TargetFeature.StrictFloat)
    known = describe_kernel(key, make)
    return _load(device, known and f"{known} {target}", target, make, len(_kernels))


def run_kernel(
    kernel: Kernel,
    device: str,
    images: Mapping[str, Image],
    sizes: Mapping[str, int] = MappingProxyType({}),
    into: Image | None = None,
    /,
    **numbers: float,
) -> dict[str, Image]:
    """Run a kernel and return its outputs, in the order of its signature.

    Parameters
    ----------
    kernel : Kernel
        Every named axis of its outputs must also be an axis of an input, or one of ``sizes``.
    device : str
        Device of the kernel.
    images : mapping of str to Image
        Input images by name; see `lobewise.backend.buffers.take_image`.
    sizes : mapping of str to int
        Lengths of named axes that no input has.
    into : Image, optional
        Memory of the only output.
    **numbers
        Numbers by name.

    Raises
    ------
    TypeError
        If a name is missing or unknown, or an image is not of the type, size or layout that the kernel relies on.
    DeviceError
        If the device fails or runs out of memory.
    """
    axes = {**list_axis_lengths(kernel.parameters, images), **sizes}
    types = {each.name: each.type for each in kernel.outputs}
    shapes = kernel.list_shapes(**axes)
    # Keep every buffer in a local name until the call has returned: Halide holds no reference.
    lent = {name: lend(image, device) for name, image in images.items()}
    if into is None:
        outputs = {name: make_output(shape, device, type=types[name]) for name, shape in shapes.items()}
    else:
        outputs = {kernel.outputs[0].name: (lend(into, device), into)}
    kernel(**lent, **numbers, **{name: buffer for name, (buffer, _) in outputs.items()})
    return {name: image for name, (_, image) in outputs.items()}


def _load(
    device: str, known: str | None, target: hl.Target, make: Callable[[hl.Target], Scheduled], number: int
) -> Kernel:
    runtime = get_runtime(device)
    symbol = "kernel_" + hashlib.sha256((known or f"{number}").encode()).hexdigest()[:24]
    content, head = fetch_object(known, lambda: compile_kernel(make, target, symbol), symbol=f"{symbol}_argv")
    return Kernel(runtime, runtime.load(content, f"{symbol}_argv"), head["name"], unpack_parameters(head["parameters"]))


def compile_kernel(
    make: Callable[[hl.Target], Scheduled], target: hl.Target, symbol: str
) -> tuple[bytes, dict[str, Any]]:
    """Return a kernel's object file, and its name and parameters as JSON keeps them."""
    with tell_compiling():
        funcs = make(target)
        pipeline = hl.Pipeline(funcs.out)
        bare = target.with_feature(hl.TargetFeature.NoRuntime)
        arguments = funcs.signature.arguments
        content = compile_object(lambda path: pipeline.compile_to_object(path, arguments, symbol, bare))
    return content, {
        "name": funcs.signature.name,
        "parameters": [astuple(each) for each in funcs.signature.parameters],
    }


_OWN_PART = f"{__name__}.{compile_kernel.__name__}"
"""The part of this module that every kernel is made by."""


def describe_kernel(key: Hashable, make: Callable[..., Any]) -> str | None:
    """Return a text that identifies a kernel's code in all processes; None if a part is not of this package."""
    described = describe_key(key)
    names = list_definitions(key, make)
    if described is None or not _are_own(names):
        return None
    return f"{look_up_version()} {_describe_definitions(names)} {described}"


def identify_kernel(key: Hashable, make: Callable[..., Any], *, strict: bool) -> str | None:
    """Return a name that a kernel has among all of one version of this package; None if a part is not of it."""
    described = describe_key(key)
    if described is None or not _are_own(list_definitions(key, make)):
        return None
    return hashlib.sha256(f"{_name_maker(make)} {described} {strict}".encode()).hexdigest()[:24]


def _are_own(names: Iterable[str]) -> bool:
    return all(name.startswith(f"{PACKAGE}.") for name in names)


_describe_definitions = cache(describe_definitions)


def list_definitions(key: Hashable, make: Callable[..., Any]) -> frozenset[str]:
    """Return the full names of the definitions that a kernel is made from, without those that they refer to."""
    return frozenset({_OWN_PART, _name_maker(make), *_list_definitions(key)})


def _name_maker(make: Callable[..., Any]) -> str:
    while isinstance(make, partial):
        make = make.func
    return _name_definition(make)


def _name_definition(definition: Any) -> str:
    """Return the full name of the statement of a module that holds a class or function."""
    first = definition.__qualname__.partition(".")[0]
    return str(definition.__module__) if "<" in first else f"{definition.__module__}.{first}"


def _list_definitions(key: Any) -> Iterator[str]:
    """Yield the full names of all classes and functions in a key."""
    if isinstance(key, (type, FunctionType)):
        yield _name_definition(key)
    elif isinstance(key, (tuple, list)):
        for part in key:
            yield from _list_definitions(part)
    elif isinstance(key, Enum):
        yield _name_definition(type(key))
    elif is_dataclass(key):
        yield from _list_definitions((type(key), *(getattr(key, each.name) for each in fields(key))))


def describe_key(key: Any) -> str | None:
    """Return a text that identifies a key in all processes; None if a part is not of this package."""
    if isinstance(key, (type, FunctionType)):
        named = f"{key.__module__}.{key.__qualname__}"
        return named if named.startswith(f"{PACKAGE}.") and "<" not in named else None
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
    described = [describe_key(part) for part in parts]
    return None if None in described else f"({', '.join(map(str, described))})"
