"""How the interactive chain follows an object that turns and a light that moves.

    python -m benchmarks.interactive.moving

64 frames of 128x128 pixels, paths at one of 4x4 pixels, a still camera. The reference of each frame is the light at the
centres of its pixels by many samples, with the same random numbers in every frame. Every eighth frame begins a test. It
takes the pixels that came into view since the frame before, and those whose light changed by a tenth. Two frames later
their error is compared with that of a session that began at the test's frame. The flicker is compared with that of
frames without history. Errors are `rel_mse` (epsilon 0.01), means over sessions with different random numbers.

The program also times how voxels follow: the shortest of some runs. Processor time is that of all threads.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import RESULTS, describe_machine, write_json
from lobewise.frame import FloatArray, GBuffer
from lobewise.interactive import InteractiveSettings, Session
from lobewise.metrics import Flicker, find_disoccluded, rel_mse
from lobewise.render import load_scene
from lobewise.render.moving.shapes import Matrix
from lobewise.render.stages import Stages
from lobewise.render.tracing.paths import PathLight

SIZE_PIXELS, FRAMES, WARM_UP_FRAMES = 128, 64, 8
TEST_EVERY, LATER = 8, 2
REFERENCE_SPP, REFERENCE_DIRECT = 128, 64
SEEDS = 2
RELIT = 0.1
"""Relative change of a pixel's reference from which on it counts as relit."""
SWITCH_FACTORS, SWITCH_FRAMES, LAMP = (0.1, 0.5, 2.0, 10.0), 12, "lamp.emitter.radiance.value"
RUNS = 16
"""Runs of each way in which voxels follow."""

WORKSHOP = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective"><float name="fov" value="42"/>
    <transform name="to_world"><lookat origin="0.3, 1.7, 4.6" target="0, 0.75, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="128"/><integer name="height" value="128"/>
      <rfilter type="box"/></film></sensor>
  <bsdf type="twosided" id="plaster"><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.7, 0.6"/></bsdf></bsdf>
  <bsdf type="twosided" id="blue"><bsdf type="diffuse"><rgb name="reflectance" value="0.15, 0.25, 0.6"/></bsdf></bsdf>
  <bsdf type="twosided" id="orange"><bsdf type="diffuse"><rgb name="reflectance" value="0.75, 0.35, 0.1"/></bsdf></bsdf>
  <bsdf type="twosided" id="lacquer"><bsdf type="roughplastic"><float name="alpha" value="0.1"/>
    <rgb name="diffuse_reflectance" value="0.35, 0.08, 0.08"/></bsdf></bsdf>
  <bsdf type="roughconductor" id="steel"><string name="material" value="Cr"/><float name="alpha" value="0.15"/></bsdf>
  <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="2.5"/>
    </transform><ref id="lacquer"/></shape>
  <shape type="rectangle" id="ceiling"><transform name="to_world"><rotate x="1" angle="90"/><scale value="2.5"/>
    <translate y="2.5"/></transform><ref id="plaster"/></shape>
  <shape type="rectangle" id="back"><transform name="to_world"><scale value="2.5"/><translate z="-2.2"/></transform>
    <ref id="plaster"/></shape>
  <shape type="rectangle" id="left"><transform name="to_world"><rotate y="1" angle="90"/><scale value="2.5"/>
    <translate x="-2.2"/></transform><ref id="blue"/></shape>
  <shape type="rectangle" id="right"><transform name="to_world"><rotate y="1" angle="-90"/><scale value="2.5"/>
    <translate x="2.2"/></transform><ref id="orange"/></shape>
  <shape type="cube" id="beam"><transform name="to_world"><scale x="0.9" y="0.12" z="0.18"/>
    <translate x="-0.2" y="0.9" z="0"/></transform><ref id="plaster"/></shape>
  <shape type="cube" id="post"><transform name="to_world"><scale x="0.1" y="0.4" z="0.1"/>
    <translate x="-0.2" y="0.4" z="0"/></transform><ref id="orange"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="1.2" y="0.45" z="0.4"/><float name="radius" value="0.45"/>
    <ref id="steel"/></shape>
  <shape type="sphere" id="bulb"><point name="center" x="-1.3" y="2.35" z="2.0"/><float name="radius" value="0.12"/>
    <emitter type="area"><rgb name="radiance" value="90, 80, 65"/></emitter></shape>
