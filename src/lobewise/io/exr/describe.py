"""The description of an EXR file, and what denoising would use of it."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from lobewise.io.exr.container import Attribute, Part, Window, show_name
from lobewise.records.camera import Camera

_LAYOUTS = {
    "int": "i", "float": "f", "double": "d", "v2i": "2i", "v2f": "2f", "v2d": "2d", "v3i": "3i", "v3f": "3f",
    "v3d": "3d", "m33f": "9f", "m33d": "9d", "m44f": "16f", "m44d": "16d", "box2i": "4i", "box2f": "4f",
    "rational": "iI", "chromaticities": "8f",
}  # fmt: skip


@dataclass(frozen=True)
class ChannelDescription:
    """One channel: its name, its pixel type, and the image of a frame that it is read into; empty for none."""

    name: str
    pixel_type: str
    used_as: str


@dataclass(frozen=True)
class PartDescription:
    """One part: its place, kind, windows, channels and attributes as text."""

    name: str
    view: str
    kind: str
    compression: str
    data_window: Window
    display_window: Window
    channels: tuple[ChannelDescription, ...]
    attributes: tuple[tuple[str, str, str], ...]


@dataclass(frozen=True)
class ImageDescription:
    """One image that a frame can have: its channels, whether the file has them, and the cost if they are missing."""

    label: str
    found: bool
    meaning: str
    missing: str


@dataclass(frozen=True)
class RoleDescription:
    """One image from a file of another renderer: its role, its channels and how they are converted."""

    role: str
    channels: str
    conversion: str


COSTS = {
    "normal": "edges and bumps are guessed from the image",
    "roughness": "mirrors and rough surfaces are treated alike: normals are compared, not reflection lobes",
    "camera": "where surfaces lie is not compared, nor their reflection lobes",
    "layers": "diffuse and specular light are filtered together, which blurs reflections",
    "albedo": "textures are filtered like noise",
}
"""Consequence of each thing that a frame can lack."""
USES = (*COSTS, "silhouettes", "halves")
"""Things that denoising can use of a frame. "camera" means a camera with positions or depths."""


@dataclass(frozen=True)
class Lack:
    """Something that a frame lacks.

    Parameters
    ----------
    role : str
        A key of `COSTS`.
    cost : str
        Consequence of the lack.
    remedy : str
        What to switch on in the renderer; empty if nothing helps.
    reason : str
        Why nothing helps.
    told : str
        The note about the lack; empty for none.
    """

    role: str
    cost: str
    remedy: str = ""
    reason: str = ""
    told: str = ""


@dataclass(frozen=True)
class FileDescription:
    """What `lobewise.interchange.describe_file` found.

    Parameters
    ----------
    path : str
        The file.
    bytes : int
        Its size.
    parts : tuple of PartDescription
        Everything in the file.
    image_part : int or None
        Index of the part that holds R, G and B; None if there is none, or if it lies in another file.
    images : tuple of ImageDescription
        Every image that a frame can have, found or missing.
    camera : Camera or None
        From the header.
    spp : int or None
        From the header.
    materials : tuple of str
        The lobe tables of the header, in the order of their numbers, each in a few words.
    similarities : tuple of str
        Those that can be computed from this file, the plainest first.
    notes : tuple of str
        What hinders denoising or lowers its quality, and of other renderers' files what was found and converted, one
        sentence each.
    preset, reason : str
        By whose names the file is read, and what told.
    roles : tuple of RoleDescription
        Of other renderers' files, what is taken from which channels.
    version : str
        Of the renderer, as the header has it; empty where the header does not tell.
    uses : tuple of str
        What denoising will use, of `USES`.
    layers, exact : tuple of str
        Layers of light that are filtered each by itself, and passes of light that no surface scattered: they stay as
        they were rendered, but at the edges of lamps and out of focus.
    lacks : tuple of Lack
        What is missing, and how to have it.
    outputs : tuple of str
        The images that the result is written into, first the one that people look at; empty where there is none.
    refusals : tuple of str
        The notes that say why the command ``lobewise denoise`` refuses the file; empty where it does not.
    unusable : tuple of str
        The notes that say which passes are there but cannot be used, and why.
    alone : str
        The note that says what to expect where there is nothing to denoise by but the image; empty where there is.
    """

    path: str
    bytes: int
    parts: tuple[PartDescription, ...]
    image_part: int | None
    images: tuple[ImageDescription, ...] = ()
    camera: Camera | None = None
    spp: int | None = None
    materials: tuple[str, ...] = ()
    similarities: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    preset: str = "lobewise"
    reason: str = ""
    roles: tuple[RoleDescription, ...] = ()
    version: str = ""
    uses: tuple[str, ...] = ()
    layers: tuple[str, ...] = ()
    exact: tuple[str, ...] = ()
    lacks: tuple[Lack, ...] = ()
    outputs: tuple[str, ...] = ()
    refusals: tuple[str, ...] = ()
    unusable: tuple[str, ...] = ()
    alone: str = ""

    @property
    def can_be_denoised(self) -> bool:
        """Whether ``lobewise denoise`` takes the file, as far as its description tells."""
        return bool(self.outputs) and not self.refusals


def describe_part(part: Part, used: dict[tuple[int, str], str]) -> PartDescription:
    return PartDescription(
        name=show_name(part.name),
        view=show_name(part.view),
        kind=("deep " if part.deep else "") + ("tiled" if part.tiled else "scanline"),
        compression=part.compression,
        data_window=part.data_window,
        display_window=part.display_window,
        channels=tuple(
            ChannelDescription(show_name(channel.name), channel.pixel_type, used.get((part.index, channel.name), ""))
            for channel in part.channels
        ),
        attributes=tuple(
            (show_name(item.name), show_name(item.type), _show_value(item))
            for item in part.attributes
            if item.name != "channels"
        ),
    )


def _show_value(item: Attribute) -> str:
    """Return an attribute's value as one line of text."""
    if item.type == "string":
        text = " ".join(item.value.decode("utf-8", "replace").split())
        text = "".join(letter if letter.isprintable() else "?" for letter in text)
        return text if len(text) <= 400 else f"{text[:380]}... ({len(item.value)} bytes)"
    layout = _LAYOUTS.get(item.type)
    if layout and struct.calcsize("<" + layout) == len(item.value):
        numbers = struct.unpack("<" + layout, item.value)
        return " ".join(f"{number:.9g}" if isinstance(number, float) else str(number) for number in numbers)
    if len(item.value) == 1:
        return str(item.value[0])
    return f"{len(item.value)} bytes"
