"""LobeField: the reflection lobe of every pixel of a G-buffer, ready for the image kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.chunks import Chunk, run_chunks
from lobewise.errors import InputError, MissingChannelError, describe_problem, require_choice
from lobewise.frame import FloatArray, GBuffer, LobeKind
from lobewise.lobes.brdf import MIN_WARP_COSINE
from lobewise.lobes.mixture import GGX_MIXTURES
from lobewise.lobes.tangent import (
    BECKMANN_LIMIT,
    GGX_LIMIT,
    Components,
    make_anisotropic_lobe,
    make_isotropic_lobe,
)
from lobewise.lobes.vectors import Array

NORMAL_ERROR = 1e-3
"""Standard deviation of the guides' normals, radians; a normal that is off by e turns the reflection by 2 e."""
MIN_COSINE = 0.01
"""Normals that face away from the viewer are bent until n.v is at least about this."""
GGX_SHARPNESS = GGX_MIXTURES[1][0][0]
"""Of the Gaussian nearest in L2 to ``(1 + q)^-2``, over that with its curvature at 0 (one lobe of the mixtures)."""
LAMBERT_SHARPNESS = 2.0
"""The similarity of two Lambert lobes falls as 1 - d^2 / 2 for small angles d, as that of two SGs of this sharpness."""


@dataclass(frozen=True)
class LobeField:
    """The reflection lobes of an image. What a representation does not need is None.

    Parameters
    ----------
    valid : (height, width), bool
        Whether the pixel has a lobe. Where not, the rest is finite and harmless: axes 0, sharpness 1, covariance 0,
        determinant 1.
    axis : (height, width, 3), float32
        ``sg``: mirror direction about the shading normal, unit length.
    sharpness : (height, width), float32
        ``sg``: band-limited sharpness of the single spherical Gaussian, inverse square radians.
    tangent_axis : (height, width, 3), float32
        ``ggx``, ``asg``: mirror direction about the dominant visible normal, unit length.
    covariance : (height, width, 6), float32
        ``ggx``, ``asg``: band-limited covariance across ``tangent_axis``: xx, xy, xz, yy, yz, zz, square radians.
    determinant : (height, width), float32
        ``ggx``, ``asg``: product of the two principal variances of ``covariance``.
    """

    valid: NDArray[np.bool_]
    axis: FloatArray | None = None
    sharpness: FloatArray | None = None
    tangent_axis: FloatArray | None = None
    covariance: FloatArray | None = None
    determinant: FloatArray | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return int(self.valid.shape[0]), int(self.valid.shape[1])


def default_tau(camera: Camera, height: int) -> float:
    """Return the band-limit in radians: the angle of a pixel and the error of the normals, added in square."""
    return float(np.hypot(camera.get_pixel_angle(height), 2.0 * NORMAL_ERROR))


def build_lobe_field(
    gbuffer: GBuffer,
    camera: Camera,
    *,
    tau: float | None = None,
    representation: str = "both",
    diffuse_fallback: bool = False,
    threads: int | None = None,
) -> LobeField:
    """Build the specular reflection lobe of every pixel.

    Parameters
    ----------
    gbuffer : GBuffer
        Needs ``normal``, ``alpha_u`` and one of ``position`` and ``depth``; ``tangent`` where ``alpha_v`` differs from
        ``alpha_u``. Without ``lobe_kind`` every surface has a GGX lobe.
    camera : Camera
        Where the view directions come from.
    tau : float, optional
        Band-limit in radians, ``1e-5 <= tau <= 1``: ``tau^2`` is added to the variance of every lobe, so that a mirror
        is finite. By default the angle of a pixel and twice 0.001 rad of normal error, added in square.
    representation : {"both", "sg", "ggx", "asg"}
        ``sg``: axis and sharpness (Tokuyoshi 2015 with the warp of Wang et al. 2009). ``ggx``: axis and covariance
        (see `lobewise.lobes.tangent`). ``both``: these two. ``asg``: the same axis, and the covariance of the Gaussian
        that is nearest in L2 to the lobe's shape, which for GGX is narrower by `GGX_SHARPNESS`.
    diffuse_fallback : bool
        Give surfaces of kind NONE the Lambert lobe (axis = normal, sharpness 2, variance 1/2) instead of none.
    threads : int, optional
        Worker threads; by default one per available core. The result is the same bits for any number.

    Returns
    -------
    LobeField
        Finite everywhere. A pixel whose guides are not finite is invalid, and so is one without surface or lobe.
        Normals need not have unit length. Normals that face away from the viewer are bent until they do not; roughness
        is clamped to [0, 1].

    Raises
    ------
    MissingChannelError
        If a channel is missing.
    InputError
        If ``tau``, ``threads`` or ``representation`` is out of range.
    """
    require_choice("representation", representation, ("both", "sg", "ggx", "asg"))
    if tau is None and gbuffer.shape is not None:
        tau = default_tau(camera, gbuffer.shape[0])
    check_lobe_guides(gbuffer, representation, tau)
    assert gbuffer.normal is not None and tau is not None  # checked just above; for the type checker
    height, width = gbuffer.normal.shape[:2]
    if threads is not None and threads < 1:
        raise InputError(
            describe_problem("threads", expected="at least 1", got=str(threads), action="leave it out for all cores")
        )
    builder = _Builder(gbuffer, camera, float(tau), representation, diffuse_fallback)
    run_chunks(builder.fill, height, width, threads)
    return builder.field


