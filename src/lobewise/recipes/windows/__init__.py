"""Windows in time: every frame of a sequence is filtered with the samples of the frames before and after it."""

from lobewise.recipes.windows.joining import JoinedFrame as JoinedFrame
from lobewise.recipes.windows.recipe import WindowFilter as WindowFilter

__all__ = ["JoinedFrame", "WindowFilter"]
