"""Write denoised images into a copy of their file: in place of the image and its layers, or beside them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from lobewise.errors import InputError, require_kind
from lobewise.interchange.channels import list_passes, list_views
from lobewise.interchange.imported import Imported, Origin
from lobewise.interchange.mapping import Found
from lobewise.interchange.reading import import_file
from lobewise.interchange.siblings import FIRST_SIBLING_INDEX
from lobewise.io.exr.container import Container, Part, show_name
from lobewise.io.exr.parsing import stamp_file
from lobewise.io.exr.replacing import write_copy
from lobewise.io.files import PathLike, require_readable
from lobewise.records.frame import FloatArray, Result

CONFIDENCE_PREFIX = "lobewise."
"""Prefix of the channels that say how reliable the result is."""
KEPT_SUFFIX = "_before"
"""Suffix of the pass that keeps the renderer's own denoised image, which the result replaced."""
MIN_DIVISOR_ALBEDO = 1e-6
"""Albedo up to which a layer is written as 0 instead of divided by the albedo."""

MIN_LIGHT = 1e-30
"""Radiance up to which light counts as black, so that no factor brings it to other light."""

Planes = dict[int, dict[str, FloatArray]]
"""Channel values by index of the part and name of the channel."""


def write_result(
    path: PathLike,
    result: Result,
    *,
    source: PathLike | Imported,
    suffix: str = "",
    only: bool = False,
    confidence: bool = False,
    rerender: FloatArray | None = None,
    view: str | None = None,
    layer: str | None = None,
) -> tuple[str, ...]:
    """Write a copy of the EXR file ``source`` in which the radiance is replaced by the denoised one.

    The result replaces the channels that the image was read from. If the renderer denoised its image and kept the noisy
    one in another pass, the result replaces the image that viewers show. A pass whose name ends in ``_before`` then
    keeps the renderer's image, and the noisy pass stays. Layers of light are replaced in their own channels, if both
    the file and the result have them. Everything else stays: the other parts byte for byte, the other channels in their
    pixel types, every attribute, the windows and the compression. Lossy compression is replaced if it would change
    other channels. A channel stored as 16-bit float stays one, and values beyond its range become 65504. The attribute
    ``lobewise/denoised`` is added. It holds the settings and the replaced channels as JSON, so that `import_file`
    recognises a denoised image.

    Parameters
    ----------
    path : path
        The output file. It is replaced in one step, and unchanged on failure.
    result : Result
        The result of `lobewise.denoise` for the frame.
    source : path or Imported
        The file, or the return value of `import_file`. A file that the frame was read from, and that did not change
        since, is taken as it was read then, with the same options. Any other file is read anew, without options.
    suffix : str
        If given, the results go to new passes whose names end in this suffix, and the original passes stay.
    only : bool
        Whether to leave out every other channel.
    confidence : bool
        Whether to add ``lobewise.weight_sum``, ``lobewise.effective_samples``, ``lobewise.bad_pixel`` (1 where the
        pixel was refilled) and, where it is given, ``lobewise.rerender``.
    rerender : array, shape (height, width), optional
        1 where a pixel should be rendered again; see `lobewise.find_unsupported`.
    view, layer : str, optional
        With a path as ``source``, the view and the view layer that were denoised; by default those of the frame. To
        write several, write the first one, then each further one with ``path`` as its ``source``.

    Returns
    -------
    tuple of str
        One sentence for each thing that had to change or was not written.

    Raises
    ------
    FileError
        If ``source`` cannot be read or ``path`` cannot be written; an existing file is then as it was.
    MissingChannelError
        If ``source`` has no image.
    InputError
        If the result does not have the size of the image in ``source``, a channel that is added exists, or the image
        lies in another file beside ``source``.
    """
    require_kind("result", result, Result)
    result = result.convert()
    origin = source if isinstance(source, Imported) else _look_up_origin(result, source, view, layer)
    planned = plan_result(result, origin, suffix=suffix, only=only, confidence=confidence, rerender=rerender)
    return write_planned(path, origin.container, [planned], only=only)


def _look_up_origin(result: Result, source: PathLike, view: str | None, layer: str | None) -> Origin:
    """Return what a file was read as when the frame of the result was read from it, else what it is read as now."""
    origin, file = result.origin, require_readable(source)
    if isinstance(origin, Origin):
        selection = origin.map.selection
        is_same = view in (None, selection.view) and layer in (None, selection.layer)
        if is_same and origin.container.stamp == stamp_file(file):
            return replace(origin, container=replace(origin.container, path=file))
    return import_file(source, view=view, layer=layer)