def check_lobe_guides(gbuffer: GBuffer, representation: str, tau: float | None) -> None:
    """Raise what `build_lobe_field` raises if a channel that it needs is missing, or ``tau`` is out of range."""

    def require(name: str, why: str, action: str) -> None:
        raise MissingChannelError(
            describe_problem(f"channel {name}", expected=f"it in the G-buffer ({why})", got="nothing", action=action)
        )

    if gbuffer.normal is None:
        require(
            "normal", "the lobe is a reflection about it", "render the shading normals, or choose no lobe similarity"
        )
    if gbuffer.alpha_u is None:
        require("alpha_u", "the lobe's width", "render the roughness, or choose the similarity 'normal'")
    if gbuffer.position is None and gbuffer.depth is None:
        require("position", "it or depth tells where a surface is", "render the position or the depth")
    if tau is not None and not 1e-5 <= tau <= 1.0:
        raise InputError(
            describe_problem("tau", expected="an angle from 1e-5 to 1 radian", got=str(tau), action="leave it out")
        )
    if representation == "sg" or gbuffer.tangent is not None or gbuffer.alpha_v is None:
        return
    if not np.array_equal(np.asarray(gbuffer.alpha_u), gbuffer.alpha_v, equal_nan=True):
        require(
            "tangent",
            "alpha_v differs from alpha_u, so the lobe has a direction",
            "render the tangents, leave alpha_v out, or choose the similarity 'sg'",
        )


def _split(image: Array) -> Components:
    return image[..., 0], image[..., 1], image[..., 2]


