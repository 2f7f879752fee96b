"""Render the frames that the affinity network learns from.

    python -m benchmarks.training.make_frames --cache DIR --count 300 --size 256

For each seed from 1: a random scene of `benchmarks.training.kinds`, two or three frames of 1 to 64 samples per pixel
with every guide and both halves, and a reference of 128 samples (512 where a frame has more than 16) that Open Image
Denoise cleans. The same seed gives the same files. What is there already is not rendered again, so that the program may
be stopped at any time and continues where it stopped.
"""

from __future__ import annotations

import argparse
import gc
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.training.frames import (
    Example,
    Half,
    is_validation,
    list_frames,
    make_file_name,
    make_half,
    open_cache,
    read_frame_file,
    write_frame_file,
)
from benchmarks.training.kinds import SALT, choose_kind, make_kind
from lobewise.errors import InputError, LobewiseError
from lobewise.frame import FloatArray, Frame
from lobewise.guides.lobe_fields import make_sg_field
from lobewise.lobes.band_limit import default_tau
from lobewise.peers import denoise_oidn
from lobewise.radiance import Radiance
from lobewise.render import load_mitsuba, render_frame, render_reference
from lobewise.render.loading import build_scene

FEW, MANY = (1, 2, 4, 8, 16), (32, 64)
"""Samples per pixel that a frame may have."""
SHARE_OF_MANY = 0.35
"""How often a scene has one frame of `MANY`: its reference takes four times as long."""

REFERENCE_SPP, LONG_REFERENCE_SPP = 128, 512
MANY_SPP = 16
"""Frames of more samples than this need the long reference."""

MEDIAN_RADIANCE = (0.08, 0.8)
"""Bounds of the median radiance: what a scene's light is scaled to."""
LEAST_MEDIAN = 0.15
"""Of the brightness that a tenth of the pixels exceed: the median counts as no less, lest what is lit blows up."""


def draw_samples(seed: int) -> tuple[int, ...]:
    """Return the samples per pixel of the frames of a scene, two or three numbers, ascending."""
    generator = np.random.default_rng([SALT, seed, 1])
    count = int(generator.integers(2, 4))
    many = [int(generator.choice(MANY))] if generator.random() < SHARE_OF_MANY else []
    few = generator.choice(FEW, count - len(many), replace=False)
    return tuple(sorted([*many, *(int(each) for each in few)]))


def choose_reference_spp(samples: Sequence[int]) -> int:
    """Return the samples per pixel of the reference beside frames of ``samples``."""
    return LONG_REFERENCE_SPP if max(samples) > MANY_SPP else REFERENCE_SPP


def find_exposure(seed: int, color: FloatArray) -> float:
    """Return what all light of a scene is multiplied by, so that its median is what the seed draws."""
    low, high = np.log(MEDIAN_RADIANCE)
    wanted = float(np.exp(np.random.default_rng([SALT, seed, 2]).uniform(low, high)))
    brightness = color.mean(axis=-1)
    found = max(float(np.median(brightness)), LEAST_MEDIAN * float(np.percentile(brightness, 90)), 1e-6)
    # Few digits: the last bits of a render may differ from machine to machine.
    return float(f"{wanted / found:.3g}")


def _scale(radiance: Radiance | None, factor: float) -> Radiance | None:
    if radiance is None:
        return None
    names = ("color", "diffuse", "specular")
    return Radiance(**{name: np.float32(factor) * getattr(radiance, name) for name in names})


def expose(frame: Frame, factor: float) -> Frame:
    """Return a frame with all its light multiplied by a factor, without variance."""
    radiance, half_a, half_b = (_scale(each, factor) for each in (frame.radiance, frame.half_a, frame.half_b))
    assert radiance is not None
    emission = frame.gbuffer.mean_emission
    guides = frame.gbuffer if emission is None else replace(frame.gbuffer, mean_emission=np.float32(factor) * emission)
    return replace(frame, radiance=radiance, half_a=half_a, half_b=half_b, variance=None, gbuffer=guides)


def make_lobes(frame: Frame) -> tuple[FloatArray, FloatArray]:
    """Return axis and base-2 logarithm of the sharpness of the specular lobes, 0 where there is none."""
    camera = frame.require_camera("a lobe")
    field = make_sg_field(frame.gbuffer, camera, tau=default_tau(camera, frame.height), diffuse_fallback=False)
    sharpness = np.where(field.valid, np.log2(np.maximum(field.sharpness, 1e-6)), 0.0)
    return field.axis, sharpness.astype(np.float32)


def clean_reference(color: FloatArray, guides: Frame) -> FloatArray:
    """Return a reference without the rest of its noise; ``guides`` is any frame of the same view."""
    return denoise_oidn(replace(guides, radiance=Radiance(color=color), half_a=None, half_b=None))[0]


def run_peers(frame: Frame) -> dict[str, Half]:
    """Return what Open Image Denoise makes of a frame with all guides and with the plain ones."""
    plain = replace(frame.gbuffer, mean_normal=None, mean_diffuse_albedo=None, mean_specular_albedo=None)
    return {
        "peer_all": make_half(denoise_oidn(frame)[0]),
        "peer_plain": make_half(denoise_oidn(replace(frame, gbuffer=plain))[0]),
    }