@dataclass(frozen=True)
class PlannedResult:
    """What one result changes in the copy of its file.

    Parameters
    ----------
    beauty : Part
        The part that holds the image. Its header gets the settings.
    changed, added : mapping of int to mapping of str to array, shape (height, width)
        New values of channels, and new channels, by the index of their part and their name.
    settings : mapping of str to object
        The settings of the result.
    notes : tuple of str
        Sentences for the user.
    """

    beauty: Part
    changed: Planes
    added: Planes
    settings: Mapping[str, Any]
    notes: tuple[str, ...]


def write_planned(
    path: PathLike, container: Container, planned: Sequence[PlannedResult], *, only: bool = False
) -> tuple[str, ...]:
    """Write a copy of a file with the results of one or more of its views; see `write_result`."""
    changed, added = ({}, {})  # type: tuple[Planes, Planes]
    for one in planned:
        for whole, mine in ((changed, one.changed), (added, one.added)):
            for index, planes in mine.items():
                whole.setdefault(index, {}).update(planes)
    notes = dict.fromkeys(note for one in planned for note in one.notes)
    first = planned[0]
    return (*notes, *write_copy(path, container, changed, first.settings, first.beauty, added=added, only=only))


def plan_result(
    result: Result,
    origin: Origin,
    *,
    suffix: str = "",
    only: bool = False,
    confidence: bool = False,
    rerender: FloatArray | None = None,
) -> PlannedResult:
    """Return what a result changes in the copy of its file; see `write_result`."""
    require_target(origin)
    container = origin.container
    beauty = origin.map.target.source.part
    planes = _plan_planes(origin, result)
    notes = _note_noisy(origin, result)
    shown, shown_notes = ({}, []) if suffix or only else _keep_shown(origin)
    notes += shown_notes
    changed: Planes = {} if suffix else planes
    added: Planes = shown
    if suffix:
        added = {
            index: {_add_suffix(name, suffix, container): plane for name, plane in each.items()}
            for index, each in planes.items()
        }
    if confidence:
        own = {
            "weight_sum": result.weight_sum,
            "effective_samples": result.effective_samples,
            "bad_pixel": result.bad_pixels.astype(np.float32),
        }
        if rerender is not None:
            own["rerender"] = np.asarray(rerender, np.float32)
        of_beauty = added.setdefault(beauty.index, {})
        of_beauty |= {f"{_name_prefix(origin, beauty)}{name}": image for name, image in own.items()}
    return PlannedResult(beauty, changed, added, result.settings, tuple(notes))


def _name_prefix(origin: Origin, beauty: Part) -> str:
    """Return the beginning of the names of added channels, with the view and layer of which the part has several."""
    view = "" if beauty.view else origin.map.selection.view
    layer = origin.map.prefix if len({each.layer for each in origin.map.selections}) > 1 else ""
    return f"{layer}{CONFIDENCE_PREFIX}{view}{'.' if view else ''}"


def require_target(origin: Origin) -> None:
    """Raise InputError if the image to replace is in a neighbouring file, not in the file that is copied."""
    if origin.map.target.source.part.index < FIRST_SIBLING_INDEX:
        return
    name = origin.container.path.name
    raise InputError(
        f"image {origin.map.target.label}",
        expected=f"one in {name!r}, of which a copy is written",
        got="one in another file beside it",
        action="give that file, or put all passes into one file",
    )


def _plan_planes(origin: Origin, result: Result) -> Planes:
    """Return the new values of the channels that receive results."""
    images = _move_hidden_light(origin, _list_images(result), result.layers)
    planes: Planes = {}
    # Rescaled exact light adds up to the image only with the filtered passes, so keep it if any pass stays noisy.
    keeps_exact = bool(_list_left(origin, images))
    for name, output in origin.outputs.items():
        if name not in images or (output.is_exact and keeps_exact):
            continue
        image = images[name]
        if output.divided_by is not None:
            known = output.divided_by > MIN_DIVISOR_ALBEDO
            image = np.divide(image, output.divided_by, out=np.zeros_like(image), where=known)
        mine = planes.setdefault(output.target.source.part.index, {})
        mine |= {channel: image[..., k] for k, channel in enumerate(output.target.channels)}
    return planes


