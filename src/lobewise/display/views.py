"""From light to the picture on a screen: by our own curve, or by a view of OpenColorIO."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.display.colors import AP0, Chromaticities, convert_light
from lobewise.display.tones import map_tones, round_codes
from lobewise.errors import FileError, InputError, MissingDependencyError, make_printable, require_choice
from lobewise.work.arrays import FloatArray

MAX_SHOWN_LIGHT = 1e9
"""Light that infinite light counts as."""
_INTERCHANGE, _SCENE = "aces_interchange", "scene_linear"


@dataclass(frozen=True)
class View:
    """A view of a display of a configuration of OpenColorIO. Plain data: the workers of a farm get it."""

    config: str
    """Path of the configuration, or one of OpenColorIO's own, such as ``ocio://default``."""
    display: str
    view: str

    def paint(self, image: FloatArray, chromaticities: Chromaticities | None, exposure: float) -> NDArray[np.uint8]:
        """Return the picture of linear light, uint8 of shape (height, width, 3). NaN becomes black.

        Light of unknown primaries has those of the configuration's role ``scene_linear``.
        """
        source = _SCENE
        if chromaticities is not None and _read_config(self.config).hasRole(_INTERCHANGE):
            source, image = _INTERCHANGE, convert_light(image, chromaticities, AP0)
        with np.errstate(over="ignore"):
            light = np.ascontiguousarray(image * np.float32(exposure), dtype=np.float32)
        light = np.nan_to_num(light, nan=0.0, posinf=MAX_SHOWN_LIGHT, neginf=-MAX_SHOWN_LIGHT)
        _make_processor(self, source).applyRGB(light)
        return round_codes(np.clip(light, 0.0, 1.0) * 255.0)


def paint_picture(
    image: FloatArray, chromaticities: Chromaticities | None, exposure: float, view: View | None = None
) -> NDArray[np.uint8]:
    """Return the picture of linear light, uint8 of shape (height, width, 3): by `map_tones`, or by a view."""
    if view is None:
        return map_tones(convert_light(image, chromaticities), exposure)
    return view.paint(image, chromaticities, exposure)


def open_view(config: Path | None, display: str | None, view: str | None) -> View:
    """Return a view that can paint; what is None is the configuration's own choice, ``config`` is then ``$OCIO``.

    Raises
    ------
    MissingDependencyError
        If OpenColorIO is not installed.
    FileError
        If the configuration cannot be read.
    InputError
        If there is no configuration, no such display or view, or the view cannot be computed.
    """
    path = os.environ.get("OCIO", "") if config is None else str(config)
    if not path:
        raise InputError(
            "--ocio",
            expected="a configuration of OpenColorIO beside --display and --view",
            got="none",
            action="name its config.ocio, or set the variable OCIO",
        )
    loaded = _read_config(path)
    display = loaded.getDefaultDisplay() if display is None else display
    require_choice("--display", display, list(loaded.getDisplays()))
    view = loaded.getDefaultView(display) if view is None else view
    require_choice("--view", view, list(loaded.getViews(display)))
    chosen = View(path, display, view)
    _make_processor(chosen, _SCENE)
    return chosen


@lru_cache(maxsize=2)
def _read_config(path: str) -> Any:
    try:
        import PyOpenColorIO
    except ImportError:
        raise MissingDependencyError(
            "Views of displays need OpenColorIO",
            action="pip install 'lobewise[color]', or leave --display and --view out",
        ) from None
    try:
        return PyOpenColorIO.Config.CreateFromFile(path)
    except (PyOpenColorIO.Exception, PyOpenColorIO.ExceptionMissingFile) as problem:
        raise FileError(
            f"file {path!r}",
            expected="a configuration of OpenColorIO",
            got=make_printable(_shorten(problem)),
            action="name a config.ocio",
        ) from None


@lru_cache(maxsize=4)
def _make_processor(view: View, source: str) -> Any:
    import PyOpenColorIO

    transform = PyOpenColorIO.DisplayViewTransform(src=source, display=view.display, view=view.view)
    try:
        return _read_config(view.config).getProcessor(transform).getDefaultCPUProcessor()
    except (PyOpenColorIO.Exception, PyOpenColorIO.ExceptionMissingFile) as problem:
        raise InputError(
            f"--view {view.view!r}",
            expected=f"a view that OpenColorIO computes from the role {source}",
            got=make_printable(_shorten(problem)),
            action="choose another view or configuration",
        ) from None


def _shorten(problem: Exception) -> str:
    """Return the first line of a message, without its full stop."""
    return str(problem).strip().partition("\n")[0].rstrip(".")
