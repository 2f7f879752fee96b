"""SparseFrame: a frame whose radiance was shaded at one pixel of every block, for upsampling."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Integral
from typing import ClassVar

import numpy as np

from lobewise.errors import InputError, name_value, require_kind
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, Guided, Radiance, describe_content
from lobewise.records.images import keep_array
from lobewise.records.lobe_table import LobeTable
from lobewise.settings.choices import MAX_SCALE_PIXELS


def require_place(
    scale: int, place: tuple[int, int], size: tuple[int, int] = (MAX_SCALE_PIXELS, MAX_SCALE_PIXELS)
) -> None:
    """Raise InputError unless blocks of ``scale`` have a pixel at ``place``, in an image of ``size`` if it is known."""
    if isinstance(scale, bool) or not isinstance(scale, int) or not 1 <= scale <= MAX_SCALE_PIXELS:
        raise InputError(
            "scale",
            expected=f"an integer from 1 to {MAX_SCALE_PIXELS}",
            got=name_value(scale),
            action="2 or 4 is usual",
        )
    require_kind("place", place, tuple, list, np.ndarray)
    pair = [index for index in place if isinstance(index, Integral) and not isinstance(index, bool)]
    is_pair = len(place) == len(pair) == 2
    if not (is_pair and all(0 <= index < min(scale, length) for index, length in zip(pair, size, strict=True))):
        raise InputError(
            "place",
            expected=f"row and column from 0 to {scale - 1}",
            got=name_value(place),
            action="say which pixel of each block was shaded",
        )


@dataclass(frozen=True, repr=False)
class Rays:
    """The rays along which the specular radiance of samples came, for frames with one ray for each shaded pixel.

    Parameters
    ----------
    weight : array, shape (rows, columns)
        ``f cos / (p a)``, finite and >= 0: f is the specular BRDF, p the density of the direction by which it was
        sampled, a the specular albedo of the pixel. Its expected value is 1. It is 0 where the specular lobe reflects
        nothing along the ray, for example because the diffuse lobe was sampled. The specular radiance of the sample is
        the weight times a times the radiance that came along the ray, so all specular radiance must have come along it.

    Raises
    ------
    InputError
        If the shapes do not fit together, a number is not finite, or a weight is below 0.
    """

    weight: FloatArray

    def __post_init__(self) -> None:
        weight = keep_array(np.asarray(self.weight))
        if weight.ndim != 2:
            raise InputError(
                "rays",
                expected="weights of shape (rows, columns)",
                got=f"shape {weight.shape}",
                action="pass one ray for each shaded pixel",
            )
        if not (np.isfinite(weight).all() and (weight >= 0.0).all()):
            raise InputError(
                "rays",
                expected="finite weights of at least 0",
                got="others",
                action="pass weight 1 where no ray is known",
            )
        object.__setattr__(self, "weight", weight)

    def __repr__(self) -> str:
        return f"Rays({self.weight.shape[1]}x{self.weight.shape[0]})"


@dataclass(frozen=True, repr=False)
class SparseFrame(Guided):
    """A frame that was shaded at every ``scale``-th pixel of every ``scale``-th row only.

    Parameters
    ----------
    radiance : Radiance
        Of shape (rows, columns): sample (Y, X) was shaded at pixel (Y scale + place[0], X scale + place[1]) of the
        full image, so ``rows = ceil((height - place[0]) / scale)``; likewise for columns.
    gbuffer : GBuffer
        The first surface of every pixel of the full image, (height, width).
    scale : int
        Distance between neighbouring shaded pixels, pixels, 1 to 16.
    place : (int, int)
        Row and column of the shaded pixel within each block, 0 to ``scale - 1``.
    camera : Camera, optional
        The camera of the full image; every similarity of reflection lobes needs it.
    variance : Radiance, optional
        Variance of the mean of ``radiance``.
    spp : int, optional
        Samples per shaded pixel, >= 1.
    lobe_tables : tuple of LobeTable
        Fitted lobes of the materials that ``gbuffer.material`` numbers.
    rays : Rays, optional
        The ray of each sample. Samples then count by the weights of their rays.

    Raises
    ------
    InputError
        If scale or place is out of range, the radiance has not one sample for each block, or the rays have another
        size or no specular radiance beside them.
    """

    is_sparse: ClassVar[bool] = True
    radiance: Radiance
    gbuffer: GBuffer
    scale: int
    place: tuple[int, int] = (0, 0)
    camera: Camera | None = None
    variance: Radiance | None = None
    spp: int | None = None
    lobe_tables: tuple[LobeTable, ...] = ()
    rays: Rays | None = None

    def __post_init__(self) -> None:
        require_kind("radiance", self.radiance, Radiance)
        require_kind("gbuffer", self.gbuffer, GBuffer)
        require_kind("rays", self.rays, Rays, type(None))
        require_kind("camera", self.camera, Camera, type(None))
        size = self.gbuffer.shape
        if size is None:
            raise InputError(
                "gbuffer", expected="the guides of the full image", got="none", action="render the normals at least"
            )
        require_place(self.scale, self.place, size)
        row, column = self.place
        # Let Frame check the radiance, the variance and the sample count.
        samples = Frame(self.radiance, variance=self.variance, spp=self.spp)
        grid = -(-(size[0] - row) // self.scale), -(-(size[1] - column) // self.scale)
        if samples.shape != grid:
            raise InputError(
                "radiance",
                expected=f"{grid[1]}x{grid[0]} samples, one for each block of {self.scale}x{self.scale} pixels",
                got=f"{samples.width}x{samples.height}",
                action="check scale and place",
            )
        if self.rays is not None and (self.rays.weight.shape != grid or self.radiance.parts is None):
            got = repr(self.rays) if self.radiance.parts is not None else "no specular radiance"
            expected = f"{grid[1]}x{grid[0]} rays, and radiance in diffuse and specular parts"
            raise InputError("rays", expected=expected, got=got, action="pass both parts, and a ray for each sample")
        object.__setattr__(self, "lobe_tables", tuple(self.lobe_tables))

    def __repr__(self) -> str:
        where = f"one of {self.scale}x{self.scale} pixels at {self.place}"
        return f"SparseFrame({self.width}x{self.height}, {where}: {describe_content(self)})"

    def with_light(self, color: FloatArray, diffuse: FloatArray, specular: FloatArray) -> SparseFrame:
        """Return the frame with other light of its samples."""
        return replace(self, radiance=replace(self.radiance, color=color, diffuse=diffuse, specular=specular))

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the full image."""
        return self.gbuffer.shape or (0, 0)

    @property
    def shaded(self) -> tuple[slice, slice]:
        """Index of the shaded pixels in images of the full size."""
        return slice(self.place[0], None, self.scale), slice(self.place[1], None, self.scale)


