"""The image of a file as viewers show it, and the noisy one that a renderer which denoised it kept beside it."""

from __future__ import annotations

from lobewise.frame import FloatArray
from lobewise.interchange.imported import ImageReader
from lobewise.interchange.mapping import map_channels
from lobewise.interchange.reading import is_own
from lobewise.interchange.siblings import find_family
from lobewise.io.exr.frames import read_image as read_own_image
from lobewise.io.exr.parsing import read_container
from lobewise.io.files import PathLike


def read_image(path: PathLike) -> FloatArray:
    """Return only the image of any EXR file, as viewers show it: float32, shape (height, width, 3).

    Where the renderer denoised its image and kept the noisy one in another pass, the denoised image is returned;
    `find_noisy_pass` names the other.

    Raises
    ------
    FileError
        If the file is missing, unreadable, damaged, truncated or of zero size.
    MissingChannelError
        If there is no image.
    """
    container = read_container(path)
    if is_own(container):
        return read_own_image(path)
    family = find_family(container)
    return ImageReader(family.decode)(map_channels(family.container).target)


def find_noisy_pass(path: PathLike) -> tuple[str, str] | None:
    """Return the labels of the image that viewers show and of the noisy pass beside it; None where there is one image.

    Raises
    ------
    FileError
        If the file is missing, unreadable, damaged, truncated or of zero size.
    MissingChannelError
        If there is no image.
    """
    container = read_container(path)
    if is_own(container):
        return None
    channels = map_channels(find_family(container).container)
    return None if channels.shown is None else (channels.shown.label, channels.roles["color"].label)
