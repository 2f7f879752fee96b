"""A table of SHA-256 of results on the bundled frame: a change that should change no bit is held against it.

``python -m benchmarks.same_bits --write`` makes the table of this processor; without ``--write`` every result is
computed again and compared. Results that may differ in the last bits are told with how far they are apart, which needs
``--keep DIRECTORY``, where both runs leave their arrays. Bits are those of one kind of processor: vectors of another
width add in another order.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import halide as hl
import numpy as np

import lobewise
from benchmarks.common import SHOWROOM
from lobewise import Camera, Frame, Radiance

TABLE = Path(__file__).parent / "results" / "same_bits.json"
LARGEST_DIFFERENCE = 1e-6
"""Of the mean of a result: what two texts of a formula that became one may differ by."""
Arrays = dict[str, np.ndarray]


def load_bundled() -> Frame:
    """Return the frame that comes with the repository, whole."""
    return lobewise.read_frame(SHOWROOM)


def crop(frame: Frame, rows: slice, columns: slice) -> Frame:
    """Return a part of a frame, with a camera that is only about right: bits do not mind."""

    def cut(part: Any) -> Any:
        values = {item.name: getattr(part, item.name) for item in fields(part)}
        return type(part)(**{name: None if v is None else v[rows, columns] for name, v in values.items()})

    assert frame.camera is not None
    scale = (rows.stop - rows.start) / frame.height
    camera = replace(frame.camera, fov_y=2.0 * float(np.arctan(scale * np.tan(0.5 * frame.camera.fov_y))))
    return Frame(cut(frame.radiance), cut(frame.gbuffer), camera, spp=frame.spp)


def enrich(frame: Frame) -> Frame:
    """Return the frame with every guide that a renderer of ours gives; what it lacks is made up, smooth and lasting."""
    rng = np.random.default_rng(20150915)
    height, width = frame.shape
    guides = frame.gbuffer
    assert guides.normal is not None
    assert guides.alpha_u is not None
    assert guides.depth is not None
    assert guides.diffuse_albedo is not None
    assert guides.specular_albedo is not None
    y, x = np.mgrid[:height, :width] / 32.0
    helper = np.cross(guides.normal, np.array([0.3, 0.9, 0.1]))
    tangent = helper / np.maximum(np.linalg.norm(helper, axis=-1, keepdims=True), 1e-6)
    wave = np.stack([np.sin(x), np.cos(y), np.sin(x + y)], axis=-1)
    noise = rng.gamma(2.0, 0.5, (height, width, 1)).astype(np.float32)

    def split(part: Radiance, factor: np.ndarray) -> Radiance:
        images = {name: getattr(part, name) for name in ("color", "diffuse", "specular")}
        return Radiance(**{name: None if image is None else image * factor for name, image in images.items()})

    return frame.with_changes(
        gbuffer=replace(
            guides,
            tangent=tangent,
            alpha_v=np.clip(guides.alpha_u * (1.0 + 0.5 * np.sin(3.0 * x)), 0.0, 1.0),
            hit_distance=np.where(guides.depth > 0.0, 1.0 + np.sin(x) ** 2, 0.0),
            hit_normal=0.7 * wave / np.linalg.norm(wave, axis=-1, keepdims=True),
            hit_albedo=0.5 + 0.4 * wave,
            mean_normal=guides.normal,
            mean_diffuse_albedo=guides.diffuse_albedo,
            mean_specular_albedo=guides.specular_albedo,
            coverage=rng.multinomial(16, np.full(9, 1 / 9), (height, width)) / 16,
        ),
        half_a=split(frame.radiance, noise),
        half_b=split(frame.radiance, np.float32(2.0) - np.minimum(noise, np.float32(2.0))),
    )


def take(result: Any) -> Arrays:
    """Return the images of a result by name."""
    names = ("image", "diffuse", "specular", "weight_sum", "effective_samples", "variance", "bad_pixels")
    found = {name: getattr(result, name) for name in names}
    return {name: np.asarray(value) for name, value in found.items() if value is not None}


def list_cases() -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Yield every case by its name."""
    bundled = load_bundled()
    part = crop(bundled, slice(150, 299), slice(120, 331))
    rich = enrich(part)

    def denoise(frame: Frame, **changes: Any) -> Callable[[], Arrays]:
        return lambda: take(lobewise.denoise(frame, device="cpu", **changes))

    for form in ("full", "separable", "atrous"):
        for similarity in ("normal", "sg", "sg_mixture", "asg", "ggx"):
            options: dict[str, Any] = {"quality": "fast", "form": form, "similarity": similarity}
            yield f"fast {form} {similarity}", denoise(part, **options)
            yield f"fast {form} {similarity}, all guides", denoise(rich, **options)
        for similarity in ("sg", "asg", "ggx"):
            options = {"quality": "fast", "form": form, "similarity": similarity, "hit_distance": True}
            yield f"fast {form} {similarity}, hits", denoise(rich, **options)
    yield "fast normal, band limit", denoise(part, quality="fast", similarity="normal", band_limit=1.0)
    yield "fast separable ggx, whole", denoise(bundled, quality="fast", form="separable")
    total = part.with_changes(radiance=Radiance(part.radiance.color))
    for similarity in ("sg_mixture", "ggx"):
        yield f"fast {similarity}, not apart", denoise(total, quality="fast", similarity=similarity)
    for quality in ("balanced", "high"):
        yield quality, denoise(part, quality=quality)
        yield f"{quality}, all guides", denoise(rich, quality=quality)
        yield f"{quality}, not apart", denoise(total, quality=quality)
    for similarity in ("normal", "sg", "sg_mixture", "asg"):
        yield f"balanced {similarity}", denoise(rich, quality="balanced", similarity=similarity)
    yield "balanced, whole", denoise(bundled, quality="balanced")
    yield "high, whole", denoise(bundled, quality="high")

    def upsample(place: tuple[int, int], **changes: Any) -> Callable[[], Arrays]:
        return lambda: take(lobewise.upsample(lobewise.make_sparse(rich, 4, place), device="cpu", **changes))

    for similarity in ("normal", "sg", "sg_mixture", "asg", "ggx"):
        yield f"upsampling {similarity}", upsample((1, 2), similarity=similarity)
    yield "upsampling bilinear", upsample((0, 0), bilinear=True)

    def run_history(frame: Frame, sparse: bool, **changes: Any) -> Callable[[], Arrays]:
        return lambda: _run_history(frame, sparse, changes)

    yield "history, sparse", run_history(rich, True)
    yield "history, sparse, few guides", run_history(part, True)
    yield "history, sparse sg", run_history(rich, True, similarity="sg")
    yield "history, full", run_history(rich, False, radius=4)
    yield "history, full, few guides", run_history(part, False, radius=4)
    yield "history, separable", run_history(rich, False, form="separable")
    yield "history, atrous normal", run_history(rich, False, form="atrous", similarity="normal")

    yield "recomputed", lambda: _recompute(rich)
    for quality in ("fast", "balanced", "high"):
        yield f"bands {quality}", lambda quality=quality: _denoise_bands(rich, quality)  # type: ignore[misc]


