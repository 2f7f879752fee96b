"""What `lobewise bench` measures: every job, and how much of it there is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np

from lobewise.bench.kernels import PAPER_RADII, PAPER_SIZE, Calls, make_kernel_calls
from lobewise.bench.machine import count_threads
from lobewise.bench.plane import SIMILARITIES, make_features, make_frame, make_mixture, make_place
from lobewise.denoising import denoise
from lobewise.frame import Frame, Radiance
from lobewise.peers import denoise_oidn, has_oidn
from lobewise.settings import FORMS
from lobewise.sparse_frame import make_sparse
from lobewise.upsampling import DEFAULT_RADIUS, upsample

Size = tuple[int, int]

CORE = ("normal", "sg", "ggx")
"""Similarities of the plots that would take long with all of them."""
TURNS = 2
"""Of every job that times kernels."""
RADIUS = 8
"""Of every job that is not about the radius."""
OIDN = "OIDN"
"""Short for Open Image Denoise; its rows' names begin so."""
OIDN_LABELS = {"fast": f"{OIDN}, fast", "balanced": f"{OIDN}, balanced", "high": f"{OIDN}, default"}
"""By quality of `lobewise.peers.denoise_oidn`; "high" is its default."""
WHAT = {
    "forms": "one kernel run over one image, radius 8",
    "radius": "one kernel run over one image, separable; radii 8 and 16 are the paper's table",
    "lobes": "one kernel run over one image, separable, radius 8, mixtures of spherical Gaussians",
    "pixels": "one kernel run over one image, separable, radius 8; Open Image Denoise beside it in the same turns",
    "threads": "one kernel run over one image, separable, radius 8, in a process for each number of threads",
    "upsampling": "lobewise.upsample, one of scale x scale pixels shaded",
    "denoising": "lobewise.denoise, diffuse and specular apart, radius 8; Open Image Denoise in the same turns",
}
"""Parts of a measurement, in order, and what one time of each is."""


@dataclass(frozen=True)
class Extent:
    """How much is measured."""

    size: Size = (1024, 1024)
    """Columns and rows of "forms", "lobes" and "threads"; that of "radius" is the paper's."""
    sizes: tuple[Size, ...] = ((512, 512), (1024, 1024), (1920, 1080), (2560, 1440), (3840, 2160))
    """Those of "pixels"."""
    recipe_size: Size = (1920, 1080)
    """That of "upsampling" and "denoising"."""
    radius_size: Size = (PAPER_SIZE, PAPER_SIZE)
    # Those of "radius", "lobes" and "upsampling".
    radii: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    lobes: tuple[int, ...] = (1, 2, 3, 4)
    scales: tuple[int, ...] = (2, 4)
    # Those of "forms" and "denoising".
    forms: tuple[str, ...] = FORMS
    qualities: tuple[str, ...] = ("fast", "balanced", "high")
    # Those of "forms" and of the paper's radii, and those of everything else; both with "normal".
    similarities: tuple[str, ...] = SIMILARITIES
    core: tuple[str, ...] = CORE
    seconds: float = 3.0
    """Least time of each job's rounds."""
    # Least number of rounds of kernels, and of whole recipes and what Open Image Denoise takes part in.
    rounds: int = 5
    recipe_rounds: int = 2
    peer_pixels: int = 1920 * 1080
    """Larger images are not given to it: it would take most of the time."""


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
"""Under a minute on two cores; its figures waver more."""


@dataclass(frozen=True)
class Job:
    """Candidates that run in turn."""

    part: str
    """One of `WHAT`."""
    facts: dict[str, Any]
    """What they have in common: ``device``, ``width``, ``height``, ``form``, ``radius`` and the like."""
    make: Callable[[], Calls]
    """Returns the candidates by name, when they are about to run, so that no two jobs' images are held at once."""
    rounds: int
    """Least number of rounds, all turns together."""
    turns: int
    """In how many parts, between which the other jobs run: a disturbance then bends no curve."""
    effort: float
    """About how many seconds it takes on two cores, for the progress alone."""


@lru_cache(maxsize=1)
def fetch_frame(size: Size) -> Frame:
    """Return the plane at this size; the last one is kept, because jobs of one size follow each other."""
    return make_frame(*size)


