"""Read the image that viewers show, and find the noisy image that a denoising renderer kept in another pass."""

from __future__ import annotations

from lobewise.display.colors import convert_light
from lobewise.interchange.imported import ImageReader
from lobewise.interchange.mapping import map_file
from lobewise.interchange.siblings import look_up_family
from lobewise.io.exr.header import read_chromaticities
from lobewise.io.exr.parsing import read_container
from lobewise.io.files import PathLike
from lobewise.records.frame import FloatArray


def read_image(path: PathLike) -> FloatArray:
    """Return the image of any EXR file that viewers show: float32, shape (height, width, 3).

    If the renderer denoised its image and kept the noisy one in another pass, this is the denoised image.
    `name_noisy_pass` names the noisy one.

    Raises
    ------
    FileError
        If the file is missing, unreadable, damaged, truncated or of zero size.
    MissingChannelError
        If there is no image.
    """
    container = read_container(path)
    family = look_up_family(container)
    image = ImageReader(family.decode)(map_file(family.container).target)
    return image.copy()  # the caller may change it


def read_light(path: PathLike) -> FloatArray:
    """Return the image of `read_image` in the primaries of Rec. 709, as screens show it; same errors."""
    return convert_light(read_image(path), read_chromaticities(read_container(path)))


def name_noisy_pass(path: PathLike) -> tuple[str, str] | None:
    """Return the labels of the shown image and of the noisy pass; None if the shown image is the noisy one.

    Raises
    ------
    FileError
        If the file is missing, unreadable, damaged, truncated or of zero size.
    MissingChannelError
        If there is no image.
    """
    container = read_container(path)
    channels = map_file(look_up_family(container).container)
    return None if channels.shown is None else (channels.shown.label, channels.roles["color"].label)