</scene>"""
"""A room with a beam that turns on a post, under a small lamp that moves."""


def slide(x: float, y: float, z: float) -> Matrix:
    """Return the matrix of a translation."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def turn(degrees: float, about: tuple[float, float, float]) -> Matrix:
    """Return the matrix of a turn about the vertical through a point."""
    angle = np.deg2rad(degrees)
    matrix = np.eye(4)
    matrix[0, [0, 2]], matrix[2, [0, 2]] = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
    return np.asarray(slide(*about) @ matrix @ slide(*(-part for part in about)))


def place_showroom(frame: int) -> dict[str, Matrix]:
    """Return the places of the showroom's cube, which turns, and of its lamp, which goes to and fro."""
    return {"cube": turn(2.5 * frame, (2.3, 0.32, 1.5)), "lamp": slide(1.5 * np.sin(0.06 * frame), 0.0, 0.0)}


def place_workshop(frame: int) -> dict[str, Matrix]:
    """Return the places of the beam and of the bulb."""
    return {"beam": turn(3.0 * frame, (-0.2, 0.9, 0.0)), "bulb": slide(0.04 * frame, 0.0, 0.0)}


PLACES: dict[str, Callable[[int], dict[str, Matrix]]] = {"showroom": place_showroom, "workshop": place_workshop}


@dataclass
class Truth:
    """The references of all frames, and the pixels of every test by the number of its first frame."""

    images: list[FloatArray]
    tests: dict[int, dict[str, NDArray[np.bool_]]]


