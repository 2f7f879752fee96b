"""Results go back into the file that they come from: into the image and its layers, or beside them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lobewise.errors import InputError, require_kind
from lobewise.frame import FloatArray, Result
from lobewise.interchange.channels import list_passes
from lobewise.interchange.imported import Imported
from lobewise.interchange.mapping import Found
from lobewise.interchange.reading import import_file
from lobewise.interchange.siblings import FIRST_INDEX
from lobewise.io.exr.container import show_name
from lobewise.io.exr.layout import plan_writing, require_beauty
from lobewise.io.exr.replacing import write_copy
from lobewise.io.files import PathLike

CONFIDENCE = "lobewise."
"""Before the names of the channels that tell how far to trust the result."""
BEFORE = "_before"
"""Behind the name of a pass: the image that the renderer had denoised, which the result replaced."""
SMALLEST_FACTOR = 1e-6

Planes = dict[int, dict[str, FloatArray]]


def write_result(
    path: PathLike,
    result: Result,
    *,
    source: PathLike | Imported,
    suffix: str = "",
    only: bool = False,
    confidence: bool = False,
    rerender: FloatArray | None = None,
) -> tuple[str, ...]:
    """Write a copy of the EXR file ``source`` in which the radiance is replaced by the denoised one.

    The image is replaced where it came from, whatever it is called there. Where the renderer denoised its image and
    kept the noisy one in another pass, the result replaces the image that viewers show; the renderer's image is kept
    in a pass whose name ends in ``_before``, and the noisy pass stays. Layers of light are replaced, each in its own
    channels, where both the file and the result have them. Everything else stays: the other parts byte for byte, the
    other channels in their pixel types, every attribute, the windows and the compression (but a lossy one, where it
    would change channels that are not touched). A channel stored as 16-bit float stays one, and values beyond its range
    become 65504. One attribute is added, ``lobewise/denoised``, with the settings and the channels that
    were replaced as JSON: `import_file` finds by it that an image is a result already.

    Parameters
    ----------
    path : path
        The output; replaced in one step, or left as it was on failure.
    result : Result
        What `lobewise.denoise` made of the frame.
    source : path or Imported
        The file, or what `import_file` made of it: needed where that took options.
    suffix : str
        If given, the results stand beside what they came from, in passes whose names end in it, and that stays.
    only : bool
        Whether to leave out every other channel.
    confidence : bool
        Whether to add ``lobewise.weight_sum``, ``lobewise.effective_samples``, ``lobewise.bad_pixel`` (1 where the
        pixel was refilled) and, where it is given, ``lobewise.rerender``.
    rerender : array, shape (height, width), optional
        1 where a pixel is worth rendering again; see `lobewise.find_unsupported`.

    Returns
    -------
    tuple of str
        What could not stay as it was or was not written, one sentence each.

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
    found = source if isinstance(source, Imported) else import_file(source)
    require_target(found)
    container = found.container
    if found.map is None:
        beauty = require_beauty(container)
        planes = _plan_own(found, result)
    else:
        beauty = found.map.target.source.part
        planes = _plan_foreign(found, result)
    notes = _note_noisy(found, result)
    kept, told = ({}, []) if suffix or only else _keep_shown(found)
    notes += told
    changed: Planes = {} if suffix else planes
    added: Planes = kept
    if suffix:
        added = {
            index: {_add_suffix(name, suffix): plane for name, plane in each.items()} for index, each in planes.items()
        }
    if confidence:
        own = {
            "weight_sum": result.weight_sum,
            "effective_samples": result.effective_samples,
            "bad_pixel": result.bad_pixels.astype(np.float32),
        }
        if rerender is not None:
            own["rerender"] = np.asarray(rerender, np.float32)
        more = added.setdefault(beauty.index, {})
        more |= {f"{CONFIDENCE}{name}": image for name, image in own.items()}
    return (*notes, *write_copy(path, container, changed, result.settings, beauty, added=added, only=only))


