"""Run every form of filter with pages around all images of kernels that may be neither read nor written.

    python -m tests.filters.guarded FORM end|start|beyond ...

An access beyond an image ends the process by a signal. "end" puts images right before such a page, "start" right behind
one; "beyond" gives kernels images that end one value earlier than they are told, to show that the pages catch it.
"""

from __future__ import annotations

import ctypes
import mmap
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

import lobewise
from lobewise.backend import jit
from lobewise.backend.buffers import Buffer
from lobewise.camera import Camera
from lobewise.frame import Frame, GBuffer, Radiance

PAGE = mmap.PAGESIZE
NO_ACCESS, READ_AND_WRITE = 0, 3
HEIGHT, WIDTH = 19, 45
"""No multiple of a vector's lanes, a strip or a tile."""
_RUN = jit.Kernel.__call__
_libc = ctypes.CDLL(None, use_errno=True)
_libc.mprotect.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)


class Guarded:
    """Memory between two pages that may not be touched, flush with one of them."""

    def __init__(self, size: int, side: str) -> None:
        pages = -(-size // PAGE) * PAGE
        self._map = mmap.mmap(-1, pages + 2 * PAGE)
        whole = np.frombuffer(self._map, np.uint8)
        self._start = whole.ctypes.data
        self._pages = pages
        first = PAGE if side == "start" else PAGE + pages - size
        self.bytes = whole[first : first + size]
        self._protect(NO_ACCESS)

    def _protect(self, access: int) -> None:
        for start in (self._start, self._start + PAGE + self._pages):
            if _libc.mprotect(start, PAGE, access) != 0:
                raise OSError(ctypes.get_errno(), "mprotect")


def guard_kernels(side: str) -> list[str]:
    """Let every kernel of this process work on guarded copies of its images; return the names of those that ran."""
    called: list[str] = []
    run = _RUN

    def run_guarded(self: jit.Kernel, **arguments: Any) -> None:
        memory: dict[tuple[int, int], Guarded] = {}
        copies: dict[str, Buffer] = {}
        for name, value in arguments.items():
            array = getattr(value, "array", None)
            if array is None:
                continue
            low, high = _find_span(array)
            if (low, high) not in memory:
                size = high - low - (array.itemsize if side == "beyond" else 0)
                guarded = Guarded(size, side)
                ctypes.memmove(guarded.bytes.ctypes.data, low, size)
                memory[low, high] = guarded
            # By its address, since NumPy would refuse memory that is too short.
            told = (ctypes.c_uint8 * (high - low)).from_address(memory[low, high].bytes.ctypes.data)
            inside = np.ndarray(array.shape, array.dtype, told, array.ctypes.data - low, array.strides)
            copies[name] = Buffer(inside, value.first)
        run(self, **{**arguments, **copies})
        for each in self.outputs:
            arguments[each.name].array[...] = copies[each.name].array
        called.append(self.name)

    jit.Kernel.__call__ = run_guarded  # type: ignore[method-assign]
    return called


def _find_span(array: np.ndarray) -> tuple[int, int]:
    """Return the addresses of the first byte of an array and of the one behind its last."""
    steps = [(length - 1) * stride for length, stride in zip(array.shape, array.strides, strict=True)]
    start = array.ctypes.data
    low, high = start + sum(min(step, 0) for step in steps), start + sum(max(step, 0) for step in steps)
    return low, high + array.itemsize


def make_frame() -> Frame:
    """Return a noisy frame with halves, whose guides change from pixel to pixel."""
    rng = np.random.default_rng(3)
    camera = Camera(position=(0.0, 1.0, 4.0), forward=(0.0, -0.4, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.4)
    rays = camera.make_ray_directions(WIDTH, HEIGHT).astype(np.float64)
    depth = -1.0 / rays[..., 1]
    halves = []
    for _ in range(2):
        diffuse, specular = rng.gamma(1.0, 1.0, (2, HEIGHT, WIDTH, 3)).astype(np.float32)
        halves.append(Radiance(diffuse + specular, diffuse, specular))
    mean = {name: 0.5 * (getattr(halves[0], name) + getattr(halves[1], name)) for name in halves[0].names}
    guides = GBuffer(
        depth=depth,
        position=camera.position + depth[..., None] * rays,
        normal=np.broadcast_to([0.0, 1.0, 0.0], (HEIGHT, WIDTH, 3)),
        alpha_u=rng.uniform(0.1, 0.5, (HEIGHT, WIDTH)),
        lobe_kind=np.ones((HEIGHT, WIDTH)),
        diffuse_albedo=rng.uniform(0.2, 0.8, (HEIGHT, WIDTH, 3)),
        specular_albedo=np.full((HEIGHT, WIDTH, 3), 0.5),
        motion=np.zeros((HEIGHT, WIDTH, 2)),
    )
    return Frame(Radiance(**mean), guides, camera, half_a=halves[0], half_b=halves[1], spp=4)


def _upsample() -> None:
    frame = make_frame()
    sparse = lobewise.SparseFrame(Radiance(frame.radiance.color[::4, ::4]), frame.gbuffer, scale=4, camera=frame.camera)
    lobewise.upsample(sparse)


def _accumulate() -> None:
    filtering = lobewise.TemporalFilter()
    for _ in range(2):
        filtering.add(make_frame())


def _filter(form: str, *similarities: str) -> None:
    for similarity in similarities:
        lobewise.denoise(make_frame(), quality="fast", form=form, similarity=similarity, radius=4)


FORMS: dict[str, Callable[[], Any]] = {
    "full": lambda: _filter("full", "ggx", "sg_mixture"),
    "separable": lambda: _filter("separable", "sg", "asg"),
    "atrous": lambda: _filter("atrous", "normal"),
    "balanced": lambda: lobewise.denoise(make_frame(), quality="balanced"),
    "high": lambda: lobewise.denoise(make_frame(), quality="high"),
    "upsampling": _upsample,
    "history": _accumulate,
}


def main(form: str, *sides: str) -> None:
    """Run one form, and print which kernels ran."""
    for side in sides:
        called = guard_kernels(side)
        FORMS[form]()
        print(*sorted(set(called)))


if __name__ == "__main__":
    main(*sys.argv[1:])
