"""Describe an EXR file and what denoising would use of it. No pixel is read."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from lobewise.errors import LobewiseError
from lobewise.io.exr.container import Attribute, Container, Part, Window, show_name
from lobewise.io.exr.header import read_camera, read_lobe_tables, read_spp
from lobewise.io.exr.layout import look_up_beauty, plan_reading
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.schema import CAMERA, SLOTS, SPP
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera
from lobewise.records.lobe_table import LobeTable
from lobewise.settings import SIMILARITY_NAMES

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
REMEDY = "lobewise render, which writes every guide in one pass"
"""Remedy for images that a file in lobewise's names lacks."""
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
    """What `describe_file` found.

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
        they were rendered, but for lights out of focus.
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
    images: tuple[ImageDescription, ...]
    camera: Camera | None
    spp: int | None
    materials: tuple[str, ...]
    similarities: tuple[str, ...]
    notes: tuple[str, ...]
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


def describe_file(path: PathLike) -> FileDescription:
    """Return what an EXR file holds: parts, channels, windows, attributes, and which of them denoising uses.

    Raises
    ------
    FileError
        If the file is missing, unreadable, damaged, truncated or of zero size.
    """
    container = read_container(path)
    beauty = look_up_beauty(container.parts)
    notes: list[str] = []
    refusals: list[str] = []
    used: dict[tuple[int, str], str] = {}
    fields: set[tuple[str, str]] = set()
    camera: Camera | None = None
    tables: tuple[LobeTable, ...] = ()
    if beauty is None:
        notes.append("There is no part with channels R, G and B, so there is no image to denoise.")
    else:
        try:
            for part, slots in plan_reading(container, beauty):
                for slot in slots:
                    fields.add((slot.owner, slot.field))
                    used.update({(part.index, name): f"{slot.owner}.{slot.field}" for name in slot.channels})
            camera = read_camera(beauty)
            tables = read_lobe_tables(beauty)
        except LobewiseError as problem:
            refusals.append(f"Denoising will refuse this file: {problem}")
    gbuffer = {field for owner, field in fields if owner == "gbuffer"}
    similarities = list_similarities(gbuffer, camera)
    uses = _list_uses(fields, camera)
    lacks: list[Lack] = []
    if beauty is not None:
        lobe_notes = _note_lobes(gbuffer, camera, similarities)
        lacks = [Lack(role, COSTS[role], REMEDY, told=lobe_notes) for role in COSTS if role not in uses]
        notes += [*([lobe_notes] if lobe_notes else []), *_note_what_lacks(container, beauty, gbuffer)]
    notes = [*refusals, *notes]
    return FileDescription(
        path=str(path),
        bytes=container.path.stat().st_size,
        parts=tuple(describe_part(part, used) for part in container.parts),
        image_part=beauty.index if beauty else None,
        images=tuple(
            ImageDescription(slot.label, (slot.owner, slot.field) in fields, slot.meaning, slot.missing)
            for slot in SLOTS
        ),
        camera=camera,
        spp=read_spp(beauty) if beauty else None,
        materials=tuple(map(_describe_table, tables)),
        similarities=similarities,
        notes=tuple(notes),
        uses=uses,
        layers=("diffuse", "specular") if "layers" in uses else (),
        lacks=tuple(lacks),
        outputs=tuple(slot.label for slot in SLOTS[:3] if (slot.owner, slot.field) in fields),
        refusals=tuple(refusals),
    )


def _list_uses(fields: set[tuple[str, str]], camera: Camera | None) -> tuple[str, ...]:
    """Return what denoising uses of a file in lobewise's names, of `USES`, from the images that it holds."""
    guides = {field for owner, field in fields if owner == "gbuffer"}
    there = {
        "normal": "normal" in guides,
        "roughness": "alpha_u" in guides,
        "camera": camera is not None and bool(guides & {"depth", "position"}),
        "layers": {("radiance", "diffuse"), ("radiance", "specular")} <= fields,
        "albedo": bool(guides & {"diffuse_albedo", "specular_albedo"}),
        "halves": {("half_a", "color"), ("half_b", "color")} <= fields,
    }
    there["silhouettes"] = there["layers"] and "coverage" in guides
    return tuple(use for use in USES if there[use])


def _describe_table(table: LobeTable) -> str:
    kind = f"{table.lobe_count} {table.kind} lobe{'s' if table.lobe_count > 1 else ''}"
    where = f"{table.cosine.size} views" + ("" if table.is_isotropic else f" at {table.azimuth.size} azimuths")
    return f"{show_name(table.name)!r}: {kind} for each of {where}"


def list_similarities(gbuffer: set[str], camera: Camera | None) -> tuple[str, ...]:
    """Return the similarities that can be computed from images of the G-buffer and a camera, the simplest first.

    Missing normals are computed from places, or are all alike.
    """
    has_lobes = "alpha_u" in gbuffer and camera is not None and gbuffer & {"depth", "position"}
    return SIMILARITY_NAMES if has_lobes else ("normal",)


def _note_lobes(gbuffer: set[str], camera: Camera | None, similarities: tuple[str, ...]) -> str:
    """Return why normals are compared and not reflection lobes; empty where lobes are, or there are no normals."""
    if "normal" in gbuffer and similarities == ("normal",):
        lacks = [
            what
            for what, there in (
                ("alpha.U", "alpha_u" in gbuffer),
                ("depth.Z or position.X/Y/Z", bool(gbuffer & {"depth", "position"})),
                (f"the camera ({CAMERA}...)", camera is not None),
            )
            if not there
        ]
        return f"Without {' and '.join(lacks)} only normals can be compared, not reflection lobes."
    return ""


def _note_what_lacks(container: Container, beauty: Part, gbuffer: set[str]) -> list[str]:
    notes = []
    if "alpha_v" in gbuffer and "tangent" not in gbuffer:
        notes.append("Without tangent.X/Y/Z the similarity ggx is refused where alpha.V differs from alpha.U.")
    if read_spp(beauty) is None:
        notes.append(
            f"Without the attribute {SPP} the amount of noise is judged by the variance, or taken as that of 4 samples."
        )
    for part in container.parts:
        if part.data_window != beauty.data_window:
            name = show_name(part.name) or str(part.index)
            notes.append(f"Part {name!r} has another data window than the image and is only copied.")
    return notes


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
