"""Frames that `measure.py` measures on, rendered once into a cache, and their pixels told apart by what they show."""

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.common import fetch_frame, write_json
from benchmarks.quality.summary import HELD_OUT, TRAIN
from lobewise.interchange import read_image
from lobewise.io.exr import write_image
from lobewise.metrics import EPSILON
from lobewise.records.frame import FloatArray, Frame, GBuffer, LobeKind
from lobewise.render import load_scene, render_frame, render_reference

Mask = NDArray[np.bool_]

SCENES = (*TRAIN, *HELD_OUT)
SAMPLES = (1, 4, 16, 64)
SEEDS = (1, 2, 3)
REFERENCE_SEED = 1000
CHUNKS = 4
"""Independent renders that make a reference; how they differ tells its error."""

NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Four of the eight; the others are these seen from the other side."""
EDGE_FOOTPRINTS = 4.0
"""Neighbours are on surfaces apart when each lies so many pixel footprints off the other's tangent plane."""
EDGE_COSINE = 0.8
"""Shading normals 37 degrees apart are an edge; a normal map stays below."""
EDGE_ALPHA = 2.0
"""Roughness that changes by more than this factor from pixel to pixel is another material."""
SMALLEST_ALPHA = 0.01
"""Alphas count as no smaller where they are compared: below, both are mirrors."""
EDGE_MIXED = 0.1
"""Distance from mean to pixel-centre normal: about a fourteenth of the pixel shows a surface at right angles."""
LEAST_SHARE = 0.05
"""A lobe with less of the pixel's albedo is as good as none."""
SPECULAR_SHARE = 0.3
"""A coated pixel is classed by its specular lobe where that carries more of the radiance."""
SHARE_BLUR = 2.0
"""Standard deviation, pixels, over which that share is averaged: the 64 samples that tell it are noisy."""
ROUGH, GLOSSY = 0.25, 0.06
"""Alphas above which a lobe is rough, and glossy; the rest are near-mirrors."""
STRETCHED = 4.0 / 3.0
FEWEST = 0.0005
"""Least share of the image that a class must have to be measured: 74 pixels of 384x384."""


@dataclass(frozen=True)
class Bench:
    """Where the frames lie and how large they are; by default the sizes of every published figure."""

    cache: Path
    size: int = 384
    reference_spp: int = 4096

    def fetch(self, scene: str, spp: int, seed: int) -> Frame:
        """Return a noisy frame, rendered on first use."""
        path = self.cache / f"{scene}-{spp}-{seed}.exr"
        frame = fetch_frame(
            path, lambda: render_frame(load_scene(scene, width=self.size, height=self.size), spp=spp, seed=seed)
        )
        if frame.shape != (self.size, self.size):
            raise SystemExit(f"{path} has {frame.width}x{frame.height} pixels, not {self.size}: use another --cache")
        return frame

    def fetch_wide(self, width: int, height: int) -> Frame:
        """Return the frame of another size that times are taken on, of 1 sample per pixel."""
        return fetch_frame(
            self.cache / f"showroom-1-1-{width}x{height}.exr",
            lambda: render_frame(load_scene("showroom", width=width, height=height), spp=1, seed=1),
        )

    def fetch_reference(self, scene: str) -> tuple[FloatArray, float]:
        """Return the reference radiance, rendered on first use, and its own error (see `average_chunks`)."""

        def render(spp: int, seed: int) -> FloatArray:
            loaded = load_scene(scene, width=self.size, height=self.size)
            return render_reference(loaded, spp=spp, seed=seed).radiance.color

        return make_reference(self.cache, f"{scene}-reference-{self.reference_spp}", self.reference_spp, render)

    def render(self, scenes: tuple[str, ...], samples: tuple[int, ...]) -> None:
        """Render all that is not there yet, references last: they take the longest."""
        for scene in scenes:
            for spp in samples:
                for seed in SEEDS:
                    self.fetch(scene, spp, seed)
        for scene in scenes:
            _, error = self.fetch_reference(scene)
            print(f"{scene}: rel_mse of the reference itself about {error:.2g}", flush=True)


