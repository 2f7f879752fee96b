"""A finished frame that is filtered for every look that a page asks for."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lobewise.denoising import resolve_settings
from lobewise.denoising.bad_pixels import mark_good
from lobewise.denoising.recipe import denoise_quietly
from lobewise.display.colors import convert_light
from lobewise.errors import InputError, LobewiseError, MissingChannelError
from lobewise.frame import FloatArray, Frame, Radiance, Result
from lobewise.guides.lobe_fields import default_tau
from lobewise.interactive.views import (
    show_albedo,
    show_hit_distance,
    show_normal,
    show_sharpness,
    show_weight_sum,
    spread_samples,
)
from lobewise.interchange import Imported, import_file, write_result
from lobewise.io.exr import write_frame
from lobewise.io.exr.header import read_chromaticities
from lobewise.io.exr.layout import look_up_beauty
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.schema import SPARSE
from lobewise.io.exr.sparse import read_sparse_frame
from lobewise.settings import FORM_NAMES, QUALITY_NAMES, DenoiseSettings
from lobewise.sparse_frame import SparseFrame
from lobewise.upsampling import DEFAULT_RADIUS, upsample
from lobewise.viewer.looks import FRAME_SIMILARITIES, FrameLook, Look
from lobewise.viewer.messages import Description, FrameReading, Request
from lobewise.viewer.pictures import MAX_SHOWN_SAMPLES
from lobewise.viewer.shots import Shot

_MAX_RESULTS = 8
"""Filtered images that are kept in memory, of all browsers."""


class FrameTarget:
    """An EXR file of any renderer, or a sparsely shaded frame of lobewise. All browsers share the filtered images.

    Raises FileError, MissingChannelError or InputError as `lobewise.read_frame`. Raises InputError if ``reading`` is
    given for a sparsely shaded frame.
    """

    def __init__(self, path: str, reading: FrameReading | None = None) -> None:
        self._path, self._reading = path, reading or FrameReading()
        self._frame: Frame | SparseFrame
        self._notes: tuple[str, ...] = ()
        container = read_container(path)
        self._primaries = read_chromaticities(container)
        beauty = look_up_beauty(container.parts)
        if beauty is not None and beauty.get(SPARSE) is not None:
            if self._reading.is_given:
                raise InputError(
                    "--preset, --map, --camera and --half",
                    expected="a frame that was shaded everywhere",
                    got=f"{path!r}, which was shaded sparsely",
                    action="leave them out",
                )
            self._frame = read_sparse_frame(path)
        else:
            imported = self._read(light_passes=False)
            self._frame, self._notes = imported.frame, imported.remarks
        self._noisy = _spread(self._frame)
        self._results: OrderedDict[FrameLook, Result] = OrderedDict()
        self._shown: dict[int, FrameLook] = {}

    def describe(self) -> Description:
        """Return the properties of the frame."""
        frame = self._frame
        sparse = isinstance(frame, SparseFrame)
        guides = frame.gbuffer
        lobes = guides.alpha_u is not None and frame.is_placed
        similarities = FRAME_SIMILARITIES if lobes else ("normal", "none")
        apart = frame.radiance.parts is not None
        has = {
            "image": True,
            "noisy": True,
            "diffuse": apart,
            "specular": apart,
            "sharpness": lobes and guides.normal is not None,
            "weight_sum": True,
            "effective_samples": True,
            "hit_distance": guides.hit_distance is not None and guides.depth is not None,
            "normal": guides.normal is not None,
            "albedo": guides.diffuse_albedo is not None and guides.specular_albedo is not None,
        }
        return Description(
            look=FrameLook(similarities[0], "fast", radius=DEFAULT_RADIUS) if sparse else FrameLook(similarities[0]),
            width=frame.width,
            height=frame.height,
            similarities=similarities,
            qualities=("fast",) if sparse else ("auto", *QUALITY_NAMES),
            forms=("full",) if sparse else FORM_NAMES,
            views=tuple(name for name, there in has.items() if there),
            sparse=sparse,
            hit_distance=lobes and guides.hit_distance is not None,
            notes=self._notes,
        )

    def is_slow(self, request: Request) -> bool:
        """Return whether the request needs a filter that has not run yet."""
        return any(look not in self._results for look in (request.look, request.other) if look is not None)

    def show_input(self, request: Request) -> list[Shot]:
        """Return the unfiltered frame."""
        light = self._get_view("noisy", None)
        return [Shot(light, lambda view: self._get_view(view, None), (self._frame.width, self._frame.height))]

    def render(self, request: Request) -> list[Shot]:
        """Return the frame, filtered by one or two looks.

        Raises LobewiseError if the file lacks a channel that a look needs.
        """
        assert isinstance(request.look, FrameLook)
        self._shown[request.client] = request.look
        return [self._filter(look) for look in (request.look, request.other) if look is not None]

    def forget(self, client: int) -> None:
        """Drop what a browser had."""
        self._shown.pop(client, None)

    def write(self, client: int, folder: Path) -> Path:
        """Write a copy of the file with the radiance that a browser sees into ``folder``; return its path.

        ``lobewise denoise`` writes the same file for the same settings. Passes of light are read and filtered only
        here: while the user tries settings they would cost time and memory.
        """
        look, frame = self._shown.get(client, FrameLook("none")), self._frame
        result = self._get_result(look)
        path = folder / f"{Path(self._path).stem}-lobewise.exr"
        if isinstance(frame, SparseFrame):
            radiance = Radiance(result.image, diffuse=result.diffuse, specular=result.specular)
            whole = Frame(radiance, frame.gbuffer, frame.camera, spp=frame.spp, lobe_tables=frame.lobe_tables)
            write_frame(path, whole)
        else:
            imported = self._read(light_passes=True)
            if look.similarity != "none" and any(layer.parts for layer in imported.frame.layers):
                result = denoise_quietly(imported.frame, DenoiseSettings(**asdict(look)))
            write_result(path, result, source=imported)
        return path

    def _read(self, *, light_passes: bool) -> Imported:
        reading = self._reading
        return import_file(
            self._path,
            preset=reading.preset,
            mapping=reading.mapping,
            camera=reading.camera,
            half=reading.half,
            light_passes=light_passes,
        )

    def _filter(self, look: Look) -> Shot:
        assert isinstance(look, FrameLook)
        result = self._get_result(look)
        return Shot(
            self._get_view("image", result),
            lambda view: self._get_view(view, result),
            (self._frame.width, self._frame.height),
            {"filter": result.seconds, "total": result.seconds} if look.similarity != "none" else {},
        )

    def _get_result(self, look: FrameLook) -> Result:
        if look not in self._results:
            self._results[look] = self._make_result(look)
            while len(self._results) > _MAX_RESULTS:
                self._results.popitem(last=False)
        self._results.move_to_end(look)
        return self._results[look]

    def _make_result(self, look: FrameLook) -> Result:
        frame = self._frame
        if look.similarity == "none":
            ones = np.ones(frame.shape, np.float32)
            return Result(self._noisy, ones, ones, ~mark_good(self._noisy), asdict(look), 0.0)
        settings = DenoiseSettings(**asdict(look))
        if isinstance(frame, SparseFrame):
            return upsample(frame, settings)
        return denoise_quietly(frame, settings)

    def _get_view(self, name: str, result: Result | None) -> FloatArray:
        if name == "noisy" or result is None:
            return convert_light(self._noisy, self._primaries)
        if name in ("image", "diffuse", "specular"):
            part = getattr(result, name)
            return convert_light(_spread(self._frame, name) if part is None else part, self._primaries)
        if name == "weight_sum":
            return show_weight_sum(result.weight_sum)
        if name == "effective_samples":
            count = np.clip(result.effective_samples, 1.0, MAX_SHOWN_SAMPLES)
            return np.asarray(np.log(count) / math.log(MAX_SHOWN_SAMPLES), dtype=np.float32)
        return self._show_guide(name, result)

    def _show_guide(self, name: str, result: Result) -> FloatArray:
        guides = self._frame.gbuffer
        if name == "sharpness":
            return _show_sharpness(self._frame, result)
        if name == "hit_distance":
            return show_hit_distance(guides.require("hit_distance", "this view"), guides.require("depth", "this view"))
        if name == "normal":
            normal = guides.require("normal", "this view")
            return show_normal(normal, np.any(normal != 0.0, axis=-1))
        diffuse, specular = (guides.require(f"{part}_albedo", "this view") for part in ("diffuse", "specular"))
        return show_albedo(diffuse, specular)


def _spread(frame: Frame | SparseFrame, name: str = "color") -> FloatArray:
    """Return a radiance at the full size; each sample of a sparse frame fills the pixels right of and below it."""
    image: FloatArray = getattr(frame.radiance, name)
    if isinstance(frame, Frame):
        return image
    return np.ascontiguousarray(spread_samples(image, frame.scale, frame.shape, frame.place))


def _show_sharpness(frame: Frame | SparseFrame, result: Result) -> FloatArray:
    """Return the sharpness of the lobes with the band-limit that the result was filtered with."""
    if frame.camera is None:
        raise MissingChannelError("lobe sharpness: expected a camera in the header, got none; write one.")
    tau: Any = result.settings.get("tau")
    return show_sharpness(frame.gbuffer, frame.camera, tau if isinstance(tau, float) else resolve_tau(frame))


def resolve_tau(frame: Frame | SparseFrame) -> float:
    """Return the band-limit that "auto" stands for on a frame."""
    try:
        return resolve_settings(frame, DenoiseSettings()).tau
    except LobewiseError:
        return default_tau(frame.require_camera("lobe sharpness"), frame.height)
