"""Denoise and upsample files: one request says what is read, how it is filtered and what is written."""

from lobewise.recipes.files.request import FileRequest as FileRequest
from lobewise.recipes.files.result import FileResult as FileResult
from lobewise.recipes.files.running import denoise_files as denoise_files

__all__ = ["FileRequest", "FileResult", "denoise_files"]
