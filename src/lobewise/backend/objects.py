"""Object files of machine code: compiled in memory, and checked before LLVM loads them.

LLVM's loader ends the process if a file is damaged. Halide's compiler ends the process if the disk is full, and leaves
its file behind; so on Linux it writes to memory. Halide 21 still makes an empty folder in ``/tmp`` for every kernel,
whatever TMPDIR says.
"""

from __future__ import annotations

import os
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

from lobewise.backend.compiler import hl, refuse_folder

_ELF_HEADER_BYTES, _ELF_SECTION_BYTES = 64, 64
_ELF_NO_BITS = 8
"""Type of a section without bytes in the file."""
_OTHER_MAGIC = (b"\xcf\xfa\xed\xfe", b"\x64\x86", b"\x64\xaa")
"""First bytes of object files on macOS, and on Windows for x86-64 and ARM."""


def compile_object(write: Callable[[str], None]) -> bytes:
    """Return the object file that ``write`` writes to a path.

    Raises
    ------
    OSError
        If the file that was written is not a whole object file.
    FileError
        If Halide cannot make its temporary folder.
    """
    try:
        content = catch_file(write)
    except hl.HalideError as problem:
        if "temp directory" not in str(problem):
            raise
        raise refuse_folder() from problem
    if not is_object(content):
        raise OSError("the compiler wrote no whole object file; is the disk full?")
    return content


def catch_file(write: Callable[[str], None]) -> bytes:
    """Return the bytes that ``write`` writes to a path."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("lobewise-kernel")
        with os.fdopen(descriptor, "rb") as file:
            write(f"/proc/self/fd/{descriptor}")
            file.seek(0)
            return file.read()
    with tempfile.TemporaryDirectory(prefix="lobewise-") as folder:
        path = Path(folder) / "kernel.o"
        write(str(path))
        return path.read_bytes()


def is_object(content: bytes, symbol: str = "") -> bool:
    """Return whether bytes are a whole object file that contains ``symbol``; damage inside sections is not detected."""
    if symbol.encode() + b"\0" not in content:
        return False
    if content.startswith(b"\x7fELF"):
        return _is_whole_elf(content)
    return len(content) > _ELF_HEADER_BYTES and content.startswith(_OTHER_MAGIC)


def _is_whole_elf(content: bytes) -> bool:
    """Return whether every section of a 64-bit little-endian ELF file lies inside it.

    Source: "ELF-64 Object File Format", version 1.5, sections 3 and 4.
    """
    if len(content) < _ELF_HEADER_BYTES or content[4:6] != b"\x02\x01":
        return False
    kind = struct.unpack_from("<H", content, 16)[0]
    start = struct.unpack_from("<Q", content, 40)[0]
    size, count, names = struct.unpack_from("<HHH", content, 58)
    if kind != 1 or size != _ELF_SECTION_BYTES or not 0 < names < count:
        return False
    if start < _ELF_HEADER_BYTES or start + count * size > len(content):
        return False
    for index in range(count):
        section_type, *_ = struct.unpack_from("<I", content, start + index * size + 4)
        offset, length = struct.unpack_from("<QQ", content, start + index * size + 24)
        if section_type != _ELF_NO_BITS and offset + length > len(content):
            return False
    return True