def _move_hidden_light(
    origin: Origin, images: Mapping[str, FloatArray], layers: Collection[str]
) -> Mapping[str, FloatArray]:
    """Return images of which passes without an albedo at a pixel have given their light to the other ``layers`` there.

    A file holds the light of a layer divided by its albedo. Where no sample met the layer's surface both are 0, and the
    light that filters bring from the pixels around would be missing from the sum of the passes. Where no layer has an
    albedo, background and emission take it.
    """
    albedos = {
        name: output.divided_by
        for name, output in origin.outputs.items()
        if name in images and name.partition("/")[0] in layers
    }
    shown = {
        name: images[name] if albedo is None else np.where(albedo > MIN_DIVISOR_ALBEDO, images[name], np.float32(0.0))
        for name, albedo in albedos.items()
    }
    if all(np.array_equal(image, images[name]) for name, image in shown.items()):
        return images
    exact = {name: images[name] for name, output in origin.outputs.items() if output.is_exact and name in images}
    missing, moved = reduce(np.add, (images[name] - image for name, image in shown.items())), dict(images)
    for takers in (shown, exact):
        seen = reduce(np.add, takers.values(), np.zeros_like(missing))
        takes = (seen > MIN_LIGHT) & (seen + missing > MIN_LIGHT)
        factor = np.divide(seen + missing, seen, out=np.ones_like(seen), where=takes)
        moved |= {name: image * factor for name, image in takers.items()}
        missing = np.where(takes, np.float32(0.0), missing)
    return moved


def _list_left(origin: Origin, images: Mapping[str, FloatArray]) -> list[str]:
    """Return the noisy passes for which the result has no image. Exact light does not count: it has no noise."""
    return [one.target.label for name, one in origin.outputs.items() if name not in images and not one.is_exact]


def _list_images(result: Result) -> Mapping[str, FloatArray]:
    """Return the images of a result, by the keys of `Imported.outputs`."""
    images: dict[str, Any] = {"color": result.image, "diffuse": result.diffuse, "specular": result.specular}
    whole = {name: image for name, image in images.items() if image is not None}
    opacity = {} if result.alpha is None else {"alpha": result.alpha[..., None]}
    also = {name: image if image.ndim == 3 else image[..., None] for name, image in result.also.items()}
    return {**whole, **opacity, **result.layers, **also}


def _keep_shown(origin: Origin) -> tuple[Planes, list[str]]:
    """Return channels that keep the renderer's denoised image, and a note about them.

    A file that lobewise wrote before has these channels already. They stay unchanged.
    """
    shown = origin.map.shown
    if shown is None or origin.shown is None:
        return {}, []
    names = [_add_suffix(name, KEPT_SUFFIX, origin.container) for name in shown.channels]
    label = Found(shown.source, tuple(names)).label
    if origin.container.multipart and shown.source.part.name:
        label += f" of the part {show_name(shown.source.part.name)!r}"
    there = {name for one in list_passes(origin.container) for name in one.channels.values()}
    if there.intersection(names):
        return {}, [f"{label} holds an earlier image of {shown.label} and stays."]
    planes = {name: origin.shown[..., k] for k, name in enumerate(names)}
    return {shown.source.part.index: planes}, [f"The renderer's own denoised image is kept as {label}."]


def _note_noisy(origin: Origin, result: Result) -> list[str]:
    """Return a note that lists the noisy passes for which the result has no image."""
    left = _list_left(origin, _list_images(result))
    return [f"Left noisy, as the result has no part for them: {', '.join(left)}."] if left else []


def _add_suffix(name: str, suffix: str, container: Container) -> str:
    """Return a channel name with a suffix after the pass: ``ViewLayer.Combined_clean.R``, or ``clean.R`` for plain R.

    A view stays before the component: ``ViewLayer.Combined_clean.left.R``.

    Raises
    ------
    InputError
        If the suffix holds a dot.
    """
    if "." in suffix.strip("."):
        raise InputError("--suffix", expected="a word without a dot", got=repr(suffix), action="write _denoised")
    *words, component = name.split(".")
    view = [words.pop()] if words and words[-1] and words[-1] in list_views(container) else []
    head, word = ".".join(words), suffix.strip(".")
    return ".".join([f"{head}{word}" if head else word.lstrip("_- ") or word, *view, component])