def list_jobs(extent: Extent, device: str, *, peers: bool = True) -> Iterator[Job]:
    """Yield what is measured on a device, but for the threads; with ``peers`` beside Open Image Denoise."""
    known = peers and has_oidn()
    for form in extent.forms:
        yield _plan_kernels("forms", extent.size, RADIUS, form, device, extent, extent.similarities)
    for lobes in extent.lobes:
        yield _plan_lobes(lobes, device, extent)
    for radius in extent.radii:
        names = extent.similarities if radius in PAPER_RADII else extent.core
        yield _plan_kernels("radius", extent.radius_size, radius, "separable", device, extent, names)
    for size in extent.sizes:
        beside = ("fast", "high") if known and size[0] * size[1] <= extent.peer_pixels else ()
        yield _plan_kernels("pixels", size, RADIUS, "separable", device, extent, extent.core, beside)
    for scale in extent.scales:
        yield _plan_upsampling(scale, device, extent)
    yield _plan_denoising(device, extent, tuple(OIDN_LABELS) if known else ())


def list_threads() -> list[int]:
    """Return the numbers of threads to measure: powers of two up to what this process may use, and that itself."""
    most = count_threads()
    return sorted({most, *(2**k for k in range(most.bit_length()) if 2**k <= most)})


def make_core_calls(extent: Extent) -> Calls:
    """Return what "threads" runs."""
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
    effort = extent.seconds + len(names) + (TURNS + rounds) * megapixels * (5.0 * bool(peers) + 4.0 * (form == "full"))
    return Job(part, facts, make, rounds, TURNS, effort)


def _plan_lobes(lobes: int, device: str, extent: Extent) -> Job:
    def make() -> Calls:
        frame = fetch_frame(extent.size)
        place = make_place(frame)
        kinds = {"own axes": False, "one axis": True}
        features = {
            name: [*place, make_mixture(frame, lobes, coaxial=coaxial)]
            for name, coaxial in kinds.items()
            # A single lobe is both.
            if lobes > 1 or coaxial
        }
        return make_kernel_calls(frame, features, RADIUS, "separable", device)

    facts = {"device": device, **describe_size(extent.size), "form": "separable", "radius": RADIUS, "lobes": lobes}
    return Job("lobes", facts, make, extent.rounds, TURNS, extent.seconds + 2.0)


def _plan_upsampling(scale: int, device: str, extent: Extent) -> Job:
    def make() -> Calls:
        run = partial(upsample, make_sparse(fetch_frame(extent.recipe_size), scale), device=device)
        return {
            "bilinear": partial(run, bilinear=True),
            **{name: partial(run, similarity=name) for name in extent.core},
        }

    facts = {"device": device, **describe_size(extent.recipe_size), "radius": DEFAULT_RADIUS, "scale": scale}
    return Job("upsampling", facts, make, extent.recipe_rounds, 1, 8.0 + extent.seconds)


def _plan_denoising(device: str, extent: Extent, peers: tuple[str, ...]) -> Job:
    def make() -> Calls:
        frame = add_halves(fetch_frame(extent.recipe_size))
        run = partial(denoise, frame, radius=RADIUS, device=device)
        calls: Calls = {}
        for similarity in (name for name in extent.core if name != "normal"):
            for form in ("separable", "full"):
                calls[f"fast, {similarity}, {form}"] = partial(run, quality="fast", similarity=similarity, form=form)
        calls |= {quality: partial(run, quality=quality) for quality in extent.qualities if quality != "fast"}
        return {**calls, **_make_peer_calls(frame, peers)}

    facts = {"device": device, **describe_size(extent.recipe_size), "radius": RADIUS}
    megapixels = extent.recipe_size[0] * extent.recipe_size[1] / 1e6
    return Job(
        "denoising", facts, make, extent.recipe_rounds, 1, 10.0 + 12.0 * (1.0 + extent.recipe_rounds) * megapixels
    )


def _make_peer_calls(frame: Frame, qualities: tuple[str, ...]) -> Calls:
    """Return Open Image Denoise at these qualities, given guides that need no filter."""
    run = partial(denoise_oidn, frame, guides="centre")
    return {OIDN_LABELS[quality]: partial(run, quality=quality) for quality in qualities}


def add_halves(frame: Frame) -> Frame:
    """Return the frame with what two halves of its samples gave, which the better qualities look at."""
    share = np.random.default_rng(1).random(frame.shape, dtype=np.float32)[..., None]

    def scale(weight: Any) -> Radiance:
        parts = {name: getattr(frame.radiance, name) for name in ("color", "diffuse", "specular")}
        return Radiance(**{name: 2.0 * weight * image for name, image in parts.items()})

    return frame.with_changes(half_a=scale(share), half_b=scale(1.0 - share))
