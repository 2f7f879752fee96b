"""`Denoiser` is called like Mitsuba's `OptixDenoiser` and uses lobewise's filters, on any variant and processor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lobewise.denoising.automatic import ask, change_settings
from lobewise.denoising.recipe import denoise_quietly
from lobewise.errors import InputError, require_choice, require_integer
from lobewise.mitsuba.frames import Given, History, list_channels, make_frame, to_camera_space
from lobewise.mitsuba.gradients import LinearImage, apply_differentiably
from lobewise.mitsuba.linear import LinearFilter
from lobewise.mitsuba.tensors import (
    ROOT,
    carries_gradients,
    give_back,
    is_bitmap,
    make_bitmap,
    split_bitmap,
    take_image,
    take_matrix,
)
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.settings import OIDN_QUALITY, DenoiseSettings
from lobewise.settings.choices import get_quality

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from lobewise.settings import DenoiseChanges

MAX_SIDE = 1 << 16
"""Largest width and height of an image, pixels."""
COLORS = {1: 1, 2: 1, 3: 3, 4: 3}
"""Number of color channels, by the number of all channels. One more channel is alpha."""


class Denoiser:
    """Denoises images of Mitsuba. It is called like ``mitsuba.OptixDenoiser``, but runs on any variant and hardware.

    Every guide of a call is used. Guides that the constructor announced are required. In a bitmap, further layers of
    Mitsuba's integrator ``aov`` (``position``, ``depth``, ``sh_normal`` ...) are found by their names.

    Parameters
    ----------
    input_size : (int, int)
        Width and height of the images.
    albedo, normals : bool
        Whether albedo and normals will be given.
    temporal : bool
        Whether every call is the next frame of a sequence. If so, ``flow`` and ``previous_denoised`` are required.
    denoise_alpha : bool
        Whether the alpha channel is denoised too, instead of copied.
    settings : DenoiseSettings, optional
        As for `lobewise.denoise`.
    **changes
        Single settings, by name, such as ``quality="high"``.

    Raises
    ------
    InputError
        If the size is not valid, or a setting is unknown or out of range.

    Examples
    --------
    >>> import mitsuba as mi  # doctest: +SKIP
    >>> noisy = mi.render(scene, spp=16)  # doctest: +SKIP
    >>> denoiser = lobewise.mitsuba.Denoiser(input_size=(noisy.shape[1], noisy.shape[0]))  # doctest: +SKIP
    >>> clean = denoiser(noisy)  # doctest: +SKIP
    """

    def __init__(
        self,
        input_size: Sequence[int],
        albedo: bool = False,
        normals: bool = False,
        temporal: bool = False,
        denoise_alpha: bool = False,
        *,
        settings: DenoiseSettings | None = None,
        **changes: Unpack[DenoiseChanges],
    ) -> None:
        sides = [int(side) for side in np.array(input_size).ravel()]
        if len(sides) != 2:
            raise InputError("input_size", expected="width and height", got=repr(input_size), action="pass (512, 512)")
        self._size = (
            require_integer("input_size, width", sides[0], 1, MAX_SIDE),
            require_integer("input_size, height", sides[1], 1, MAX_SIDE),
        )
        self._announced = {"albedo": bool(albedo), "normals": bool(normals)}
        self._denoise_alpha = bool(denoise_alpha)
        self._settings = change_settings(settings or DenoiseSettings(), changes)
        self._history = History(settings, changes) if temporal else None
        self._notes: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what was found, converted, missing or not used in the last call."""
        return self._notes

    def __repr__(self) -> str:
        parts = [name for name, there in self._announced.items() if there]
        parts += ["temporal"] if self._history else []
        parts += ["denoise_alpha"] if self._denoise_alpha else []
        return f"Denoiser({', '.join([f'input_size={self._size}', *parts])})"

    def __call__(
        self,
        noisy: Any,
        albedo: Any = None,
        normals: Any = None,
        to_sensor: Any = None,
        flow: Any = None,
        previous_denoised: Any = None,
        noisy_ch: str = ROOT,
        *,
        albedo_ch: str = "",
        normals_ch: str = "",
        flow_ch: str = "",
        previous_denoised_ch: str = "",
        position: Any = None,
        depth: Any = None,
    ) -> Any:
        """Return the denoised image, of the type of ``noisy``: a tensor, a bitmap or a NumPy array.

        Parameters
        ----------
        noisy : TensorXf, Bitmap or array
            Linear radiance, (height, width, channels), with 3 channels, or 4 with alpha. Monochrome variants have 1 or
            2. A box filter gives the best results. A bitmap may hold the guides as further layers.
        albedo : TensorXf, optional
            (height, width, 3).
        normals : TensorXf, optional
            Shading normals, (height, width, 3), in the coordinate frame of the sensor (x left, y up, z forward).
        to_sensor : Transform4f, optional
            Transform from the space of the normals to the frame of the sensor, if they differ. The integrator ``aov``
            writes normals in world space, so pass ``sensor.world_transform().inverse()``.
        flow : TensorXf, optional
            Motion of each pixel's surface from the previous frame to this one, (height, width, 2), in pixels to the
            right and down.
        previous_denoised : TensorXf, optional
            Result of this denoiser for the previous frame. Pass ``noisy`` in the first call, or to begin anew.
        noisy_ch, albedo_ch, normals_ch, flow_ch, previous_denoised_ch : str
            Names of the layers of a bitmap, in place of the images.
        position, depth : TensorXf, optional
            World positions, (height, width, 3), and distances from the camera, (height, width, 1), of surfaces.

        Raises
        ------
        InputError
            If an image is missing or has another size or number of channels; if a guide carries gradients, or ``noisy``
            does and the settings are not those of ``quality="fast"``, whose weights are fixed and pass them exactly.
        """
        images = {"albedo": albedo, "normals": normals, "flow": flow, "previous_denoised": previous_denoised}
        names = {"albedo": albedo_ch, "normals": normals_ch, "flow": flow_ch, "previous_denoised": previous_denoised_ch}
        more = {"position": position, "depth": depth}
        for name, image in {**images, **more}.items():
            _refuse_gradients(name, image)
        others: dict[str, FloatArray] = {}
        if is_bitmap(noisy):
            color, images, others = _take_layers(noisy, noisy_ch, images, names)
        else:
            color = noisy
            if any(names.values()) or noisy_ch != ROOT:
                action = "pass tensors as albedo, normals, flow and previous_denoised"
                raise InputError("noisy", expected="a bitmap for names of its layers", got="a tensor", action=action)
        image = take_image("noisy", color, self._size, tuple(COLORS))
        frame, notes = self._make_frame(image, {**images, **more}, others, to_sensor)
        if carries_gradients(noisy):
            self._notes = tuple(notes)
            return apply_differentiably(noisy, self._make_linear(image, frame))
        clean = self._filter(image, frame, images["previous_denoised"], notes)
        self._notes = tuple(notes)
        return make_bitmap(noisy, noisy_ch, clean) if is_bitmap(noisy) else give_back(noisy, clean)

    def _make_frame(
        self, image: FloatArray, images: dict[str, Any], others: dict[str, FloatArray], to_sensor: Any
    ) -> tuple[Frame, list[str]]:
        """Return the frame of an image and its guides, and notes on it."""
        color = image[..., :3] if COLORS[image.shape[2]] == 3 else np.repeat(image[..., :1], 3, axis=-1)
        passed = self._take_guides(color, images, others, to_sensor)
        frame, notes = make_frame(passed)
        self._require_announced(frame, passed)
        return frame, notes

    def _make_linear(self, image: FloatArray, frame: Frame) -> LinearImage:
        """Return the denoiser as a linear map, for an image with gradients.

        Raises
        ------
        InputError
            If the settings make no linear map.
        """
        settings = ask(self._settings, {})
        if self._history is not None or get_quality(settings.quality).reads_halves or settings.form != "full":
            whose = "a history" if self._history is not None else f"quality {settings.quality!r}"
            whose += f" and form {settings.form!r}" if settings.form != "full" else ""
            raise InputError(
                "noisy",
                expected=f"a tensor without gradients, which are not passed exactly by {whose}",
                got="one that carries them",
                action="make the denoiser with quality='fast', which does, or pass dr.detach(noisy)",
            )
        count = COLORS[image.shape[2]]
        filters_alpha = self._denoise_alpha and image.shape[2] > count
        alpha = LinearFilter(_make_alpha_frame(frame, image[..., count:]), settings) if filters_alpha else None
        return LinearImage(LinearFilter(frame, settings), alpha, count)

    def _filter(self, image: FloatArray, frame: Frame, previous: Any, notes: list[str]) -> FloatArray:
        """Return the denoised image, with all channels of the noisy one."""
        count = COLORS[image.shape[2]]
        if self._history is not None:
            before = take_image("previous_denoised", previous, self._size, image.shape[2:])
            clean = self._history.add(frame, before[..., :count], image[..., :count])
        else:
            result = denoise_quietly(frame, self._settings)
            clean = result.image
            notes.append(f"Used: {result.method}.")
            if result.bad_pixel_count:
                notes.append(
                    f"{result.bad_pixel_count} pixels were NaN, infinite or far below the light around them, and were "
                    "refilled."
                )
        parts = [clean[..., :count]]
        if image.shape[2] > count:
            alpha = image[..., count:]
            parts.append(self._clean_alpha(frame, alpha) if self._denoise_alpha else alpha)
        clean = np.concatenate(parts, axis=-1)
        if self._history is not None:
            self._history.remember(clean[..., :count])
        return clean

    def _take_guides(
        self, color: FloatArray, images: dict[str, Any], others: dict[str, FloatArray], to_sensor: Any
    ) -> Given:
        passed = Given(np.ascontiguousarray(color), others=others)
        channels = {"albedo": 3, "normals": 3, "flow": 2, "position": 3, "depth": 1}
        guides = {
            name: take_image(name, images[name], self._size, (count,))
            for name, count in channels.items()
            if images[name] is not None
        }
        if "normals" in guides:
            matrix = None if to_sensor is None else take_matrix("to_sensor", to_sensor)
            passed.roles["normal"] = to_camera_space(guides["normals"], matrix)
        for name in ("albedo", "position", "depth"):
            if name in guides:
                passed.roles[name] = guides[name]
        for name in ("flow", "previous_denoised"):
            if self._history is None and images[name] is not None:
                got = f"{name} without it"
                raise InputError("temporal", expected="True", got=got, action="make the denoiser with temporal=True")
            if self._history is not None and images[name] is None:
                action = "pass flow and previous_denoised, in the first call zeros and the noisy image"
                raise InputError(name, expected="an image, as temporal is True", got="none", action=action)
        if "flow" in guides:
            passed.roles["motion"] = guides["flow"]
        return passed

    def _require_announced(self, frame: Frame, passed: Given) -> None:
        there = {"albedo": frame.gbuffer.diffuse_albedo is not None, "normals": "normal" in passed.roles}
        for name, announced in self._announced.items():
            if announced and not there[name]:
                action = f"pass {name}, of a bitmap {name}_ch"
                raise InputError(name, expected=f"an image, as {name} is True", got="none", action=action)

    def _clean_alpha(self, frame: Frame, alpha: FloatArray) -> FloatArray:
        """Return alpha, (height, width, 1), filtered like light on white surfaces."""
        # Open Image Denoise was trained on light, not on coverage.
        settings = ask(self._settings, {})
        own = replace(settings, quality=OIDN_QUALITY if settings.needs_oidn else settings.quality, with_oidn=False)
        clean = denoise_quietly(_make_alpha_frame(frame, alpha), own)
        return np.clip(clean.image[..., :1], 0.0, 1.0)