def load(name: str) -> Any:
    """Return a scene whose shapes have ids."""
    if name != "workshop":
        return load_scene(name, width=SIZE_PIXELS, height=SIZE_PIXELS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "workshop.xml"
        path.write_text(WORKSHOP)
        return load_scene(path, width=SIZE_PIXELS, height=SIZE_PIXELS, merge=False)


def render_truth(stages: Stages, spp: int) -> FloatArray:
    """Return the light at the centres of all pixels, by many samples."""
    camera = stages.start_camera
    rows, columns = (index.ravel() for index in np.indices((SIZE_PIXELS, SIZE_PIXELS)))
    total = np.zeros((SIZE_PIXELS * SIZE_PIXELS, 3))
    method = PathLight(stages.scene, stages.materials)
    part = 64
    for seed in range(spp // part):
        total += sum(stages.shade_indirect(method, rows, columns, part, 7000 + seed)[:2]) * (part / spp)
    direct = [stages.trace_first(camera, 9000 + seed)[1].total for seed in range(REFERENCE_DIRECT)]
    return np.asarray(total.reshape(SIZE_PIXELS, SIZE_PIXELS, 3) + np.mean(direct, axis=0), np.float32)


def render_references(session: Session, name: str, spp: int) -> Truth:
    """Return the references of a scene's sequence. The session renders the guides."""
    stages, images = Stages(session.scene), []
    quick = InteractiveSettings(scale=16, adaptive=0.0)
    tests: dict[int, dict[str, NDArray[np.bool_]]] = {}
    before: GBuffer | None = None
    for frame in range(FRAMES):
        session.set_transforms(PLACES[name](frame))
        guides = session.render(None, quick).parts.hits.gbuffer
        stages.place_camera(stages.start_camera, SIZE_PIXELS, SIZE_PIXELS)
        images.append(render_truth(stages, spp))
        if before is not None and frame % TEST_EVERY == 0 and frame + LATER < FRAMES:
            new = find_disoccluded(guides, session.camera, before, session.camera)
            old, now = (image.sum(axis=-1) for image in images[-2:])
            relit = np.abs(now - old) > RELIT * np.maximum(old, 0.01)
            tests[frame] = {"disoccluded": new, "relit": relit & ~new}
        before = guides
        print(f"{name}: reference {frame + 1} of {FRAMES}", flush=True)
    return Truth(images, tests)


def render(session: Session, name: str, frames: range, settings: InteractiveSettings) -> Iterator[FloatArray]:
    """Yield the frames of a sequence."""
    for frame in frames:
        session.set_transforms(PLACES[name](frame))
        yield session.render(None, settings).image


def measure_sequence(session: Session, name: str, truth: Truth, settings: InteractiveSettings) -> dict[str, Any]:
    """Return the flicker of a sequence, and its squared errors at the pixels of each test."""
    flicker, errors = Flicker(), {"disoccluded": [], "relit": [], "all": []}
    stream = session.make_sibling()
    stream.reset()
    session.set_transforms(PLACES[name](0))
    for _ in range(WARM_UP_FRAMES):
        stream.render(None, settings)
    for frame, image in enumerate(render(stream, name, range(FRAMES), settings)):
        flicker.add(image, truth.images[frame])
        errors["all"].append(rel_mse(image, truth.images[frame]))
        for kind, mask in truth.tests.get(frame - LATER, {}).items():
            errors[kind].append(sum_errors(image, truth.images[frame], mask))
    return {"flicker": flicker.get_mean(), **errors}


def sum_errors(image: FloatArray, reference: FloatArray, mask: NDArray[np.bool_]) -> float:
    """Return the sum of the `rel_mse` of single pixels."""
    return rel_mse(image, reference, mask) * float(mask.sum()) if mask.any() else 0.0


def measure_fresh(session: Session, name: str, truth: Truth, settings: InteractiveSettings) -> dict[str, list[float]]:
    """Return the squared errors of sessions that began at each test."""
    errors: dict[str, list[float]] = {"disoccluded": [], "relit": []}
    for first, masks in truth.tests.items():
        stream = session.make_sibling()
        *_, image = render(stream, name, range(first, first + LATER + 1), settings)
        for kind, mask in masks.items():
            errors[kind].append(sum_errors(image, truth.images[first + LATER], mask))
    return errors


@contextmanager
def forget_motion() -> Iterator[None]:
    """Leave motion vectors out, and let histories follow no light."""
    from lobewise.interactive import session
    from lobewise.interactive.changes import SceneChanges

    original = SceneChanges.add_motion, session.relight
    SceneChanges.add_motion = lambda self, hits, seen: hits  # type: ignore[method-assign]
    session.relight = lambda *_: None  # type: ignore[assignment]
    try:
        yield
    finally:
        SceneChanges.add_motion, session.relight = original  # type: ignore[method-assign]


def average(runs: list[dict[str, Any]], name: str) -> float:
    """Return the mean of numbers of all runs."""
    return float(np.mean([np.sum(run[name]) for run in runs]))


def measure_scene(name: str, spp: int, seeds: int) -> dict[str, Any]:
    """Return ratios of errors and flicker of one scene."""
    # Each session has a scene of its own, because places count from those at the session's beginning.
    truth = render_references(Session(load(name)), name, spp)
    usual = InteractiveSettings(accumulate=False)
    runs: dict[str, list[dict[str, Any]]] = {"kept": [], "single": [], "fresh": [], "unaware": []}
    for seed in range(seeds):
        session = Session(load(name), seed=seed)
        runs["kept"].append(measure_sequence(session, name, truth, usual))
        runs["single"].append(measure_sequence(session, name, truth, replace(usual, temporal=False)))
        runs["fresh"].append(measure_fresh(session, name, truth, usual))
        with forget_motion():
            runs["unaware"].append(measure_sequence(session, name, truth, usual))
        print(f"{name}: seed {seed + 1} of {seeds}", flush=True)

    def divide(above: str, below: str, kind: str) -> float:
        return float(f"{average(runs[above], kind) / average(runs[below], kind):.4g}")

    return {
        "pixels": {
            kind: int(sum(int(masks[kind].sum()) for masks in truth.tests.values()))
            for kind in ("disoccluded", "relit")
        },
        "error_over_fresh": {kind: divide("kept", "fresh", kind) for kind in ("disoccluded", "relit")},
        "unaware_over_fresh": {kind: divide("unaware", "fresh", kind) for kind in ("disoccluded", "relit")},
        "flicker_over_single": divide("kept", "single", "flicker"),
        "unaware_flicker_over_single": divide("unaware", "single", "flicker"),
        "error_over_single": divide("kept", "single", "all"),
    }


def time_voxels() -> dict[str, dict[str, float]]:
    """Return how long voxels take to follow changes of the showroom: the shortest wall and processor time, seconds."""
    from lobewise.render.bridge import dr
    from lobewise.render.moving.shapes import ShapePlaces
    from lobewise.render.voxels.cones import VoxelCones

    scene = load("showroom")
    method, places = VoxelCones(scene, Stages(scene).materials), ShapePlaces(scene)
    spent: dict[str, list[tuple[float, float]]] = {"anew": [], "light": [], "shape": [], "refined": []}

    def watch(name: str, work: Callable[[], None]) -> None:
        dr.sync_thread()
        start = time.perf_counter(), time.process_time()
        work()
        dr.sync_thread()
        spent[name].append((time.perf_counter() - start[0], time.process_time() - start[1]))

    for run in range(RUNS):
        boxes = [box for pair in places.place({"cube": place_showroom(run + 1)["cube"]}).values() for box in pair]
        watch("shape", lambda boxes=boxes: method.update_shapes(boxes))  # type: ignore[misc]
        watch("refined", method.refine)
        places.place({"lamp": place_showroom(run + 1)["lamp"]})
        watch("light", method.update_lights)
        if run < 3:
            watch("anew", method.update)
    return {
        name: {kind: float(f"{min(each[k] for each in times):.4g}") for k, kind in enumerate(("wall", "processor"))}
        for name, times in spent.items()
    }


def measure_switch() -> dict[str, dict[str, float]]:
    """Return the mean indirect light of the showroom in the frame after its lamp changed, over what it should be.

    The histories are a dozen frames long then.
    """
    import mitsuba as mi

    usual = InteractiveSettings(accumulate=False)

    def switch(factor: float) -> float:
        scene = load("showroom")
        session = Session(scene)
        for _ in range(SWITCH_FRAMES):
            before = session.render(None, usual).get_view("indirect").mean()
        values = mi.traverse(scene)
        values[LAMP] = values[LAMP] * factor
        values.update()
        session.update_lights()
        after = session.render(None, usual).get_view("indirect").mean()
        return float(f"{after / before / factor:.4g}")

    found = {}
    for factor in SWITCH_FACTORS:
        kept = switch(factor)
        with forget_motion():
            found[f"{factor:g}"] = {"kept": kept, "unaware": switch(factor)}
    return found


def main() -> None:
    """Measure both scenes and the voxels, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "moving.json")
    parser.add_argument("--spp", type=int, default=REFERENCE_SPP, help="Samples of the references.")
    parser.add_argument("--only", choices=("voxels", "switch"), help="Measure this, and keep the rest of the JSON.")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="Sessions of each scene.")
    asked = parser.parse_args()
    quick: dict[str, Callable[[], dict[str, Any]]] = {"voxels": time_voxels, "switch": measure_switch}
    found = {name: measure() for name, measure in quick.items() if asked.only in (None, name)}
    print(found, flush=True)
    if asked.only is not None:
        write_json(asked.output, {**json.loads(asked.output.read_text()), **found})
        return
    scenes = {name: measure_scene(name, asked.spp, asked.seeds) for name in PLACES}
    print(*scenes.items(), sep="\n")
    facts = {"frames": FRAMES, "size": SIZE_PIXELS, "reference_spp": asked.spp, "seeds": asked.seeds}
    write_json(asked.output, {"scenes": scenes, **found, **facts, "machine": describe_machine()})


if __name__ == "__main__":
    main()
