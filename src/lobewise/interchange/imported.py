"""What is made of a file: its frame, what its channels mean, and where results go back to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field

import numpy as np

from lobewise.frame import FloatArray, Frame
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.lighting import PartOutput
from lobewise.interchange.mapping import ChannelMap, Found, Key
from lobewise.io.exr.container import Container, Part
from lobewise.io.exr.describe import Lack
from lobewise.io.exr.layout import join_planes
from lobewise.io.exr.pixels import Pixels

OWN = "lobewise"
"""What is told as the preset of a file in lobewise's own channel names."""


@dataclass(frozen=True)
class Imported:
    """A frame, and what was made of the file that it comes from.

    Parameters
    ----------
    frame : Frame
        Ready to be denoised.
    container : Container
        The file.
    map : ChannelMap or None
        What its channels mean; None for a file in lobewise's own names.
    notes : tuple of str
        What was found, converted, dropped or is missing, one sentence each.
    outputs : mapping of str to PartOutput
        Where results go back to: "color", and layers and their parts by the names that `lobewise.Result` has for them.
    findings : tuple of Finding
        What was measured to be another convention than the file was taken for; the notes have their sentences.
    shown : array, shape (height, width, 3), or None
        The image that viewers show, where the renderer denoised it and kept the noisy one in another pass.
    lacks : tuple of Lack
        What the frame lacks of what denoising can use; the notes have the sentences.
    """

    frame: Frame
    container: Container
    map: ChannelMap | None = None
    notes: tuple[str, ...] = ()
    outputs: Mapping[str, PartOutput] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    shown: FloatArray | None = None
    lacks: tuple[Lack, ...] = ()

    @property
    def preset(self) -> str:
        """By which names the file was read."""
        return OWN if self.map is None else self.map.preset.name

    @property
    def remarks(self) -> tuple[str, ...]:
        """Whose file it was taken for and why, then the notes; nothing of a file in lobewise's own names."""
        if self.map is None:
            return ()
        return (f"Read as {self.map.preset.title}, because {self.map.reason}.", *self.notes)


Decode = Callable[[Part, frozenset[str]], Mapping[str, Pixels]]
"""Returns some channels of a part, each (height, width), by their names."""


class ImageReader:
    """Images of a file. The channels that a map names are decoded at once for each part, any other when it is asked."""

    def __init__(self, decode: Decode) -> None:
        self._decode = decode
        self._wanted: dict[int, set[str]] = {}
        self._pixels: dict[int, dict[str, Pixels]] = {}
        self._images: dict[Key, FloatArray] = {}

    def expect(self, channels: ChannelMap) -> None:
        """Take note of the images that will be read, so that each part is decoded once and no other channel stays."""
        layers = [one for layer in channels.layers for one in (*layer.light, layer.albedo)]
        mattes = [one for matte in channels.cryptomatte for one in matte]
        for one in (*channels.roles.values(), *layers, *mattes, channels.shown):
            if one is not None:
                self._wanted.setdefault(one.source.part.index, set()).update(one.channels)

    def __call__(self, found: Found) -> FloatArray:
        """Return an image (height, width, channels), or (height, width) for one channel, as it is in the file."""
        if found.key not in self._images:
            planes = self.read_planes(found)
            self._images[found.key] = planes[0].astype(np.float32) if len(planes) == 1 else join_planes(planes)
        return self._images[found.key]

    def with_images(self, changed: Mapping[Key, FloatArray]) -> ImageReader:
        """Return a reader that gives other images for some keys."""
        reader = copy(self)
        reader._images = {**self._images, **changed}
        return reader

    def read_planes(self, found: Found) -> list[Pixels]:
        """Return the channels of an image one by one, (height, width) each, in their types."""
        part = found.source.part
        there = self._pixels.setdefault(part.index, {})
        if not there.keys() >= set(found.channels):
            wanted = self._wanted.get(part.index, set()).union(found.channels)
            there.update(self._decode(part, frozenset(wanted - there.keys())))
        return [there[name] for name in found.channels]
