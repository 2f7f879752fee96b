"""Rendering and denoising of a Mitsuba scene: in one call, and as an integrator that scenes name."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from lobewise.denoising.automatic import ask
from lobewise.denoising.recipe import denoise_quietly
from lobewise.errors import InputError, require_integer
from lobewise.settings import DenoiseSettings

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from lobewise.settings import DenoiseChanges


def denoise(
    scene: Any,
    spp: int,
    sensor: Any = 0,
    seed: int = 0,
    *,
    integrator: str = "auto",
    max_depth: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    settings: DenoiseSettings | None = None,
    **changes: Unpack[DenoiseChanges],
) -> Any:
    """Return a denoised image of a scene, as ``mitsuba.render`` returns a noisy one.

    The scene is rendered with a box filter and with all guides: normals, roughness, albedos, reflected surfaces, and
    light separated by the lobe that scattered it first.

    Parameters
    ----------
    scene : mitsuba.Scene
        A scene of the variant ``llvm_ad_rgb`` or ``cuda_ad_rgb``.
    spp : int
        Samples per pixel.
    sensor : int or mitsuba.Sensor
        A perspective sensor, or the number of one of the scene's sensors, counted from 0.
    seed : int
        The same seed gives the same image.
    integrator, max_depth
        The integrator, and its longest path; see `lobewise.render.render_frame`.
    progress : callable, optional
        Called with ``(done, total)`` samples.
    settings : DenoiseSettings, optional
        As for `lobewise.denoise`.
    **changes
        Single settings by name.

    Returns
    -------
    mitsuba.TensorXf
        (height, width, 3), linear.

    Raises
    ------
    InputError
        If the variant, sensor or integrator is not supported, a number is out of range, or a parameter of
        the scene carries gradients.
    UnsupportedBsdfError, MissingDependencyError
        See `lobewise.render.render_frame`.

    Examples
    --------
    >>> import mitsuba as mi  # doctest: +SKIP
    >>> mi.util.write_bitmap("clean.png", lobewise.mitsuba.denoise(scene, spp=16))  # doctest: +SKIP
    """
    from lobewise.render import render_frame
    from lobewise.render.bridge import mi
    from lobewise.render.camera import use_sensor
    from lobewise.render.integrators import check_scene

    chosen = ask(settings, changes)
    check_scene(scene)
    _refuse_gradients(scene)
    eye = _choose_sensor(scene, sensor)
    with use_sensor(eye):
        light: dict[str, Any] = {"integrator": integrator, "max_depth": max_depth}
        frame = render_frame(scene, spp=spp, seed=seed, progress=progress, **light)
    return mi.TensorXf(np.ascontiguousarray(denoise_quietly(frame, chosen).image))


def _choose_sensor(scene: Any, sensor: Any) -> Any:
    """Return the scene's sensor of a number, or the sensor itself if one is given.

    Raises
    ------
    InputError
        If it is neither.
    """
    from lobewise.render.bridge import mi
    from lobewise.render.camera import list_sensors

    if isinstance(sensor, mi.Sensor):
        return sensor
    sensors = list_sensors(scene)
    return sensors[require_integer("sensor", sensor, 0, len(sensors) - 1)]


def _refuse_gradients(scene: Any) -> None:
    """Raise InputError if a parameter of a scene carries gradients, because rendering here loses them."""
    from lobewise.render.bridge import dr, mi

    parameters = mi.traverse(scene)
    for name in parameters.keys():  # noqa: SIM118  # Mitsuba's own type, no mapping
        if dr.grad_enabled(parameters[name]):
            raise InputError(
                f"scene parameter {name!r}",
                expected="a value without gradients, as rendering and denoising in one step passes none",
                got="one that carries them",
                action="render with mi.render and denoise with Denoiser(quality='fast'), or dr.disable_grad it",
            )


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
