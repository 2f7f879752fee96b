"""A finished frame that is filtered with all settings that a page asks for."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising import resolve_settings
from lobewise.denoising.recipe import denoise_quietly
from lobewise.display.colors import convert_light
from lobewise.errors import InputError, LobewiseError, require_choice
from lobewise.interactive.settings import VIEWS
from lobewise.interactive.views import show_guide, spread_samples
from lobewise.interchange import Imported, import_file, read_image, read_light, write_result
from lobewise.io.exr import write_frame
from lobewise.io.exr.header import read_chromaticities
from lobewise.io.exr.layout import look_up_beauty
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.schema import SPARSE
from lobewise.io.exr.sparse import read_sparse_frame
from lobewise.recipes.upsampling import DEFAULT_RADIUS, upsample
from lobewise.records.frame import FloatArray, Frame, Radiance, Result
from lobewise.records.sparse_frame import SparseFrame
from lobewise.settings import FORM_NAMES, QUALITY_NAMES, SIMILARITY_NAMES, DenoiseSettings, list_knobs
from lobewise.settings.choices import QUALITIES, SIMILARITIES
from lobewise.viewer.messages import FrameReading
from lobewise.viewer.pictures import LEGENDS, MAX_STOPS, RADIANCE, choose_stops, paint
from lobewise.work.progress import Progress, watch_call

_MAX_RESULTS = 8
"""Filtered images that are kept in memory, of all browsers."""
SLIDERS = {
    "radius": (0.0, 32.0, 1.0),
    "beta": (0.5, 64.0, 0.5),
    "normal_exponent": (1.0, 256.0, 1.0),
    "tau": (-5.0, 0.0, 0.05),
}
"""Ends and step of the sliders. That of the band-limit ``tau`` is a base-10 logarithm."""
CONTROLS = ("similarity", "quality", "form", *SLIDERS)
"""Settings that have a control on the page."""
_TITLES = {
    **VIEWS,
    "noisy": "noisy",
    "image": "auto",
    "reference": "reference",
    "diffuse": "diffuse light",
    "specular": "specular light",
    "effective_samples": "effective samples",
}


class FrameTarget:
    """An EXR file of any renderer, or a sparsely shaded frame of lobewise. All browsers share the filtered images.

    ``reference`` is another EXR file, which is shown beside the frame.

    Raises FileError, MissingChannelError or InputError as `lobewise.read_frame`. Raises InputError if ``reading`` is
    given for a sparsely shaded frame, or if the reference has another size.
    """

    def __init__(self, path: str, reading: FrameReading | None = None, reference: str | None = None) -> None:
        self._path, self._reading = path, reading or FrameReading()
        self._frame: Frame | SparseFrame
        self.notes: tuple[str, ...] = ()
        container = read_container(path)
        self._primaries = read_chromaticities(container)
        beauty = look_up_beauty(container.parts)
        if beauty is not None and beauty.get(SPARSE) is not None:
            if self._reading.is_given:
                raise InputError(
                    "--preset, --map, --camera, --half and --wrap",
                    expected="a frame that was shaded everywhere",
                    got=f"{path!r}, which was shaded sparsely",
                    action="leave them out",
                )
            self._frame = read_sparse_frame(path)
        else:
            imported = self._read(light_passes=False)
            self._frame, self.notes = imported.frame, imported.remarks
        self._noisy = _spread(self._frame)
        self._reference = None if reference is None else self._read_reference(reference)
        self.stops = choose_stops(self._show_light(self._noisy))
        """First exposure, base-2 logarithm."""
        self._results: OrderedDict[DenoiseSettings, Result] = OrderedDict()
        self._lock = threading.Lock()
        self.share = 1.0
        """Share that is done of the image that is filtered now; 1 where none is."""

    def describe(self) -> dict[str, Any]:
        """Return what the page is built from: the size, the exposure, the names of pictures, and the controls."""
        frame = self._frame
        guides = frame.gbuffer
        apart = frame.radiance.parts is not None
        has = {
            "noisy": True,
            "image": True,
            "reference": self._reference is not None,
            "diffuse": apart,
            "specular": apart,
            "sharpness": self._has_lobes and guides.normal is not None,
            "weight_sum": True,
            "effective_samples": True,
            "hit_distance": guides.hit_distance is not None and guides.depth is not None,
            "normal": guides.normal is not None,
            "albedo": guides.diffuse_albedo is not None and guides.specular_albedo is not None,
        }
        return {
            "name": Path(self._path).stem,
            "width": frame.width,
            "height": frame.height,
            "stops": self.stops,
            "max_stops": MAX_STOPS,
            "pictures": {name: _TITLES[name] for name, there in has.items() if there},
            "legends": LEGENDS,
            "controls": self._list_controls(),
        }

    def make_settings(self, values: Mapping[str, Any]) -> DenoiseSettings:
        """Return the settings that a page or a command line gives; the others have their defaults.

        Raises InputError if a name or a value is none that the page offers.
        """
        first = {"quality": "fast", "radius": DEFAULT_RADIUS} if isinstance(self._frame, SparseFrame) else {}
        for name in values:
            require_choice("setting", name, CONTROLS)
        return DenoiseSettings(**{**first, **values})

    def paint(self, name: str, settings: DenoiseSettings) -> NDArray[np.float16] | NDArray[np.uint8]:
        """Return a picture: light times the first exposure as half floats, or the colours of a guide as bytes.

        Raises LobewiseError if the file lacks a channel that the settings need, or has no such picture.
        """
        require_choice("picture", name, self.describe()["pictures"])
        if name not in (*RADIANCE, "reference"):
            return paint(name, self._show_guide(name, self._get_result(settings)), 1.0)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(self._get_light(name, settings) * np.float32(2.0**self.stops), np.float16)

    def list_values(self, x: int, y: int, settings: DenoiseSettings) -> list[tuple[str, str]]:
        """Return the names and numbers of a pixel, as they stand in the files: light, and every guide.

        The result is among them once it is there. A number is never filtered for.
        """
        # Without the lock, which is held while a filter runs.
        result, guides = self._results.get(settings), self._frame.gbuffer
        images = {"noisy": self._noisy, "denoised": None if result is None else result.image}
        if self._reference is not None:
            images["reference"] = self._reference[0]
        if isinstance(self._frame, Frame):
            light = self._frame.radiance
            images |= {f"{name} light": getattr(light, name) for name in light.names if name != "color"}
        images |= {name: getattr(guides, name) for name in guides.names}
        return [
            (name.replace("_", " "), "  ".join(f"{value:.4g}" for value in np.atleast_1d(image[y, x])))
            for name, image in images.items()
            if image is not None and y < image.shape[0] and x < image.shape[1]
        ]

    def write(self, settings: DenoiseSettings, folder: Path) -> Path:
        """Write a copy of the file with the filtered radiance into ``folder``; return its path.

        ``lobewise denoise`` writes the same file for the same settings. Passes of light are read and filtered only
        here: while the user tries settings they would cost time and memory.
        """
        frame, result = self._frame, self._get_result(settings)
        path = folder / f"{Path(self._path).stem}-lobewise.exr"
        if isinstance(frame, SparseFrame):
            radiance = Radiance(result.image, diffuse=result.diffuse, specular=result.specular)
            whole = Frame(radiance, frame.gbuffer, frame.camera, spp=frame.spp, lobe_tables=frame.lobe_tables)
            write_frame(path, whole)
        else:
            imported = self._read(light_passes=True)
            if any(layer.parts for layer in imported.frame.layers):
                result = denoise_quietly(imported.frame, settings)
            write_result(path, result, source=imported)
        return path

    @property
    def _has_lobes(self) -> bool:
        return self._frame.gbuffer.alpha_u is not None and self._frame.is_placed

    def _list_controls(self) -> list[dict[str, Any]]:
        """Return the controls in the order of the page.

        A control has an effect where each setting in ``when`` has one of the words listed there.
        """
        lobes, sparse = self._has_lobes, isinstance(self._frame, SparseFrame)
        # What "auto" stands for.
        kinds = {**SIMILARITIES, "auto": SIMILARITIES["ggx" if lobes else "normal"]}
        words: dict[str, tuple[str, ...]] = {
            "similarity": ("auto", *reversed(SIMILARITY_NAMES)) if lobes else (),
            "quality": () if sparse else ("auto", *QUALITY_NAMES),
            "form": () if sparse else FORM_NAMES,
        }
        when = {
            "form": {"quality": [name for name, quality in QUALITIES.items() if len(quality.forms) > 1]},
            "radius": {"form": [name for name in FORM_NAMES if name != "atrous"]},
            "normal_exponent": {"similarity": [name for name, kind in kinds.items() if not kind.has_lobes]},
            "tau": {"similarity": [name for name, kind in kinds.items() if kind.has_lobes]},
        }
        first, knobs = self.make_settings({}), list_knobs(DenoiseSettings)
        return [
            {
                "name": name,
                "label": knobs[name].label,
                "hint": knobs[name].hint,
                "default": getattr(first, name),
                "words": words.get(name),
                "slider": SLIDERS.get(name),
                "auto": "auto" in knobs[name].choices,
                "when": when.get(name, {}),
            }
            for name in CONTROLS
            if words.get(name, True)
        ]

    def _read_reference(self, path: str) -> tuple[FloatArray, FloatArray]:
        """Return the image of the reference as it stands in its file, and as screens show it."""
        plain, shown = read_image(path), read_light(path)
        if plain.shape[:2] != self._frame.shape:
            raise InputError(
                "--reference",
                expected=f"the size of the frame, {self._frame.width}x{self._frame.height} pixels",
                got=f"{path!r} with {plain.shape[1]}x{plain.shape[0]}",
                action="pass another",
            )
        return plain, shown

    def _read(self, *, light_passes: bool) -> Imported:
        reading = self._reading
        return import_file(
            self._path,
            preset=reading.preset,
            mapping=reading.mapping,
            camera=reading.camera,
            half=reading.half,
            wraps=reading.wraps,
            light_passes=light_passes,
        )

    def _get_result(self, settings: DenoiseSettings) -> Result:
        with self._lock:
            if settings not in self._results:
                frame = self._frame
                with watch_call(self._follow):
                    self._results[settings] = (
                        upsample(frame, settings)
                        if isinstance(frame, SparseFrame)
                        else denoise_quietly(frame, settings)
                    )
                while len(self._results) > _MAX_RESULTS:
                    self._results.popitem(last=False)
            self._results.move_to_end(settings)
            return self._results[settings]

    def _follow(self, progress: Progress) -> None:
        self.share = progress.share

    def _get_light(self, name: str, settings: DenoiseSettings) -> FloatArray:
        if name == "reference" and self._reference is not None:
            return self._reference[1]
        if name == "noisy":
            return self._show_light(self._noisy)
        part = getattr(self._get_result(settings), name, None)
        return self._show_light(_spread(self._frame, name) if part is None else part)

    def _show_light(self, image: FloatArray) -> FloatArray:
        return convert_light(image, self._primaries)

    def _show_guide(self, name: str, result: Result) -> FloatArray:
        tau: Any = result.settings.get("tau")
        if name == "sharpness" and not isinstance(tau, float):
            # A similarity without lobes has no band-limit: take the one of the usual similarity.
            tau = None
            with suppress(LobewiseError):
                tau = resolve_settings(self._frame, DenoiseSettings()).tau
        view = show_guide(name, self._frame.gbuffer, result, self._frame.camera, tau)
        return np.asarray(view, dtype=np.float32)


def _spread(frame: Frame | SparseFrame, name: str = "color") -> FloatArray:
    """Return a radiance at the full size; each sample of a sparse frame fills the pixels right of and below it."""
    image: FloatArray = getattr(frame.radiance, name)
    if isinstance(frame, Frame):
        return image
    return np.ascontiguousarray(spread_samples(image, frame.scale, frame.shape, frame.place))
