"""Make the frames that the refining network learns from.

    python -m benchmarks.training.refinement_frames --cache DIR --count 300 --size 256
    python -m benchmarks.training.refinement_frames --cache DIR --drawn 300
    python -m benchmarks.training.refinement_frames --cache DIR --shots FOLDER

Each seed from 1 is a random scene of `benchmarks.training.kinds`. It gives two or three frames of 1 to 64 samples per
pixel, and each frame one file for every set of guides that a user may have. A file holds what
`lobewise.denoising.refining.inputs` reads after the passes of "balanced", and the reference. ``--drawn`` makes
frames of drawn textures instead (`benchmarks.training.textures`), and ``--shots`` reads frames of Blender that
`benchmarks/foreign/factory` rendered, but for the kinds for validation. What is there already is not made again, so
that the program may be stopped at any time and continues where it stopped.
"""

from __future__ import annotations

import gc
import os
import re
import time
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from benchmarks.foreign.factory.kinds import ORDER, TRAINING
from benchmarks.training.frames import Half, is_validation, make_half, make_parser, open_cache
from benchmarks.training.rendering import (
    choose_exposure,
    choose_reference_spp,
    clean_reference,
    draw_samples,
    expose,
    limit_threads,
)
from benchmarks.users.guides import reduce_frame, sum_albedos
from benchmarks.users.scenes import Scene, find_shots
from lobewise.denoising.refining.inputs import RefinementInputs, collect_inputs
from lobewise.guides.lobe_fields import default_tau, make_sg_field
from lobewise.records.frame import FloatArray, Frame, Radiance

GUIDE_SETS = ("all", "unsplit", "passes", "plain", "color")
"""Sets of guides. "unsplit" has all guides beside one image of all light; the others are those of the users' bench."""
CYCLES_SETS = {f"cycles_{guides}": guides for guides in ("all", "passes", "plain", "color")}
"""Sets of the frames of Blender Cycles, by their name in files."""
FIRST_SHOT_SEED, SEEDS_OF_A_KIND = 200_001, 1000
"""Seed of the first shot of Blender, and how many seeds a kind of shots has. Of the shots of a kind the fifth, the
tenth and so on are kept aside."""
DRAWN = "drawn"
SHARED_SHARE = 0.35
"""Share of the frames whose neighbouring pixels share samples, as with the pixel filters of most renderers."""
SHARED_SIGMAS_PIXELS = (0.4, 0.8)
"""Standard deviation of such a pixel filter."""
SALT = 20261125

_FILE_NAME = re.compile(r"(\d{6})-(\d{4})-(\w+)\.npz")


def name_file(seed: int, spp: int, guides: str) -> str:
    """Return the name of a file."""
    return f"{seed:06d}-{spp:04d}-{guides}.npz"


def parse_file_name(path: Path) -> tuple[int, int, str] | None:
    """Return seed, samples per pixel and set of guides that a file's name tells, None where it names no frame."""
    found = _FILE_NAME.fullmatch(path.name)
    return None if found is None else (int(found[1]), int(found[2]), found[3])


def write_arrays(path: Path, arrays: dict[str, Half]) -> None:
    """Write arrays under another name, then move the file, so that no reader sees half of one."""
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    with temporary.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]
    temporary.replace(path)


