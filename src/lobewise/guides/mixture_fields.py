"""The reflection lobes of every pixel of a frame as a sum of spherical Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import HALIDE
from lobewise.backend.pointwise import Grid, Vector
from lobewise.camera import Camera
from lobewise.chunks import Chunk, run_chunks
from lobewise.errors import InputError
from lobewise.fitting.arrays import Array, normalize
from lobewise.fitting.table import evaluate_table
from lobewise.frame import FloatArray, GBuffer, LobeKind
from lobewise.guides.lobe_fields import SgField, define_lobes, make_sg_field
from lobewise.lobe_table import LobeTable
from lobewise.lobes.gaussian import integrate_gaussian
from lobewise.lobes.mixture import LAMBERT_AMPLITUDE, LAMBERT_SHARPNESS, spread_ggx_mixture
from lobewise.lobes.numbers import NUMPY_SINGLE
from lobewise.lobes.vectors import LUMINANCE
from lobewise.settings import MAX_LOBES


@dataclass(frozen=True)
class MixtureField:
    """The reflection lobes of an image, N lobes for every pixel.

    Parameters
    ----------
    valid : (height, width), bool
        Whether the pixel has a lobe. A pixel without one has axes 0, sharpnesses 1 and amplitudes 0.
    axis : (height, width, 3) or (height, width, 3 N), float32
        Unit axes: one per lobe, or a single one if all lobes of each pixel have the same axis.
    sharpness : (height, width, N), float32
        Band-limited, inverse square radians.
    amplitude : (height, width, N), float32
        Value along the axis, 1/sr; 0 for an absent lobe.
    """

    valid: NDArray[np.bool_]
    axis: FloatArray
    sharpness: FloatArray
    amplitude: FloatArray


def make_mixture_field(
    gbuffer: GBuffer,
    camera: Camera,
    *,
    tau: float,
    lobes: int = 3,
    lobe_tables: Sequence[LobeTable] = (),
    diffuse: bool = False,
) -> MixtureField:
    """Return the lobes of every pixel.

    A GGX surface has ``lobes`` lobes about its mirror direction (`lobewise.lobes.mixture.GGX_MIXTURES`). A Beckmann
    surface and a mirror have one lobe. A material with a lobe table has the lobes of the table. The lobes integrate to
    the specular albedo if the G-buffer has it, and otherwise to 1.

    Parameters
    ----------
    gbuffer, camera
        See `lobewise.guides.lobe_fields.make_sg_field`.
    tau : float
        Band-limit, radians: ``tau^2`` is added to the variance of every lobe; its integral does not change.
    lobes : {1, 2, 3, 4}
        Number of lobes of a GGX surface; at most 3 with ``diffuse``.
    lobe_tables : sequence of LobeTable
        ``gbuffer.material`` holds indices into this sequence, counted from 1.
    diffuse : bool
        Add the diffuse lobe, with the integral ``gbuffer.diffuse_albedo``. It is needed if the radiance holds both
        diffuse and specular light. If False, only surfaces without a specular lobe get the diffuse lobe.

    Returns
    -------
    MixtureField

    Raises
    ------
    MissingChannelError
        If a channel is missing.
    InputError
        If ``tau`` or ``lobes`` is out of range.
    """
    tables = tuple(lobe_tables) if gbuffer.material is not None else ()
    diffuse_lobes = int(diffuse and gbuffer.diffuse_albedo is not None)
    count = _count_lobes(lobes, tables, diffuse, diffuse_lobes)
    single = make_sg_field(gbuffer, camera, tau=tau, diffuse_fallback=not diffuse)
    height, width = single.valid.shape
    field = MixtureField(
        valid=np.empty((height, width), np.bool_),
        axis=np.zeros((height, width, 3 * count if tables or diffuse_lobes else 3), np.float32),
        sharpness=np.ones((height, width, count), np.float32),
        amplitude=np.zeros((height, width, count), np.float32),
    )
    rays = camera.make_ray_directions(width, height) if tables and gbuffer.position is None else None
    builder = _Builder(gbuffer, camera.position.astype(np.float32), rays, np.float32(tau * tau), lobes, single, field)

    def fill(chunk: Chunk) -> None:
        with np.errstate(all="ignore"):  # pixels without a surface may overflow; `finish` replaces their values
            builder.fill_parametric(chunk)
            for number, table in enumerate(tables):
                builder.fill_table(chunk, number, table)
            valid = single.valid[chunk]
            if diffuse_lobes:
                valid = valid | builder.fill_diffuse(chunk)
            builder.finish(chunk, valid)

    run_chunks(fill, height, width)
    return field


def _count_lobes(lobes: int, tables: Sequence[LobeTable], diffuse: bool, diffuse_lobes: int) -> int:
    """Return the largest number of lobes that a pixel can have."""

    def complain(expected: str, got: str, action: str) -> NoReturn:
        raise InputError("lobes of a mixture", expected=expected, got=got, action=action)

    most = MAX_LOBES - diffuse
    if isinstance(lobes, bool) or lobes not in range(1, most + 1):
        complain(
            f"an integer from 1 to {most}",
            repr(lobes),
            "use 3, which approximate GGX within 1 %; a fourth one may be diffuse, where light is not split",
        )
    count = max([lobes, *(table.lobe_count for table in tables)]) + diffuse_lobes
    if count > MAX_LOBES:
        complain(
            f"at most {MAX_LOBES} for a pixel, the diffuse one included",
            str(count),
            "fit the materials with fewer lobes, or render diffuse and specular radiance apart",
        )
    return count


def _sum_luminance(albedo: FloatArray) -> Array:
    return np.asarray(sum(weight * albedo[..., k] for k, weight in enumerate(LUMINANCE)), dtype=np.float32)


@dataclass(frozen=True)
class _Builder:
    """Fills the arrays of a MixtureField chunk by chunk."""

    gbuffer: GBuffer
    eye: FloatArray
    rays: FloatArray | None
    """Unit directions in which the pixels look; only if there are lobe tables and no positions."""
    noise: np.float32
    """Variance that the band-limit adds to every lobe, square radians."""
    lobes: int
    single: SgField
    field: MixtureField

    def fill_parametric(self, chunk: Chunk) -> None:
        """Fill in the GGX mixture about the axis of the single lobe. The variance of the single lobe is its area."""
        single, gbuffer, field = self.single, self.gbuffer, self.field
        assert gbuffer.alpha_u is not None
        area = np.maximum(np.float32(1.0) / single.sharpness[chunk] - self.noise, np.float32(0.0))
        alpha_v = gbuffer.alpha_u if gbuffer.alpha_v is None else gbuffer.alpha_v
        square = np.clip(gbuffer.alpha_u[chunk] * alpha_v[chunk], np.float32(0.0), np.float32(1.0))
        albedo = np.ones_like(square)
        if gbuffer.specular_albedo is not None:
            albedo = _sum_luminance(gbuffer.specular_albedo[chunk])
        found = spread_ggx_mixture(NUMPY_SINGLE, area, square, albedo, lobes=self.lobes, noise=self.noise)
        for k, (sharpness, amplitude) in enumerate(zip(*found, strict=True)):
            field.sharpness[chunk][..., k], field.amplitude[chunk][..., k] = sharpness, amplitude
        for k in range(0, min(3 * self.lobes, field.axis.shape[2]), 3):
            field.axis[chunk][..., k : k + 3] = single.axis[chunk]
        if gbuffer.lobe_kind is None:
            return
        kind = gbuffer.lobe_kind[chunk]
        # The lobes of Beckmann surfaces and mirrors, and the diffuse lobe, are a single Gaussian already.
        alone = kind != LobeKind.GGX
        if alone.any():
            sharpness = single.sharpness[chunk][alone]
            weight = np.where(kind[alone] == LobeKind.NONE, np.float32(1.0), albedo[alone])
            field.sharpness[chunk][..., 0][alone] = sharpness
            field.amplitude[chunk][..., 0][alone] = weight / integrate_gaussian(NUMPY_SINGLE, sharpness)
            field.amplitude[chunk][..., 1 : self.lobes][alone] = 0.0

    def fill_table(self, chunk: Chunk, number: int, table: LobeTable) -> None:
        """Replace the lobes of the pixels that show the material of the table."""
        gbuffer, field = self.gbuffer, self.field
        assert gbuffer.material is not None and gbuffer.normal is not None
        here = self.single.valid[chunk] & (gbuffer.material[chunk] == number + 1)
        if not here.any():
            return
        normal = normalize(gbuffer.normal[chunk][here])
        if gbuffer.position is not None:
            view = normalize(self.eye - gbuffer.position[chunk][here])
        else:
            assert self.rays is not None
            view = -self.rays[chunk][here]
        tangent = None
        if not table.is_isotropic:
            assert gbuffer.tangent is not None
            tangent = gbuffer.tangent[chunk][here]
        found = evaluate_table(table, normal, view, tangent)
        # Use the isotropic Gaussian with the area of the anisotropic one: twice the geometric mean of the sharpnesses.
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

    def fill_diffuse(self, chunk: Chunk) -> NDArray[np.bool_]:
        """Put the diffuse lobe last and return where there is one. A pixel without specular lobe has it alone."""
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
        none = ~self.single.valid[chunk]
        if none.any():
            field.axis[chunk][..., :-3][none] = 0.0
            field.sharpness[chunk][..., :-1][none] = 1.0
            field.amplitude[chunk][..., :-1][none] = 0.0
        return np.asarray(there)

    def finish(self, chunk: Chunk, valid: NDArray[np.bool_]) -> None:
        """Write the mask, and neutral values where there is no lobe."""
        field = self.field
        field.valid[chunk] = valid & np.isfinite(field.axis[chunk].sum(-1) + field.amplitude[chunk].sum(-1))
        none = ~field.valid[chunk]
        for values, harmless in ((field.axis, 0.0), (field.sharpness, 1.0), (field.amplitude, 0.0)):
            values[chunk][none] = harmless


def define_mixture(grid: Grid, lobes: int) -> list[Vector]:
    """Return validity, axis, sharpnesses and amplitudes of GGX surfaces of albedo 1, for exported filters.

    The area of the mixture is the variance of the single lobe without its band-limit.
    """
    valid, _, _, axis, (single,) = define_lobes(grid, "sg")
    (noise,) = grid.get("noise")
    area = hl.max(1.0 / single - noise, hl.f32(0.0))
    alpha = hl.clamp(grid.read_one("alpha_u"), hl.f32(0.0), hl.f32(1.0))
    sharpness, amplitude = spread_ggx_mixture(HALIDE, area, alpha * alpha, 1.0, lobes=lobes, noise=noise)
    there = valid[0] != 0
    return [
        valid,
        axis,
        [hl.select(there, value, hl.f32(1.0)) for value in sharpness],
        [hl.select(there, value, hl.f32(0.0)) for value in amplitude],
    ]