def make_reference(
    cache: Path, name: str, spp: int, render: Callable[[int, int], FloatArray]
) -> tuple[FloatArray, float]:
    """Return the reference of that name and its error; made in chunks, each of which is kept until all are there.

    ``render`` is called with samples per pixel and seed.
    """
    target, note = cache / f"{name}.exr", cache / f"{name}.json"
    parts = [cache / f"{name}-part-{k}.exr" for k in range(CHUNKS)]
    if not (target.exists() and note.exists()):
        for k, part in enumerate(parts):
            if not part.exists():
                print(f"rendering {part.name}", file=sys.stderr, flush=True)
                write_image(part, render(-(-spp // CHUNKS), REFERENCE_SEED + k))
        mean, error = average_chunks([read_image(part) for part in parts])
        write_image(target, mean)
        write_json(note, {"spp": spp, "chunks": CHUNKS, "first_seed": REFERENCE_SEED, "rel_mse": error})
    for part in parts:
        part.unlink(missing_ok=True)
    return read_image(target), float(json.loads(note.read_text())["rel_mse"])


def average_chunks(chunks: list[FloatArray]) -> tuple[FloatArray, float]:
    """Return the mean of independent renders, and an estimate of that mean's rel_mse.

    The variance of a mean of n is the unbiased variance between the n over n; it takes the place of ``(a - r)^2`` in
    `lobewise.metrics.rel_mse`.
    """
    stack = np.asarray(chunks, dtype=np.float64)
    mean = stack.mean(axis=0)
    variance = stack.var(axis=0, ddof=1) / len(stack)
    return mean.astype(np.float32), float((variance / (mean**2 + EPSILON)).mean())


def classify_pixels(frame: Frame) -> dict[str, Mask]:
    """Return which pixels show what, by class; every mask has the shape (height, width).

    Each pixel is in one class at most. "silhouette" comes first: pixels that differ from one of their eight neighbours
    in surface, orientation or material, or whose samples saw other normals than the centre did. The others go by the
    lobe that carries what they show: "diffuse" without a specular lobe, or with one of less than a twentieth of the
    albedo; "rough" (alpha above 0.25), "glossy" (above 0.06) and "near-mirror" (the rest, and delta lobes), where alpha
    is the geometric mean of the two. A coated pixel has both lobes: it goes by its specular lobe where that carries
    more than 30 % of the radiance scattered there, measured on the frame itself and blurred a little, else it is
    diffuse. What is no surface, or only emits, is in no class.

    "anisotropic" overlaps the three specular classes: their pixels whose alphas are apart by more than a third.
    """
    guides = frame.gbuffer
    edge = mark_silhouettes(frame)
    diffuse, specular = guides.diffuse_albedo.mean(axis=-1), guides.specular_albedo.mean(axis=-1)
    albedo = diffuse + specular
    inside = ~edge & (albedo > 0.0)
    has_lobe = (np.rint(guides.lobe_kind) != LobeKind.NONE) & (specular >= LEAST_SHARE * albedo)
    coated = diffuse >= LEAST_SHARE * albedo
    shiny = inside & has_lobe & (~coated | (compute_specular_share(frame) > SPECULAR_SHARE))
    alpha = np.sqrt(guides.alpha_u * guides.alpha_v)
    large, small = np.maximum(guides.alpha_u, guides.alpha_v), np.minimum(guides.alpha_u, guides.alpha_v)
    return {
        "silhouette": edge,
        "diffuse": inside & ~shiny,
        "rough": shiny & (alpha > ROUGH),
        "glossy": shiny & (alpha > GLOSSY) & (alpha <= ROUGH),
        "near-mirror": shiny & (alpha <= GLOSSY),
        "anisotropic": shiny & (large > STRETCHED * small),
    }


def compute_specular_share(frame: Frame) -> FloatArray:
    """Return how much of the scattered radiance the specular lobe carries, in [0, 1], averaged over some pixels."""
    radiance = frame.radiance
    diffuse, specular = (
        gaussian_filter(image.mean(axis=-1), SHARE_BLUR) for image in (radiance.diffuse, radiance.specular)
    )
    return np.asarray(specular / np.maximum(diffuse + specular, 1e-6), dtype=np.float32)


def mark_silhouettes(frame: Frame) -> Mask:
    """Return the pixels at which another surface, orientation or material begins, on both its sides."""
    guides = frame.gbuffer
    position = guides.position if guides.position is not None else frame.camera.make_positions(guides.depth)
    footprint = guides.depth * frame.camera.get_pixel_angle(frame.height)
    edge = np.zeros(frame.shape, dtype=np.bool_)
    mean = guides.mean_normal
    if mean is not None:
        edge |= np.linalg.norm(mean - guides.normal, axis=-1) > EDGE_MIXED
    for here, there in _list_pairs(frame.shape):
        apart = position[there] - position[here]
        heights = [np.abs((guides.normal[each] * apart).sum(axis=-1)) for each in (here, there)]
        surface = np.minimum(*heights) > EDGE_FOOTPRINTS * np.minimum(footprint[here], footprint[there])
        turned = (guides.normal[here] * guides.normal[there]).sum(axis=-1) < EDGE_COSINE
        hit = guides.depth > 0.0
        both = hit[here] & hit[there]
        differ = (hit[here] != hit[there]) | (both & (surface | turned | _mark_material_steps(guides, here, there)))
        edge[here] |= differ
        edge[there] |= differ
    return edge


def _list_pairs(shape: tuple[int, int]) -> Iterator[tuple[Any, Any]]:
    """Yield pairs of views of an image that lay each pixel on one of its neighbours."""
    for down, right in NEIGHBOURS:
        rows = slice(0, shape[0] - down), slice(down, shape[0])
        columns = slice(max(0, -right), shape[1] - max(0, right)), slice(max(0, right), shape[1] + min(0, right))
        yield (rows[0], columns[0]), (rows[1], columns[1])


def _mark_material_steps(guides: GBuffer, here: Any, there: Any) -> Mask:
    """Return where two neighbours have lobes of another kind, of another table, or of quite another roughness."""
    kind = np.rint(guides.lobe_kind)
    steps = kind[here] != kind[there]
    if guides.material is not None:
        steps |= np.rint(guides.material[here]) != np.rint(guides.material[there])
    for image in (guides.alpha_u, guides.alpha_v):
        alpha = np.maximum(image, SMALLEST_ALPHA)
        ratio = alpha[here] / alpha[there]
        steps |= (ratio > EDGE_ALPHA) | (ratio < 1.0 / EDGE_ALPHA)
    return np.asarray(steps)
