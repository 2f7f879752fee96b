"""Options of verbs that shade the least supported pixels again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from lobewise.cli.terminal.help import shading_option
from lobewise.errors import InputError

if TYPE_CHECKING:
    from lobewise.frame import Result
    from lobewise.sparse_frame import AnyFrame


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
    adaptive_spp: Annotated[int, shading_option(metavar="N", help="With --adaptive: samples of each pixel.")] = 64
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

    def plan(self) -> Callable[[Result, AnyFrame], Result]:
        """Return a function that shades the least supported pixels of a result again.

        The function loads the scene when it is first called.
        """
        budget = self.share
        if budget == 0.0:
            return lambda result, frame: result
        if self.scene is None:
            raise InputError("--adaptive", expected="--scene beside it", got="none", action="name the scene")
        scene, spp, loaded = self.scene, self.adaptive_spp, list[Any]()

        def improve(result: Result, frame: AnyFrame) -> Result:
            from lobewise.adaptive import recompute
            from lobewise.cli.output import print_line
            from lobewise.render import load_scene, render_pixels, set_camera

            if not loaded:
                loaded.append(load_scene(scene, width=frame.width, height=frame.height))
            if frame.camera is not None:
                set_camera(loaded[0], frame.camera)
            better = recompute(
                result,
                lambda rows, columns: render_pixels(loaded[0], rows, columns, spp=spp, seed=1, light=self.light),
                samples=spp / (frame.spp or 1),
                frame=frame,
                budget=budget,
            )
            print_line(f"Shaded {better.settings['recomputed']} pixels again, {spp} spp.")
            return better

        return improve
