"""The demonstration: one noisy frame through every filter, as a page."""

from __future__ import annotations

import platform
import shlex
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from lobewise.bench.machine import find_processor
from lobewise.chunks import count_cores
from lobewise.denoising import denoise
from lobewise.denoising.bad_pixels import blacken_bad
from lobewise.errors import FileError, InputError
from lobewise.frame import FloatArray, Frame
from lobewise.io import read_frame
from lobewise.io.files import PathLike, make_folder, write_text
from lobewise.metrics import find_specular_pixels
from lobewise.peers import denoise_oidn, has_oidn
from lobewise.reporting.report import Picture, Report, make_page
from lobewise.settings.choices import get_similarity

Progress = Callable[[str, int, int], None]

FRAME, REFERENCE = "showroom-4spp.exr", "showroom-reference.exr"
REFERENCE_SEED = 1000
"""Seed of a rendered reference: its noise must differ from the noise of the frame."""
_TUNED_NORMAL: dict[str, Any] = {
    "similarity": "normal",
    "normal_exponent": 64.0,
    "screen_sigma": 2.0,
    "quality": "fast",
}
"""Best settings of the normal-aware filter: a grid search on the frame inside the package, against its reference."""
METHODS: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
    (
        "normal",
        "normal-aware",
        "Cross-bilateral filter that compares depth and shading normals: the usual filter for diffuse surfaces.",
        _TUNED_NORMAL,
    ),
    (
        "normal-limited",
        "normal-aware, band-limited",
        "The normal-aware filter with a kernel that is narrower on the screen where the BRDF is sharp.",
        {**_TUNED_NORMAL, "band_limit": 1.0},
    ),
    (
        "sg",
        "single SG lobe",
        "Compares reflection lobes, each approximated by one spherical Gaussian (Tokuyoshi 2015).",
        {"similarity": "sg", "quality": "fast"},
    ),
    (
        "ggx",
        "ggx lobe",
        "Compares reflection lobes as covariances in the tangent plane, with the long tails of GGX.",
        {"similarity": "ggx", "quality": "fast"},
    ),
    (
        "balanced",
        "ggx lobe and noise",
        "Compares the same lobes, and two halves of the samples: pixels that differ by more than noise are kept apart.",
        {"similarity": "ggx", "quality": "balanced"},
    ),
    ("default", "lobewise", "The result of `lobewise denoise` without options.", {}),
)
OIDN_REMARK = (
    "Open Image Denoise is a neural network trained on many renders, given the same radiance with the same albedo and "
    "normals. It knows neither the camera nor the roughness, and no parameter was tuned for it. It is the mark to "
    "reach. The default of lobewise mixes its image with the image of the lobe filter, pixel by pixel."
)


def make_demo(
    folder: PathLike,
    *,
    live: bool = False,
    scene: str = "showroom",
    spp: int = 4,
    reference_spp: int = 1024,
    size: int = 512,
    device: str = "auto",
    progress: Progress | None = None,
) -> Path:
    """Filter a frame with every method and write ``report.html`` into ``folder``; return the path of the page.

    The parameters are the options of `lobewise demo`; ``progress`` is called with (name of the step, done, total).
    """
    say = progress or (lambda _what, _done, _total: None)
    if not live and (scene, spp, reference_spp, size) != ("showroom", 4, 1024, 512):
        raise InputError(
            "demo",
            expected="--live beside the options of rendering",
            got="none",
            action="add --live, which needs Mitsuba",
        )
    page = make_folder(folder) / "report.html"
    if live:
        frame, reference, samples = _render(scene, spp, reference_spp, size, say)
    else:
        frame, reference, samples = load_bundled()
    pictures, remarks = _filter(frame, device, say)
    command = ["lobewise", "demo"]
    if live:
        options = {"--scene": scene, "--spp": spp, "--reference-spp": reference_spp, "--size": size}
        command += ["--live", *(str(word) for option in options.items() for word in option)]
    if device != "auto":
        command += ["--device", device]
    mask = find_specular_pixels(frame.gbuffer)
    name = Path(scene).stem.capitalize()
    report = Report(
        title=f"{name} at {frame.spp} samples per pixel, filtered {_spell_number(len(pictures) - 1)} ways",
        subtitle=f"{frame.width}\u00d7{frame.height} pixels, path traced. Each filter sees the same noisy frame; the "
        f"reference was rendered with {samples} samples per pixel.",
        pictures=pictures,
        reference=Picture("reference", "reference", reference, f"Path traced with {samples} samples per pixel."),
        baseline="normal",
        left="noisy",
        right="default",
        mask=mask if mask.any() else None,
        command=shlex.join(command),
        facts=_list_facts(),
        remarks=remarks,
    )
    write_text(page, make_page(report, progress=lambda done, total: say("Measuring", done, total)))
    return page