def blur(image: FloatArray, sigma: float) -> FloatArray:
    """Return an image as a pixel filter makes it."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(image, (sigma, sigma, 0.0), mode="nearest"), dtype=np.float32)


def share_samples(frame: Frame, sigma: float) -> Frame:
    """Return a frame whose pixels share samples: light and albedos are blurred, and halves are not known."""
    names = ("diffuse_albedo", "specular_albedo", "mean_diffuse_albedo", "mean_specular_albedo")
    known = {name: image for name in names if (image := getattr(frame.gbuffer, name)) is not None}
    guides = replace(frame.gbuffer, **{name: blur(image, sigma) for name, image in known.items()})
    light = {name: blur(getattr(frame.radiance, name), sigma) for name in ("color", "diffuse", "specular")}
    return replace(
        frame,
        gbuffer=guides,
        radiance=Radiance(**light),
        half_a=None,
        half_b=None,
        variance=None,
        noise_is_shared=True,
    )


def limit_guides(frame: Frame, guides: str) -> Frame:
    """Return a frame with one of `GUIDE_SETS`."""
    if guides == "unsplit":
        lights = (frame.radiance, frame.half_a, frame.half_b)
        light, half_a, half_b = (None if each is None else Radiance(each.color) for each in lights)
        assert light is not None
        return replace(frame, radiance=light, half_a=half_a, half_b=half_b)
    found = reduce_frame(frame, guides)
    assert found is not None
    return found


def filter_frame(frame: Frame) -> dict[str, FloatArray]:
    """Return what the refining network reads, and the light that is in no layer, by name."""
    from lobewise.denoising.automatic import resolve_all
    from lobewise.denoising.bad_pixels import mark_bad_pixels
    from lobewise.denoising.chain import filter_halves
    from lobewise.guides.usable import check_guides
    from lobewise.settings import DenoiseSettings

    settings = resolve_all(frame, DenoiseSettings(quality="balanced", with_oidn=False))
    frame = check_guides(frame).frame
    found = filter_halves(frame, settings, (), mark_bad_pixels(frame), None, None)
    inputs = collect_inputs(frame, found.noisy, found.parts)
    images = {each.name: getattr(inputs, each.name) for each in fields(RefinementInputs)}
    images |= {"rest": found.rest, "lobe": compute_lobes(frame)}
    return {name: image for name, image in images.items() if image is not None}


def compute_lobes(frame: Frame) -> FloatArray | None:
    """Return axis and base-2 logarithm of the sharpness of the specular lobes, 0 where there is none."""
    if frame.camera is None or frame.gbuffer.alpha_u is None:
        return None
    tau = default_tau(frame.camera, frame.height)
    field = make_sg_field(frame.gbuffer, frame.camera, tau=tau, diffuse_fallback=False)
    sharpness = np.where(field.valid, np.log2(np.maximum(field.sharpness, 1e-6)), 0.0)
    return np.concatenate([field.axis, sharpness[..., None]], axis=-1, dtype=np.float32)


def make_arrays(frame: Frame, reference: FloatArray, peer: Frame | None = None) -> dict[str, Half]:
    """Return what a file holds; the result of Open Image Denoise where its frame is given."""
    from lobewise.peers import denoise_oidn

    images = filter_frame(frame) | {"reference": reference}
    if peer is not None:
        images["peer"] = denoise_oidn(peer)[0]
    arrays = {name: make_half(image) for name, image in images.items()}
    return arrays | {"shared": make_half(np.float32(frame.noise_is_shared))}


def list_missing(folder: Path, seed: int) -> list[int]:
    """Return the samples per pixel of the frames of a scene that the folder lacks."""
    return [spp for spp in draw_samples(seed) if not (folder / name_file(seed, spp, GUIDE_SETS[-1])).exists()]


def vary_frame(frame: Frame, reference: FloatArray, seed: int) -> Iterator[tuple[str, Frame, FloatArray]]:
    """Yield a frame and its reference with every set of guides; some frames share samples between pixels."""
    rng = np.random.default_rng([SALT, seed, frame.spp or 1])
    if rng.random() < SHARED_SHARE:
        sigma = float(rng.uniform(*SHARED_SIGMAS_PIXELS))
        frame, reference = share_samples(frame, sigma), blur(reference, sigma)
    for guides in GUIDE_SETS:
        yield guides, limit_guides(frame, guides), reference


def render_scene(folder: Path, seed: int, size: int) -> list[int]:
    """Render what the folder lacks of a scene; return the samples per pixel of the frames."""
    from benchmarks.training.kinds import make_kind
    from lobewise.render import render_frame, render_reference
    from lobewise.render.loading import build_scene

    missing = list_missing(folder, seed)
    if not missing:
        return []
    scene: Any = build_scene(make_kind(seed, size, size))
    spp = choose_reference_spp(draw_samples(seed))
    color = render_reference(scene, spp=spp, seed=1000 * seed + 500).radiance.color
    factor, reference = choose_exposure(seed, color), None
    for count in missing:
        frame = expose(render_frame(scene, spp=count, seed=1000 * seed + count), factor)
        if reference is None:
            reference = clean_reference(np.float32(factor) * color, frame)
        for guides, each, target in vary_frame(frame, reference, seed):
            arrays = make_arrays(each, target, each if is_validation(seed) else None)
            write_arrays(folder / name_file(seed, count, guides), arrays)
    return missing


def draw_texture(folder: Path, seed: int, size: int) -> bool:
    """Draw the textured frame of a seed where the folder lacks it; return whether it did."""
    from benchmarks.training.textures import draw_frame

    path = folder / name_file(seed, 0, DRAWN)
    if path.exists():
        return False
    frame, truth = draw_frame(seed, size)
    write_arrays(path, make_arrays(frame, truth))
    return True


def number_shot(name: str) -> int:
    """Return the seed of the files of a shot, from its folder's name, as "glass_3"."""
    kind, _, seed = name.rpartition("_")
    return FIRST_SHOT_SEED + SEEDS_OF_A_KIND * ORDER.index(kind) + int(seed)


