"""The jobs that `lobewise bench` times, and their sizes and settings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from lobewise.bench.kernels import PAPER_RADII, PAPER_SIZE, Calls, make_kernel_calls
from lobewise.bench.plane import SIMILARITIES, make_features, make_frame, make_mixture, make_place
from lobewise.chunks import count_threads
from lobewise.denoising import denoise
from lobewise.frame import Frame, Radiance
from lobewise.peers import denoise_oidn, has_oidn
from lobewise.settings import FORM_NAMES
from lobewise.settings.choices import get_quality, get_similarity
from lobewise.sparse_frame import make_sparse
from lobewise.upsampling import DEFAULT_RADIUS, upsample

Size = tuple[int, int]

CORE = ("normal", "sg", "ggx")
"""Similarities of the jobs that would take too long with all similarities."""
KERNEL_TURNS = 2
"""Turns of every job that times kernels: see `Job.turns`."""
RADIUS = 8
"""Filter radius of every job that does not vary the radius, pixels."""
OIDN = "OIDN"
"""Beginning of the names of the rows that time Open Image Denoise."""
OIDN_LABELS = {"fast": f"{OIDN}, fast", "balanced": f"{OIDN}, balanced", "high": f"{OIDN}, default"}
"""Names of rows, by quality of `lobewise.peers.denoise_oidn`; "high" is its default."""
MEANINGS_OF_TIMES = {
    "forms": "one kernel run over one image, radius 8",
    "radius": "one kernel run over one image, separable; radii 8 and 16 are the paper's table",
    "lobes": "one kernel run over one image, separable, radius 8, mixtures of spherical Gaussians",
    "pixels": "one kernel run over one image, separable, radius 8; Open Image Denoise beside it in the same turns",
    "threads": "one kernel run over one image, separable, radius 8, in a process for each number of threads",
    "upsampling": "lobewise.upsample, one of scale x scale pixels shaded",
    "denoising": "lobewise.denoise, diffuse and specular apart, radius 8; Open Image Denoise in the same turns",
}
"""Parts of a measurement, in order, and the work that one time of each covers."""


@dataclass(frozen=True)
class Extent:
    """The sizes and settings that are measured."""

    size: Size = (1024, 1024)
    """Columns and rows of the images of "forms", "lobes" and "threads"."""
    sizes: tuple[Size, ...] = ((512, 512), (1024, 1024), (1920, 1080), (2560, 1440), (3840, 2160))
    """Sizes of "pixels"."""
    recipe_size: Size = (1920, 1080)
    """Size of "upsampling" and "denoising"."""
    radius_size: Size = (PAPER_SIZE, PAPER_SIZE)
    """Size of "radius": the paper's."""
    radii: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    """Radii of "radius", pixels."""
    lobes: tuple[int, ...] = (1, 2, 3, 4)
    """Lobes per pixel of "lobes"."""
    scales: tuple[int, ...] = (2, 4)
    """Distances of shaded pixels of "upsampling", pixels."""
    forms: tuple[str, ...] = FORM_NAMES
    """Forms of "forms"."""
    qualities: tuple[str, ...] = ("fast", "balanced", "high")
    """Qualities of "denoising"."""
    similarities: tuple[str, ...] = SIMILARITIES
    """Similarities of "forms" and of the paper's radii; they must include "normal"."""
    core: tuple[str, ...] = CORE
    """Similarities of all other jobs; they must include "normal"."""
    seconds: float = 3.0
    """Shortest time of all rounds of a job together."""
    rounds: int = 5
    """Fewest rounds of a job that times kernels."""
    recipe_rounds: int = 2
    """Fewest rounds of "upsampling", "denoising" and jobs with Open Image Denoise."""
    peer_pixels: int = 1920 * 1080
    """Largest image that Open Image Denoise is timed on, pixels: it would take most of the total time."""


FULL = Extent()
QUICK = Extent(
    size=(512, 512),
    sizes=((256, 256), (512, 512), (768, 768)),
    recipe_size=(512, 512),
    radii=(4, 8, 16),
    lobes=(1, 3),
    scales=(4,),
    forms=("separable", "full"),
    qualities=("fast", "balanced"),
    seconds=0.3,
    rounds=3,
    recipe_rounds=2,
)
"""Takes under a minute on two cores; its times vary more from run to run."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Functions that are timed together, one after the other in each round."""

    part: str
    """A key of `MEANINGS_OF_TIMES`."""
    facts: dict[str, Any]
    """Settings that the functions share: ``device``, ``width``, ``height``, ``form``, ``radius`` and others."""
    make: Callable[[], Calls]
    """Returns the functions by name. It is called just before they run: only one job's images are in memory."""
    rounds: int
    """Fewest rounds, all turns together."""
    turns: int
    """Parts of the rounds. The other jobs run between them, so that a disturbance of the machine bends no curve."""
    effort: float
    """Estimated seconds on two cores, for the progress only."""


@lru_cache(maxsize=1)
def fetch_frame(size: Size) -> Frame:
    """Return the benchmark frame; the last one is cached, because jobs of one size follow each other."""
    return make_frame(*size)


