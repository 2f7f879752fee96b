"""What is made of a file: its frame, what its channels mean, and where results go back to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from lobewise.frame import FloatArray, Frame
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.lighting import PartOutput
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.io.exr.container import Container, Part
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
    """

    frame: Frame
    container: Container
    map: ChannelMap | None = None
    notes: tuple[str, ...] = ()
    outputs: Mapping[str, PartOutput] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    shown: FloatArray | None = None

    @property
    def preset(self) -> str:
        """By which names the file was read."""
        return OWN if self.map is None else self.map.preset.name


class ImageReader:
    """Images of a file, each part decoded once."""

    def __init__(self, decode: Callable[[Part], Mapping[str, Pixels]]) -> None:
        self._decode = decode
        self._pixels: dict[int, Mapping[str, Pixels]] = {}
        self._images: dict[tuple[int, tuple[str, ...]], FloatArray] = {}

    def __call__(self, found: Found) -> FloatArray:
        """Return an image (height, width, channels), or (height, width) for one channel, as it is in the file."""
        key = found.source.part.index, found.channels
        if key not in self._images:
            planes = self.read_planes(found)
            self._images[key] = planes[0].astype(np.float32) if len(planes) == 1 else join_planes(planes)
        return self._images[key]

    def read_planes(self, found: Found) -> list[Pixels]:
        """Return the channels of an image one by one, (height, width) each, in their types."""
        part = found.source.part
        if part.index not in self._pixels:
            self._pixels[part.index] = self._decode(part)
        return [self._pixels[part.index][name] for name in found.channels]