def convert_shot(folder: Path, scene: Scene) -> list[int]:
    """Write the files that the folder lacks of a shot of Blender; return the samples per pixel of the frames."""
    seed, last = number_shot(scene.name), tuple(CYCLES_SETS)[-1]
    first, *others = scene.references
    spp_of_reference = lobewise.read_frame(first, light_passes=False).spp
    assert spp_of_reference is not None
    scene = replace(scene, frames={spp_of_reference: first, **scene.frames})
    missing = [spp for spp in scene.frames if not (folder / name_file(seed, spp, last)).exists()]
    for spp in missing:
        frame = scene.read(spp)
        peer = scene.read_peer(spp, frame)
        assert peer is not None
        # One of the references is a frame of many samples as well: the others are its reference.
        paths = others if scene.frames[spp] == first else scene.references
        lights = [lobewise.read_frame(path, light_passes=False).radiance.color for path in paths]
        reference = clean_reference(np.mean(lights, axis=0, dtype=np.float32), peer)
        for name, guides in CYCLES_SETS.items():
            reduced = reduce_frame(frame, guides, sum_albedos(peer))
            if reduced is not None:
                arrays = make_arrays(reduced, reference, peer if is_validation(seed) else None)
                write_arrays(folder / name_file(seed, spp, name), arrays)
    return missing


def main(words: list[str] | None = None) -> None:
    """Make what is missing, and say in one line for each scene how long it took."""
    parser = make_parser(__doc__, count=0, size=256)
    parser.add_argument("--first", type=int, default=1, help="seed of the first scene, from 1")
    parser.add_argument("--drawn", type=int, default=0, help="how many frames of drawn textures")
    parser.add_argument("--shots", type=Path, help="folder of the factory's shots of Blender")
    parser.add_argument("--threads", type=int, default=1, help="threads that render and clean")
    arguments = parser.parse_args(words)
    folder = open_cache(parser, arguments.cache)
    if min(arguments.first, arguments.size, arguments.threads) < 1 or min(arguments.count, arguments.drawn) < 0:
        parser.error("--first, --size and --threads must be at least 1, --count and --drawn at least 0")
    limit_threads(arguments.threads)
    if arguments.drawn:
        from benchmarks.training.textures import FIRST_SEED

        start = time.perf_counter()
        seeds = range(FIRST_SEED, FIRST_SEED + arguments.drawn)
        count = sum(draw_texture(folder, seed, arguments.size) for seed in seeds)
        print(f"{count} frames drawn, {time.perf_counter() - start:.1f} s", flush=True)
    shots = find_shots(arguments.shots) if arguments.shots else []
    for scene in (each for each in shots if each.name.rpartition("_")[0] in TRAINING):
        start = time.perf_counter()
        if done := convert_shot(folder, scene):
            print(f"{scene.name}: {', '.join(map(str, done))} spp, {time.perf_counter() - start:.1f} s", flush=True)
    for seed in range(arguments.first, arguments.first + arguments.count):
        start = time.perf_counter()
        done = render_scene(folder, seed, arguments.size)
        told = f"{', '.join(map(str, done))} spp, {time.perf_counter() - start:.1f} s" if done else "is there"
        print(f"scene {seed}: {told}", flush=True)
        # Every BSDF that lives is compiled into the kernels of the next scene.
        gc.collect()


if __name__ == "__main__":
    main()