def list_jobs(extent: Extent, device: str, *, peers: bool = True) -> Iterator[Job]:
    """Yield the jobs of a device, except "threads"; ``peers`` adds Open Image Denoise where it is installed."""
    has_peer = peers and has_oidn()
    for form in extent.forms:
        yield _plan_kernels("forms", extent.size, RADIUS, form, device, extent, extent.similarities)
    for lobes in extent.lobes:
        yield _plan_lobes(lobes, device, extent)
    for radius in extent.radii:
        names = extent.similarities if radius in PAPER_RADII else extent.core
        yield _plan_kernels("radius", extent.radius_size, radius, "separable", device, extent, names)
    for size in extent.sizes:
        peer_qualities = ("fast", "high") if has_peer and size[0] * size[1] <= extent.peer_pixels else ()
        yield _plan_kernels("pixels", size, RADIUS, "separable", device, extent, extent.core, peer_qualities)
    for scale in extent.scales:
        yield _plan_upsampling(scale, device, extent)
    yield _plan_denoising(device, extent, tuple(OIDN_LABELS) if has_peer else ())


def list_threads() -> list[int]:
    """Return the numbers of threads to measure: powers of two below the threads of this process, and these."""
    maximum = count_threads()
    return sorted({maximum, *(2**k for k in range(maximum.bit_length()) if 2**k <= maximum)})


def make_core_calls(extent: Extent) -> Calls:
    """Return the functions of "threads"."""
    frame = fetch_frame(extent.size)
    return make_kernel_calls(frame, make_features(frame, extent.core), RADIUS, "separable")


def describe_size(size: Size) -> dict[str, int]:
    """Return the facts of a size."""
    return {"width": size[0], "height": size[1]}


def _plan_kernels(
    part: str,
    size: Size,
    radius: int,
    form: str,
    device: str,
    extent: Extent,
    names: tuple[str, ...],
    peers: tuple[str, ...] = (),
) -> Job:
    def make() -> Calls:
        frame = fetch_frame(size)
        calls = make_kernel_calls(frame, make_features(frame, names), radius, form, device)
        return {**calls, **_make_peer_calls(frame, peers)}

    facts = {"device": device, **describe_size(size), "form": form, "radius": radius}
    rounds = extent.recipe_rounds if peers else extent.rounds
    megapixels = size[0] * size[1] / 1e6
    effort = (
        extent.seconds
        + len(names)
        + (KERNEL_TURNS + rounds) * megapixels * (5.0 * bool(peers) + 4.0 * (form == "full"))
    )
    return Job(part=part, facts=facts, make=make, rounds=rounds, turns=KERNEL_TURNS, effort=effort)


def _plan_lobes(lobes: int, device: str, extent: Extent) -> Job:
    def make() -> Calls:
        frame = fetch_frame(extent.size)
        place = make_place(frame)
        kinds = {"own axes": False, "one axis": True}
        features = {
            name: [*place, make_mixture(frame, lobes, coaxial=coaxial)]
            for name, coaxial in kinds.items()
            # A single lobe is both kinds.
            if lobes > 1 or coaxial
        }
        return make_kernel_calls(frame, features, RADIUS, "separable", device)

    facts = {"device": device, **describe_size(extent.size), "form": "separable", "radius": RADIUS, "lobes": lobes}
    effort = extent.seconds + 2.0
    return Job(part="lobes", facts=facts, make=make, rounds=extent.rounds, turns=KERNEL_TURNS, effort=effort)


def _plan_upsampling(scale: int, device: str, extent: Extent) -> Job:
    def make() -> Calls:
        run = partial(upsample, make_sparse(fetch_frame(extent.recipe_size), scale), device=device)
        return {
            "bilinear": partial(run, bilinear=True),
            **{name: partial(run, similarity=name) for name in extent.core},
        }

    facts = {"device": device, **describe_size(extent.recipe_size), "radius": DEFAULT_RADIUS, "scale": scale}
    effort = 8.0 + extent.seconds
    return Job(part="upsampling", facts=facts, make=make, rounds=extent.recipe_rounds, turns=1, effort=effort)


def _plan_denoising(device: str, extent: Extent, peers: tuple[str, ...]) -> Job:
    def make() -> Calls:
        frame = add_halves(fetch_frame(extent.recipe_size))
        run = partial(denoise, frame, radius=RADIUS, device=device)
        calls: Calls = {}
        for similarity in (name for name in extent.core if get_similarity(name).has_lobes):
            for form in ("separable", "full"):
                calls[f"fast, {similarity}, {form}"] = partial(run, quality="fast", similarity=similarity, form=form)
        calls |= {
            quality: partial(run, quality=quality) for quality in extent.qualities if get_quality(quality).reads_halves
        }
        return {**calls, **_make_peer_calls(frame, peers)}

    facts = {"device": device, **describe_size(extent.recipe_size), "radius": RADIUS}
    megapixels = extent.recipe_size[0] * extent.recipe_size[1] / 1e6
    effort = 10.0 + 12.0 * (1.0 + extent.recipe_rounds) * megapixels
    return Job(part="denoising", facts=facts, make=make, rounds=extent.recipe_rounds, turns=1, effort=effort)


def _make_peer_calls(frame: Frame, qualities: tuple[str, ...]) -> Calls:
    """Return calls of Open Image Denoise at some qualities, with guides that need no prefilter."""
    run = partial(denoise_oidn, frame, guides="centre")
    return {OIDN_LABELS[quality]: partial(run, quality=quality) for quality in qualities}


def add_halves(frame: Frame) -> Frame:
    """Return the frame with two halves of its samples, which the qualities above "fast" use."""
    share = np.random.default_rng(1).random(frame.shape, dtype=np.float32)[..., None]

    def scale(weight: Any) -> Radiance:
        parts = {name: getattr(frame.radiance, name) for name in ("color", "diffuse", "specular")}
        return Radiance(**{name: 2.0 * weight * image for name, image in parts.items()})

    return frame.with_changes(half_a=scale(share), half_b=scale(1.0 - share))