def list_places(scale: int) -> list[tuple[int, int]]:
    """Return the order in which frames shade the pixels of a block: ``scale**2`` pairs of row and column.

    Consecutive pixels lie far apart, so that any few consecutive frames cover the block evenly. For a power of two it
    is the order of an ordered dither: the bits of the count, lowest first, halve the block by turns along the diagonal
    and across. Other scales take the order of the next power of two and leave out pixels outside the block.

    Raises
    ------
    InputError
        If the scale is not from 1 to `MAX_SCALE_PIXELS`.

    Notes
    -----
    Source: Bayer 1973, "An optimum method for two-level rendition of continuous-tone pictures"; for the fixed
    permutation, Herzog et al. 2010.
    """
    require_place(scale, (0, 0))
    bits = (scale - 1).bit_length()
    places = []
    for count in range(4**bits):
        row = column = 0
        for level in range(bits):
            pair = count >> 2 * level & 3
            step = 1 << bits - 1 - level
            row += step * (pair & 1)
            column += step * ((pair & 1) ^ (pair >> 1))
        if row < scale and column < scale:
            places.append((row, column))
    return places


AnyFrame = Frame | SparseFrame
"""A frame with guides, shaded at every pixel or sparsely."""


def make_sparse(frame: Frame, scale: int, place: tuple[int, int] = (0, 0)) -> SparseFrame:
    """Return a frame that keeps the radiance of one pixel in every block, and all guides. Raises as `SparseFrame`."""
    require_kind("frame", frame, Frame)
    require_place(scale, place, frame.shape)
    shaded = slice(place[0], None, scale), slice(place[1], None, scale)

    def pick(part: Radiance) -> Radiance:
        return replace(part, **{name: getattr(part, name)[shaded] for name in part.names})

    return SparseFrame(
        pick(frame.radiance),
        frame.gbuffer,
        scale,
        place,
        camera=None if frame.wraps else frame.camera,
        variance=None if frame.variance is None else pick(frame.variance),
        spp=frame.spp,
        lobe_tables=frame.lobe_tables,
    )
