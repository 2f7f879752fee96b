"""Options of verbs that shade the least supported pixels again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, cast

from lobewise.cli.terminal.help import shading_option
from lobewise.errors import InputError

if TYPE_CHECKING:
    from lobewise.recipes.adaptive.shading import Light, Shading

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

    def make_shading(self) -> Shading | None:
        """Return what is shaded again, None for nothing. Raises InputError or FileError if an option is wrong."""
        from lobewise.recipes.adaptive.shading import Shading

        share = self.share
        if share == 0.0 or self.scene is None:
            return None
        light = cast("Light", self.light)
        shading = Shading(scene=self.scene, share=share, spp=self.choose_spp(), light=light)
        shading.check()
        return shading
