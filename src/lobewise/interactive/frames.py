"""What can be asked of an interactive frame, and what comes back."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from lobewise.camera import Camera
from lobewise.errors import InputError, require_choice, require_integer
from lobewise.frame import FloatArray, Frame, Radiance, Result
from lobewise.interactive.methods import METHODS
from lobewise.interactive.views import VIEWS, Parts, make_view
from lobewise.settings import SIMILARITIES, Auto, DenoiseSettings, Similarity
from lobewise.sparse_frame import MAX_SCALE

UNFILTERED = "none"
"""The similarity that compares nothing."""
STAGES = ("gbuffer", "indirect", "upsampling", "adaptive", "composite")
"""What the seconds of a frame are told apart by, in the order in which it is made; the first makes direct light too."""
_OF_THE_FILTER = ("beta", "radius", "screen_sigma", "tau", "normal_exponent")


@dataclass(frozen=True)
class InteractiveSettings:
    """Parameters of a frame of `Session`.

    Parameters
    ----------
    method : {"paths", "voxel_cones", "virtual_lights"}
        What computes indirect light.
    scale : int
        One of ``scale`` times ``scale`` pixels is shaded, 1 to 16.
    spp : int
        Samples of a shaded pixel, >= 1.
    similarity : str
        As `lobewise.DenoiseSettings`, or "none": no filter; samples are interpolated on the screen, without history.
    beta : float or "auto"
        As `lobewise.DenoiseSettings`.
    radius : int
        Samples from the centre to the edge of the kernel, 0 to 64; pixels where the scale is 1.
    screen_sigma, tau, normal_exponent : float or "auto"
        As `lobewise.DenoiseSettings`; the exponent is a number.
    temporal : bool
        Whether a frame knows those before it.
    adaptive : float
        Largest share of the pixels that is shaded again because nothing supports them, 0 (none) to 1.
    limit_lobes : bool
        Whether lobes are widened (where ``tau`` is "auto") to what light that is not sampled by the BRDF can show:
        virtual lights on a sharp lobe are spikes, which a narrow kernel would keep (Tokuyoshi 2015, "Limitations (2)").
    filter_direct : bool
        Whether direct light, which has one light sample a pixel, is filtered over 7x7 pixels.
    accumulate : bool
        Whether frames are averaged for as long as neither camera nor settings change.
    """

    method: str = "paths"
    scale: int = 4
    spp: int = 1
    similarity: Similarity | Auto | Literal["none"] = "ggx"
    beta: float | Auto = "auto"
    radius: int = 2
    screen_sigma: float | Auto = "auto"
    tau: float | Auto = "auto"
    normal_exponent: float = 64.0
    temporal: bool = True
    adaptive: float = 0.05
    limit_lobes: bool = True
    filter_direct: bool = True
    accumulate: bool = True

    def __post_init__(self) -> None:
        require_choice("method", self.method, METHODS)
        require_choice("similarity", self.similarity, ("auto", *SIMILARITIES, UNFILTERED))
        for name, highest in (("scale", MAX_SCALE), ("spp", 1 << 16)):
            require_integer(name, getattr(self, name), 1, highest)
        if not 0.0 <= self.adaptive <= 1.0:
            got = repr(self.adaptive)
            raise InputError("adaptive", expected="a share from 0 to 1", got=got, action="0.05 is usual")
        self.make_filter_settings()

    def make_filter_settings(self) -> DenoiseSettings:
        """Return the settings of the filter that these ask for."""
        similarity = "auto" if self.similarity == "none" else self.similarity
        same: dict[str, Any] = {name: getattr(self, name) for name in _OF_THE_FILTER}
        return DenoiseSettings(similarity=similarity, **same)


@dataclass(frozen=True)
class InteractiveFrame:
    """A finished frame and how it was made.

    Parameters
    ----------
    image : array, shape (height, width, 3)
        Linear radiance.
    seconds : dict of float
        By stage (`STAGES`), and ``total``.
    settings : InteractiveSettings
    camera : Camera
    accumulated : int
        Frames in a row, this one included, with this camera and these settings.
    recomputed : int
        Pixels that were shaded again.
    parts : Parts
        What `get_view` shows; arrays that must not be changed.
    """

    image: FloatArray
    seconds: dict[str, float]
    settings: InteractiveSettings
    camera: Camera
    accumulated: int
    recomputed: int
    parts: Parts = field(repr=False)

    def get_view(self, name: str) -> FloatArray:
        """Return what happens inside as an image, (height, width, 3) of radiance or (height, width) in [0, 1].

        Raises
        ------
        InputError
            If there is no view of that name; they are `VIEWS`.
        """
        require_choice("view", name, VIEWS)
        return make_view(name, self.image, self.parts)

    def make_frame(self) -> Frame:
        """Return the noisy frame of this image's size, with all guides, as `lobewise.write_frame` takes it.

        Its radiance is what the views call "noisy".
        """
        hits = self.parts.hits
        return Frame(Radiance(self.get_view("noisy")), hits.gbuffer, self.camera, lobe_tables=hits.lobe_tables)

    def make_result(self) -> Result:
        """Return this image as `lobewise.write_result` takes it."""
        return replace(self.parts.result, image=self.image, diffuse=None, specular=None, variance=None)
