"""The demonstration: one noisy frame, denoised, as a page."""

from __future__ import annotations

import platform
import shlex
import time
from collections.abc import Callable
from importlib import metadata
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from lobewise.cli.bench.machine import look_up_processor
from lobewise.cli.options.common import require_device
from lobewise.denoising import denoise
from lobewise.denoising.bad_pixels import blacken_bad
from lobewise.errors import InputError
from lobewise.io import read_frame
from lobewise.io.files import PathLike, make_folder, write_text
from lobewise.metrics import find_specular_pixels
from lobewise.peers import denoise_oidn, explain_no_oidn, has_oidn
from lobewise.records.frame import FloatArray, Frame
from lobewise.reporting.report import Picture, Report, make_page
from lobewise.scenes import require_scene
from lobewise.settings.choices import get_similarity
from lobewise.work.chunks import count_cores

Progress = Callable[[str, int, int], None]

FRAME, REFERENCE = "demo.exr", "demo-reference.exr"
"""The frame inside the package and its reference; `benchmarks/pictures/demo_frame.py` renders them."""
ABOUT = (
    "A printed sheet, seen in a mirror. It was chosen to show a difference: albedo and normal of a mirror do not show "
    "the print, and the noise of the samples tells that it is there."
)
OWN_KEY, OIDN_KEY = "default", "oidn"
REFERENCE_SEED = 1000
"""Seed of a rendered reference: its noise must differ from the noise of the frame."""
_TUNED_NORMAL: dict[str, Any] = {
    "similarity": "normal",
    "normal_exponent": 64.0,
    "screen_sigma": 2.0,
    "quality": "fast",
}
"""Best settings of the normal-aware filter: a grid search on the scene ``showroom`` at 4 samples per pixel."""
STORY: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
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
        "single SG lobe and noise",
        "Compares lobes and two halves of the samples: pixels that differ by more than noise are kept apart.",
        {"similarity": "sg", "quality": "balanced"},
    ),
)
"""The filters that ``--all`` adds, from the usual one to the default: key, title, note and settings of each."""
OWN: tuple[str, str, str, dict[str, Any]] = (
    OWN_KEY,
    "lobewise",
    "The result of `lobewise denoise` without options.",
    {},
)
OIDN_REMARK = (
    "Open Image Denoise is a neural network trained on many renders, given the same radiance with the same albedo and "
    "normals. It knows neither the camera nor the roughness, and no parameter was tuned for it. It is the mark to "
    "reach. The default of lobewise mixes its image with the image of the lobe filter, pixel by pixel."
)


def make_demo(
    folder: PathLike,
    *,
    everything: bool = False,
    live: bool = False,
    scene: str = "showroom",
    spp: int = 4,
    reference_spp: int = 1024,
    size: int = 512,
    device: str = "auto",
    tell: Callable[[str], None] | None = None,
    progress: Progress | None = None,
) -> Path:
    """Filter a frame and write ``report.html`` into ``folder``; return the path of the page.

    The parameters are the options of `lobewise demo`; ``everything`` is ``--all``. ``tell`` is called with a sentence
    before each step that takes time, ``progress`` with (name of the step, done, total).
    """
    say, show = tell or (lambda _sentence: None), progress or (lambda _what, _done, _total: None)
    if not live and (scene, spp, reference_spp, size) != ("showroom", 4, 1024, 512):
        raise InputError(
            "demo",
            expected="--live beside the options of rendering",
            got="none",
            action="add --live, which needs Mitsuba",
        )
    require_device(device)
    if live:
        require_scene(scene)
    page = make_folder(folder) / "report.html"
    if live:
        say(f"Rendering {scene} with {spp} samples per pixel, and a reference with {reference_spp}.")
        frame, reference, samples = _render(scene, spp, reference_spp, size, show)
        about = f"{Path(scene).stem.capitalize()}, path traced."
    else:
        frame, reference, samples = load_bundled()
        about = ABOUT
    pictures, remarks = _filter(frame, device, everything, say)
    command = ["lobewise", "demo", *(["--all"] if everything else [])]
    if live:
        options = {"--scene": scene, "--spp": spp, "--reference-spp": reference_spp, "--size": size}
        command += ["--live", *(str(word) for option in options.items() for word in option)]
    if device != "auto":
        command += ["--device", device]
    mask = find_specular_pixels(frame.gbuffer)
    keys = [picture.key for picture in pictures]
    peer = OIDN_KEY if OIDN_KEY in keys else "noisy"
    report = Report(
        title=f"{frame.spp} samples per pixel, filtered {_spell_number(len(pictures) - 1)} ways",
        subtitle=f"{about} {frame.width}\u00d7{frame.height} pixels. Each filter sees the same noisy frame; the "
        f"reference was rendered with {samples} samples per pixel.",
        pictures=pictures,
        reference=Picture("reference", "reference", reference, f"Path traced with {samples} samples per pixel."),
        baseline="normal" if everything else peer,
        left=peer,
        right=OWN_KEY,
        mask=mask if mask.any() else None,
        command=shlex.join(command),
        facts=_list_facts(),
        remarks=remarks,
    )
    say(f"Measuring the errors of {_spell_number(len(pictures))} pictures.")
    write_text(page, make_page(report, progress=lambda done, total: show("Measuring", done, total)))
    return page


