"""The imported file: its frame, the meaning of its channels, and the channels that receive the results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass, field, fields, replace

import numpy as np

from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.lighting import PartOutput
from lobewise.interchange.mapping import ChannelMap, Found, Key
from lobewise.io.exr.container import Container, Part
from lobewise.io.exr.describe import Lack
from lobewise.io.exr.layout import join_planes
from lobewise.io.exr.pixels import DTYPES, Pixels
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.images import make_read_only
from lobewise.work.chunks import Chunk
from lobewise.work.limits import check_limits, require_memory


@dataclass(frozen=True, kw_only=True)
class Origin:
    """The file that a frame was read from, and its channels that receive the results of the frame.

    Parameters
    ----------
    container : Container
        The file.
    map : ChannelMap
        The meaning of the channels.
    outputs : mapping of str to PartOutput
        The channels that receive each result. The keys are "color" and the names of layers and their parts in
        `lobewise.Result`.
    shown : array, shape (height, width, 3), or None
        The image that viewers show, if the renderer denoised it and kept the noisy image in another pass.
    """

    container: Container
    map: ChannelMap
    outputs: Mapping[str, PartOutput] = field(default_factory=dict)
    shown: FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class Imported(Origin):
    """A frame, and how it was made from its file.

    Parameters
    ----------
    frame : Frame
        The frame, ready to be denoised.
    notes : tuple of str
        One sentence for each image that was found, converted, dropped or is missing.
    findings : tuple of Finding
        Conventions that the pixels contradict. The notes contain their messages.
    lacks : tuple of Lack
        Missing images that denoising could use. The notes contain their messages.
    flips : mapping of str to str
        The orientations of the guides that lay upside down or mirrored, and were turned over, by role.
    """

    frame: Frame
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    lacks: tuple[Lack, ...] = ()
    flips: Mapping[str, str] = field(default_factory=dict)

    @property
    def preset(self) -> str:
        """Name of the preset by which the file was read."""
        return self.map.preset.name

    @property
    def remarks(self) -> tuple[str, ...]:
        """The preset and the reason for it, then the notes; empty for a file in lobewise's own names."""
        if self.map.is_own:
            return ()
        return (f"Read as {self.map.preset.title}, because {self.map.reason}.", *self.notes)

    def with_origin(self) -> Imported:
        """Return this frame with a note of where it came from, so that its results find the file again."""
        origin = Origin(**{each.name: getattr(self, each.name) for each in fields(Origin)})
        return replace(self, frame=self.frame.with_changes(origin=origin))

    def follow_window(self, before: Container) -> Imported:
        """Return this frame with its motion to the pixels of the frame before it, whose data window may lie elsewhere.

        Renderers measure motion in the whole image, and pixels are counted from the corner of the data window.
        """
        motion, part = self.frame.gbuffer.motion, self.map.target.source.part
        there = next((one for one in before.parts if one.index == part.index), part).data_window
        aside, below = part.data_window.x_min - there.x_min, part.data_window.y_min - there.y_min
        if motion is None or not (aside or below):
            return self
        moved = motion + np.array([aside, below], np.float32)
        return replace(self, frame=self.frame.with_changes(gbuffer=replace(self.frame.gbuffer, motion=moved)))


Decode = Callable[[Part, frozenset[str]], Mapping[str, Pixels]]
"""Function that returns the named channels of a part, each of shape (height, width)."""


class ImageReader:
    """Reads and caches images of a file. The expected channels of a part are decoded together, others on request.

    ``rows`` is the number of rows that ``decode`` returns; by default all.
    """

    def __init__(self, decode: Decode, rows: int | None = None) -> None:
        self._decode, self._rows = decode, rows
        self._wanted: dict[int, set[str]] = {}
        self._pixels: dict[int, dict[str, Pixels]] = {}
        self._images: dict[Key, FloatArray] = {}
        self._bytes = 0

    def expect(self, channels: ChannelMap) -> None:
        """Register the channels of a map, so that each part is decoded once and no unused channel stays in memory."""
        layers = [one for layer in channels.layers for one in (*layer.light, layer.albedo)]
        mattes = [one for matte in channels.cryptomatte for one in matte]
        self.expect_images(one for one in (*channels.roles.values(), *layers, *mattes, channels.shown) if one)
        # Whether the alpha beside the image has noise is told to the user.
        target = channels.target.source
        self._wanted.setdefault(target.part.index, set()).update(
            target.channels[each] for each in "a" if each in target.channels
        )

    def expect_images(self, images: Iterable[Found]) -> None:
        """Register images that are read next, so that their part is decoded once for all of them."""
        for one in images:
            self._wanted.setdefault(one.source.part.index, set()).update(one.channels)

    def __call__(self, found: Found) -> FloatArray:
        """Return an image without conversions: (height, width, channels), or (height, width) for one channel."""
        if found.key not in self._images:
            check_limits()
            planes = self.read_planes(found)
            image = planes[0].astype(np.float32) if len(planes) == 1 else join_planes(planes)
            # A frame keeps an image without a copy where nobody can change it.
            self._images |= {found.key: make_read_only(image=image)["image"]}
        return self._images[found.key]

    def open(self, found: Found) -> Callable[[Chunk], FloatArray]:
        """Return a function that returns a chunk of an image, from any thread; the whole image is not kept."""
        whole = self._images.get(found.key)
        if whole is not None:
            return whole.__getitem__
        check_limits()
        planes = self.read_planes(found)

        def join(chunk: Chunk) -> FloatArray:
            image = np.empty((*planes[0][chunk].shape, len(planes)), np.float32)
            for index, plane in enumerate(planes):
                image[..., index] = plane[chunk]
            return image

        return join

    def with_images(self, changed: Mapping[Key, FloatArray]) -> ImageReader:
        """Return a reader that returns the images in ``changed`` instead of those of the file."""
        reader = copy(self)
        reader._images = {**self._images, **changed}
        return reader

    def read_planes(self, found: Found) -> list[Pixels]:
        """Return the channels of an image as separate arrays of shape (height, width), in the types of the file."""
        part = found.source.part
        there = self._pixels.setdefault(part.index, {})
        if not there.keys() >= set(found.channels):
            names = self._wanted.get(part.index, set()).union(found.channels) - there.keys()
            # A plane stays as it is in the file, and becomes float32.
            rows = part.data_window.height if self._rows is None else self._rows
            self._bytes += (
                rows
                * part.data_window.width
                * sum(DTYPES[each.pixel_type].itemsize + 4 for each in part.channels if each.name in names)
            )
            require_memory(self._bytes)
            there.update(self._decode(part, frozenset(names)))
        return [there[name] for name in found.channels]