def load_bundled() -> tuple[Frame, FloatArray, int]:
    """Return the frame of the repository, its reference, and the reference's samples per pixel.

    Raises
    ------
    FileError
        If the package was installed from a wheel: wheels do not bring the frame along.
    """
    folder = files("lobewise").joinpath("data")
    if not folder.joinpath(FRAME).is_file():
        raise FileError(
            "demo",
            expected=f"{FRAME} in the package",
            got="a package installed from a wheel, which has no frames",
            action="run it from a clone of the repository, or add --live, which renders the frame with Mitsuba",
        )
    with as_file(folder.joinpath(FRAME)) as path:
        frame = restore_positions(read_frame(path))
    with as_file(folder.joinpath(REFERENCE)) as path:
        reference = read_frame(path)
    return frame, reference.radiance.color, reference.spp or 0


def restore_positions(frame: Frame) -> Frame:
    """Return the frame with world positions, computed from depth and camera: the small file leaves them out."""
    depth, camera = frame.gbuffer.depth, frame.camera
    if frame.gbuffer.position is not None or depth is None or camera is None:
        return frame
    position = camera.make_positions(depth)
    return frame.with_changes(gbuffer=replace(frame.gbuffer, position=position))


def _filter(frame: Frame, device: str, say: Progress) -> tuple[list[Picture], list[str]]:
    # Metrics and pictures need finite pixels.
    noisy = blacken_bad(frame.radiance.color)
    pictures = [Picture("noisy", "noisy", noisy, f"Path traced with {frame.spp} samples per pixel.")]
    total = len(METHODS) + 1
    for done, (key, title, note, settings) in enumerate(METHODS):
        say("Filtering", done, total)
        # The first call compiles the kernel. The page shows the time of the second call.
        denoise(frame, device=device, **settings)
        result = denoise(frame, device=device, **settings)
        shown = {name: result.settings[name] for name in _list_used_settings(result.settings)}
        note += "" if settings else f" Here: {result.method}."
        pictures.append(Picture(key, title, result.image, note, shown, result.seconds))
    say("Filtering", total - 1, total)
    remarks = []
    if has_oidn():
        denoise_oidn(frame)
        image, seconds = denoise_oidn(frame)
        note = f"Neural network (pyoidn {_find_version('pyoidn')}), guided by albedo and normals."
        pictures.append(Picture("oidn", "Open Image Denoise", image, note, {"quality": "high"}, seconds))
        remarks.append(OIDN_REMARK)
    else:
        remarks.append(
            "Open Image Denoise is not installed; pip install 'lobewise[best]' adds it to this page and to the default."
        )
    remarks.append(
        "The two normal-aware filters run with the settings that a grid search found best on the showroom frame inside "
        "the package, measured against its reference; the lobe filters run with their defaults."
    )
    remarks.append(
        "Times are those of one call that does everything, lobes and buffers included, after the kernel is compiled."
    )
    say("Filtering", total, total)
    return pictures, remarks


def _list_used_settings(settings: dict[str, Any]) -> list[str]:
    """Return the names of the settings that a similarity uses."""
    names = ["quality", "form", "radius", "screen_sigma", "position_sigma"]
    has_lobes = get_similarity(settings["similarity"]).has_lobes
    return [*names, *(("beta", "diffuse_beta", "tau") if has_lobes else ("normal_exponent", "band_limit"))]


def _render(scene: str, spp: int, reference_spp: int, size: int, say: Progress) -> tuple[Frame, FloatArray, int]:
    from lobewise.render import load_scene, render_frame, render_reference

    loaded = load_scene(scene, width=size, height=size)
    frame = render_frame(loaded, spp=spp, progress=lambda done, total: say("Rendering the frame", done, total))
    reference = render_reference(
        loaded,
        spp=reference_spp,
        seed=REFERENCE_SEED,
        progress=lambda done, total: say("Rendering the reference", done, total),
    )
    return frame, reference.radiance.color, reference_spp


def _list_facts() -> dict[str, str]:
    versions = {name: _find_version(name) for name in ("lobewise", "halide", "numpy")}
    return {
        "machine": f"{find_processor()}, {count_cores()} threads, {platform.system()} {platform.machine()}",
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "Python": platform.python_version(),
        "made": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
    }


def _find_version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "unknown"


def _spell_number(number: int) -> str:
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    return words[number] if number < len(words) else str(number)
