"""MixtureField: the lobes of every pixel of a G-buffer as a sum of spherical Gaussians, ready for the image kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.chunks import Chunk, run_chunks
from lobewise.errors import InputError, describe_problem
from lobewise.frame import FloatArray, GBuffer, LobeKind
from lobewise.lobe_table import LobeTable
from lobewise.lobes.field import LobeField, build_lobe_field
from lobewise.lobes.mixture import LAMBERT_AMPLITUDE, LAMBERT_SHARPNESS, spread_ggx_mixture
from lobewise.lobes.sg import sg_integral
from lobewise.lobes.table import evaluate_table
from lobewise.lobes.vectors import LUMINANCE, Array, normalize


@dataclass(frozen=True)
class MixtureField:
    """The reflection lobes of an image, N for every pixel.

    Parameters
    ----------
    valid : (height, width), bool
        Whether the pixel has a lobe. Where not, axes are 0, sharpnesses 1 and amplitudes 0.
    axis : (height, width, 3) or (height, width, 3 N), float32
        Unit lobe axes; one where the lobes of every pixel share it.
    sharpness : (height, width, N), float32
        Band-limited, inverse square radians.
    amplitude : (height, width, N), float32
        Value at the axis, 1/sr; 0 for a lobe that is absent.
    """

    valid: NDArray[np.bool_]
    axis: FloatArray
    sharpness: FloatArray
    amplitude: FloatArray


def build_mixture_field(
    gbuffer: GBuffer,
    camera: Camera,
    *,
    tau: float,
    lobes: int = 3,
    lobe_tables: Sequence[LobeTable] = (),
    diffuse: bool = False,
    threads: int | None = None,
) -> MixtureField:
    """Build the lobes of every pixel.

    A GGX surface has ``lobes`` lobes about its mirror direction (`lobewise.lobes.mixture.GGX_MIXTURES`), a Beckmann
    surface and a mirror one, a material with a lobe table those of the table. Their integrals are the specular albedo,
    where the G-buffer has it.

    Parameters
    ----------
    gbuffer, camera
        See `lobewise.lobes.field.build_lobe_field`.
    tau : float
        Band-limit, radians: ``tau^2`` is added to the variance of every lobe and its integral kept.
    lobes : {1, 2, 3, 4}
        Of a GGX surface; at most 3 with ``diffuse``.
    lobe_tables : sequence of LobeTable
        What ``gbuffer.material`` counts from 1.
    diffuse : bool
        Add the diffuse lobe, of integral ``gbuffer.diffuse_albedo``, for radiance that holds both. Without it, surfaces
        that have no specular lobe get the diffuse one alone.
    threads : int, optional
        Worker threads; by default one per available core. The result is the same bits for any number.

    Returns
    -------
    MixtureField

    Raises
    ------
    MissingChannelError
        If a channel is missing.
    InputError
        If ``tau``, ``lobes`` or ``threads`` is out of range.
    """
    most = 3 if diffuse else 4
    if isinstance(lobes, bool) or lobes not in range(1, most + 1):
        raise InputError(
            describe_problem(
                "lobes of a mixture",
                expected=f"an integer from 1 to {most}",
                got=repr(lobes),
                action="3 stand for GGX within 1 %; one more is diffuse where radiances are not apart",
            )
        )
    single = build_lobe_field(
        gbuffer, camera, tau=tau, representation="sg", diffuse_fallback=not diffuse, threads=threads
    )
    builder = _Builder(gbuffer, camera, tau, lobes, tuple(lobe_tables), diffuse, single)
    height, width = single.shape
    run_chunks(builder.fill, height, width, threads)
    return builder.field


def _sum_luminance(albedo: FloatArray) -> Array:
    return np.asarray(sum(weight * albedo[..., k] for k, weight in enumerate(LUMINANCE)), dtype=np.float32)


class _Builder:
    """Fills the arrays of a MixtureField piece by piece."""

    def __init__(
        self,
        gbuffer: GBuffer,
        camera: Camera,
        tau: float,
        lobes: int,
        tables: tuple[LobeTable, ...],
        diffuse: bool,
        single: LobeField,
    ) -> None:
        self.gbuffer, self.camera = gbuffer, camera
        self.noise = np.float32(tau * tau)
        self.lobes = lobes
        self.tables = tables if gbuffer.material is not None else ()
        self.diffuse = diffuse and gbuffer.diffuse_albedo is not None
        self.single = single
        height, width = single.shape
        specular = max([lobes, *(table.axis.shape[2] for table in self.tables)])
        if specular + self.diffuse > 4:
            raise InputError(
                describe_problem(
                    "lobes of a mixture",
                    expected="at most 4 for a pixel, the diffuse one included",
                    got=f"{specular + self.diffuse}",
                    action="fit the materials with fewer lobes, or render diffuse and specular radiance apart",
                )
            )
        count = specular + self.diffuse
        self.coaxial = not self.tables and not self.diffuse
        self.rays = None
        if self.tables and gbuffer.position is None:
            self.rays = camera.make_ray_directions(width, height)
        self.field = MixtureField(
            valid=np.empty((height, width), np.bool_),
            axis=np.zeros((height, width, 3 if self.coaxial else 3 * count), np.float32),
            sharpness=np.ones((height, width, count), np.float32),
            amplitude=np.zeros((height, width, count), np.float32),
        )

    def fill(self, chunk: Chunk) -> None:
        """Compute the pixels of ``chunk``."""
        with np.errstate(all="ignore"):  # what is garbage is not valid, and taken out at the end
            self._fill_parametric(chunk)
            for number, table in enumerate(self.tables):
                self._fill_table(chunk, number, table)
            valid = self.single.valid[chunk]
            if self.diffuse:
                valid = valid | self._fill_diffuse(chunk)
        field = self.field
        field.valid[chunk] = valid & np.isfinite(field.axis[chunk].sum(-1) + field.amplitude[chunk].sum(-1))
        none = ~field.valid[chunk]
        if none.any():
            for values, harmless in ((field.axis, 0.0), (field.sharpness, 1.0), (field.amplitude, 0.0)):
                values[chunk][none] = harmless

    def _fill_parametric(self, chunk: Chunk) -> None:
        """The universal mixture about the axis of the single lobe, whose variance tells the area."""
        single, gbuffer, field = self.single, self.gbuffer, self.field
        assert single.axis is not None and single.sharpness is not None and gbuffer.alpha_u is not None
        area = np.maximum(np.float32(1.0) / single.sharpness[chunk] - self.noise, np.float32(0.0))
        alpha_v = gbuffer.alpha_u if gbuffer.alpha_v is None else gbuffer.alpha_v
        square = np.clip(gbuffer.alpha_u[chunk] * alpha_v[chunk], np.float32(0.0), np.float32(1.0))
        albedo = np.ones_like(square)
        if gbuffer.specular_albedo is not None:
            albedo = _sum_luminance(gbuffer.specular_albedo[chunk])
        lobes = slice(0, self.lobes)
        field.sharpness[chunk][..., lobes], field.amplitude[chunk][..., lobes] = spread_ggx_mixture(
            area, square, albedo, lobes=self.lobes, noise=float(self.noise)
        )
        for k in range(1 if self.coaxial else self.lobes):
            field.axis[chunk][..., 3 * k : 3 * k + 3] = single.axis[chunk]
        if gbuffer.lobe_kind is None:
            return
        kind = gbuffer.lobe_kind[chunk]
        # Beckmann, mirrors and, in place of a missing lobe, the diffuse one are each a single Gaussian already.
        alone = kind != LobeKind.GGX
        if alone.any():
            sharpness = single.sharpness[chunk][alone]
            scale = np.where(kind[alone] == LobeKind.NONE, np.float32(1.0), albedo[alone])
            field.sharpness[chunk][..., 0][alone] = sharpness
            field.amplitude[chunk][..., 0][alone] = scale / sg_integral(sharpness)
            field.amplitude[chunk][..., 1 : self.lobes][alone] = 0.0

    def _fill_table(self, chunk: Chunk, number: int, table: LobeTable) -> None:
        """Replace the lobes of the pixels that show the table's material."""
        gbuffer, field = self.gbuffer, self.field
        assert gbuffer.material is not None and gbuffer.normal is not None
        here = self.single.valid[chunk] & (gbuffer.material[chunk] == number + 1)
        if not here.any():
            return
        normal = normalize(gbuffer.normal[chunk][here])
        if gbuffer.position is not None:
            view = normalize(self.camera.position.astype(np.float32) - gbuffer.position[chunk][here])
        else:
            assert self.rays is not None
            view = -self.rays[chunk][here]
        tangent = None
        if table.azimuth.size > 1:
            assert gbuffer.tangent is not None
            tangent = gbuffer.tangent[chunk][here]
        found = evaluate_table(table, normal, view, tangent)
        # The spherical Gaussian of the same area as an anisotropic one has twice its mean sharpness.
        sharpness = 2.0 * np.sqrt(found.sharpness[..., 0] * found.sharpness[..., 1])
        limited = sharpness / (1.0 + self.noise * sharpness)
        count = sharpness.shape[-1]
        axis = np.zeros((len(normal), field.axis.shape[2]), np.float32)
        axis[:, : 3 * count] = found.axis.reshape(len(normal), -1)
        both = np.ones((2, len(normal), field.sharpness.shape[2]), np.float32)
        both[0, :, :count] = limited
        both[1] = 0.0
        both[1, :, :count] = found.amplitude * limited / sharpness
        field.axis[chunk][here], field.sharpness[chunk][here], field.amplitude[chunk][here] = axis, both[0], both[1]

    def _fill_diffuse(self, chunk: Chunk) -> NDArray[np.bool_]:
        """Put the diffuse lobe last; return where there is one."""
        gbuffer, field = self.gbuffer, self.field
        assert gbuffer.diffuse_albedo is not None and gbuffer.normal is not None
        albedo = _sum_luminance(gbuffer.diffuse_albedo[chunk])
        x, y, z = (gbuffer.normal[chunk][..., k] for k in range(3))
        square = x * x + y * y + z * z
        there = (albedo > 0.0) & (albedo < np.inf) & (square > 1e-6) & (square < np.inf)
        inverse = np.float32(1.0) / np.sqrt(square)
        for k, component in enumerate((x, y, z)):
            field.axis[chunk][..., -3 + k] = np.where(there, component * inverse, 0.0)
        field.sharpness[chunk][..., -1] = LAMBERT_SHARPNESS
        field.amplitude[chunk][..., -1] = np.where(there, albedo * np.float32(LAMBERT_AMPLITUDE / np.pi), 0.0)
        # A pixel without specular lobe has the diffuse one alone.
        none = ~self.single.valid[chunk]
        if none.any():
            field.axis[chunk][..., :-3][none] = 0.0
            field.sharpness[chunk][..., :-1][none] = 1.0
            field.amplitude[chunk][..., :-1][none] = 0.0
        return np.asarray(there)
