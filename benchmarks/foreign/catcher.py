"""Measure a shadow catcher over gray: ``python -m benchmarks.foreign.catcher FOLDER`` after render_catcher.py.

The error is the relative squared one of the composited picture, freed of the noise of the references. The peer is Open
Image Denoise at its best for the light, and on the opacity, with the normals.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.users.measuring import make_reference_judge
from lobewise.guides.survey import ALBEDOS
from lobewise.peers import denoise_oidn
from lobewise.records.frame import FloatArray, Frame, Radiance

GRAY = 0.5
"""The background."""
PASS = "ViewLayer.Shadow Catcher"


def main() -> None:
    """Write benchmarks/results/catcher.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder

    def composite(light: FloatArray, alpha: FloatArray) -> FloatArray:
        return np.asarray(light + (1.0 - alpha[..., None]) * GRAY, np.float32)

    frames = {name: lobewise.read_frame(folder / f"{name}.exr") for name in ("noisy", "reference_1", "reference_2")}
    opacity = {}
    for name in frames:
        with OpenEXR.File(str(folder / f"{name}.exr"), separate_channels=True) as file:
            opacity[name] = np.array(file.channels()["ViewLayer.Combined.A"].pixels)
    noisy = frames["noisy"]
    gray = Radiance(np.repeat(opacity["noisy"][..., None], 3, axis=-1))
    peer_alpha = denoise_oidn(Frame(gray, replace(noisy.gbuffer, **dict.fromkeys(ALBEDOS))))[0].mean(axis=-1)
    peer, own, fast = denoise_oidn(noisy)[0], lobewise.denoise(noisy), lobewise.denoise(noisy, quality="fast")
    judge = make_reference_judge(
        *(composite(frames[name].radiance.color, opacity[name]) for name in ("reference_1", "reference_2"))
    )
    pictures = {
        "noisy": composite(noisy.radiance.color, opacity["noisy"]),
        "Open Image Denoise, noisy alpha": composite(peer, opacity["noisy"]),
        "Open Image Denoise, alpha by itself": composite(peer, np.clip(peer_alpha, 0.0, 1.0)),
        "auto, noisy alpha": composite(own.image, opacity["noisy"]),
        "auto": composite(own.image, own.alpha),
        "fast": composite(fast.image, fast.alpha),
    }
    errors = {name: round(judge.measure(picture)[0], 6) for name, picture in pictures.items()}
    # The pass of the catcher has no albedo, so the peer gets none.
    images = {name: lobewise.read_frame(folder / f"pass_{name}.exr") for name in frames}
    judge = make_reference_judge(*(images[name].also[PASS] for name in ("reference_1", "reference_2")))
    frame = images["noisy"]
    alone = Frame(Radiance(frame.also[PASS]), replace(frame.gbuffer, **dict.fromkeys(ALBEDOS)))
    passes = {"noisy": frame.also[PASS], "Open Image Denoise": denoise_oidn(alone)[0]}
    for quality in ("auto", "fast"):
        passes[quality] = lobewise.denoise(frame, quality=quality).also[PASS]
    of_pass = {name: round(judge.measure(image)[0], 6) for name, image in passes.items()}
    write_json(RESULTS / "catcher.json", {"errors": errors, "pass": of_pass, "machine": describe_machine()})
    print(errors, of_pass)


if __name__ == "__main__":
    main()
