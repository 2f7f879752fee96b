"""Read EXR files of any renderer as frames."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from lobewise.errors import InputError, MissingChannelError
from lobewise.interchange.channels import list_passes
from lobewise.interchange.imported import ImageReader, Imported
from lobewise.interchange.importing.leftovers import describe_left_noisy
from lobewise.interchange.importing.steps import import_mapped
from lobewise.interchange.importing.surfaces import WRAPS_AROUND
from lobewise.interchange.joining import add_also, add_further, add_light_groups, add_noisy_alpha, join_halves
from lobewise.interchange.mapping import Found, map_channels, map_file
from lobewise.interchange.selections import Selection, look_up_mapped_view
from lobewise.interchange.siblings import describe_family, look_up_family
from lobewise.io.exr.container import Channel, Container, Part, Window
from lobewise.io.exr.header import wraps_around
from lobewise.io.exr.layout import name_file, require_shaded
from lobewise.io.exr.parsing import read_container
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.lobe_table import LobeTable

MAX_SELECTIONS = 256
"""Most pairs of a view and a view layer in a file."""


def read_frame(
    path: PathLike,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    camera: Camera | None = None,
    half: PathLike | None = None,
    lobe_tables: Sequence[LobeTable] | None = None,
    light_passes: bool = True,
    view: str | None = None,
    layer: str | None = None,
    wraps: bool | None = None,
) -> Frame:
    """Return the frame of an EXR file, whichever renderer wrote it.

    Files in lobewise's own channel names (``docs/developers/conventions.md``) are not converted. Files of other
    renderers are recognised by their attributes and channel names, and converted (``docs/renderers.md``). Pixels that
    are NaN, infinite or negative stay so, with one exception: light that lossy compression left just below 0 becomes 0.

    `read_frame`, `lobewise.denoise` and `lobewise.write_result` together write the same bytes as the command ``lobewise
    denoise``, the passes of light included. The command also prints notes about the file. It filters large files in
    bands (`lobewise.denoise_file`), with the same result.

    Parameters
    ----------
    path : path
        The file.
    preset : str or path, optional
        Name of the renderer, or path of a preset file; by default, the renderer is recognised from the file.
    mapping : mapping of str to str, optional
        Channels by role, such as ``{"normal": "N.X,N.Y,N.Z"}``. They override the preset. A conversion may follow
        after a colon: ``"rough.R:square"``.
    camera : Camera, optional
        Replaces the camera of the file.
    half : path, optional
        The same frame rendered again with another seed. Each render becomes one half of the samples; with unequal noise
        each counts by its samples instead.
    lobe_tables : sequence of LobeTable, optional
        Tables that the channel ``material.I`` of a file in lobewise's names indexes. They replace those in its header.
    light_passes : bool
        Whether the passes that make up the layers (direct and indirect light of each) stay in the frame as parts of
        its layers. Then `lobewise.denoise` filters them and `lobewise.write_result` writes them back. Without them, the
        frame takes less memory and filtering is faster. The image is the same to the bit, but the passes in the written
        file stay noisy.
    view : str, optional
        Name of the view, such as ``right`` in a stereo file; by default the first view of the file.
    layer : str, optional
        Name of the view layer, such as ``ViewLayer``; by default the first one of the file.
    wraps : bool, optional
        As of `lobewise.Frame`; by default, the header tells (the attribute ``envmap`` of OpenEXR), or positions
        all around a camera.

    Raises
    ------
    FileError
        If a file is missing, unreadable, damaged, truncated or of zero size, or a lobe table in the header is invalid.
    MissingChannelError
        If there is no image, or an image has only some of its channels.
    InputError
        If a preset, role, conversion, channel, view or view layer is unknown, the camera in the header is invalid, a
        pixel names a missing lobe table, the frame was shaded sparsely, or the halves do not fit each other.
    """
    return import_file(
        path,
        preset=preset,
        mapping=mapping,
        camera=camera,
        half=half,
        lobe_tables=lobe_tables,
        light_passes=light_passes,
        view=view,
        layer=layer,
        wraps=wraps,
    ).frame


def list_selections(
    path: PathLike,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    all_layers: bool = False,
) -> tuple[Selection, ...]:
    """Return what ``lobewise denoise`` filters of a file: every view, in the first view layer or in all of them.

    If the user mapped channels of one view by their names, only this view is filtered. A view without an image, or
    without a channel that the user mapped, is left out. `describe_left_noisy` names it.

    Parameters
    ----------
    path, preset, mapping
        As in `read_frame`.
    all_layers : bool
        Whether to filter every view layer.

    Raises
    ------
    FileError, MissingChannelError, InputError
        As `read_frame`; also if the user mapped the image, which is in one layer, and wants all layers.
    """
    if all_layers and "color" in (mapping or {}):
        raise InputError(
            "--all-layers", expected="no --map color beside it", got="both", action="leave --all-layers out"
        )
    container = read_container(path)
    family = look_up_family(container).container
    with name_file(path):
        first = map_file(family, preset=preset, mapping=mapping)
    views = dict.fromkeys(each.view for each in first.selections)
    if look_up_mapped_view(list_passes(family), mapping or {}):
        views = {}
    if len(first.selections) > MAX_SELECTIONS:
        raise InputError(
            f"input {str(path)!r}",
            expected=f"at most {MAX_SELECTIONS} views and view layers",
            got=str(len(first.selections)),
            action="split the file",
        )
    layers = dict.fromkeys(each.layer for each in first.selections) if all_layers else (first.selection.layer,)
    selections = {first.selection: None}
    for view, layer in product(views or (first.selection.view,), layers):
        if Selection(view, layer) in selections:
            continue
        with suppress(InputError, MissingChannelError):
            own = map_file(family, preset=preset, mapping=mapping, view=view, layer=layer or None)
            selections[own.selection] = None
    return tuple(selections)


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
    light_groups: bool = True,
    view: str | None = None,
    layer: str | None = None,
    denoised: Collection[Selection] = (),
    wraps: bool | None = None,
    header_only: bool = False,
    flips: Mapping[str, str] | None = None,
) -> Imported:
    """Return the frame of an EXR file, with notes, findings and the channels that receive results.

    Parameters
    ----------
    path, preset, mapping, camera, half, lobe_tables, view, layer, wraps
        As in `read_frame`.
    also : sequence of str
        Patterns, with the wildcards * and ?, of further passes to filter. A pass is filtered like the layer whose pass
        name begins its own (``DiffDir_key``), else like the image.
    light_passes : bool
        Whether each pass of a layer (direct, indirect) is filtered too, so that it can be written back.
    light_groups : bool
        Whether light groups are found and filtered, see `add_light_groups`, as far as ``light_passes`` lets them.
    denoised : collection of Selection
        Further views and view layers that are denoised, so that no note says that they stay noisy.
    header_only : bool
        Whether one black pixel stands for the image of a file in lobewise's own names, whose header tells the rest.
    flips : mapping of str to str, optional
        The `Imported.flips` that the file's sequence has; by default they are measured.

    Raises
    ------
    FileError, MissingChannelError, InputError
        As `read_frame`; also if no pass matches a pattern of ``also``.
    """
    container = read_container(path)
    wrapping = (WRAPS_AROUND.format("its header says (envmap)"),) if wraps is None and wraps_around(container) else ()
    wraps = True if wrapping else wraps
    family = look_up_family(container)
    told = (*wrapping, *describe_family(family))
    read = ImageReader(family.decode)
    with name_file(path):
        channels = map_file(family.container, preset=preset, mapping=mapping, view=view, layer=layer)
        if not channels.is_own:
            require_no_tables(path, lobe_tables)
        elif header_only:
            read = read.with_images({one.key: _make_black_pixel(one) for one in channels.roles.values()})
        else:
            require_shaded(container)
        imported, read = import_mapped(
            container, read, channels, camera, wraps=wraps, lobe_tables=lobe_tables, flips=flips
        )
    if not light_passes:
        layers = tuple(replace(layer, parts={}) for layer in imported.frame.layers)
        imported = replace(imported, frame=imported.frame.with_changes(layers=layers))
    # Images that sum to the picture stand before others.
    if light_passes:
        imported = _add_known(imported, read, light_groups)
    if also:
        with name_file(path):
            imported = add_also(imported, also, read)
    if not light_passes:
        imported = replace(imported, outputs=_add_known(imported, read, light_groups).outputs)
    imported = add_noisy_alpha(imported, imported.map, read)
    left = describe_left_noisy(imported, read, {imported.map.selection, *denoised})
    imported = replace(imported, frame=imported.frame.with_changes(notes=(*told, *left)))
    if half is None:
        return imported.with_origin()
    options: dict[str, Any] = {"preset": preset, "mapping": mapping, "camera": camera, "lobe_tables": lobe_tables}
    options |= {"also": also, "light_passes": light_passes, "light_groups": light_groups}
    options |= {"view": view, "layer": layer, "wraps": wraps, "flips": imported.flips}
    other = import_file(half, **options)
    with name_file(half):
        return join_halves(imported, other).with_origin()


def _make_black_pixel(found: Found) -> FloatArray:
    count = len(found.channels)
    return np.zeros((1, 1) if count == 1 else (1, 1, count), np.float32)


def _add_known(imported: Imported, read: ImageReader, light_groups: bool) -> Imported:
    """Return a frame with the noisy images that its preset names, with light groups if asked."""
    return add_further(add_light_groups(imported, read) if light_groups else imported, read)


def require_no_tables(path: PathLike, lobe_tables: Sequence[LobeTable] | None) -> None:
    """Raise InputError if lobe tables are given for the file of another renderer."""
    if lobe_tables is not None:
        raise InputError(
            "lobe tables",
            expected="a file in lobewise's own channel names",
            got=f"{str(path)!r}, which is not",
            action="leave them out",
        )


def import_planes(
    planes: Mapping[str, FloatArray],
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    camera: Camera | None = None,
) -> Imported:
    """Return the frame of channels in memory, as `import_file` does for a file.

    Parameters
    ----------
    planes : mapping of str to array, shape (height, width)
        The channels by the names that they would have in a file.
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
    return import_mapped(container, read, map_channels(container, preset=preset, mapping=mapping), camera)[0]