class _Builder:
    """Fills the arrays of a LobeField piece by piece; pieces do not depend on each other."""

    def __init__(
        self, gbuffer: GBuffer, camera: Camera, tau: float, representation: str, diffuse_fallback: bool
    ) -> None:
        self.gbuffer = gbuffer
        self.noise: Any = np.float32(tau) * np.float32(tau)
        self.diffuse_fallback = diffuse_fallback
        self.gaussian = representation == "asg"
        assert gbuffer.normal is not None
        height, width = gbuffer.normal.shape[:2]

        self.eye = camera.position.astype(np.float32)
        x, y = camera.get_plane(width, height)
        # the ray through a pixel is a part of its column and a part of its row
        self.ray_columns = (x[None, :] * camera.right[:, None]).astype(np.float32)
        self.ray_rows = (camera.forward[:, None] + y[None, :] * camera.up[:, None]).astype(np.float32)

        kind = gbuffer.lobe_kind
        self.has_beckmann = kind is not None and bool(np.any(kind == LobeKind.BECKMANN))
        self.has_delta = kind is not None and bool(np.any(kind == LobeKind.DELTA))
        alpha_v = gbuffer.alpha_v
        self.anisotropic = alpha_v is not None and not np.array_equal(
            np.asarray(gbuffer.alpha_u), alpha_v, equal_nan=True
        )

        def empty(*channels: int) -> FloatArray:
            return np.empty((height, width, *channels), np.float32)

        sg, ggx = representation in ("both", "sg"), representation != "sg"
        self.field = LobeField(
            valid=np.empty((height, width), np.bool_),
            axis=empty(3) if sg else None,
            sharpness=empty() if sg else None,
            tangent_axis=empty(3) if ggx else None,
            covariance=empty(6) if ggx else None,
            determinant=empty() if ggx else None,
        )

    def fill(self, chunk: Chunk) -> None:
        """Compute the pixels of ``chunk``."""
        with np.errstate(all="ignore"):  # garbage in a guide ends as a non-finite lobe, which is taken out at the end
            self._fill(chunk)

    def _fill(self, chunk: Chunk) -> None:
        gbuffer, field = self.gbuffer, self.field
        normal, surface = self._get_normal(chunk)
        view = self._get_view(chunk)
        normal, cosine = _face_viewer(normal, view)

        kind = None if gbuffer.lobe_kind is None else gbuffer.lobe_kind[chunk]
        alpha_u, alpha_v, known = self._get_alphas(chunk, kind)
        surface &= np.isfinite(cosine)
        finite = surface & known
        # any other non-finite guide shows in the axis or the width
        if field.axis is not None and field.sharpness is not None:
            finite = finite & self._fill_sg(chunk, normal, view, cosine, alpha_u, alpha_v)
        if field.covariance is not None:
            finite = finite & self._fill_ggx(chunk, normal, view, kind, alpha_u, alpha_v)
        specular = finite if kind is None else finite & (kind > 0.5) & (kind < 3.5)
        lambert = surface & (kind == LobeKind.NONE) if self.diffuse_fallback and kind is not None else None
        self._finish(chunk, normal, specular, lambert)

    def _get_normal(self, chunk: Chunk) -> tuple[Components, Any]:
        """Return the unit normal and where there is a surface."""
        assert self.gbuffer.normal is not None
        x, y, z = _split(self.gbuffer.normal[chunk])
        square = x * x + y * y + z * z
        # a normal averaged over an edge is short, but not a thousandth
        surface = (square > 1e-6) & (square < np.inf)
        if self.gbuffer.depth is not None:
            depth = self.gbuffer.depth[chunk]
            surface &= (depth > 0.0) & (depth < np.inf)
        inverse = np.float32(1.0) / np.sqrt(square)
        return (x * inverse, y * inverse, z * inverse), surface

    def _get_alphas(self, chunk: Chunk, kind: FloatArray | None) -> tuple[Array, Array, Any]:
        """Return both alphas, in [0, 1] and 0 for mirrors, and where they are numbers."""
        zero, one = np.float32(0.0), np.float32(1.0)
        delta = kind == LobeKind.DELTA if self.has_delta else None

        def get(image: FloatArray | None) -> tuple[Array, Any]:
            assert image is not None
            values = image[chunk] if delta is None else np.where(delta, zero, image[chunk])
            return np.clip(values, zero, one), np.isfinite(values)

        alpha_u, finite = get(self.gbuffer.alpha_u)
        if not self.anisotropic:
            return alpha_u, alpha_u, finite
        alpha_v, finite_v = get(self.gbuffer.alpha_v)
        return alpha_u, alpha_v, finite & finite_v

    def _get_view(self, chunk: Chunk) -> Components:
        """Return the unit direction from the surface to the eye."""
        rows, columns = chunk
        if self.gbuffer.position is not None:
            position = self.gbuffer.position[chunk]
            x, y, z = (self.eye[k] - position[..., k] for k in range(3))
        else:
            x, y, z = (-self.ray_columns[k][None, columns] - self.ray_rows[k][rows, None] for k in range(3))
        inverse = np.float32(1.0) / np.sqrt(x * x + y * y + z * z)
        inverse = np.where(inverse > 0.0, inverse, np.float32(np.nan))  # so far away that its square overflows
        return x * inverse, y * inverse, z * inverse

    def _fill_sg(
        self,
        chunk: Chunk,
        normal: Components,
        view: Components,
        cosine: Array,
        alpha_u: Array,
        alpha_v: Array,
    ) -> Any:
        assert self.field.axis is not None
        assert self.field.sharpness is not None
        axis, sharpness = self.field.axis[chunk], self.field.sharpness[chunk]
        twice = cosine + cosine
        np.subtract(twice * normal[0], view[0], out=axis[..., 0])
        np.subtract(twice * normal[1], view[1], out=axis[..., 1])
        np.subtract(twice * normal[2], view[2], out=axis[..., 2])
        # normals of sharpness 2 / alpha^2, the reflection's Jacobian 4 n.v, and the band-limit
        variance = 2.0 * np.maximum(cosine, np.float32(MIN_WARP_COSINE)) * (alpha_u * alpha_v) + self.noise
        np.divide(np.float32(1.0), variance, out=sharpness)
        return np.isfinite(axis[..., 0] + axis[..., 1] + axis[..., 2] + variance)

    def _fill_ggx(
        self,
        chunk: Chunk,
        normal: Components,
        view: Components,
        kind: FloatArray | None,
        alpha_u: Array,
        alpha_v: Array,
    ) -> Any:
        one, limit = np.float32(1.0), np.float32(GGX_LIMIT)
        if self.anisotropic:
            tangent, bitangent, known = self._get_tangent(chunk, normal)
            if not known.all():  # without a direction only the area of the lobe is known
                mean = np.sqrt(alpha_u * alpha_v)
                alpha_u, alpha_v = np.where(known, alpha_u, mean), np.where(known, alpha_v, mean)
        deficit_u: Any = one - alpha_u * alpha_u
        deficit_v: Any = one - alpha_v * alpha_v if self.anisotropic else deficit_u
        limits: Any = limit
        if self.has_beckmann:
            beckmann = kind == LobeKind.BECKMANN
            deficit_u, deficit_v = np.where(beckmann, one, deficit_u), np.where(beckmann, one, deficit_v)
            limits = np.where(beckmann, np.float32(BECKMANN_LIMIT), limit)
        sharper: Any = np.float32(GGX_SHARPNESS if self.gaussian else 1.0)
        if self.gaussian and self.has_beckmann:
            sharper = np.where(kind == LobeKind.BECKMANN, one, sharper)
        # What is scaled afterwards holds the band-limit, which must not be.
        noise = sharper * self.noise
        if self.anisotropic:
            axis, covariance, determinant = make_anisotropic_lobe(
                tangent, bitangent, normal, view, alpha_u, alpha_v, deficit_u, deficit_v, limits, noise
            )
        else:
            axis, covariance, determinant = make_isotropic_lobe(normal, view, alpha_u, deficit_u, limits, noise)
        field = self.field
        assert field.tangent_axis is not None
        assert field.covariance is not None
        assert field.determinant is not None
        for k in range(3):
            field.tangent_axis[(*chunk, k)] = axis[k]
        for k in range(6):
            field.covariance[(*chunk, k)] = covariance[k] / sharper if self.gaussian else covariance[k]
        field.determinant[chunk] = determinant / (sharper * sharper)
        return np.isfinite(axis[0] + axis[1] + axis[2] + determinant)

    def _get_tangent(self, chunk: Chunk, normal: Components) -> tuple[Components, Components, Any]:
        """Return the tangent made perpendicular to the normal, the bitangent, and where the G-buffer has a tangent.

        Elsewhere the tangent is any vector perpendicular to the normal.
        """
        assert self.gbuffer.tangent is not None
        nx, ny, nz = normal
        x, y, z = _split(self.gbuffer.tangent[chunk])
        along = x * nx + y * ny + z * nz
        x, y, z = x - along * nx, y - along * ny, z - along * nz
        square = x * x + y * y + z * z
        known = (square > 1e-8) & (square < 1e8)
        if not known.all():
            flat = np.abs(nz) < 0.7
            x, y, z = (
                np.where(known, x, flat * -ny),
                np.where(known, y, flat * nx - ~flat * nz),
                np.where(known, z, ~flat * ny),
            )
            square = x * x + y * y + z * z
        inverse = np.float32(1.0) / np.sqrt(square)
        x, y, z = x * inverse, y * inverse, z * inverse
        return (x, y, z), (ny * z - nz * y, nz * x - nx * z, nx * y - ny * x), known

    def _finish(self, chunk: Chunk, normal: Components, specular: Any, lambert: Any) -> None:
        """Write the mask, the Lambert lobes and the harmless values of the pixels that have none."""
        field = self.field
        valid = specular if lambert is None else specular | lambert
        field.valid[chunk] = valid
        if lambert is not None and lambert.any():
            self._write_lambert(chunk, normal, lambert)
        if valid.all():
            return
        none = ~valid
        for values, harmless in (
            (field.axis, 0.0),
            (field.sharpness, 1.0),
            (field.tangent_axis, 0.0),
            (field.covariance, 0.0),
            (field.determinant, 1.0),
        ):
            if values is not None:
                values[chunk][none] = harmless

    def _write_lambert(self, chunk: Chunk, normal: Components, lambert: Any) -> None:
        field = self.field
        axis = np.stack([component[lambert] for component in normal], axis=-1)
        if field.axis is not None and field.sharpness is not None:
            field.axis[chunk][lambert] = axis
            field.sharpness[chunk][lambert] = LAMBERT_SHARPNESS
        if field.tangent_axis is not None and field.covariance is not None and field.determinant is not None:
            variance = np.float32(1.0 / LAMBERT_SHARPNESS)
            x, y, z = axis.T
            field.tangent_axis[chunk][lambert] = axis
            field.covariance[chunk][lambert] = variance * np.stack(
                [1.0 - x * x, -x * y, -x * z, 1.0 - y * y, -y * z, 1.0 - z * z], axis=-1
            )
            field.determinant[chunk][lambert] = variance * variance


def _face_viewer(normal: Components, view: Components) -> tuple[Components, Array]:
    """Return normals bent towards the viewer until n.v is at least about `MIN_COSINE`, and n.v."""
    cosine = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2]
    floor = np.float32(MIN_COSINE)
    if not (cosine < floor).any():
        return normal, cosine
    lift = np.maximum(floor - cosine, np.float32(0.0))
    # |n + lift v|^2 = 1 + lift (2 cosine + lift) and its cosine is cosine + lift
    x, y, z = (normal[k] + lift * view[k] for k in range(3))
    inverse = np.float32(1.0) / np.sqrt(x * x + y * y + z * z)
    inverse = np.where(lift > 0.0, inverse, np.float32(1.0))
    return (x * inverse, y * inverse, z * inverse), (cosine + lift) * inverse
