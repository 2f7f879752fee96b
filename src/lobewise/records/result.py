"""What a filter returns. Frozen, as what it takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.records.images import FloatArray, crop_columns, make_array, read_array, say_size


class Described:
    """A result whose facts can be told, such as `Result`."""

    def describe(self: Any) -> dict[str, Any]:
        """Return the facts of the result for JSON: size, method, settings, seconds, light, bad pixels and notes."""
        height, width = self.shape
        return {
            "width": width,
            "height": height,
            "method": self.method,
            "settings": self.settings,
            "seconds": self.seconds,
            "energy_lost": self.energy_lost,
            "bad_pixels": self.bad_pixel_count,
            "notes": list(self.notes),
            "unused": list(self.unused),
        }


@dataclass(frozen=True, repr=False)
class Result(Described):
    """A denoised frame. Its arrays have the type that the frame's color had: NumPy's, PyTorch's, JAX's, Dr.Jit's.

    Parameters
    ----------
    image : (height, width, 3)
        Denoised total radiance, linear, finite.
    diffuse, specular : (height, width, 3) or None
        The two filtered parts, with their albedo, where the frame gave them apart.
    weight_sum : (height, width)
        Sum of the filter weights; the smaller of the diffuse and the specular sum where the pixel reflects both. A tap
        that matches fully has weight 1.
    effective_samples : (height, width)
        ``(sum w)^2 / sum w^2``: number of equally weighted neighbours with the same variance, >= 1 where the filter
        gathered anything.
    bad_pixels : (height, width), bool
        Pixels that were NaN, infinite or far below the light around them, had weight 0 and were refilled.
    alpha : (height, width) or None
        Denoised opacity, in [0, 1], where the frame has one.
    variance : (height, width) or None
        Estimated variance of the image's luminance, where the image has a history.
    energy_lost : float
        Share of the light of the filtered layers that the result lacks, in [0, 1]. The light that bounding takes from
        fireflies is shared out over their layer, except the light of a few pixels that hold most of the layer's light.
        0 with the quality "fast", which does not measure it.
    layers : mapping of str to (height, width, 3)
        The filtered layers of a frame that has any, by name.
    also : mapping of str to (height, width, 3) or (height, width)
        The filtered images of ``Frame.also``; the images of ``Frame.unscattered`` that changed; and the parts of the
        layers, named ``layer/part``.
    settings : dict
        Every parameter that was used, with every "auto" replaced.
    seconds : float
        Wall time of the call.
    method : str
        The filters and networks that made the image, and their guides: one sentence without its full stop.
    notes : tuple of str
        Notes to the user, one sentence each: guides with values that no surface can have, and their replacement; light
        of fireflies that was shared out, where the noise does not explain how much.
    unused : tuple of str
        Images of the frame that change nothing with these settings.
    find_noisy : callable or None
        Returns the noisy radiance that was denoised, (height, width, 3), as long as somebody else holds it, else None.
        Pickled results have lost it.
    origin : object, optional
        ``Frame.origin`` of the frame that was denoised.
    """

    image: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray
    bad_pixels: NDArray[np.bool_]
    settings: dict[str, Any]
    seconds: float
    diffuse: FloatArray | None = None
    specular: FloatArray | None = None
    alpha: FloatArray | None = None
    variance: FloatArray | None = None
    energy_lost: float = 0.0
    method: str = ""
    layers: Mapping[str, FloatArray] = field(default_factory=dict)
    also: Mapping[str, FloatArray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    find_noisy: Callable[[], FloatArray | None] | None = field(default=None, compare=False)
    origin: object = field(default=None, compare=False)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.image.shape[0], self.image.shape[1]

    @property
    def bad_pixel_count(self) -> int:
        """How many pixels were refilled."""
        return int(np.count_nonzero(read_array("bad_pixels", self.bad_pixels)))

    def convert(self, maker: str = "") -> Result:
        """Return this result with arrays of another library, see `name_maker`; by default NumPy's."""

        def change(value: Any) -> Any:
            if isinstance(value, Mapping):
                return {name: change(each) for name, each in value.items()}
            return make_array(maker, read_array("result", value)) if hasattr(value, "__dlpack__") else value

        if isinstance(self.image, np.ndarray) and not maker:
            return self
        return replace(self, **{each.name: change(getattr(self, each.name)) for each in fields(self)})

    def subtract(self, other: Result) -> Result:
        """Return this result with the images of another subtracted, where both have them; the rest stays."""

        def take(first: FloatArray | None, second: FloatArray | None) -> FloatArray | None:
            return first if first is None or second is None else first - second

        def take_all(first: Mapping[str, FloatArray], second: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
            return {name: image - second[name] if name in second else image for name, image in first.items()}

        return replace(
            self,
            image=self.image - other.image,
            diffuse=take(self.diffuse, other.diffuse),
            specular=take(self.specular, other.specular),
            layers=take_all(self.layers, other.layers),
            also=take_all(self.also, other.also),
        )

    def crop_columns(self, width: int) -> Result:
        """Return the result of only the ``width`` columns in the middle."""
        if self.image.shape[1] == width:
            return self
        return replace(self, **{each.name: crop_columns(getattr(self, each.name), width) for each in fields(self)})

    def __repr__(self) -> str:
        images = [name for name in ("image", "diffuse", "specular", "variance") if getattr(self, name) is not None]
        named = [f"{name} {self.settings[name]}" for name in ("quality", "similarity") if name in self.settings]
        size = say_size((self.image.shape[0], self.image.shape[1]))
        parts = [*images, *named, f"{self.bad_pixel_count} bad pixels", f"{self.seconds:.3g} s"]
        return f"Result({size}{', '.join(parts)})"

    def _repr_html_(self) -> str:
        """Return the card that notebooks show: the noisy and the clean picture, and short facts."""
        from lobewise.display.cards import make_card

        noisy = self.find_noisy() if self.find_noisy else None
        pictures = {"noisy": noisy} if noisy is not None and noisy.shape == tuple(self.image.shape) else {}
        pictures["denoised"] = self.convert().image
        facts: list[tuple[str, str]] = []
        facts += [(name, str(self.settings[name])) for name in ("quality", "similarity") if name in self.settings]
        facts += [("method", self.method)] if self.method else []
        facts += [("bad pixels", str(self.bad_pixel_count))] if self.bad_pixel_count else []
        facts += [("time", f"{self.seconds:.3g} s")] if self.seconds else []
        facts += [("note", note) for note in self.notes]
        facts += [("unused", ", ".join(self.unused))] if self.unused else []
        height, width = self.image.shape[:2]
        return make_card(f"Result, {say_size((height, width))[:-2]}", pictures, facts)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "find_noisy": None}
