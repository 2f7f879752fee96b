"""How the interactive chain follows the reflection of an object that moves, and the picture in a mirror that turns.

    python -m benchmarks.interactive.reflections

A checked ball moves before a flat mirror, or the mirror turns before the ball. The mirror is sharp (alpha 0.02) or
satin (alpha 0.15). Frames have 128x128 pixels, paths at one of 4x4 pixels, and a still camera. The reference of each
frame is the light at the centres of its pixels by many samples. Every fourth frame is a test. Its error is that of the
pixels whose mirror ray hits the ball, and of the whole mirror. It is compared with the error of a session that began
two frames earlier, with that of frames without history, and with that of a session without the guide
``reflected_motion``. Errors are `rel_mse` (epsilon 0.01), sums over tests, means over sessions with different random
numbers.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.interactive.moving import LATER, render_truth, slide, sum_errors, turn
from lobewise.frame import FloatArray
from lobewise.interactive import InteractiveSettings, Session
from lobewise.io.png import encode_png
from lobewise.render import load_scene
from lobewise.render.moving.shapes import Matrix
from lobewise.render.stages import FirstHits, Stages

SIZE_PIXELS, FRAMES, WARM_UP_FRAMES = 128, 32, 8
TEST_EVERY = 4
REFERENCE_SPP, SEEDS = 128, 3
ALPHAS = {"sharp": 0.02, "satin": 0.15}
KINDS = ("reflection", "mirror")
SHOWN = 0.35
"""Factor of the radiance in pictures."""

ROOM = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective"><float name="fov" value="36"/>
    <transform name="to_world"><lookat origin="1.6, 1.3, 1.2" target="-0.4, 1.1, -1.8" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="128"/><integer name="height" value="128"/>
      <rfilter type="box"/></film></sensor>
  <bsdf type="twosided" id="plaster"><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.7, 0.6"/></bsdf></bsdf>
  <bsdf type="twosided" id="green"><bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.5, 0.25"/></bsdf></bsdf>
  <bsdf type="twosided" id="checks"><bsdf type="diffuse"><texture type="checkerboard" name="reflectance">
    <rgb name="color0" value="0.85, 0.3, 0.08"/><rgb name="color1" value="0.08, 0.2, 0.6"/>
    <transform name="to_uv"><scale x="4" y="2"/></transform></texture></bsdf></bsdf>
  <bsdf type="twosided" id="silver"><bsdf type="roughconductor"><string name="material" value="Al"/>
    <float name="alpha" value="$alpha"/></bsdf></bsdf>
  <default name="alpha" value="0.02"/>
  <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="4"/>
    </transform><ref id="green"/></shape>
  <shape type="rectangle" id="ceiling"><transform name="to_world"><rotate x="1" angle="90"/><scale value="4"/>
    <translate y="3"/></transform><ref id="plaster"/></shape>
  <shape type="rectangle" id="back"><transform name="to_world"><scale value="4"/><translate z="-2.6"/></transform>
    <ref id="plaster"/></shape>
  <shape type="rectangle" id="front"><transform name="to_world"><rotate y="1" angle="180"/><scale value="4"/>
    <translate z="4"/></transform><ref id="plaster"/></shape>
  <shape type="rectangle" id="left"><transform name="to_world"><rotate y="1" angle="90"/><scale value="4"/>
    <translate x="-3.2"/></transform><ref id="checks"/></shape>
  <shape type="rectangle" id="right"><transform name="to_world"><rotate y="1" angle="-90"/><scale value="4"/>
    <translate x="3.2"/></transform><ref id="plaster"/></shape>
  <shape type="rectangle" id="mirror"><transform name="to_world"><scale x="1.7" y="0.9"/>
    <translate x="-0.4" y="1.1" z="-1.8"/></transform><ref id="silver"/></shape>
  <shape type="sphere" id="ball"><transform name="to_world"><rotate x="1" angle="90"/><scale value="0.5"/>
    <translate x="-1.6" y="1.1" z="-0.3"/></transform><ref id="checks"/></shape>
  <shape type="rectangle" id="lamp"><transform name="to_world"><rotate x="1" angle="90"/><scale value="0.9"/>
    <translate y="2.99" z="0.6"/></transform><emitter type="area"><rgb name="radiance" value="12, 11, 10"/></emitter>
    </shape>
</scene>"""
"""A room with a mirror on a wall and a ball before it."""

