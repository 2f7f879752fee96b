"""What a mixture chooses among: frames of random scenes, denoised by several methods with guides missing at random.

    python -m benchmarks.training.candidates --cache FOLDER --count 60

Each scene of `benchmarks.training.kinds` is rendered at a few samples per pixel, at 64 and at 512, and denoised by
`balanced`, `high` and Open Image Denoise with four sets of guides. At many samples no reference that this machine
could render is free of noise, so the reference is two independent images: the mean of
``(result - one) (result - other)`` is the squared error without their noise. What is there already is not made again.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.training.frames import make_half, make_parser, open_cache
from lobewise.records.frame import Frame, GBuffer, Radiance

COLOR = "color"
"""The set without guides: light together, and nothing else."""
KINDS = ("all", "plain", "passes", "shared", COLOR)
"""Sets of guides: all; one albedo, normal and depth beside light together; split light with albedos and roughness, but
no halves; all guides, no halves, and a pixel filter by which neighbours share samples; none."""
DRAWN = "drawn"
"""The set of guides of the frames that `textures` draws: mostly normals, and albedo or halves or both or neither."""
FEW_SPP = (2, 4, 8, 16)
"""Samples per pixel, one number a scene in turn."""
MORE_SPP = (64, 512)
REFERENCE_SPP = 512
SHARED_SIGMA = 0.6
"""Standard deviation of the pixel filter of the set ``shared``, pixels."""
IMAGES = ("noisy", "balanced", "high", "peer", "clean", "reference_a", "reference_b", "half_a", "half_b")

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Candidates:
    """A frame as several methods see it: arrays of shape (rows, columns, 3), None where the set of guides lacks them.

    Parameters
    ----------
    seed, spp, kind
        Of the scene; samples per pixel; one of `KINDS`.
    noisy, balanced, high, peer
        The input and three results. Ours neither take the noisy image back nor mix with Open Image Denoise.
    clean
        The reference, cleaned by Open Image Denoise: what errors are relative to.
    reference_a, reference_b
        Independent and noisy.
    half_a, half_b
        Of the samples of ``noisy``.
    """

    seed: int
    spp: int
    kind: str
    noisy: Array
    balanced: Array
    high: Array
    peer: Array
    clean: Array
    reference_a: Array
    reference_b: Array
    half_a: Array | None = None
    half_b: Array | None = None

    @property
    def halves(self) -> tuple[Array, Array] | None:
        """Return both halves where there are any."""
        return None if self.half_a is None or self.half_b is None else (self.half_a, self.half_b)


def name_file(seed: int, spp: int, kind: str) -> str:
    """Return under which name a frame is stored."""
    return f"{seed:05d}-{spp:04d}-{kind}.npz"


def write_candidates(folder: Path, found: Candidates) -> Path:
    """Write a frame as half floats, under another name first; return where it is."""
    images = {name: getattr(found, name) for name in IMAGES}
    halves = {name: make_half(image) for name, image in images.items() if image is not None}
    target = folder / name_file(found.seed, found.spp, found.kind)
    temporary = target.with_name(target.name + ".tmp")
    with temporary.open("wb") as stream:
        np.savez(stream, **halves)  # type: ignore[arg-type]
    temporary.replace(target)
    return target


def read_candidates(path: Path) -> Candidates:
    """Return what `write_candidates` wrote."""
    seed, spp, kind = path.stem.split("-")
    with np.load(path) as arrays:
        images = {name: arrays[name].astype(np.float32) for name in arrays.files}
    return Candidates(int(seed), int(spp), kind, **images)


def list_samples(seed: int) -> tuple[int, ...]:
    """Return the samples per pixel of the frames of a scene, ascending."""
    return (FEW_SPP[seed % len(FEW_SPP)], *MORE_SPP)


def blur(image: Array) -> Array:
    """Return an image as a wide pixel filter makes it."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(image, (SHARED_SIGMA, SHARED_SIGMA, 0.0), mode="nearest"), dtype=np.float32)