def load_bundled() -> tuple[Frame, FloatArray, int]:
    """Return the frame inside the package, its reference, and the reference's samples per pixel."""
    folder = files("lobewise") / "data"
    with as_file(folder / FRAME) as path:
        frame = read_frame(path)
    with as_file(folder / REFERENCE) as path:
        reference = read_frame(path)
    return frame, reference.radiance.color, reference.spp or 0


def _filter(frame: Frame, device: str, everything: bool, say: Callable[[str], None]) -> tuple[list[Picture], list[str]]:
    """Return the noisy picture and those of the filters, and sentences for the reader."""
    # Metrics and pictures need finite pixels.
    noisy = blacken_bad(frame.radiance.color)
    pictures = [Picture("noisy", "noisy", noisy, f"Path traced with {frame.spp} samples per pixel.")]
    for key, title, note, settings in (*STORY, OWN) if everything else (OWN,):
        say(f"Filtering: {title}.")
        result = denoise(frame, device=device, **settings)
        shown = {name: result.settings[name] for name in _list_used_settings(result.settings)}
        note += "" if settings else f" Here: {result.method}."
        pictures.append(Picture(key, title, result.image, note, shown, result.seconds))
    remarks = []
    if has_oidn():
        say("Filtering: Open Image Denoise.")
        image, seconds = denoise_oidn(frame)
        note = f"Neural network (pyoidn {_look_up_version('pyoidn')}), guided by albedo and normals."
        pictures.append(Picture(OIDN_KEY, "Open Image Denoise", image, note, {"quality": "high"}, seconds))
        remarks.append(OIDN_REMARK)
    else:
        remarks.append(f"{explain_no_oidn()} adds it to this page and to the default.")
    if everything:
        remarks.append(
            "The two normal-aware filters run with the settings that a grid search found best on the built-in scene "
            "showroom with 4 samples per pixel; the lobe filters run with their defaults."
        )
    remarks.append(
        "Times are those of one call that does everything, lobes and buffers included. On a machine's first call they "
        "include the compiling of kernels."
    )
    return pictures, remarks


def _list_used_settings(settings: dict[str, Any]) -> list[str]:
    """Return the names of the settings that a similarity uses."""
    if "quality" not in settings:
        return []  # Open Image Denoise alone, where no filter can run
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
    versions = {name: _look_up_version(name) for name in ("lobewise", "halide", "numpy")}
    return {
        "machine": f"{look_up_processor()}, {count_cores()} threads, {platform.system()} {platform.machine()}",
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "Python": platform.python_version(),
        "made": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
    }


def _look_up_version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "unknown"


def _spell_number(number: int) -> str:
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
    return words[number] if number < len(words) else str(number)
