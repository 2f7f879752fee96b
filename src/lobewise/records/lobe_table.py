"""LobeTable: the reflection of one material as lobes for a grid of view directions."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError, require_choice
from lobewise.settings import MAX_LOBES

KINDS = ("sg", "asg")
"""Kinds of lobes: isotropic or anisotropic spherical Gaussians."""
MAX_UNIT_ERROR = 1e-3
"""Largest difference between the length of a stored axis and 1. Axes may be written with four digits."""
MAX_SG_DIFFERENCE = 1e-5
"""Largest relative difference between the two sharpnesses of an isotropic lobe: float32 rounding."""

_VIEWS = ("views", "azimuths")
_SHAPES: dict[str, tuple[str, ...]] = {
    "axis": (*_VIEWS, "lobes", "3"),
    "sharpness": (*_VIEWS, "lobes", "2"),
    "twist": (*_VIEWS, "lobes"),
    "amplitude": (*_VIEWS, "lobes"),
    "alpha": (*_VIEWS, "2"),
    "albedo": (*_VIEWS, "3"),
    "cosine_l2": _VIEWS,
}


@dataclass(frozen=True, eq=False, repr=False)
class LobeTable:
    """The BRDF of a material times the cosine, as a sum of at most four lobes for each view direction of a grid.

    A lobe is ``a max(w.z, 0) exp(-l (w.x)^2 - m (w.y)^2)`` (Xu et al. 2013). In a table of kind ``sg`` it is the
    spherical Gaussian ``a exp(2 l (w.z - 1))``, which near its axis agrees with the former for ``l = m``. The sum of
    the lobes approximates ``brdf * max(n.w, 0)`` in 1/sr, as luminance.

    Directions are in the view-aligned frame: z is the normal and the view is ``(sin t, 0, cos t)``, so that the plane
    of incidence is y = 0. A lobe's z is its axis. Its x is the frame's y, projected across the axis, normalised, and
    turned about the axis by ``twist`` (counter-clockwise, seen against the axis). Its y is ``z cross x``. With
    ``twist = 0`` and the axis in the plane of incidence, l is the sharpness across that plane and m the sharpness in
    it. The frame is continuous except at an axis along y, and no lobe of a reflection has such an axis.

    Arrays are kept as read-only float32. Sizes: V views, P azimuths, N lobes (1 to 4).

    Parameters
    ----------
    name : str
        Name of the material.
    kind : {"sg", "asg"}
        With ``sg`` both sharpnesses of every lobe are equal.
    cosine : (V,)
        n.v of the views, ascending, in (0, 1].
    azimuth : (P,)
        Azimuths of the views about the normal, from the tangent, counter-clockwise, radians: ascending, in [0, 2 pi).
        A table with one azimuth is isotropic, and the value of the azimuth has no meaning.
    axis : (V, P, N, 3)
        Unit vectors.
    sharpness : (V, P, N, 2)
        ``(l, m)``, above 0, inverse square radians.
    twist : (V, P, N)
        Radians.
    amplitude : (V, P, N)
        Value at the axis, >= 0, 1/sr; at every view at least one amplitude is above 0.
    alpha : (V, P, 2)
        Roughness of the anisotropic GGX whose reflected lobe has the shape of the best single lobe at that view: in the
        plane of incidence (along the view-aligned x) and across it. In (0, 1].
    albedo : (V, P, 3)
        Directional albedo, linear RGB, >= 0; that of measured materials may be slightly above 1.
    cosine_l2 : (V, P)
        Cosine between the sum of the lobes and the data in the space of square-integrable functions, in [0, 1].

    Raises
    ------
    InputError
        If an array has a wrong shape, or a value is out of range.
    """

    name: str
    kind: str
    cosine: NDArray[np.float32]
    azimuth: NDArray[np.float32]
    axis: NDArray[np.float32]
    sharpness: NDArray[np.float32]
    twist: NDArray[np.float32]
    amplitude: NDArray[np.float32]
    alpha: NDArray[np.float32]
    albedo: NDArray[np.float32]
    cosine_l2: NDArray[np.float32]

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise _complain("name", "text", type(self.name).__name__)
        require_choice("kind of lobes", self.kind, KINDS)
        for item in fields(self):
            if item.name not in ("name", "kind"):
                object.__setattr__(self, item.name, _as_floats(item.name, getattr(self, item.name)))
        self._check_shapes()
        self._check_ranges()

    def _check_shapes(self) -> None:
        for name in ("cosine", "azimuth"):
            grid = getattr(self, name)
            if grid.ndim != 1 or grid.size == 0:
                raise _complain(name, "a list of at least one number", f"shape {grid.shape}")
        lobes = self.axis.shape[2] if self.axis.ndim == 4 else 0
        if not 1 <= lobes <= MAX_LOBES:
            raise _complain(
                "axis", f"shape (views, azimuths, lobes, 3) with 1 to {MAX_LOBES} lobes", f"shape {self.axis.shape}"
            )
        sizes = {"views": self.cosine.size, "azimuths": self.azimuth.size, "lobes": lobes, "2": 2, "3": 3}
        for name, axes in _SHAPES.items():
            expected = tuple(sizes[axis] for axis in axes)
            if getattr(self, name).shape != expected:
                raise _complain(name, f"shape {expected} ({', '.join(axes)})", f"shape {getattr(self, name).shape}")

    def _check_ranges(self) -> None:
        # Every comparison fails for NaN.
        if not (np.all(np.diff(self.cosine) > 0.0) and self.cosine[0] > 0.0 and self.cosine[-1] <= 1.0):
            raise _complain("cosine", "ascending numbers above 0 and at most 1", _say_range(self.cosine))
        # 2 pi would be azimuth 0 again. Compare in the precision of the array.
        turn = np.float32(2.0 * math.pi)
        if not (np.all(np.diff(self.azimuth) > 0.0) and self.azimuth[0] >= 0.0 and self.azimuth[-1] < turn):
            raise _complain("azimuth", "ascending angles from 0 to below 2 pi", _say_range(self.azimuth))
        length = np.linalg.norm(self.axis.astype(np.float64), axis=-1)
        if not np.all(np.abs(length - 1.0) <= MAX_UNIT_ERROR):
            raise _complain("axis", "unit vectors", f"lengths {_say_range(length)}")
        for name, (good, words) in {
            "sharpness": ((self.sharpness > 0.0) & (self.sharpness < np.inf), "finite numbers above 0"),
            "twist": (np.isfinite(self.twist), "finite angles"),
            "amplitude": ((self.amplitude >= 0.0) & (self.amplitude < np.inf), "finite numbers >= 0"),
            "alpha": ((self.alpha > 0.0) & (self.alpha <= 1.0), "numbers above 0 and at most 1"),
            "albedo": ((self.albedo >= 0.0) & (self.albedo < np.inf), "finite numbers >= 0"),
            "cosine_l2": ((self.cosine_l2 >= 0.0) & (self.cosine_l2 <= 1.0), "numbers from 0 to 1"),
        }.items():
            if not np.all(good):
                raise _complain(name, words, _say_range(getattr(self, name)))
        if not np.all(self.amplitude.max(axis=-1) > 0.0):
            raise _complain("amplitude", "a lobe above 0 at every view", "a view whose lobes are all 0")
        across, along = self.sharpness[..., 0], self.sharpness[..., 1]
        if self.kind == "sg" and not np.all(np.abs(across - along) <= MAX_SG_DIFFERENCE * along):
            raise _complain("sharpness", "equal sharpnesses in a table of kind sg", "lobes with two different ones")

    def __repr__(self) -> str:
        counts = f"{self.lobe_count} {self.kind} lobes, {self.cosine.size} views, {self.azimuth.size} azimuths"
        return f"LobeTable({self.name!r}: {counts})"

    @property
    def lobe_count(self) -> int:
        """Number of lobes of every view, 1 to 4."""
        return int(self.axis.shape[2])

    @property
    def is_isotropic(self) -> bool:
        """Whether the lobes do not depend on the azimuth of the view."""
        return self.azimuth.size == 1


def _as_floats(name: str, value: object) -> NDArray[np.float32]:
    """Return a copy of ``value`` as a read-only C-contiguous float32 array."""
    try:
        array = np.array(value)
        if array.dtype.kind not in "fiu":
            raise ValueError(f"an array of {array.dtype}")
    except ValueError as problem:
        raise _complain(name, "an array of real numbers", str(problem)) from None
    with np.errstate(over="ignore"):
        out = np.array(array, dtype=np.float32, order="C")
    out.flags.writeable = False
    return out


def _say_range(values: NDArray[np.floating]) -> str:
    return f"values from {float(np.min(values)):g} to {float(np.max(values)):g}"


def _complain(name: str, expected: str, got: str) -> InputError:
    return InputError(f"lobe table: {name}", expected=expected, got=got, action="correct the table or fit it again")
