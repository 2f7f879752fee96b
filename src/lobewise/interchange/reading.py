"""Files of any renderer become frames: what is there is found, converted, and told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from lobewise.camera import Camera
from lobewise.errors import InputError
from lobewise.frame import FloatArray, Frame
from lobewise.interchange.checks import check_own_mark
from lobewise.interchange.imported import ImageReader, Imported
from lobewise.interchange.importing.steps import import_foreign
from lobewise.interchange.joining import add_also, join_halves
from lobewise.interchange.lighting import name_pass
from lobewise.interchange.mapping import map_channels
from lobewise.interchange.siblings import find_family
from lobewise.io.exr.container import Channel, Container, Part, Window
from lobewise.io.exr.frames import read_whole
from lobewise.io.exr.layout import find_beauty, name_file, plan_reading, require_shaded
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.schema import SCHEMA
from lobewise.io.files import PathLike
from lobewise.lobe_table import LobeTable
from lobewise.radiance import RadianceLayer


def is_own(container: Container) -> bool:
    """Return whether a file is in lobewise's own channel names: it says so, or has guides by them and no renderer's."""
    if any(item.name == SCHEMA for part in container.parts for item in part.attributes):
        return True
    beauty = find_beauty(container.parts)
    if beauty is None or map_channels(find_family(container).container).preset.name != "generic":
        return False
    return any(slot.owner != "radiance" for _, slots in plan_reading(container, beauty) for slot in slots)


def read_frame(
    path: PathLike,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    camera: Camera | None = None,
    half: PathLike | None = None,
    lobe_tables: Sequence[LobeTable] | None = None,
    light_passes: bool = True,
) -> Frame:
    """Return the frame of an EXR file, whichever renderer wrote it.

    Files in lobewise's own channel names (``docs/conventions.md``) come as they are; those of other renderers are
    recognised by their attributes and names, and converted (``docs/renderers.md``); `import_file` also says how. Pixels
    that are NaN, infinite or negative come through as they are, but for light that compression with loss left just
    below 0: it becomes 0.

    With `lobewise.denoise` and `lobewise.write_result` it does what the command ``lobewise denoise`` does, to the byte:
    the passes of light are filtered as well. Two things the command alone does: it prints what was found, and it
    filters large files in bands, `lobewise.denoise_file`, which gives the same bytes and takes lobewise's own files
    only; those have no passes of light.

    Parameters
    ----------
    path : path
        The file.
    preset : str or path, optional
        Name of the renderer whose conventions the file follows, or a file of them; by default what the file tells.
    mapping : mapping of str to str, optional
        Which channels are which image, such as ``{"normal": "N.X,N.Y,N.Z"}``, before what the preset says; behind a
        colon a conversion, such as ``"rough.R:square"``.
    camera : Camera, optional
        In place of what the file tells.
    half : path, optional
        The same frame rendered again with another seed: then both are halves of the samples.
    lobe_tables : sequence of LobeTable, optional
        What the channel ``material.I`` of a file in lobewise's names counts, in place of the tables in its header.
    light_passes : bool
        Whether the passes that make up the layers (direct and indirect light of each) stay in the frame, as parts of
        its layers, so that `lobewise.denoise` filters them and `lobewise.write_result` writes them back. Without them
        the frame takes less memory, filtering is quicker, the image is the same to the bit, and the passes in the
        written file stay noisy.

    Raises
    ------
    FileError
        If a file is missing, unreadable, damaged, truncated or of zero size, or a lobe table in the header is none.
    MissingChannelError
        If there is no image, or an image has only some of its channels.
    InputError
        If a preset, role, conversion or channel is unknown, the camera in the header makes no sense, a pixel names a
        lobe table that is not there, the frame was shaded sparsely, or the halves do not fit each other.
    """
    return import_file(
        path,
        preset=preset,
        mapping=mapping,
        camera=camera,
        half=half,
        lobe_tables=lobe_tables,
        light_passes=light_passes,
    ).frame


def import_file(
    path: PathLike,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    camera: Camera | None = None,
    half: PathLike | None = None,
    lobe_tables: Sequence[LobeTable] | None = None,
    also: Sequence[str] = (),
    light_passes: bool = False,
) -> Imported:
    """Return the frame of an EXR file and what was made of it.

    Parameters
    ----------
    path, preset, mapping, camera, half, lobe_tables
        As in `read_frame`.
    also : sequence of str
        Patterns of passes, with * and ?, that are filtered like what they belong to: the layer whose pass their name
        begins with (``DiffDir_key``), else the image.
    light_passes : bool
        Whether the passes that make up a layer (direct, indirect) are filtered each, so that they can be written back.

    Raises
    ------
    FileError, MissingChannelError, InputError
        As `read_frame`; or if no pass has a name of ``also``.
    """
    container = read_container(path)
    family = find_family(container)
    read = ImageReader(family.decode)
    if preset is None and not mapping and is_own(container):
        require_shaded(container)
        frame = read_whole(path, container, lobe_tables)
        frame = frame if camera is None else frame.with_changes(camera=camera)
        found = Imported(frame, container, findings=check_own_mark(container))
    else:
        if lobe_tables is not None:
            raise InputError(
                "lobe tables",
                expected="a file in lobewise's own channel names",
                got=f"{str(path)!r}, which is not",
                action="leave them out",
            )
        with name_file(path):
            channels = map_channels(family.container, preset=preset, mapping=mapping)
            found, read = import_foreign(container, read, channels, camera)
    if also:
        with name_file(path):
            found = add_also(found, also, read)
    if not light_passes:
        found = _leave_passes(found)
    if half is None:
        return found
    given = {"preset": preset, "mapping": mapping, "camera": camera, "lobe_tables": lobe_tables}
    other = import_file(half, also=also, light_passes=light_passes, **given)  # type: ignore[arg-type]
    with name_file(half):
        return join_halves(found, other)


def import_planes(
    planes: Mapping[str, FloatArray],
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    camera: Camera | None = None,
) -> Imported:
    """Return the frame of channels in memory and what was made of them, as `import_file` does of a file's.

    Parameters
    ----------
    planes : mapping of str to array, shape (height, width)
        The channels by the names that a file would have for them.
    preset, mapping, camera
        As in `read_frame`.

    Raises
    ------
    MissingChannelError, InputError
        As `read_frame`.
    """
    height, width = next(iter(planes.values())).shape
    channels = tuple(Channel(name, "float", linear=False, x_sampling=1, y_sampling=1) for name in planes)
    window = Window(0, 0, width - 1, height - 1)
    part = Part(0, (), False, False, channels, "none", window, window, 1, ())
    container = Container(Path("memory"), 2, (part,))
    read = ImageReader(lambda part, names: planes)
    return import_foreign(container, read, map_channels(container, preset=preset, mapping=mapping), camera)[0]


def _leave_passes(found: Imported) -> Imported:
    """Return a frame whose layers have no parts but those that were asked for."""
    rules = found.map.layers if found.map else ()
    passes = {(each.rule.name, name_pass(one.source.path)) for each in rules for one in each.light}

    def strip(layer: RadianceLayer) -> RadianceLayer:
        parts = {part: image for part, image in layer.parts.items() if (layer.name, part) not in passes}
        return replace(layer, parts=parts)

    layers = tuple(map(strip, found.frame.layers))
    return replace(found, frame=found.frame.with_changes(layers=layers)) if layers else found
