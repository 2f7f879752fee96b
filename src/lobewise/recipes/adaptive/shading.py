"""Shade the least supported pixels of a result again, in the scene that was rendered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lobewise.errors import InputError, require_choice
from lobewise.io.files import anchor_name
from lobewise.recipes.adaptive.recipe import recompute
from lobewise.records.frame import Frame, Result
from lobewise.records.sparse_frame import AnyFrame
from lobewise.scenes import require_scene

if TYPE_CHECKING:
    from typing_extensions import Self

MAX_PARTS = 8
"""Most parts of a pixel's samples, whose differences tell the noise."""

Light = Literal["all", "indirect"]


@dataclass(frozen=True, kw_only=True)
class Shading:
    """Which pixels are shaded again, and how.

    Parameters
    ----------
    scene : str
        Name of a scene that is built in, or the path of a Mitsuba scene.
    share : float
        Largest share of the pixels, in (0, 1]: those with the least support.
    spp : int
        Samples of each of these pixels, at least 1.
    light : str
        The light that was rendered: "all" or "indirect".
    """

    scene: str
    share: float
    spp: int
    light: Light = "all"

    def check(self) -> None:
        """Raise InputError or FileError unless the scene is there and the light is known."""
        require_scene(self.scene)
        require_choice("light", self.light, ("all", "indirect"))

    def anchor(self) -> Self:
        """Return the same with an absolute path, for processes that run in another folder."""
        return replace(self, scene=anchor_name(self.scene))

    def list_files(self) -> list[Path]:
        """Return the file of the scene, unless it is built in."""
        return [Path(self.scene)] if Path(self.scene).is_file() else []

    def make_improver(self) -> Callable[[Result, AnyFrame], Result]:
        """Return a function that shades pixels of a result again. It loads the scene when it is first called."""
        loaded: list[Any] = []
        parts = next(parts for parts in range(min(MAX_PARTS, self.spp), 0, -1) if self.spp % parts == 0)

        def improve(result: Result, frame: AnyFrame) -> Result:
            from lobewise.render import load_scene, render_pixels, set_camera

            if isinstance(frame, Frame) and frame.wraps:
                expected, got = "frames of a pinhole camera", "one that wraps around"
                raise InputError("adaptive", expected=expected, got=got, action="leave it out")
            if not loaded:
                loaded.append(load_scene(self.scene, width=frame.width, height=frame.height))
            if frame.camera is not None:
                set_camera(loaded[0], frame.camera)
            options: dict[str, Any] = {"spp": self.spp, "seed": 1, "light": self.light, "parts": parts}
            better = recompute(
                result,
                lambda rows, columns: render_pixels(loaded[0], rows, columns, **options),
                samples=self.spp / (frame.spp or 1),
                frame=frame,
                budget=self.share,
            )
            note = f"{better.settings['recomputed']} pixels were shaded again, with {self.spp} samples each."
            return replace(better, notes=(*better.notes, note))

        return improve
