"""What the guides of a whole frame are worth: images that are 0 everywhere or one value everywhere, encoded normals.

A renderer writes a pass of zeros where nobody filled it. Filters would take such normals or depths for a frame without
surfaces, and keep its noise. So empty guides are left out. A `GuideSurvey` looks at a frame as a whole or band by band,
and changes every band alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from lobewise.records.frame import FloatArray, Frame
from lobewise.records.sparse_frame import AnyFrame

SURFACES = ("normal", "mean_normal", "denoiser_normal", "position", "depth")
"""Guides that are 0 only where there is no surface."""
TELLING = ("normal", "position", "depth")
"""Guides that are named where they have one value everywhere."""
LOBE_ALBEDOS = ("diffuse_albedo", "specular_albedo")
ALBEDOS = (*LOBE_ALBEDOS, "mean_diffuse_albedo", "mean_specular_albedo", "denoiser_albedo")
"""Guides that are means over a pixel's samples, or over its area, in [0, 1]: they have noise at edges of textures."""
STRIDE = 16
"""Pixels between two pixels of a first look, which settles most images."""
MIN_NORMALS = 60
"""Smallest number of normals from which their encoding is judged."""
MIN_UNIT_SHARE = 0.75
"""Smallest share of normals of about unit length that shows an encoding. Others may be means, which are shorter."""
MAX_LENGTH_ERROR = 0.1
"""Largest difference from 1 of the length of a unit normal."""
MAX_ROUNDING_ERROR = 1e-3
"""Largest distance of an encoded normal from [0, 1] that the rounding of 16-bit floats explains."""

FrameT = TypeVar("FrameT", bound=AnyFrame)


@dataclass
class _Look:
    """What was seen of an image so far."""

    value: FloatArray
    """First pixel; all others are like it while ``is_uniform``."""
    is_uniform: bool = True
    has_light: bool = False
    """Whether any light was seen that surfaces with this guide scattered."""
    count: int = 0
    """Pixels."""

    @property
    def is_zero(self) -> bool:
        """Whether every value was 0."""
        return self.is_uniform and not self.value.any()


@dataclass
class _Encoding:
    """Counts that tell whether normals are stored in [0, 1]."""

    is_possible: bool = True
    count: int = 0
    plain: int = 0
    """Normals of unit length as they stand."""
    decoded: int = 0
    """Normals of unit length after decoding."""

    @property
    def is_encoded(self) -> bool:
        """Whether nearly all normals have unit length after decoding, and not as they stand."""
        least = MIN_UNIT_SHARE * self.count
        return self.is_possible and self.count >= MIN_NORMALS and self.decoded >= least > self.plain


@dataclass
class GuideSurvey:
    """Collects what the guides of a frame are worth, and changes the frame accordingly."""

    _looks: dict[str, _Look] = field(default_factory=dict)
    _encoding: _Encoding = field(default_factory=lambda: _Encoding(is_possible=False))
    _is_apart: bool = True

    def look_at(self, frame: AnyFrame) -> None:
        """Take in a frame, or the next of its bands."""
        is_first = not self._looks
        lights, self._is_apart = dict(_list_lights(frame)), frame.radiance.parts is not None
        for name, image in _list_images(frame):
            look = self._looks.setdefault(name, _Look(np.array(image[0, 0])))
            look.count += image.shape[0] * image.shape[1]
            look.is_uniform = look.is_uniform and _is_all(image, look.value)
            if look.is_zero and not look.has_light:
                look.has_light = any(bool(np.any(light > 0.0)) for light in lights.get(name, ()))
        normal = frame.gbuffer.normal
        if is_first and normal is not None:
            self._encoding.is_possible = True
        if normal is not None and self._encoding.is_possible:
            _add_normals(self._encoding, normal)

    @property
    def is_settled(self) -> bool:
        """Whether further bands cannot change anything."""
        is_open = [look.is_uniform if name in TELLING else look.is_zero for name, look in self._looks.items()]
        return not any(is_open) and not self._encoding.is_possible

    @property
    def empty(self) -> tuple[str, ...]:
        """Names of the guides that hold nothing."""
        zero = {name for name, look in self._looks.items() if look.is_zero}
        names = [name for name in self._looks if name in zero and self._looks[name].has_light]
        if not self._is_apart and any(name in self._looks and name not in zero for name in LOBE_ALBEDOS):
            # Of two albedos of one light, one may be black, as in a scene of metals.
            names = [name for name in names if name.removeprefix("mean_") not in LOBE_ALBEDOS]
        return tuple(names)

    @property
    def is_encoded(self) -> bool:
        """Whether the normals are stored in [0, 1]."""
        return self._encoding.is_encoded

    def apply(self, frame: FrameT) -> FrameT:
        """Return a frame, or a band of it, without its empty guides and with normals in [-1, 1]."""
        empty, changes = self.empty, dict[str, Any]()
        guides: dict[str, Any] = {name: None for name in empty if hasattr(frame.gbuffer, name)}
        if self.is_encoded and frame.gbuffer.normal is not None:
            guides["normal"] = decode_normals(frame.gbuffer.normal)
        if guides:
            changes["gbuffer"] = replace(frame.gbuffer, **guides)
        if isinstance(frame, Frame) and any(_name_layer(layer.name) in empty for layer in frame.layers):
            changes["layers"] = tuple(
                replace(layer, albedo=None) if _name_layer(layer.name) in empty else layer for layer in frame.layers
            )
        return replace(frame, **changes) if changes else frame

    def list_idle(self) -> list[str]:
        """Return a sentence for each guide that is left out."""
        return [f"{name} is 0 everywhere, so it is not used." for name in self.empty]

    def list_notes(self) -> list[str]:
        """Return sentences on guides that are used, but are changed or tell nothing."""
        notes = ["normal is stored in [0, 1], so it was decoded to [-1, 1]."] if self.is_encoded else []
        for name, look in self._looks.items():
            if name in TELLING and look.is_uniform and not look.is_zero and look.count > 1:
                notes.append(f"{name} has the same value everywhere, so it tells no surfaces apart.")
        return notes


