"""Options of verbs that shade the least supported pixels again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from lobewise.cli.options.common import require_scene
from lobewise.cli.options.reading import anchor_name
from lobewise.cli.terminal.help import shading_option
from lobewise.errors import InputError, require_choice

if TYPE_CHECKING:
    from lobewise.records.frame import Result
    from lobewise.records.sparse_frame import AnyFrame

PARTS = 8
"""Parts of a pixel's samples, whose differences tell the noise."""
MAX_SPP = 1 << 16
"""Largest number of samples of a pixel."""


@dataclass(frozen=True)
class Reshading:
    """Options that tell which pixels to shade again, and how."""

    adaptive: Annotated[
        str,
        shading_option(
            metavar="PERCENT", help="Shade this share of the pixels again, the least supported; needs --scene."
        ),
    ] = "0%"
    scene: Annotated[
        str | None,
        shading_option(metavar="SCENE", help="With --adaptive: the scene that was rendered.", show_default=False),
    ] = None
    adaptive_spp: Annotated[
        str,
        shading_option(
            metavar="N|auto",
            help="With --adaptive: samples of each pixel; auto costs 3.2 samples per pixel of the whole image.",
        ),
    ] = "auto"
    light: Annotated[
        str, shading_option(metavar="all|indirect", help="With --adaptive: the light that was rendered.")
    ] = "all"

    @property
    def share(self) -> float:
        """Largest share of the pixels that is shaded again, 0 to 1."""
        try:
            percent = float(self.adaptive.removesuffix("%"))
        except ValueError:
            percent = -1.0
        if 0.0 <= percent <= 100.0:
            return percent / 100.0
        raise InputError("--adaptive", expected="0% to 100%", got=repr(self.adaptive), action="5% is usual")

    def choose_spp(self) -> int:
        """Return the samples of each pixel that is shaded again, at least 1; ask only if some are.

        Raises
        ------
        InputError
            If the samples are no whole number.
        """
        from lobewise.recipes.adaptive import choose_spp

        if self.adaptive_spp == "auto":
            return choose_spp(self.share)
        if self.adaptive_spp.isdecimal() and 1 <= int(self.adaptive_spp) <= MAX_SPP:
            return int(self.adaptive_spp)
        expected, got = f'1 to {MAX_SPP}, or "auto"', repr(self.adaptive_spp)
        raise InputError("--adaptive-spp", expected=expected, got=got, action='"auto" is usual')

    def anchor(self) -> Reshading:
        """Return the options with an absolute path of the scene, for processes that run in another folder."""
        return self if self.scene is None else replace(self, scene=anchor_name(self.scene))

    def list_files(self) -> list[Path]:
        """Return the file of the scene, unless it is built in."""
        return [Path(self.scene)] if self.scene is not None and Path(self.scene).is_file() else []

    def _require_unused(self) -> None:
        """Raise InputError if an option is given that nothing uses without ``--adaptive``."""
        for one in fields(self):
            if getattr(self, one.name) != one.default and one.name != "adaptive":
                option = f"--{one.name.replace('_', '-')}"
                raise InputError(option, expected="--adaptive beside it", got="none", action="add --adaptive 5%")

    def plan(self, tell: Callable[[str], None] | None = None) -> Callable[[Result, AnyFrame], Result]:
        """Return a function that shades the least supported pixels of a result again.

        The function loads the scene when it is first called. It calls ``tell`` with the number of pixels; by default
        the number is printed.
        """
        budget = self.share
        if budget == 0.0:
            self._require_unused()
            return lambda result, frame: result
        if self.scene is None:
            raise InputError("--adaptive", expected="--scene beside it", got="none", action="name the scene")
        require_scene(self.scene)
        require_choice("light", self.light, ("all", "indirect"))
        scene, loaded, light = self.scene, list[Any](), self.light
        spp = self.choose_spp()
        parts = next(parts for parts in range(min(PARTS, spp), 0, -1) if spp % parts == 0)

        def improve(result: Result, frame: AnyFrame) -> Result:
            from lobewise.cli.output import print_line
            from lobewise.recipes.adaptive import recompute
            from lobewise.records.frame import Frame
            from lobewise.render import load_scene, render_pixels, set_camera

            if isinstance(frame, Frame) and frame.wraps:
                raise InputError(
                    "--adaptive",
                    expected="frames of a pinhole camera",
                    got="one that wraps around",
                    action="leave it out",
                )
            if not loaded:
                loaded.append(load_scene(scene, width=frame.width, height=frame.height))
            if frame.camera is not None:
                set_camera(loaded[0], frame.camera)
            better = recompute(
                result,
                lambda rows, columns: render_pixels(
                    loaded[0], rows, columns, spp=spp, seed=1, light=light, parts=parts
                ),
                samples=spp / (frame.spp or 1),
                frame=frame,
                budget=budget,
            )
            (tell or print_line)(f"Shaded {better.settings['recomputed']} pixels again, {spp} spp.")
            return better

        return improve
