"""Sparsely shaded frames as OpenEXR files: whole images whose radiance is 0 wherever nothing was shaded."""

from __future__ import annotations

import numpy as np

from lobewise.errors import InputError, require_kind
from lobewise.io.exr.frames import read_whole, write_frame
from lobewise.io.exr.layout import name_file, require_beauty
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.schema import SPARSE
from lobewise.io.files import PathLike
from lobewise.records.frame import Frame, Radiance
from lobewise.records.images import make_read_only
from lobewise.records.sparse_frame import SparseFrame, make_sparse

MAX_DIGITS = 9
"""Most digits of a scale, row or column in the header: no image is that large."""


def read_sparse_frame(path: PathLike, *, scale: int | None = None, place: tuple[int, int] | None = None) -> SparseFrame:
    """Return a sparsely shaded frame, as `write_sparse_frame` and ``lobewise render --scale`` write it.

    Parameters
    ----------
    path : path
        The file.
    scale, place : int and (int, int), optional
        The shaded pixels, in place of those in the header. Without any there, the file may hold any frame, and its
        radiance at other pixels is ignored.

    Raises
    ------
    FileError, MissingChannelError
        As `read_frame`.
    InputError
        As `read_frame`, or if neither the header nor ``scale`` tells which pixels were shaded, or both contradict.
    """
    container = read_container(path)
    item = require_beauty(container).get(SPARSE)
    words = [] if item is None or item.type != "string" else item.value.decode("ascii", "replace").split()
    is_told = len(words) == 3 and all(word.isdecimal() and len(word) <= MAX_DIGITS for word in words)
    if scale is None and not is_told:
        raise InputError(
            f"input {str(path)!r}",
            expected=f"the attribute {SPARSE} with scale, row and column",
            got="no such attribute" if item is None else repr(item.value[:40]),
            action="say the scale, or render with lobewise render --scale",
        )
    if is_told:
        told, shaded = int(words[0]), (int(words[1]), int(words[2]))
        scale, place = scale or told, place or shaded
        require_shaded_pixels(scale, place, told, shaded)
    assert scale is not None
    frame = read_whole(path, container)
    with name_file(path):
        return make_sparse(frame, scale, place or (0, 0))


def require_shaded_pixels(scale: int, place: tuple[int, int], told: int, shaded: tuple[int, int]) -> None:
    """Raise InputError unless every pixel that is asked for was shaded as the header tells. Others are black."""
    steps = (scale, *(mine - its for mine, its in zip(place, shaded, strict=True)))
    if told > 0 and any(step % told for step in steps):
        raise InputError(
            "scale and place",
            expected=f"pixels of those that the header tells: every {told} from row {shaded[0]}, column {shaded[1]} on",
            got=f"every {scale} from row {place[0]}, column {place[1]} on, where the file is black",
            action="leave both out",
        )


def write_sparse_frame(path: PathLike, frame: SparseFrame, *, half: bool = True, compression: str = "zip") -> None:
    """Write a sparsely shaded frame: an image of the full size whose radiance is 0 at pixels that were not shaded.

    Parameters and errors are those of `write_frame`.
    """

    require_kind("frame", frame, SparseFrame)

    def spread(part: Radiance | None) -> Radiance | None:
        if part is None:
            return None
        images = {name: np.zeros((*frame.shape, 3), np.float32) for name in part.names}
        for name, image in images.items():
            image[frame.shaded] = getattr(part, name)
        return Radiance(**make_read_only(**images))

    radiance = spread(frame.radiance)
    assert radiance is not None
    whole = Frame(
        radiance,
        frame.gbuffer,
        frame.camera,
        variance=spread(frame.variance),
        spp=frame.spp,
        lobe_tables=frame.lobe_tables,
    )
    sparse = {SPARSE: " ".join(map(str, (frame.scale, *frame.place)))}
    write_frame(path, whole, half=half, compression=compression, attributes=sparse)