def decode_normals(normal: FloatArray) -> FloatArray:
    """Return normals in [-1, 1] from normals stored in [0, 1]. Black means that there is no surface."""
    nothing = ~(normal != 0.0).any(axis=-1, keepdims=True)
    return np.asarray(np.where(nothing, np.float32(0.0), np.float32(2.0) * normal - np.float32(1.0)))


def is_uniform(image: FloatArray) -> bool:
    """Return whether every pixel of an image has the value of the first; false where that is NaN."""
    return _is_all(image, image[0, 0])


def _is_all(image: FloatArray, value: FloatArray) -> bool:
    if not (image[::STRIDE, ::STRIDE] == value).all():
        return False
    # A row of its own, because NumPy is several times slower where it spreads a value over an axis of three.
    row = np.broadcast_to(value, image.shape[1:]).copy()
    return bool((image == row).all())


def _name_layer(name: str) -> str:
    return f"the albedo of the layer {name!r}"


def _list_images(frame: AnyFrame) -> Iterator[tuple[str, FloatArray]]:
    """Yield the guides that may be empty, by their names."""
    for name in (*SURFACES, *ALBEDOS):
        image = getattr(frame.gbuffer, name)
        if image is not None:
            yield name, image
    for layer in frame.layers if isinstance(frame, Frame) else ():
        if layer.albedo is not None:
            yield _name_layer(layer.name), layer.albedo


def _list_lights(frame: AnyFrame) -> Iterator[tuple[str, Sequence[FloatArray]]]:
    """Yield the light that surfaces with a guide scatter, by the guide: black light explains a black guide."""
    parts = frame.radiance.parts
    scattered = parts or (frame.radiance.color,)
    yield from ((name, scattered) for name in (*SURFACES, "denoiser_albedo"))
    for number, name in enumerate(LOBE_ALBEDOS):
        light = [scattered[number if parts else 0]]
        yield name, light
        yield f"mean_{name}", light
    for layer in frame.layers if isinstance(frame, Frame) else ():
        yield _name_layer(layer.name), [layer.radiance]


def _add_normals(encoding: _Encoding, normal: FloatArray) -> None:
    """Add the normals of a band. Pixels that are black, or the gray that encodes 0, show no surface."""
    for part in (normal[::STRIDE, ::STRIDE], normal):
        if not (part.min() >= -MAX_ROUNDING_ERROR and part.max() <= 1.0 + MAX_ROUNDING_ERROR):
            encoding.is_possible = False
            return
    decoded = 2.0 * normal.astype(np.float64) - 1.0
    there = (normal != 0.0).any(axis=-1) & ~(np.abs(decoded) < 0.02).all(axis=-1)
    encoding.count += int(np.count_nonzero(there))
    encoding.plain += _count_unit(normal[there])
    encoding.decoded += _count_unit(decoded[there])


def _count_unit(normals: FloatArray) -> int:
    lengths = np.sqrt((normals.astype(np.float64) ** 2).sum(axis=-1))
    return int(np.count_nonzero(np.abs(lengths - 1.0) < MAX_LENGTH_ERROR))