MIRROR_MIDDLE = (-0.4, 1.1, -1.8)


def place_ball(frame: int) -> dict[str, Matrix]:
    """Return the place of the ball: it goes to and fro along the mirror, and towards it."""
    return {"ball": slide(0.5 * np.sin(0.1 * frame), 0.12 * np.sin(0.23 * frame), 0.4 * np.sin(0.07 * frame))}


def place_mirror(frame: int) -> dict[str, Matrix]:
    """Return the place of the mirror: it turns to and fro about the vertical."""
    return {"mirror": turn(5.0 * np.sin(0.1 * frame), MIRROR_MIDDLE)}


PLACES: dict[str, Callable[[int], dict[str, Matrix]]] = {"ball": place_ball, "mirror": place_mirror}


@dataclass
class Truth:
    """The references of the tests, and the pixels of each, by the number of the frame."""

    images: dict[int, FloatArray]
    pixels: dict[int, dict[str, NDArray[np.bool_]]]


def load(alpha: float) -> Any:
    """Return the room with a mirror of this roughness."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.xml"
        path.write_text(ROOM)
        size = {"width": SIZE_PIXELS, "height": SIZE_PIXELS}
        return load_scene(path, merge=False, parameters={"alpha": f"{alpha:g}"}, **size)


def number_shape(scene: Any, name: str) -> int:
    """Return the number of a shape in `FirstHits.shape`."""
    import drjit as dr
    import mitsuba as mi

    shape = next(each for each in scene.shapes() if each.id() == name)
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def mark_pixels(hits: FirstHits, scene: Any) -> dict[str, NDArray[np.bool_]]:
    """Return the pixels of the mirror, and those of them that reflect the ball."""
    mirror = hits.shape == number_shape(scene, "mirror")
    return {"reflection": mirror & (hits.seen_shape == number_shape(scene, "ball")), "mirror": mirror}


def list_tests() -> range:
    """Return the numbers of the frames that are tests."""
    return range(TEST_EVERY, FRAMES, TEST_EVERY)


def render_references(alpha: float, motion: str, spp: int) -> Truth:
    """Return the references of a sequence."""
    session = Session(load(alpha))
    stages, truth = Stages(session.scene), Truth({}, {})
    for frame in list_tests():
        session.set_transforms(PLACES[motion](frame))
        hits = session.render(None, InteractiveSettings(scale=16, adaptive=0.0)).parts.hits
        truth.pixels[frame] = mark_pixels(hits, session.scene)
        stages.place_camera(stages.start_camera, SIZE_PIXELS, SIZE_PIXELS)
        truth.images[frame] = render_truth(stages, spp)
    return truth


def render(session: Session, motion: str, frames: range, settings: InteractiveSettings) -> Iterator[FloatArray]:
    """Yield the frames of a sequence."""
    for frame in frames:
        session.set_transforms(PLACES[motion](frame))
        yield session.render(None, settings).image


def measure(truth: Truth, frame: int, image: FloatArray) -> dict[str, float]:
    """Return the summed errors of a test's pixels."""
    return {kind: sum_errors(image, truth.images[frame], truth.pixels[frame][kind]) for kind in KINDS}


def measure_sequence(
    session: Session, motion: str, truth: Truth, settings: InteractiveSettings
) -> tuple[dict[str, float], FloatArray]:
    """Return the summed errors of the tests in a sequence with its history, and the last test's image."""
    stream, total = session.make_sibling(), dict.fromkeys(KINDS, 0.0)
    session.set_transforms(PLACES[motion](0))
    for _ in range(WARM_UP_FRAMES):
        stream.render(None, settings)
    for frame, image in enumerate(render(stream, motion, range(FRAMES), settings)):
        if frame in truth.images:
            shown = image
            for kind, error in measure(truth, frame, image).items():
                total[kind] += error
    return total, shown


def measure_fresh(
    session: Session, motion: str, truth: Truth, settings: InteractiveSettings
) -> tuple[dict[str, float], FloatArray]:
    """Return the summed errors of sessions that began `LATER` frames before each test, and the last test's image."""
    total = dict.fromkeys(KINDS, 0.0)
    for frame in truth.images:
        *_, image = render(session.make_sibling(), motion, range(frame - LATER, frame + 1), settings)
        for kind, error in measure(truth, frame, image).items():
            total[kind] += error
    return total, image


