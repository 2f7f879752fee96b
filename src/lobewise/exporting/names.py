"""What can be exported, by name; importing it costs nothing."""

from __future__ import annotations

SHADER_LANGUAGES = ("hlsl", "glsl", "wgsl")
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
"""Targets that a test compiles for. Others of these processors and systems are tried as well."""