def _make_alpha_frame(frame: Frame, alpha: FloatArray) -> Frame:
    """Return a frame whose light is alpha, (height, width, 1), and whose surfaces are white."""
    bare = replace(frame.gbuffer, diffuse_albedo=None, specular_albedo=None)
    return Frame(Radiance(np.repeat(alpha, 3, axis=-1)), bare, frame.camera)


def _take_layers(
    bitmap: Any, noisy_ch: str, images: dict[str, Any], names: dict[str, str]
) -> tuple[FloatArray, dict[str, Any], dict[str, FloatArray]]:
    """Return the noisy image of a bitmap, its layers that are named as guides, and the channels of all other layers."""
    layers = split_bitmap(bitmap)
    named = {"noisy": noisy_ch}
    for name, image in images.items():
        # Names that are passed by position arrive in the arguments of the images.
        text = names[name] or (image if isinstance(image, str) else "")
        if image is not None and not isinstance(image, str):
            got = f"a {type(image).__name__}"
            raise InputError(name, expected=f"the name of a layer, as {name}_ch", got=got, action="pass tensors alone")
        if text:
            named[name] = text
    for name, layer in named.items():
        require_choice(f"{name}_ch", layer, layers)
    rest = {name: layer for name, layer in layers.items() if name not in {*named.values(), ROOT}}
    guides: dict[str, Any] = {name: layers[named[name]].image if name in named else None for name in images}
    return (
        layers[noisy_ch].image,
        guides,
        list_channels({name: (layer.image, layer.components) for name, layer in rest.items()}),
    )


def _refuse_gradients(name: str, image: Any) -> None:
    """Raise InputError if a tensor carries gradients."""
    if carries_gradients(image):
        raise InputError(
            name,
            expected="a tensor without gradients, which only noisy passes",
            got="one that carries them",
            action=f"pass dr.detach({name})",
        )