def vary_guides(frame: Frame, rng: np.random.Generator) -> Iterator[tuple[str, Frame]]:
    """Yield a frame with four of the five sets of guides."""
    yield "all", frame
    guides, light = frame.gbuffer, frame.radiance
    without = replace(frame, half_a=None, half_b=None, variance=None)
    plain = GBuffer(normal=guides.normal, depth=guides.depth, diffuse_albedo=sum_albedo(frame))
    yield "plain", replace(without, gbuffer=plain, radiance=Radiance(light.color))
    if rng.random() < 0.5:
        soft = Radiance(blur(light.color), diffuse=blur(light.diffuse), specular=blur(light.specular))
        yield "shared", replace(without, radiance=soft, noise_is_shared=True)
    else:
        names = ("normal", "depth", "position", "diffuse_albedo", "specular_albedo", "alpha_u", "alpha_v", "lobe_kind")
        kept = {name: getattr(guides, name) for name in (*names, "tangent")}
        yield "passes", replace(without, gbuffer=GBuffer(**kept))
    yield COLOR, replace(without, gbuffer=make_empty_guides(frame.shape), radiance=Radiance(light.color))


def make_empty_guides(shape: tuple[int, int]) -> GBuffer:
    """Return the guides of a file that has none: the readers let every surface face the camera."""
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 2] = 1.0
    return GBuffer(normal=normal)


def sum_albedo(frame: Frame) -> Array:
    """Return the albedo of all lobes, at most 1."""
    diffuse, specular = frame.gbuffer.diffuse_albedo, frame.gbuffer.specular_albedo
    return np.clip(diffuse if specular is None else diffuse + specular, 0.0, 1.0)


def denoise_all(frame: Frame) -> dict[str, Array]:
    """Return the noisy image, what `balanced`, `high` and Open Image Denoise make of it, and halves if it has any.

    The results are those before the noisy image is taken back, which is what the first network decides.
    """
    from lobewise.denoising.automatic import resolve_all
    from lobewise.denoising.bad_pixels import mark_bad_pixels
    from lobewise.denoising.chain import filter_rows
    from lobewise.guides.usable import check_guides
    from lobewise.peers import denoise_oidn
    from lobewise.settings import DenoiseSettings

    images = {"noisy": frame.radiance.color, "peer": denoise_oidn(frame)[0]}
    for quality in ("balanced", "high"):
        settings = resolve_all(frame, DenoiseSettings(quality=quality, with_oidn=False))
        checked = check_guides(frame).frame
        filtered = filter_rows(checked, settings, (), mark_bad_pixels(checked))
        images[quality] = (filtered.taken_from or filtered).image
    if frame.half_a is not None and frame.half_b is not None:
        images |= {"half_a": frame.half_a.color, "half_b": frame.half_b.color}
    return images


def collect_scene(folder: Path, seed: int, size: int) -> list[Path]:
    """Render and denoise the frames of a scene that the folder lacks; return what was written."""
    from benchmarks.training.kinds import make_kind
    from benchmarks.training.rendering import choose_exposure, clean_reference, expose
    from lobewise.render import render_frame, render_reference
    from lobewise.render.loading import build_scene

    missing = [spp for spp in list_samples(seed) if not (folder / name_file(seed, spp, COLOR)).exists()]
    if not missing:
        return []
    scene: Any = build_scene(make_kind(seed, size, size))
    halves = [
        render_reference(scene, spp=REFERENCE_SPP // 2, seed=1000 * seed + 998 + number).radiance.color
        for number in range(2)
    ]
    factor = np.float32(choose_exposure(seed, 0.5 * (halves[0] + halves[1])))
    truth = {"reference_a": factor * halves[0], "reference_b": factor * halves[1]}
    written = []
    for spp in missing:
        frame = expose(render_frame(scene, spp=spp, seed=1000 * seed + spp), float(factor))
        if "clean" not in truth:
            truth["clean"] = clean_reference(0.5 * (truth["reference_a"] + truth["reference_b"]), frame)
        for kind, each in vary_guides(frame, np.random.default_rng([seed, spp])):
            images = {name: blur(image) if kind == "shared" else image for name, image in truth.items()}
            found = Candidates(seed=seed, spp=spp, kind=kind, **denoise_all(each), **images)
            written.append(write_candidates(folder, found))
    return written


def main(words: list[str] | None = None) -> None:
    """Make what is missing, and say in one line for each scene how long it took."""
    from benchmarks.training.rendering import limit_threads

    parser = make_parser(__doc__, count=60, size=128)
    parser.add_argument("--first", type=int, default=1, help="seed of the first scene, from 1")
    arguments = parser.parse_args(words)
    folder = open_cache(parser, arguments.cache)
    limit_threads(1)
    for seed in range(arguments.first, arguments.first + arguments.count):
        start = time.perf_counter()
        written = collect_scene(folder, seed, arguments.size)
        print(f"scene {seed}: {len(written)} written, {time.perf_counter() - start:.1f} s", flush=True)
        # Every BSDF that lives is compiled into the kernels of the next scene.
        gc.collect()


if __name__ == "__main__":
    main()
