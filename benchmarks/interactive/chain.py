"""How right the interactive chain is: sparse voxel cones upsampled, against the same voxel cones at every pixel.

python -m benchmarks.interactive.chain --output benchmarks/results/interactive_quality.json
python -m benchmarks.interactive.chain --results benchmarks/results/interactive_quality.json --pictures docs/images
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import describe_machine, write_json
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.interactive import InteractiveFrame, InteractiveSettings, Session
from lobewise.io.png import encode_png
from lobewise.metrics import find_specular_pixels, rel_mse
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray
from lobewise.render import find_orbit_centre, make_orbit

SCENES = ("showroom", "brushed", "parlour")
METHOD = "voxel_cones"
FRAMES = 8
DEGREES_PER_FRAME = 0.5
REFERENCE_SAMPLES = 64
ADAPTIVE = 0.05
GAP = 6
LOBES = ("sg", "ggx")
# What a chain that compares normals was tuned over, by the error after upsampling and repair of a single frame.
GRID = {
    "radius": (1, 2, 3),
    "normal_exponent": (16.0, 64.0, 256.0, 1024.0),
    "screen_sigma": (2.0, 3.0, 5.0, 8.0),
}


def make_settings(**changes: Any) -> InteractiveSettings:
    """Return the settings of a chain; the share of re-computed pixels is the one that is measured."""
    return replace(InteractiveSettings(method=METHOD, adaptive=ADAPTIVE), **changes)


def render_reference(session: Session, camera: Camera) -> FloatArray:
    """Return indirect light with every pixel shaded, by the method of the chains itself."""
    settings = make_settings(scale=1, similarity="none", spp=REFERENCE_SAMPLES, adaptive=0.0)
    return session.make_sibling().render(camera, settings).get_view("indirect")


def render_last(session: Session, cameras: list[Camera], settings: InteractiveSettings) -> InteractiveFrame:
    """Return the last frame of a path; its history begins with the path."""
    stream = session.make_sibling()
    path = cameras if settings.temporal else cameras[-1:]
    return list(stream.frames(path, settings))[-1]


def measure(frame: InteractiveFrame, reference: FloatArray) -> dict[str, float]:
    """Return the errors of indirect light, of all pixels and of those with a specular lobe."""
    indirect, before = frame.get_view("indirect"), frame.parts.before.image
    shiny = find_specular_pixels(frame.parts.hits.gbuffer)
    return {
        "rel_mse": float(rel_mse(indirect, reference)),
        "rel_mse_specular": float(rel_mse(indirect[shiny][None], reference[shiny][None])),
        "without_adaptive": float(rel_mse(before, reference)),
    }


def list_grid() -> Iterator[dict[str, Any]]:
    """Yield every combination of `GRID`."""
    for values in product(*GRID.values()):
        yield dict(zip(GRID, values, strict=True))


def tune_normals(session: Session, cameras: list[Camera], reference: FloatArray, temporal: bool) -> dict[str, Any]:
    """Return the parameters with which comparing normals has the lowest error on this very frame."""

    def compute_error(changes: dict[str, Any]) -> float:
        settings = make_settings(similarity="normal", temporal=temporal, **changes)
        return measure(render_last(session, cameras, settings), reference)["rel_mse"]

    return min(list_grid(), key=compute_error)


def open_scene(name: str, size: int) -> tuple[Session, list[Camera], FloatArray]:
    """Return a session that is ready, the path, and the reference of its last camera."""
    session = Session(name, width=size, height=size)
    session.prepare(METHOD)
    cameras = make_orbit(session.camera, find_orbit_centre(session.scene), FRAMES, DEGREES_PER_FRAME)
    return session, cameras, render_reference(session, cameras[-1])


def measure_scene(name: str, size: int, known: dict[str, Any] | None) -> dict[str, Any]:
    """Return errors by chain; ``known`` results of the scene tell how the baseline was tuned."""
    session, cameras, reference = open_scene(name, size)
    found: dict[str, Any] = {}
    for temporal in (False, True):
        kind = "over time" if temporal else "single frame"
        if known is None:
            tuned = tune_normals(session, cameras, reference, temporal)
        else:
            tuned = {key: known[kind]["normal, tuned"]["settings"][key] for key in GRID}
        chains: dict[str, dict[str, Any]] = {
            "none": {"similarity": "none"},
            "normal": {"similarity": "normal"},
            "normal, tuned": {"similarity": "normal", **tuned},
            **{lobes: {"similarity": lobes} for lobes in LOBES},
        }
        rows = {}
        for chain, changes in chains.items():
            frame = render_last(session, cameras, make_settings(temporal=temporal, **changes))
            rows[chain] = {**measure(frame, reference), "settings": changes, "recomputed": frame.recomputed}
            print(f"{name:10} {kind:12} {chain:14} {rows[chain]['rel_mse']:.5f}", flush=True)
        found[kind] = rows
    return found


def write_row(path: Path, panels: list[Any]) -> None:
    """Write pictures beside each other."""
    gap = np.full((panels[0].shape[0], GAP, 3), 255, dtype=np.uint8)
    row = np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)
    path.write_bytes(encode_png(np.ascontiguousarray(row)))
    print(f"{path}: {row.shape[1]}x{row.shape[0]}, {path.stat().st_size / 1e3:.0f} kB")


def write_pictures(folder: Path, name: str, size: int, rows: dict[str, Any]) -> None:
    """Write what the page shows of a scene: chains beside each other, and what re-computation does."""
    session, cameras, reference = open_scene(name, size)
    frames = {
        chain: render_last(session, cameras, make_settings(**rows[chain]["settings"]))
        for chain in ("normal, tuned", "ggx")
    }
    ours = frames["ggx"]
    direct = ours.parts.noisy_direct.total
    samples = ours.get_view("noisy") - direct
    part = slice(size * 3 // 10, size * 3 // 10 + size // 2), slice(size * 3 // 8, size * 3 // 8 + size // 2)
    exposure = choose_exposure(reference)

    def show(image: FloatArray) -> Any:
        return map_tones(image, exposure)[part]

    images = [samples, *(frame.get_view("indirect") for frame in frames.values()), reference]
    write_row(folder / f"interactive-{name}.png", [show(image) for image in images])
    mask = np.repeat((255.0 * ours.get_view("recomputed")[part]).astype(np.uint8)[..., None], 3, axis=-1)
    write_row(
        folder / f"interactive-{name}-adaptive.png",
        [show(ours.parts.before.image), mask, show(ours.get_view("indirect")), show(reference)],
    )


def main() -> None:
    """Measure, and write the JSON or the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, help="JSON to write")
    parser.add_argument("--results", type=Path, help="JSON that says how the baseline was tuned: no search again")
    parser.add_argument("--pictures", type=Path, help="folder for the pictures of the first scene; measures nothing")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("scenes", nargs="*", default=list(SCENES))
    arguments = parser.parse_args()
    known = json.loads(arguments.results.read_text())["scenes"] if arguments.results is not None else {}
    if arguments.pictures is not None:
        name = arguments.scenes[0]
        write_pictures(arguments.pictures, name, arguments.size, known[name]["over time"])
        return
    found = {name: measure_scene(name, arguments.size, known.get(name)) for name in arguments.scenes}
    if arguments.output is not None:
        head = {
            "machine": describe_machine(),
            "size": arguments.size,
            "method": METHOD,
            "frames": FRAMES,
            "degrees_per_frame": DEGREES_PER_FRAME,
            "adaptive": ADAPTIVE,
            "reference_samples": REFERENCE_SAMPLES,
            "scale": InteractiveSettings().scale,
        }
        write_json(arguments.output, {**head, "scenes": found})


if __name__ == "__main__":
    main()