@contextmanager
def forget_reflected_motion() -> Iterator[None]:
    """Leave the guide ``reflected_motion`` out."""
    from lobewise.interactive.changes import SceneChanges

    original, mark_moved = SceneChanges.add_motion, SceneChanges.mark_moved

    def add_motion(self: Any, *arguments: Any) -> FirstHits:
        hits = original(self, *arguments)
        return replace(hits, gbuffer=replace(hits.gbuffer, reflected_motion=None))

    SceneChanges.add_motion = add_motion  # type: ignore[method-assign]
    SceneChanges.mark_moved = lambda self, seen, shapes: np.zeros(shapes.shape, bool)  # type: ignore[method-assign]
    try:
        yield
    finally:
        SceneChanges.add_motion, SceneChanges.mark_moved = original, mark_moved  # type: ignore[method-assign]


def measure_case(alpha: float, motion: str, spp: int, seeds: int, pictures: Path | None) -> dict[str, Any]:
    """Return the ratios of errors of one mirror and one motion; write pictures of the last test."""
    truth = render_references(alpha, motion, spp)
    usual = InteractiveSettings(accumulate=False)
    totals = {way: dict.fromkeys(KINDS, 0.0) for way in ("guided", "unguided", "fresh", "single")}
    images: dict[str, FloatArray] = {}
    for seed in range(seeds):
        session = Session(load(alpha), seed=seed)
        found = {"guided": measure_sequence(session, motion, truth, usual)}
        found["fresh"] = measure_fresh(session, motion, truth, usual)
        found["single"] = measure_sequence(session, motion, truth, replace(usual, temporal=False))
        with forget_reflected_motion():
            found["unguided"] = measure_sequence(session, motion, truth, usual)
        for way, (errors, image) in found.items():
            images[way] = image
            for kind, error in errors.items():
                totals[way][kind] += error / seeds
    if pictures is not None:
        row = [images["unguided"], images["guided"], images["fresh"], list(truth.images.values())[-1]]
        write_picture(pictures / f"reflection-{motion}-{alpha:g}.png", row)
    counts = {kind: int(sum(masks[kind].sum() for masks in truth.pixels.values())) for kind in KINDS}
    ratios = {
        f"{way}_over_{other}": {kind: float(f"{totals[way][kind] / totals[other][kind]:.4g}") for kind in KINDS}
        for way, other in (("guided", "fresh"), ("unguided", "fresh"), ("guided", "single"), ("guided", "unguided"))
    }
    errors = {way: {kind: float(f"{totals[way][kind] / counts[kind]:.4g}") for kind in KINDS} for way in totals}
    return {"pixels": counts, "error": errors, **ratios}


def write_picture(path: Path, images: list[FloatArray]) -> None:
    """Write images side by side, each pixel as 3x3."""
    linear = np.concatenate(images, axis=1) * SHOWN
    codes = np.clip(255.0 * np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2), 0.0, 255.0).astype(np.uint8)
    path.write_bytes(encode_png(np.kron(codes, np.ones((3, 3, 1), np.uint8))))


def main() -> None:
    """Measure both mirrors and both motions, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "reflections.json")
    parser.add_argument("--spp", type=int, default=REFERENCE_SPP, help="Samples of the references.")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="Sessions of each case.")
    shown = "Folder for pictures: without the guide, with it, fresh, reference."
    parser.add_argument("--pictures", type=Path, help=shown)
    asked = parser.parse_args()
    cases: dict[str, dict[str, Any]] = {}
    for name, alpha in ALPHAS.items():
        for motion in PLACES:
            found = measure_case(alpha, motion, asked.spp, asked.seeds, asked.pictures)
            cases.setdefault(name, {})[motion] = found
            print(name, motion, found, flush=True)
    facts = {"frames": FRAMES, "size": SIZE_PIXELS, "reference_spp": asked.spp, "seeds": asked.seeds, "alpha": ALPHAS}
    write_json(asked.output, {"cases": cases, **facts, "machine": describe_machine()})


if __name__ == "__main__":
    main()
