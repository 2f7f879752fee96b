"""Files of any renderer become frames: what is there is found, converted, and told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lobewise.camera import Camera
from lobewise.errors import InputError
from lobewise.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.interchange.cameras.header import read_camera_attributes, read_sample_count
from lobewise.interchange.checks import (
    SHARED,
    check_alpha,
    check_compression,
    check_guides,
    check_mark,
    check_noise,
    check_own_mark,
    check_places,
    describe_alone,
    find_second,
    name_assumption,
)
from lobewise.interchange.checks.lacks import list_lacks
from lobewise.interchange.imported import ImageReader, Imported
from lobewise.interchange.joining import add_also, join_halves
from lobewise.interchange.lighting import (
    Light,
    PartOutput,
    keep_lamps,
    lend_albedo,
    make_radiance,
    name_pass,
    take_albedos,
    take_layers,
)
from lobewise.interchange.mapping import ChannelMap, Found, map_channels
from lobewise.interchange.placing import derive_normal, place_surfaces
from lobewise.interchange.siblings import FIRST_INDEX, find_family
from lobewise.interchange.silhouettes import Silhouettes, take_silhouettes
from lobewise.interchange.values import convert_plain, undo_mean_roughness
from lobewise.io.exr.container import Channel, Container, Part, Window
from lobewise.io.exr.frames import read_whole
from lobewise.io.exr.header import read_pixel_aspect
from lobewise.io.exr.layout import find_beauty, name_file, plan_reading, require_shaded
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.schema import SCHEMA
from lobewise.io.files import PathLike
from lobewise.lobe_table import LobeTable
from lobewise.radiance import RadianceLayer

Read = Callable[[Found], FloatArray]
"""Gives the pixels of an image."""


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
            found = _import_foreign(
                container, read, map_channels(family.container, preset=preset, mapping=mapping), camera
            )
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
    return _import_foreign(container, read, map_channels(container, preset=preset, mapping=mapping), camera)


def _leave_passes(found: Imported) -> Imported:
    """Return a frame whose layers have no parts but those that were asked for."""
    rules = found.map.layers if found.map else ()
    passes = {(each.rule.name, name_pass(one.source.path)) for each in rules for one in each.light}

    def strip(layer: RadianceLayer) -> RadianceLayer:
        parts = {part: image for part, image in layer.parts.items() if (layer.name, part) not in passes}
        return replace(layer, parts=parts)

    layers = tuple(map(strip, found.frame.layers))
    return replace(found, frame=found.frame.with_changes(layers=layers)) if layers else found


def _import_foreign(container: Container, read: ImageReader, channels: ChannelMap, camera: Camera | None) -> Imported:
    channels, marks = check_mark(container, channels)
    read.expect(channels)
    compressed = check_compression(channels, read)
    images = {role: read(found) for role, found in channels.roles.items()}
    color = images["color"]
    beauty = channels.roles["color"].source.part
    notes = [*channels.preset.notes]
    if channels.shown is not None:
        notes.append(
            f"{channels.shown.label} was denoised by the renderer: the noisy image, {channels.roles['color'].label}, "
            f"is filtered, and the result goes into {channels.shown.label}."
        )
    if channels.others:
        notes.append(f"There are images of the same kind beside it that are only copied: {', '.join(channels.others)}.")
    guides = check_guides(images, channels, read)
    light = _take_light(guides.images, channels, guides.lend(read, images))
    images = guides.images
    if "albedo" in images:
        lend_albedo(light, images["albedo"])
    located = read_camera_attributes(container.parts, beauty)
    places = place_surfaces(images, guides.roles, camera, located, read_pixel_aspect(beauty))
    findings = [
        *compressed,
        *marks,
        *guides.findings,
        *check_places(places, guides, located.camera if located else None),
    ]
    shape = color.shape[0], color.shape[1]
    normal = places.normal if places.normal is not None else derive_normal(places, shape)
    spp = read_sample_count(container.parts, channels.preset)
    diffuse_albedo, specular_albedo = take_albedos(images, light.layers)
    albedos = diffuse_albedo, specular_albedo
    alpha = _take_alpha(images, channels, albedos, notes)
    alpha, meant = check_alpha(alpha, guides, channels, find_second(container, channels), read, albedos)
    motion = images.get("motion")
    # Of light that is not told apart nothing is resolved by silhouettes.
    is_split = light.layers or {"diffuse", "specular"} <= images.keys()
    silhouettes = take_silhouettes(channels, read, notes) if is_split else Silhouettes()
    coverage = silhouettes.coverage
    gbuffer = GBuffer(
        depth=places.depth,
        position=places.position if places.camera is not None else None,
        normal=normal,
        alpha_u=alpha,
        diffuse_albedo=diffuse_albedo,
        specular_albedo=specular_albedo,
        motion=None if motion is None else convert_plain(motion, channels.roles["motion"].convert),
        coverage=coverage,
        object_share=silhouettes.object_share,
        # Of other renderers' pixels albedos are means over the area.
        mean_diffuse_albedo=None if coverage is None else diffuse_albedo,
        mean_specular_albedo=None if coverage is None else specular_albedo,
        # Open Image Denoise gets both as the file has them: at edges their means are shorter, and black is black.
        denoiser_albedo=images.get("albedo"),
        denoiser_normal=images.get("denoiser_normal", places.mean_normal),
    )
    frame = Frame(
        make_radiance(color, images, light),
        gbuffer,
        places.camera,
        variance=_take_variance(images, channels, spp),
        spp=spp,
        layers=light.layers,
        unscattered=light.unscattered,
    )
    findings += meant
    notes += name_assumption(channels)
    noise = check_noise(frame, has_normals="normal" in images)
    frame = frame.with_changes(noise_is_shared=any(one.what == SHARED for one in noise))
    findings += noise
    lacks = list_lacks(channels, frame, findings)
    notes += [*places.notes, *(one.told for one in findings), *light.notes, *channels.refused.values()]
    notes += describe_alone(channels, frame) or [one.told for one in lacks]
    frame = keep_lamps(frame, notes)
    outputs = {"color": PartOutput(channels.target), **light.outputs}
    outputs |= {name: PartOutput(channels.roles[name]) for name in ("diffuse", "specular") if name in channels.roles}
    if any(one.found.source.part.index >= FIRST_INDEX for one in outputs.values()):
        notes.append("Passes in files of their own stay as they are there: only the image is written.")
        outputs = {name: one for name, one in outputs.items() if one.found.source.part.index < FIRST_INDEX}
    shown = None if channels.shown is None else read(channels.shown)
    return Imported(frame, container, channels, tuple(notes), outputs, tuple(findings), shown=shown, lacks=tuple(lacks))


def _take_light(images: Mapping[str, FloatArray], channels: ChannelMap, read: Read) -> Light:
    """Return the layers, unless diffuse and specular light are passes themselves."""
    if "diffuse" in images and "specular" in images:
        return Light()
    return take_layers(images["color"], channels.layers, read)


def _take_alpha(
    images: Mapping[str, FloatArray],
    channels: ChannelMap,
    albedos: tuple[FloatArray | None, FloatArray | None],
    notes: list[str],
) -> FloatArray | None:
    """Return the microfacet alpha, (height, width)."""
    if "roughness" not in images:
        return None
    found, roughness = channels.roles["roughness"], images["roughness"]
    if "cycles_roughness" in found.convert:
        undone = undo_mean_roughness(roughness, *albedos)
        if undone is None:
            notes.append(
                f"{found.label} is a mean over diffuse and specular lobes, which the albedos of both would undo; "
                "without them it is not used."
            )
            return None
        roughness, known = undone
        share = 100.0 * float(known.mean())
        notes.append(
            f"{found.label} was a mean over all lobes; that of the specular ones is known at {share:.0f} % of pixels."
        )
    return np.clip(np.nan_to_num(convert_plain(roughness, found.convert), nan=1.0, posinf=1.0), 0.0, 1.0)


def _take_variance(images: Mapping[str, FloatArray], channels: ChannelMap, spp: int | None) -> Radiance | None:
    if "variance" not in images:
        return None
    variance = images["variance"]
    if "of_samples" in channels.roles["variance"].convert:
        if spp is None:
            return None
        variance = variance / np.float32(spp)
    return Radiance(variance)
