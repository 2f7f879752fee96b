"""Files of any size: frames filtered in bands of rows, from file to file, to the same bits as a whole."""

from lobewise.denoising.inputs import list_images
from lobewise.recipes.streaming.plan import DEFAULT_MEMORY, needs_bands
from lobewise.recipes.streaming.recipe import DenoisedFile, denoise_file

__all__ = ["DEFAULT_MEMORY", "DenoisedFile", "denoise_file", "list_images", "needs_bands"]
