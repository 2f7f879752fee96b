"""Names of targets and shader languages; importing them costs nothing."""

from __future__ import annotations

from lobewise.errors import InputError

MAX_NAME_LETTERS = 64
"""Longest prefix of exported files and functions."""
SHADER_LANGUAGES = ("hlsl", "glsl", "wgsl")
CHAINS = {
    "filter": "which filters every frame by itself",
    "history": "which joins it with the history of the frames before",
    "upsample": "which does so from one shaded pixel in every block",
}
"""The chains of compute passes, with what each does."""
TARGETS = (
    "host",
    "x86-64-linux",
    "x86-64-linux-avx2-fma",
    "x86-64-linux-avx512_skylake",
    "x86-64-osx-avx2-fma",
    "x86-64-windows-avx2-fma",
    "arm-64-linux",
    "arm-64-osx",
    "arm-64-ios",
    "arm-64-android",
    "arm-64-windows",
    "wasm-32-wasmrt-wasm_simd128",
    "x86-64-linux-avx2-fma-cuda",
    "x86-64-windows-avx2-fma-cuda",
    "x86-64-linux-avx2-fma-vulkan",
    "x86-64-windows-avx2-fma-vulkan",
    "arm-64-android-vulkan",
    "x86-64-linux-avx2-fma-opencl",
    "x86-64-windows-avx2-fma-d3d12compute",
    "arm-64-osx-metal",
    "arm-64-ios-metal",
    "wasm-32-wasmrt-wasm_simd128-webgpu",
    "x86-64-linux-avx2-fma-webgpu",
)
"""Targets that a test compiles for. Other targets that Halide knows are accepted too."""


def require_identifier(name: str, example: str) -> None:
    """Raise InputError unless a prefix of files and functions is an identifier of C of at most 64 letters."""
    if not name.isidentifier() or not name.isascii() or len(name) > MAX_NAME_LETTERS:
        raise InputError("--name", expected="an identifier of C", got=repr(name), action=f"such as {example}")