def _run_history(frame: Frame, sparse: bool, changes: dict[str, Any]) -> Arrays:
    """Return the results of four frames of a camera that moves, and what is remembered then."""
    history = lobewise.TemporalFilter(device="cpu", **changes)
    found: Arrays = {}
    camera = frame.camera
    assert camera is not None
    rng = np.random.default_rng(7)
    for number in range(4):
        step = 0.02 * number * camera.right
        moved = Camera(camera.position + step, camera.forward, camera.up, camera.fov_y, camera.fov_x)
        noise = rng.gamma(4.0, 0.25, (*frame.shape, 1)).astype(np.float32)
        light = frame.radiance
        images = {name: getattr(light, name) for name in ("color", "diffuse", "specular")}
        shaded = Radiance(**{name: None if image is None else image * noise for name, image in images.items()})
        now = Frame(shaded, frame.gbuffer, moved, spp=frame.spp)
        given = lobewise.make_sparse(now, 4, (number, 3 - number)) if sparse else now
        found |= {f"{number} {name}": value for name, value in take(history.add(given)).items()}
    state = {name: value for name, value in history.get_state().items() if name.startswith("sums")}
    return found | {name: np.asarray(value) for name, value in state.items()}


def _recompute(frame: Frame) -> Arrays:
    result = lobewise.upsample(lobewise.make_sparse(frame, 4), device="cpu")

    def shade(rows: np.ndarray, columns: np.ndarray) -> Radiance:
        parts = [getattr(frame.radiance, name)[rows, columns][:, None] for name in ("color", "diffuse", "specular")]
        return Radiance(parts[0], diffuse=parts[1], specular=parts[2])

    return take(lobewise.recompute(result, shade, samples=1.0, frame=frame))


