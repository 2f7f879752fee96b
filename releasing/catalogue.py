"""The list of kernels that are compiled ahead of time: all that the recipes ask for over all documented settings.

``python -m releasing.catalogue`` prints how many kernels each part of the list adds.

Kernels are recorded, not computed (`releasing.recording`). What the list leaves out must be compiled where it is used,
which needs ``lobewise[jit]``: features of other packages, and numbers that are unusual for settings that are unusual.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

import lobewise
from lobewise import Frame, Radiance
from lobewise.cli.bench.filters import add_halves, list_jobs
from lobewise.cli.bench.plane import make_frame as make_plane
from lobewise.cli.doctor.machine import examine_kernels
from lobewise.errors import LobewiseError
from lobewise.interactive import InteractiveSettings, Session
from lobewise.interactive.settings import METHODS, UNFILTERED
from lobewise.render import load_scene, make_orbit
from lobewise.settings import MAX_LOBES
from lobewise.settings.choices import FORM_NAMES, MAX_SCALE_PIXELS, QUALITIES, SIMILARITIES
from releasing.frames import NARROW, SIZE, combine, draw_images, drop, make_frame, vary_main_images, vary_rare_images
from releasing.recording import Wanted, record_kernels

BENCH_SIZE = 64, 48
"""Columns and rows of the images of benchmarks here."""
RANDOM_FRAMES = 1000
"""Random sets of images of a frame."""
RANDOM_SPARSE_FRAMES = 300
"""The same for upsampling, which has fewer kernels."""
Case = Callable[[], Any]


def denoise(frame: Frame, **changes: Any) -> Case:
    """Return a call of the recipe without Open Image Denoise."""
    return lambda: lobewise.denoise(frame, device="cpu", with_oidn=False, **changes)


def list_qualities() -> Iterator[Case]:
    """Yield every quality on every usual combination of images."""
    rich = make_frame()
    for frame in (*vary_main_images(rich), *vary_rare_images(rich), *vary_rare_images(combine(rich))):
        for quality in QUALITIES:
            yield denoise(frame, quality=quality)
    color = np.where(np.eye(*SIZE)[..., None] > 0.0, np.float32(np.nan), rich.radiance.color)
    spoiled = combine(rich).with_changes(radiance=Radiance(color), half_a=None, half_b=None)
    for quality in QUALITIES:
        yield denoise(spoiled, quality=quality)
    narrow = make_frame((SIZE[0], NARROW))
    for frame in (narrow, combine(narrow), drop(narrow, "tangent", "alpha_v")):
        for quality in QUALITIES:
            yield denoise(frame, quality=quality)


def list_drawn_images() -> Iterator[Case]:
    """Yield every quality on random sets of images."""
    for frame in draw_images(make_frame(), RANDOM_FRAMES):
        for quality in QUALITIES:
            yield denoise(frame, quality=quality)
        for similarity in SIMILARITIES:
            for quality in ("fast", "balanced"):
                yield denoise(frame, quality=quality, similarity=similarity)


def list_similarities() -> Iterator[Case]:
    """Yield every similarity with each of its options."""
    for whole in (make_frame(), drop(make_frame(), "tangent", "alpha_v")):
        for frame in (whole, combine(whole), whole.with_changes(half_a=None, half_b=None)):
            for similarity in SIMILARITIES:
                for quality in QUALITIES:
                    yield denoise(frame, quality=quality, similarity=similarity)
                for form in FORM_NAMES:
                    yield denoise(frame, quality="fast", form=form, similarity=similarity)
            for quality in QUALITIES:
                yield denoise(frame, quality=quality, similarity="normal", band_limit=1.0)
            for lobes in range(1, MAX_LOBES + 1):
                yield denoise(frame, quality="fast", similarity="sg_mixture", lobes=lobes)


def upsample(frame: Frame, scale: int, **changes: Any) -> Case:
    """Return a call of upsampling."""
    return lambda: lobewise.upsample(lobewise.make_sparse(frame, scale, (1, 1)), device="cpu", **changes)


def follow(frame: Frame, scale: int, **changes: Any) -> Case:
    """Return a history of four frames: recorded, it goes on for two and is then cut."""

    def run() -> None:
        history = lobewise.TemporalFilter(device="cpu", **changes)
        for number in range(4):
            given = lobewise.make_sparse(frame, scale, (number % scale, 0)) if scale > 1 else frame
            history.add(given)

    return run


def list_upsampling() -> Iterator[Case]:
    """Yield upsampling by every similarity and scale."""
    rich = make_frame((32, 48))
    for frame in (
        rich,
        combine(rich),
        drop(rich, "tangent", "alpha_v"),
        drop(rich, "position"),
        drop(rich, "hit_distance"),
    ):
        for similarity in SIMILARITIES:
            yield upsample(frame, 4, similarity=similarity)
        yield upsample(frame, 4, bilinear=True)
        for scale in range(2, MAX_SCALE_PIXELS + 1):
            yield upsample(frame, scale)
        yield lambda frame=frame: _recompute(frame)  # type: ignore[misc]


def _recompute(frame: Frame) -> Any:
    result = lobewise.upsample(lobewise.make_sparse(frame, 4), device="cpu")

    def shade(rows: np.ndarray, columns: np.ndarray) -> lobewise.Radiance:
        images = {name: getattr(frame.radiance, name) for name in ("color", "diffuse", "specular")}
        return lobewise.Radiance(**{n: None if i is None else i[rows, columns][:, None] for n, i in images.items()})

    return lobewise.recompute(result, shade, samples=1.0, frame=frame)


def list_histories() -> Iterator[Case]:
    """Yield histories by every form, similarity and usual scale."""
    rich = make_frame((32, 48))
    frames = (
        rich,
        combine(rich),
        drop(rich, "tangent", "alpha_v"),
        drop(rich, "hit_distance"),
        drop(rich, "hit_distance", "tangent", "alpha_v", "position"),
        drop(rich, "motion"),
        drop(rich, "diffuse_albedo", "specular_albedo", "mean_diffuse_albedo", "mean_specular_albedo"),
        make_frame((SIZE[0], NARROW)),
    )
    for frame in frames:
        for form in FORM_NAMES:
            yield follow(frame, 1, form=form)
        for similarity in SIMILARITIES:
            yield follow(frame, 1, similarity=similarity)
            yield follow(frame, 4, similarity=similarity)
        for scale in (2, 3, 8):
            yield follow(frame, scale)


def list_sparse_images() -> Iterator[Case]:
    """Yield upsampling and histories of every usual combination of images, and of random sets."""
    rich = make_frame((32, 48))
    # Recorded masks always show a background. Without light it has no layer.
    black = Radiance(np.zeros_like(rich.radiance.color))
    frames = [*vary_main_images(rich), *vary_rare_images(rich), *draw_images(rich, RANDOM_SPARSE_FRAMES)]
    frames += [frame.with_changes(radiance=black) for frame in vary_main_images(combine(rich))]
    for frame in frames:
        yield upsample(frame, 4)
        yield follow(frame, 4)


def list_windows() -> Iterator[Case]:
    """Yield windows in time of each reach over three frames."""

    def join(frame: Frame, reach: int, **changes: Any) -> Case:
        frames = [frame] + [make_frame(frame.shape, seed=seed).with_changes(gbuffer=frame.gbuffer) for seed in (2, 3)]
        return lambda: lobewise.WindowFilter(reach, device="cpu", **changes).denoise(frames, 1)

    rich = make_frame()
    for frame in (*vary_rare_images(rich), drop(rich, "hit_distance"), drop(rich, "motion")):
        yield join(frame, 1)
    for quality in QUALITIES:
        for similarity in SIMILARITIES:
            yield join(rich, 2, quality=quality, similarity=similarity)


def list_benchmarks() -> Iterator[Case]:
    """Yield the calls of `lobewise bench` on a small image, without Open Image Denoise."""
    for _, calls, _ in list_jobs(add_halves(make_plane(*BENCH_SIZE)), "cpu", peers=False):
        yield from calls.values()


def list_examinations() -> Iterator[Case]:
    """Yield the filter by which `lobewise doctor` finds out whether kernels run."""
    yield examine_kernels


def list_interactive_frames() -> Iterator[Case]:
    """Yield frames of an interactive session by every method and similarity, while camera and light move.

    Needs Mitsuba: the kernels filter what it renders.
    """
    scene = load_scene("showroom", width=48, height=48)
    session = Session(scene, options={"voxel_cones": {"resolution": 32}})
    path = make_orbit(session.camera, (0.0, 0.75, -0.6), 3, 1.0)

    def follow(settings: InteractiveSettings) -> Case:
        return lambda: [session.render(camera, settings) for camera in (*path, path[-1])]

    usual = InteractiveSettings()
    for method in METHODS:
        yield follow(replace(usual, method=method))
    for similarity in (*SIMILARITIES, UNFILTERED):
        yield follow(InteractiveSettings(similarity=similarity))
    for name in ("temporal", "filter_direct", "limit_lobes"):
        for value in (True, False):
            yield follow(replace(usual, **{name: value}))
    for scale in (1, 2, 3, 8):
        yield follow(replace(usual, scale=scale))


PARTS: dict[str, Callable[[], Iterator[Case]]] = {
    "qualities": list_qualities,
    "random images": list_drawn_images,
    "similarities": list_similarities,
    "upsampling": list_upsampling,
    "histories": list_histories,
    "sparse images": list_sparse_images,
    "windows": list_windows,
    "benchmarks": list_benchmarks,
    "examinations": list_examinations,
    "interactive frames": list_interactive_frames,
}


def list_kernels() -> dict[str, Wanted]:
    """Return every kernel of the list by identity."""
    found = record_cases(list_qualities, seed=1)
    for cases in PARTS.values():
        found |= record_cases(cases)
    return found


def record_cases(cases: Callable[[], Iterator[Case]], seed: int = 0) -> dict[str, Wanted]:
    """Return the kernels that cases ask for. Cases that a recipe refuses, for lack of an image, ask for few."""
    with record_kernels(seed) as found, warnings.catch_warnings():
        # Random numbers are no image: recipes divide by zero, which changes no kernel.
        warnings.simplefilter("ignore")
        for run in cases():
            with suppress(LobewiseError):
                run()
    return found


def main() -> None:
    """Print how many kernels each part adds."""
    found: dict[str, Wanted] = {}
    for name, cases in PARTS.items():
        more = record_cases(cases)
        print(f"{name}: {len(more)} kernels, {len(more.keys() - found.keys())} of them new", flush=True)
        found |= more
    print(f"{len(found)} kernels for frames of {SIZE[1]}x{SIZE[0]} pixels and more")


if __name__ == "__main__":
    main()
