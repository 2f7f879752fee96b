"""Read EXR files of any renderer as frames, and write denoised images back into copies of these files."""

from lobewise.interchange.describing import describe_file
from lobewise.interchange.imported import Imported
from lobewise.interchange.reading import import_file, read_frame
from lobewise.interchange.replacing import write_result
from lobewise.interchange.showing import name_noisy_pass, read_image, read_light

__all__ = [
    "Imported",
    "describe_file",
    "import_file",
    "name_noisy_pass",
    "read_frame",
    "read_image",
    "read_light",
    "write_result",
]