def _denoise_bands(frame: Frame, quality: str) -> Arrays:
    with tempfile.TemporaryDirectory() as folder:
        source, output = Path(folder) / "in.exr", Path(folder) / "out.exr"
        lobewise.write_frame(source, frame)
        lobewise.denoise_file(source, output, quality=quality, rows=40, device="cpu")
        return {"image": lobewise.read_frame(output).radiance.color}


def digest(arrays: Arrays) -> str:
    """Return the SHA-256 of arrays, their names, types and shapes."""
    found = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        found.update(f"{name} {array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def find_difference(old: Arrays, new: Arrays) -> float:
    """Return the largest relative difference of two results: of a pixel, over its value or the mean of its image."""
    if old.keys() != new.keys():
        return float("inf")
    largest = 0.0
    for name, before in old.items():
        a, b = before.astype(np.float64), new[name].astype(np.float64)
        if a.shape != b.shape or not np.array_equal(np.isfinite(a), np.isfinite(b)):
            return float("inf")
        good = np.isfinite(a)
        scale = np.maximum(np.abs(a[good]), np.abs(a[good]).mean() if good.any() else 1.0)
        gap = np.abs(a - b)[good] / np.maximum(scale, 1e-30)
        largest = max(largest, float(gap.max(initial=0.0)))
    return largest


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="make the table of this processor anew")
    parser.add_argument("--keep", type=Path, help="where arrays are left, and compared if they differ")
    parser.add_argument("--only", default="", help="cases whose name has this in it")
    options = parser.parse_args()
    target = hl.get_host_target()
    processor = f"{target.arch.name.lower()}, {target.natural_vector_size(hl.Float(32))} lanes of float32"
    tables = json.loads(TABLE.read_text()) if TABLE.exists() else {}
    table = tables.get(processor, {})
    if not options.write and not table:
        print(f"{TABLE.name} has no results of a processor with {processor}; make them with --write of an old version")
        return 2
    failed = 0
    for name, run in list_cases():
        if options.only not in name:
            continue
        arrays = run()
        found = digest(arrays)
        path = options.keep and options.keep / f"{name.replace(' ', '_').replace(',', '')}.npz"
        if options.write:
            table[name] = found
            if path:
                path.parent.mkdir(parents=True, exist_ok=True)
                np.savez_compressed(path, **arrays)
            print(f"{found[:12]} {name}", flush=True)
            continue
        if found == table.get(name):
            print(f"same      {name}", flush=True)
            continue
        gap = find_difference(dict(np.load(path)), arrays) if path and path.exists() else float("nan")
        failed += not gap <= LARGEST_DIFFERENCE
        print(f"{gap:9.2e} {name}", flush=True)
    if options.write:
        # Not at the top: the table can be made by an older version, which has other modules.
        from benchmarks.common import write_json

        write_json(TABLE, {**tables, processor: table})
    print(f"{failed} results differ by more than {LARGEST_DIFFERENCE}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
