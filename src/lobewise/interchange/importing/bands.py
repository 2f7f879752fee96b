"""Read the file of another renderer some rows at a time, to the bits of the frame that the whole file gives.

What a whole file tells (its camera, which guides are empty, which findings there are) is judged once, of a large file
by some of its pixels. What follows from it is then done to every band of rows. A file is refused if a finding changes
its pixels, or if a step needs the whole image.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lobewise.errors import InputError
from lobewise.guides.lamps import LAMP_REACH
from lobewise.interchange.cameras.header import read_camera_attributes
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.noise import check_noise, list_tile_rows
from lobewise.interchange.checks.precision import MAX_COARSENESS, measure_grain
from lobewise.interchange.imported import ImageReader, Imported
from lobewise.interchange.importing.blur import is_blurred
from lobewise.interchange.importing.draft import Draft, Step, run_steps
from lobewise.interchange.importing.leftovers import describe_left_noisy, take_noisy_alpha
from lobewise.interchange.importing.steps import BAND_STEPS, import_mapped
from lobewise.interchange.importing.surfaces import measure_offsets
from lobewise.interchange.lighting import BACKGROUND, REST, PartOutput
from lobewise.interchange.mapping import ChannelMap, Found, map_channels
from lobewise.interchange.siblings import look_up_family
from lobewise.interchange.silhouettes import Silhouettes, take_silhouettes
from lobewise.io.exr.bands import BandReader, Place, read_slabs
from lobewise.io.exr.container import Part
from lobewise.io.exr.layout import name_file
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import Pixels
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance

MAX_JUDGED_PIXELS = 1 << 20
"""Most pixels by which a file is judged."""
MARGIN = LAMP_REACH + 1
"""Rows around a band that its import reads: for lamps, beside guides that are filled from their neighbours."""
UNUSED_ROLES = ("motion",)
"""Roles that no frame by itself is denoised with."""
IN_ROWS = {
    *("guides without numbers", "albedo out of range", "light below 0 by compression", "noise shared by pixels"),
    *("positions coarse", "normals not of unit length"),
}
"""Findings whose correction needs no other rows than those of `MARGIN`."""
BLURRED = "one that a lens blurs"
COPIES = 3
"""Arrays of an image that are in memory while a band is imported."""


@dataclass(frozen=True)
class Judged:
    """What the whole file tells.

    Parameters
    ----------
    channels : ChannelMap
        The images that are used.
    camera : Camera or None
        The camera of the whole image.
    is_mirrored : bool
        Whether the world was mirrored for the camera.
    noise_is_shared : bool
        As `lobewise.Frame.noise_is_shared`.
    findings, notes
        As of `Imported`; the notes on what stays noisy come first.
    outputs : mapping of str to PartOutput
        As of `Imported`.
    silhouettes : tuple of Found
        What shows the silhouettes, as of `Silhouettes`.
    may_blur : bool
        Whether a lens may blur the image at pixels by which the file was not judged.
    """

    channels: ChannelMap
    camera: Camera | None
    is_mirrored: bool
    noise_is_shared: bool
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    outputs: Mapping[str, PartOutput]
    silhouettes: tuple[Found, ...]
    may_blur: bool


class ImportedBands(BandReader):
    """Reads the frame of another renderer's file some rows at a time.

    Raises InputError if the file must be read as a whole, and errors as `lobewise.read_frame`. Most reasons are found
    by the first call that reads pixels.
    """

    def __init__(self, path: PathLike, judged: Judged | None = None) -> None:
        container = read_container(path)
        if look_up_family(container).homes:
            raise self._refuse(path, "one whose passes are in files of their own")
        with name_file(path):
            self._channels = map_channels(container) if judged is None else judged.channels
        if len(self._channels.selections) > 1:
            raise self._refuse(path, "one of several views or view layers")
        if self._channels.shown is not None:
            raise self._refuse(path, "one whose image the renderer denoised")
        if judged is not None:
            self.judged = judged
        used = [one for role, one in self._channels.roles.items() if role not in UNUSED_ROLES]
        for layer in self._channels.layers:
            used += [*layer.light, *([layer.albedo] if layer.albedo else [])]
        used += () if judged is None else judged.silhouettes
        self._start(container, self._channels.target.source.part, [(one.source.part, one.channels) for one in used])
        self.lobe_tables = ()

    @cached_property
    def judged(self) -> Judged:
        """What the whole file tells; it is read once for this."""
        with name_file(self.container.path):
            return self._judge()

    @cached_property
    def camera(self) -> Camera | None:  # type: ignore[override]
        """The camera of the whole image."""
        return self.judged.camera

    @property
    def images(self) -> frozenset[tuple[str, str]]:
        """Owner and field of the images by which bands are chosen."""
        roles = self.judged.channels.roles
        known = {("gbuffer", "normal"): "normal", ("variance", "color"): "variance"}
        return frozenset({("radiance", "color"), *(image for image, role in known.items() if role in roles)})

    @property
    def layers(self) -> tuple[str, ...]:
        """The names of the layers of light, in their order."""
        there = {name.partition("/")[0] for name in self.outputs}
        rules = [one.rule for one in self.judged.channels.layers]
        return tuple(rule.name for rule in rules if rule.name in there and rule.lobe != "exact")

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the images of a result that the file has channels for."""
        return tuple(self.judged.outputs)

    def reopen(self, wanted: Collection[tuple[str, str]] | None = None) -> ImportedBands:
        """Return another reader of the same file; it reads all images."""
        return ImportedBands(self.container.path, self.judged)

    def count_bytes(self) -> tuple[int, int]:
        """Return bytes per pixel: of all kept channels in their stored types, and of the images of a frame."""
        stored, read = super().count_bytes()
        return stored, COPIES * read

    def list_targets(self, fields: Collection[str]) -> dict[str, Place]:
        """Return the places of a result's images, of those that the file has channels for."""
        targets = {name: one.target for name, one in self.judged.outputs.items() if name in fields}
        return {name: (one.source.part, one.channels) for name, one in targets.items()}

    def read_frame(self, first: int, stop: int) -> Frame:
        """Return the rows from ``first`` to before ``stop``, counted from the top, as a frame."""
        with name_file(self.container.path):
            frame = self._import(max(first - MARGIN, 0), min(stop + MARGIN, self.shape[0]))
        core = slice(first - max(first - MARGIN, 0), None)
        frame = _crop(frame, slice(core.start, core.start + stop - first))
        camera = None if self.camera is None else self.camera.crop_rows(first, self.shape[0])
        return frame.with_changes(camera=camera, noise_is_shared=self.judged.noise_is_shared)

    def _import(self, top: int, bottom: int, steps: Sequence[Step] = BAND_STEPS) -> Frame:
        judged = self.judged

        def decode(part: Part, names: frozenset[str]) -> dict[str, Pixels]:
            return self.read_channels(part, names, top, bottom)

        roles = {role: one for role, one in judged.channels.roles.items() if role not in UNUSED_ROLES}
        channels = replace(judged.channels, roles=roles)
        draft = Draft(
            container=self.container,
            mapped=channels,
            channels=channels,
            read=ImageReader(decode, bottom - top),
            camera=None if judged.camera is None else judged.camera.crop_rows(top, self.shape[0]),
            is_mirrored=judged.is_mirrored,
            outputs=judged.outputs,
            silhouettes=Silhouettes(source=judged.silhouettes),
        )
        frame = run_steps(draft, steps).frame
        assert frame is not None
        self._require_sharp(frame.gbuffer.position, top)
        return frame

    def _require_sharp(self, position: FloatArray | None, top: int) -> None:
        camera = self.judged.camera
        if not self.judged.may_blur or camera is None or position is None:
            return
        if is_blurred(measure_offsets(camera, position, self.shape, top)):
            raise self._refuse(self.container.path, BLURRED)

    def _judge(self) -> Judged:
        path, channels = self.container.path, self._channels
        height, width = self.shape
        # An odd step has a pixel in its middle.
        step = int(np.ceil(np.sqrt(height * width / MAX_JUDGED_PIXELS))) // 2 * 2 + 1
        imported, read = import_mapped(
            self.container, ImageReader(lambda part, names: self._thin(part, names, step)), channels
        )
        reason = self._describe_obstacle(imported)
        if reason:
            raise self._refuse(path, reason)
        header = read_camera_attributes(self.container.parts, imported.map.roles["color"].source.part)
        roles, grain = dict(imported.map.roles), None
        if "position" in roles:
            grain = measure_grain(read(roles["position"]))
            if not grain.is_coarse and step * grain.coarseness > MAX_COARSENESS:
                raise self._refuse(path, "one whose positions are stored too coarsely to be judged by some pixels")
        if imported.frame.gbuffer.position is None and "depth" in roles:
            roles.pop("position", None)
        silhouettes, _ = take_silhouettes(imported.map, read)
        alpha_stays = take_noisy_alpha(imported.map, read) is not None
        left = describe_left_noisy(imported, read, {imported.map.selection}, alpha_stays=alpha_stays)
        judged = Judged(
            replace(imported.map, roles=roles),
            imported.frame.camera,
            imported.frame.camera is not None and header is not None and header.mirrored,
            imported.frame.noise_is_shared,
            imported.findings,
            (*left, *imported.remarks),
            outputs=imported.outputs,
            silhouettes=silhouettes.source if imported.frame.gbuffer.coverage is not None else (),
            may_blur=step > 1 and grain is not None and not grain.is_coarse,
        )
        return judged if step == 1 else self._judge_noise(judged)

    def _judge_noise(self, judged: Judged) -> Judged:
        """Return what the file tells with the noise of all its pixels, which cannot be told by some of them."""
        own, strips = ImportedBands(self.container.path, judged), []
        for top, bottom in list_tile_rows(self.shape):
            strips.append(own._import(top, bottom, BAND_STEPS[:-1]))
            own.forget(bottom)
        shared, findings = check_noise(_join(strips), has_normals="normal" in judged.channels.roles, whole=self.shape)
        others = tuple(one for one in judged.findings if one.what not in NOISE)
        return replace(judged, noise_is_shared=shared, findings=(*others, *findings))

    def _describe_obstacle(self, imported: Imported) -> str:
        """Return why a file must be read as a whole, worded to follow "got"; empty if it need not."""
        frame, header = imported.frame, read_camera_attributes(self.container.parts, self.beauty)
        names = [layer.name for layer in frame.layers]
        if any(one.divided_by is not None for one in imported.outputs.values()):
            return "one whose passes of light are divided by an albedo"
        if REST in names or BACKGROUND in names or (frame.radiance.parts is not None and not names):
            return "one with noisy light that is in no layer"
        if frame.camera is not None and (header is None or not _is_same(frame.camera, header.camera)):
            return "one whose camera is found from all of its positions"
        if frame.gbuffer.blur_radius is not None:
            return BLURRED
        mended = [one.sentence for one in imported.findings if one.mended and one.what not in IN_ROWS]
        return f"one with a guide that is corrected as a whole ({mended[0].rstrip('.')})" if mended else ""

    def _thin(self, part: Part, names: frozenset[str], step: int) -> dict[str, Pixels]:
        """Return one pixel of every square of ``step`` pixels of channels."""
        pieces: dict[str, list[Pixels]] = {name: [] for name in names}
        for top, decoded in read_slabs(self.container, part, names):
            first = (step // 2 - top) % step
            for name in names:
                # A copy, so that the other pixels are freed.
                pieces[name].append(decoded[name][first::step, step // 2 :: step].copy())
        return {name: np.concatenate(each) for name, each in pieces.items()}

    @staticmethod
    def _refuse(path: PathLike, got: str) -> InputError:
        return InputError(
            f"input {str(path)!r}",
            expected="a file that can be read in bands",
            got=got,
            action="denoise it as a whole (--bands off)",
        )


NOISE = ("noise shared by pixels", "denoised already")
"""Findings of `check_noise`."""


def _is_same(one: Camera, other: Camera) -> bool:
    names = ("position", "forward", "up", "fov_y", "fov_x", "shift")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


def _crop(frame: Frame, rows: slice) -> Frame:
    """Return some rows of a frame, without its camera."""
    return _rebuild(frame, {key: image[rows] for key, image in _list_images(frame).items()})


def _join(frames: Sequence[Frame]) -> Frame:
    """Return one frame of frames below each other."""
    listed = list(map(_list_images, frames))
    return _rebuild(frames[0], {key: np.concatenate([each[key] for each in listed]) for key in listed[0]})


def _list_images(frame: Frame) -> dict[tuple[str, str], FloatArray]:
    """Return the images of a frame by what holds them and their name there."""
    owners = {"radiance": frame.radiance, "variance": frame.variance, "gbuffer": frame.gbuffer}
    images = {(key, name): getattr(one, name) for key, one in owners.items() if one is not None for name in one.names}
    images |= {("light", layer.name): layer.radiance for layer in frame.layers}
    images |= {("albedo", layer.name): layer.albedo for layer in frame.layers if layer.albedo is not None}
    for layer in frame.layers:
        images |= {(f"parts of {layer.name}", name): part for name, part in layer.parts.items()}
    return images | {("unscattered", name): light for name, light in frame.unscattered.items()}


def _rebuild(frame: Frame, images: Mapping[tuple[str, str], FloatArray]) -> Frame:
    """Return a frame of other images that are listed alike."""

    def take(key: str) -> dict[str, FloatArray]:
        return {name: image for (owner, name), image in images.items() if owner == key}

    light, albedos = take("light"), take("albedo")
    return Frame(
        Radiance(**take("radiance")),
        GBuffer(**take("gbuffer")),
        variance=None if frame.variance is None else Radiance(**take("variance")),
        spp=frame.spp,
        layers=tuple(
            replace(
                layer,
                radiance=light[layer.name],
                albedo=albedos.get(layer.name),
                parts=take(f"parts of {layer.name}"),
            )
            for layer in frame.layers
        ),
        unscattered=take("unscattered"),
    )