def require_target(found: Imported) -> None:
    """Raise InputError if the image that a result replaces lies in a file beside the one of which a copy is written."""
    if found.map is None or found.map.target.source.part.index < FIRST_INDEX:
        return
    name = found.container.path.name
    raise InputError(
        f"image {found.map.target.label}",
        expected=f"one in {name!r}, of which a copy is written",
        got="one in another file beside it",
        action="give that file, or put all passes into one file",
    )


def _plan_own(found: Imported, result: Result) -> Planes:
    """Return which channels of a file in lobewise's names get which values."""
    given = {"color": result.image, "diffuse": result.diffuse, "specular": result.specular}
    images = {field: image for field, image in given.items() if image is not None}
    container = found.container
    return {
        part.index: {name: images[slot.field][..., k] for slot in slots for k, name in enumerate(slot.channels)}
        for part, slots in plan_writing(container, require_beauty(container), images)
    }


def _plan_foreign(found: Imported, result: Result) -> Planes:
    """Return which channels of another renderer's file get which values."""
    images = _list_images(result)
    planes: Planes = {}
    # What is scaled of exact light makes up the image with filtered passes: where these stay noisy it stays as well.
    kept = set(found.frame.unscattered) if _list_left(found, images) else set()
    for name, output in found.outputs.items():
        if name not in images or name in kept:
            continue
        image = images[name]
        if output.divided_by is not None:
            known = output.divided_by > SMALLEST_FACTOR
            image = np.divide(image, output.divided_by, out=np.zeros_like(image), where=known)
        mine = planes.setdefault(output.found.source.part.index, {})
        mine |= {channel: image[..., k] for k, channel in enumerate(output.found.channels)}
    return planes


def _list_left(found: Imported, images: Mapping[str, FloatArray]) -> list[str]:
    """Return the passes of scattered light that a result has no image for; exact light has no noise to leave."""
    exact = found.frame.unscattered
    return [output.found.label for name, output in found.outputs.items() if name not in images and name not in exact]


def _list_images(result: Result) -> Mapping[str, FloatArray]:
    """Return every image of a result by the name that outputs have."""
    images: dict[str, Any] = {"color": result.image, "diffuse": result.diffuse, "specular": result.specular}
    whole = {name: image for name, image in images.items() if image is not None}
    return {**whole, **result.layers, **result.also}


def _keep_shown(found: Imported) -> tuple[Planes, list[str]]:
    """Return the channels that keep the image which the renderer denoised, and a sentence that names them.

    A file that lobewise wrote has them already: they stay as they are.
    """
    shown = None if found.map is None else found.map.shown
    if shown is None or found.shown is None:
        return {}, []
    names = [_add_suffix(name, BEFORE) for name in shown.channels]
    label = Found(shown.source, tuple(names)).label
    if found.container.multipart and shown.source.part.name:
        label += f" of the part {show_name(shown.source.part.name)!r}"
    there = {name for one in list_passes(found.container) for name in one.channels.values()}
    if there.intersection(names):
        return {}, [f"{label} holds an earlier image of {shown.label} and stays."]
    planes = {name: found.shown[..., k] for k, name in enumerate(names)}
    return {shown.source.part.index: planes}, [f"The renderer's own denoised image is kept as {label}."]


def _note_noisy(found: Imported, result: Result) -> list[str]:
    """Say which passes of the layers stay noisy, because the result does not have them."""
    left = _list_left(found, _list_images(result))
    return [f"Left noisy, as the result has no part for them: {', '.join(left)}."] if left else []


def _add_suffix(name: str, suffix: str) -> str:
    """Return a channel's name with a suffix to its pass: ``ViewLayer.Combined_clean.R``; of plain R ``clean.R``.

    Raises
    ------
    InputError
        If the suffix holds a dot.
    """
    if "." in suffix.strip("."):
        raise InputError("--suffix", expected="a word without a dot", got=repr(suffix), action="write _denoised")
    head, _, component = name.rpartition(".")
    word = suffix.strip(".")
    return f"{head}{word}.{component}" if head else f"{word.lstrip('_- ') or word}.{component}"
