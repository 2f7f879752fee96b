"""A plugin of Mitsuba that renders and denoises, for scenes that name it as their integrator."""

from __future__ import annotations

from typing import Any

from lobewise.denoising.automatic import ask
from lobewise.errors import InputError
from lobewise.mitsuba.scenes import denoise

PLUGIN = "lobewise"
"""Name of the integrator in scene files and dictionaries."""


def register_integrator() -> None:
    """Register the integrator ``lobewise`` with Mitsuba, for the variant that is set.

    ``mitsuba.render`` then returns denoised images of scenes that name it: ``{"type": "lobewise"}`` or ``<integrator
    type="lobewise">``. Its parameters are ``max_depth``, the longest path (by default 8 vertices after the camera),
    and every setting of `lobewise.denoise`. The light is that of `lobewise.mitsuba.denoise`.

    Raises
    ------
    MissingDependencyError
        If Mitsuba is not installed.
    InputError
        When a scene is loaded whose integrator has an unknown parameter; when it is rendered, see
        `lobewise.mitsuba.denoise`.

    Examples
    --------
    >>> import mitsuba as mi  # doctest: +SKIP
    >>> mi.set_variant("llvm_ad_rgb")  # doctest: +SKIP
    >>> lobewise.mitsuba.register_integrator()  # doctest: +SKIP
    >>> scene = mi.load_dict(mi.cornell_box() | {"integrator": {"type": "lobewise"}})  # doctest: +SKIP
    >>> clean = mi.render(scene, spp=16)  # doctest: +SKIP
    """
    from lobewise.render.bridge import mi
    from lobewise.render.integrators import DEPTH

    class LobewiseIntegrator(mi.SamplingIntegrator):  # type: ignore[misc]
        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            given = {name: properties[name] for name in properties.keys()}  # noqa: SIM118 - Mitsuba's own type
            self.max_depth = given.pop("max_depth", DEPTH)
            self._settings = ask(None, given)

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            if not develop:
                action = "call mitsuba.render, or leave develop out"
                raise InputError("develop", expected="True: the film is not written to", got="False", action=action)
            eye = sensor if isinstance(sensor, mi.Sensor) else scene.sensors()[sensor]
            return denoise(
                scene,
                spp or eye.sampler().sample_count(),
                eye,
                int(seed),
                integrator="paths",
                max_depth=self.max_depth,
                settings=self._settings,
            )

        def to_string(self) -> str:
            return f"LobewiseIntegrator[max_depth = {self.max_depth}]"

    mi.register_integrator(PLUGIN, LobewiseIntegrator)
