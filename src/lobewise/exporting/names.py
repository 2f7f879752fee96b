"""Names of targets and shader languages, and the settings of an export; importing them costs nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from lobewise.errors import InputError
from lobewise.settings import LARGEST_RADIUS, MAX_LOBES, Declared, Form, Knob, Similarity, document
from lobewise.settings.choices import SIMILARITIES
from lobewise.settings.choices import Similarity as SimilarityRecord

MAX_NAME_LETTERS = 64
"""Longest prefix of exported files and functions."""
SHADER_LANGUAGES = ("hlsl", "glsl", "wgsl")
WEB = "web"
"""The target that is a page for browsers."""
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


@dataclass(frozen=True)
class ExportSettings(Declared):
    """The settings of a filter that are fixed when it is compiled."""

    similarity: Annotated[
        Similarity | Literal["diffuse"], Knob("What two pixels must share to be averaged, besides their places.")
    ] = "ggx"
    form: Annotated[Form, Knob("Which neighbours count.")] = "separable"
    radius: Annotated[
        int,
        Knob(
            'Pixels from the centre to the edge of the kernel; "atrous" does not use it.',
            high=LARGEST_RADIUS,
            usual="8 is usual",
        ),
    ] = 8
    lobes: Annotated[
        int,
        Knob(
            'With "sg_mixture": spherical Gaussians of a pixel.',
            low=2,
            high=MAX_LOBES,
            usual="3 stand for GGX within 1 %, and one is similarity 'sg'",
        ),
    ] = 3
    albedo: Annotated[
        bool, Knob("Whether the radiance is divided by an albedo before the filter and multiplied by it after.")
    ] = True
    anisotropic: Annotated[
        bool,
        Knob(
            'With "asg" and "ggx": lobes from two roughnesses and a tangent instead of one roughness.',
            opposite="isotropic",
        ),
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.anisotropic and not (self.record and self.record.has_covariance):
            raise InputError(
                "anisotropic lobes",
                expected="similarity 'asg' or 'ggx'",
                got=repr(self.similarity),
                action="choose one of them, or leave it out",
            )

    @property
    def record(self) -> SimilarityRecord | None:
        """The record of the similarity; None for "diffuse", which only exports have."""
        return SIMILARITIES.get(self.similarity)


document(ExportSettings)


def require_identifier(name: str, example: str) -> None:
    """Raise InputError unless a prefix of files and functions is an identifier of C of at most 64 letters."""
    if not name.isidentifier() or not name.isascii() or len(name) > MAX_NAME_LETTERS:
        raise InputError("--name", expected="an identifier of C", got=repr(name), action=f"such as {example}")
