"""The systems and levels of processors that libraries of kernels are made for."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Level:
    """A set of instructions.

    Parameters
    ----------
    name : str
        Name of the library's file.
    number : int
        Level of the x86-64 psABI (section 3.1.1); 0 for any processor of another kind.
    features : str
        Features of Halide's target.
    lanes : int
        Number of float32 in a vector.
    """

    name: str
    number: int
    features: str
    lanes: int


X86 = (
    Level("x86-64-v4", 4, "avx-avx2-avx512-avx512_skylake-f16c-fma-sse41", 16),
    Level("x86-64-v3", 3, "avx-avx2-f16c-fma-sse41", 8),
    Level("x86-64-v2", 2, "sse41", 4),
)
ARM = (Level("arm-64", 0, "", 4),)


@dataclass(frozen=True)
class System:
    """An operating system on a kind of processor.

    Parameters
    ----------
    name : str
        As `lobewise.backend.prebuilt.name_system` names it.
    halide : str
        First part of Halide's targets.
    levels : tuple of Level
        Levels of libraries, best first.
    zig : str
        Target of Zig's C compiler.
    tag : str
        Platform tag of wheels.
    suffix : str
        Suffix of libraries.
    """

    name: str
    halide: str
    levels: tuple[Level, ...]
    zig: str
    tag: str
    suffix: str = ".so"

    def make_target(self, level: Level) -> str:
        """Return Halide's target, without checks of buffers, as `lobewise.backend.devices.make_target` does."""
        return "-".join(part for part in (self.halide, level.features, "no_asserts-no_bounds_query") if part)


SYSTEMS = {
    each.name: each
    for each in (
        System("linux-x86-64", "x86-64-linux", X86, "x86_64-linux-gnu.2.28", "manylinux_2_28_x86_64"),
        System("linux-arm-64", "arm-64-linux", ARM, "aarch64-linux-gnu.2.28", "manylinux_2_28_aarch64"),
        System("windows-x86-64", "x86-64-windows", X86, "x86_64-windows-gnu", "win_amd64", ".dll"),
        System("macos-arm-64", "arm-64-osx", ARM, "aarch64-macos.11.0", "macosx_11_0_arm64", ".dylib"),
        System("macos-x86-64", "x86-64-osx", X86[1:], "x86_64-macos.10.15", "macosx_10_15_x86_64", ".dylib"),
    )
}
