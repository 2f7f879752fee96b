"""Map the images of a frame to the parts and channels of a file, and convert between them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import CancelledError, InputError, LobewiseError, MissingChannelError, TimeLimitError
from lobewise.io.exr.container import Container, Part, show_name
from lobewise.io.exr.pixels import Pixels
from lobewise.io.exr.schema import BEAUTY, SLOTS, SPARSE, Slot
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.records.images import make_read_only
from lobewise.records.lobe_table import LobeTable
from lobewise.work.chunks import Chunk, run_chunks


def look_up_beauty(parts: Iterable[Part]) -> Part | None:
    """Return the part that holds the image: the first part with channels R, G and B that have a value per pixel."""
    for part in parts:
        names = {channel.name for channel in part.channels if channel.is_whole}
        if not part.deep and names.issuperset(BEAUTY.channels):
            return part
    return None


def build_frame(
    images: Mapping[tuple[str, str], FloatArray],
    camera: Camera | None,
    spp: int | None,
    lobe_tables: tuple[LobeTable, ...] = (),
) -> Frame:
    """Return the frame of images that are keyed by (owner, field)."""

    def collect(owner: str) -> dict[str, Any]:
        return make_read_only(**{field: image for (who, field), image in images.items() if who == owner})

    others = {owner: Radiance(**collect(owner)) for owner in ("half_a", "half_b", "variance") if collect(owner)}
    radiance, gbuffer = Radiance(**collect("radiance")), GBuffer(**collect("gbuffer"))
    frame = Frame(radiance, gbuffer, camera, spp=spp, lobe_tables=lobe_tables)
    return frame.with_changes(**others) if others else frame


MAX_HALF = 65504.0
"""Largest 16-bit float."""
CHROMA = frozenset(("Y", "RY", "BY"))
"""Channels of an image of luminance and chroma. Source: "Technical Introduction to OpenEXR"."""


def require_shaded(container: Container) -> None:
    """Raise InputError if a file holds a sparsely shaded frame, MissingChannelError if it holds no image."""
    if require_beauty(container).get(SPARSE) is not None:
        raise InputError(
            f"input {str(container.path)!r}",
            expected="radiance at every pixel",
            got="a frame that was shaded sparsely",
            action="upsample it (lobewise upsample)",
        )


def make_images(slots: Iterable[Slot], pixels: Mapping[str, Pixels]) -> dict[tuple[str, str], FloatArray]:
    """Return the images of some slots by owner and field. ``pixels`` are channels in their stored types."""
    images = {}
    for slot in slots:
        image = join_planes([pixels[name] for name in slot.channels])
        images[slot.owner, slot.field] = image[..., 0] if len(slot.channels) == 1 else image
    return images


@contextmanager
def name_file(path: PathLike) -> Iterator[None]:
    """Add the name of the file to errors about its content, at the end where an option is wrong for this file."""
    try:
        yield
    except (CancelledError, TimeLimitError):
        raise
    except LobewiseError as problem:
        if repr(str(path)) in str(problem):
            raise
        name = f"input {str(path)!r}"
        if problem.holder or not problem.what.startswith("--"):
            raise problem.place_in(name) from None
        end = "?" if problem.action.endswith("?") else ""
        raise problem.change(action=f"{problem.action.removesuffix('?')} ({name}){end}") from None


def put_images(
    channels: Mapping[str, Sequence[str]], images: Mapping[str, FloatArray], pixels: Mapping[str, Pixels]
) -> dict[str, Pixels]:
    """Return the channels of a part with the channels of some images replaced, all in their stored types."""
    changed = dict(pixels)
    for field, names in channels.items():
        for index, name in enumerate(names):
            changed[name] = convert_plane(images[field][..., index], pixels[name].dtype)
    return changed


def plan_reading(container: Container, beauty: Part) -> list[tuple[Part, list[Slot]]]:
    """Return the slots of a frame that are read from each part.

    Raises MissingChannelError if an image has only some of its channels.
    """
    plan: dict[int, list[Slot]] = {}
    for slot in SLOTS:
        best: list[str] = []
        for part in _list_readable(container, beauty):
            names = {channel.name for channel in part.channels}
            have = [name for name in slot.channels if name in names]
            if len(have) == len(slot.channels):
                plan.setdefault(part.index, []).append(slot)
                best = []
                break
            best = max(best, have, key=len)
        if best:
            raise _refuse_incomplete(container.path, slot.label, "only " + ", ".join(best))
    fields = {(slot.owner, slot.field) for slots in plan.values() for slot in slots}
    for owner in ("half_a", "half_b", "variance"):
        if (owner, "color") not in fields and any(who == owner for who, _ in fields):
            raise _refuse_incomplete(container.path, f"{owner}.R/G/B", "none of them beside its other images")
    return [(container.parts[index], slots) for index, slots in sorted(plan.items())]


def require_beauty(container: Container) -> Part:
    """Return the part that holds the image; raise MissingChannelError where none has R, G and B."""
    part = look_up_beauty(container.parts)
    if part is not None:
        return part
    action = "rename the channels of the image to R, G and B"
    raise refuse_missing_image(container, expected="channels R, G and B", action=action)


MAX_NAMES = 12
"""Most passes or channels that are named in place of a missing image."""


def refuse_missing_image(
    container: Container, *, expected: str, action: str, passes: Sequence[str] = ()
) -> MissingChannelError:
    """Return the error for a file without a readable image.

    The error names an unsupported form of the image (deep, luminance and chroma, subsampled). For a file with other
    channels it has the given ``expected`` and ``action``, and names ``passes``, those that could be the image. Without
    them it names the channels.
    """
    what = f"input {str(container.path)!r}"
    names = passes or [channel.name for part in container.parts for channel in part.channels]
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    shown = f"{', '.join(map(show_name, names[:MAX_NAMES]))}{more}"
    if all(part.deep for part in container.parts):
        return MissingChannelError(
            what,
            expected="a flat image",
            got=f"a deep one, with any number of samples in each pixel ({shown})",
            action="flatten it, or render it without deep output",
        )
    if any(CHROMA.issubset(channel.name for channel in part.channels) for part in container.parts):
        return MissingChannelError(
            what,
            expected="channels R, G and B",
            got="luminance and chroma (Y, RY, BY), which are not read",
            action="save it as RGB",
        )
    odd = [
        channel.name for part in container.parts for channel in part.channels if not part.deep and not channel.is_whole
    ]
    if set(odd).intersection(BEAUTY.channels):
        got = f"{', '.join(map(show_name, odd[:MAX_NAMES]))} with less than one value for each pixel"
        return MissingChannelError(what, expected=expected, got=got, action="save it without subsampling")
    if not passes and set(names).issuperset(BEAUTY.channels):
        return MissingChannelError(
            what,
            expected="channels R, G and B in one part",
            got=f"each of them in a part of its own ({shown})",
            action="save the file with one part for the picture",
        )
    got = f"only the passes {shown}" if passes else f"only {shown}"
    return MissingChannelError(what, expected=expected, got=got, action=action)


def _list_readable(container: Container, beauty: Part) -> Iterable[Part]:
    """Yield the part of the image, then the other flat parts with its data window and its view or no view."""
    yield beauty
    for part in container.parts:
        same = part.data_window == beauty.data_window and part.view in ("", beauty.view)
        if part.index != beauty.index and same and not part.deep:
            yield part


def _refuse_incomplete(path: PathLike, label: str, got: str) -> MissingChannelError:
    return MissingChannelError(
        f"input {str(path)!r}", expected=f"all of {label}, or none", got=got, action="add or remove them"
    )


def convert_plane(plane: NDArray[Any], dtype: np.dtype[Any]) -> Pixels:
    """Return a plane in the type of a channel, clipped to its range."""
    if dtype == np.float16:
        plane = np.clip(plane, -MAX_HALF, MAX_HALF)
    elif dtype == np.uint32:
        plane = np.clip(np.rint(plane), 0, 2**32 - 1)
    out: Pixels = plane.astype(dtype)
    return out


def join_planes(planes: Sequence[Pixels]) -> FloatArray:
    """Return the image of these channels. Conversion while copying takes a fifth of the time of two steps."""
    image = np.empty((*planes[0].shape, len(planes)), dtype=np.float32)

    def join(chunk: Chunk) -> None:
        for index, plane in enumerate(planes):
            image[(*chunk, index)] = plane[chunk]

    run_chunks(join, *planes[0].shape)
    return image
