"""LobeTable: the reflection of one material as lobes over the viewing angle. Checked once, then frozen."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError, require_choice
from lobewise.settings import MAX_LOBES

KINDS = ("sg", "asg")
"""Spherical Gaussians, as sharp in every direction about their axis, or anisotropic ones."""
UNIT_TOLERANCE = 1e-3
"""How far the length of a stored axis may be from 1: what four written digits leave."""
SG_TOLERANCE = 1e-5
"""Relative difference that the two sharpnesses of a spherical Gaussian may have: rounding of float32."""

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
    """What a material reflects, times the cosine, as a sum of at most four lobes for each of some views.

    A lobe is ``a max(w.z, 0) exp(-l (w.x)^2 - m (w.y)^2)`` (Xu et al. 2013), or in a table of kind ``sg`` the
    spherical Gaussian ``a exp(2 l (w.z - 1))``, which near its axis is the same with ``l = m``. Their sum stands for
    ``brdf * max(n.w, 0)`` in 1/sr, as luminance.

    Directions are in the view-aligned frame: z is the normal and the view is ``(sin t, 0, cos t)``, so that the plane
    of incidence is y = 0. A lobe's z is its axis; its x is the part of the frame's y across the axis, made unit length
    and turned about the axis by ``twist`` (counter-clockwise seen against the axis); its y is ``z cross x``. With
    ``twist = 0`` and the axis in the plane of incidence, l is the sharpness across that plane and m the one in it.
    This stays continuous wherever the axis is not along y itself, where no lobe of a reflection lies.

    Arrays are kept as read-only float32. Sizes: V views, P azimuths, N lobes (1 to 4).

    Parameters
    ----------
    name : str
        What the material is called.
    kind : {"sg", "asg"}
        With ``sg`` both sharpnesses of every lobe are equal.
    cosine : (V,)
        n.v of the views, ascending, in (0, 1].
    azimuth : (P,)
        Azimuths of the views about the normal, from the tangent, counter-clockwise, radians: ascending, in [0, 2 pi).
        One azimuth: the material is isotropic, and the value has no meaning.
    axis : (V, P, N, 3)
        Unit vectors.
    sharpness : (V, P, N, 2)
        ``(l, m)``, above 0, inverse square radians.
    twist : (V, P, N)
        Radians.
    amplitude : (V, P, N)
        Value at the axis, >= 0, 1/sr; at every view one of them is above 0.
    alpha : (V, P, 2)
        Roughness of the anisotropic GGX whose reflected lobe has the shape of the best single lobe at that view:
        along the view-aligned x, that is in the plane of incidence, and across it. In (0, 1].
    albedo : (V, P, 3)
        Directional albedo, linear RGB, >= 0; measured materials may exceed 1 a little.
    cosine_l2 : (V, P)
        Cosine between the sum of the lobes and the data in the space of square-integrable functions, in [0, 1].

    Raises
    ------
    InputError
        If an array has another shape, or a value out of its range.
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
        # Written so that a NaN fails.
        if not (np.all(np.diff(self.cosine) > 0.0) and self.cosine[0] > 0.0 and self.cosine[-1] <= 1.0):
            raise _complain("cosine", "ascending numbers above 0 and at most 1", _say_range(self.cosine))
        # 2 pi itself would be azimuth 0 again; it is compared in the arrays' own precision.
        turn = np.float32(2.0 * math.pi)
        if not (np.all(np.diff(self.azimuth) > 0.0) and self.azimuth[0] >= 0.0 and self.azimuth[-1] < turn):
            raise _complain("azimuth", "ascending angles from 0 to below 2 pi", _say_range(self.azimuth))
        length = np.linalg.norm(self.axis.astype(np.float64), axis=-1)
        if not np.all(np.abs(length - 1.0) <= UNIT_TOLERANCE):
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
        if self.kind == "sg" and not np.all(np.abs(across - along) <= SG_TOLERANCE * along):
            raise _complain("sharpness", "equal sharpnesses in a table of kind sg", "lobes with two different ones")

    def __repr__(self) -> str:
        counts = f"{self.lobe_count} {self.kind} lobes, {self.cosine.size} views, {self.azimuth.size} azimuths"
        return f"LobeTable({self.name!r}: {counts})"

    @property
    def lobe_count(self) -> int:
        """Number of lobes at every view, 1 to 4."""
        return int(self.axis.shape[2])

    @property
    def is_isotropic(self) -> bool:
        """Whether the lobes do not depend on the azimuth of the view."""
        return self.azimuth.size == 1


def _as_floats(name: str, value: object) -> NDArray[np.float32]:
    """Return ``value`` as a read-only C-contiguous float32 array of its own."""
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