def pack(frame: Frame, reference: FloatArray, *, seed: int, reference_spp: int, kind: str) -> Example:
    """Return a frame as it is stored, with its peers where the seed is one for validation."""
    gbuffer, zeros = frame.gbuffer, np.zeros((*frame.shape, 3), dtype=np.float32)
    names = ("mean_diffuse_albedo", "mean_specular_albedo", "diffuse_albedo", "specular_albedo", "mean_normal")
    more = ("normal", "depth", "alpha_u", "alpha_v", "hit_albedo", "hit_normal")
    guides = {name: make_half(getattr(gbuffer, name)) for name in (*names, *more)}
    distance = zeros[..., 0] if gbuffer.hit_distance is None else gbuffer.hit_distance
    known = np.isfinite(distance) & (distance > 0.0)
    axis, sharpness = make_lobes(frame)
    light = {name: make_half(getattr(frame.radiance, name)) for name in ("color", "diffuse", "specular")}
    for half, radiance in (("a", frame.half_a), ("b", frame.half_b)):
        if radiance is not None:
            light |= {f"{name}_{half}": make_half(getattr(radiance, name)) for name in ("diffuse", "specular")}
    return Example(
        seed=seed,
        spp=frame.spp or 1,
        reference_spp=reference_spp,
        kind=kind,
        hit_inverse=make_half(np.where(known, 1.0 / (1.0 + np.where(known, distance, 0.0)), 0.0)),
        lobe_axis=make_half(axis),
        lobe_sharpness=make_half(sharpness),
        reference=make_half(reference),
        **guides,
        **light,
        **(run_peers(frame) if is_validation(seed) else {}),
    )


def list_missing(folder: Path, seed: int) -> tuple[int, ...]:
    """Return the samples per pixel of the frames of a scene that the folder lacks."""
    return tuple(spp for spp in draw_samples(seed) if not (folder / make_file_name(seed, spp)).exists())


def render_scene(folder: Path, seed: int, size: int) -> tuple[int, ...]:
    """Render what the folder lacks of one scene; return the samples per pixel of what was rendered."""
    missing = list_missing(folder, seed)
    if not missing:
        return ()
    reference_spp = choose_reference_spp(draw_samples(seed))
    scene = build_scene(make_kind(seed, size, size))
    color = render_reference(scene, spp=reference_spp, seed=1000 * seed + 500).radiance.color
    factor = find_exposure(seed, color)
    reference: FloatArray | None = None
    for spp in missing:
        frame = expose(render_frame(scene, spp=spp, seed=1000 * seed + spp), factor)
        if reference is None:
            reference = clean_reference(np.float32(factor) * color, frame)
        kind = choose_kind(seed)
        write_frame_file(folder, pack(frame, reference, seed=seed, reference_spp=reference_spp, kind=kind))
    return missing


def check_size(folder: Path, size: int) -> None:
    """Raise InputError if the frames that a folder holds are of another size."""
    for path in list_frames(folder)[:1]:
        rows, columns = read_frame_file(path).color.shape[:2]
        if (rows, columns) != (size, size):
            expected = f"{rows}, as the frames in {str(folder)!r} have"
            raise InputError("--size", expected=expected, got=str(size), action="name an empty folder, or the old size")


def limit_threads(threads: int) -> Any:
    """Limit every library that computes here to so many threads, and return Mitsuba. Comes before any rendering."""
    os.environ |= {"OIDN_NUM_THREADS": str(threads), "OIDN_SET_AFFINITY": "0", "HL_NUM_THREADS": str(threads)}
    mi = load_mitsuba("cpu")
    import drjit as dr

    dr.set_thread_count(threads)
    return mi


def main() -> None:
    """Render what is missing, and say in one line for each scene how long it took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for the files, outside the repository")
    parser.add_argument("--first", type=int, default=1, help="seed of the first scene, from 1")
    parser.add_argument("--count", type=int, default=300, help="how many scenes")
    parser.add_argument("--size", type=int, default=256, help="pixels a side")
    parser.add_argument("--threads", type=int, default=1, help="threads that render and clean")
    arguments = parser.parse_args()
    folder = open_cache(parser, arguments.cache)
    for name in ("first", "count", "size", "threads"):
        if getattr(arguments, name) < 1:
            parser.error(f"--{name} must be at least 1")
    try:
        check_size(folder, arguments.size)
    except LobewiseError as error:
        parser.error(str(error))
    limit_threads(arguments.threads)
    for seed in range(arguments.first, arguments.first + arguments.count):
        start, spent = time.perf_counter(), time.process_time()
        done = render_scene(folder, seed, arguments.size)
        wall, cpu = time.perf_counter() - start, time.process_time() - spent
        told = f"{', '.join(map(str, done))} spp, {wall:.1f} s, {cpu:.1f} s of CPU" if done else "is there"
        print(f"scene {seed} ({choose_kind(seed)}): {told}", flush=True)
        # Every BSDF that lives is compiled into the kernels of the next scene.
        gc.collect()


if __name__ == "__main__":
    main()
