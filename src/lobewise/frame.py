"""What travels between the rooms: G-buffer, radiance, frame and result. Checked once, then frozen."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.errors import InputError, MissingChannelError, require_kind, require_number
from lobewise.images import ABSENT, Images, MaybeImage, as_images, refuse_size, say_size
from lobewise.images import FloatArray as FloatArray  # every room has it from here
from lobewise.lobe_table import LobeTable
from lobewise.radiance import Radiance as Radiance
from lobewise.radiance import RadianceLayer as RadianceLayer


def require_spp(spp: Any) -> None:
    """Raise InputError unless a count of samples per pixel is None or a number of at least 1."""
    if spp is not None and not require_number("spp", spp) >= 1:
        raise InputError("spp", expected="at least 1", got=str(spp), action="leave it out if unknown")


class LobeKind(IntEnum):
    """Which specular reflection lobe a pixel has; the value is what the channel ``lobe_kind.I`` holds.

    A pixel of any kind may carry a diffuse lobe as well: that is told by its diffuse albedo.
    """

    NONE = 0
    """No specular lobe: a diffuse surface, a light source, or no surface at all."""
    GGX = 1
    """Microfacet lobe with GGX (Trowbridge-Reitz) normals."""
    BECKMANN = 2
    """Microfacet lobe with Beckmann normals."""
    DELTA = 3
    """Perfect mirror or smooth dielectric; the alphas are 0."""


@dataclass(frozen=True, repr=False)
class GBuffer(Images):
    """The first surface that every pixel sees. World space, row 0 on top; a missing surface has depth 0.

    Parameters
    ----------
    depth : array_like, shape (height, width), optional
        Distance along the ray, world units, 0 where there is no surface.
    position : array_like, shape (height, width, 3), optional
        World position; ignored where there is no surface.
    normal : array_like, shape (height, width, 3), optional
        Shading normal (after normal and bump maps), on the camera's side; 0 where there is no surface.
    tangent : array_like, shape (height, width, 3), optional
        Direction of ``alpha_u``, perpendicular to ``normal``.
    alpha_u, alpha_v : array_like, shape (height, width), optional
        Microfacet roughness alpha (not perceptual) along and across the tangent, in [0, 1]; 0 is a mirror.
    lobe_kind : array_like, shape (height, width), optional
        `LobeKind` of the specular lobe.
    diffuse_albedo : array_like, shape (height, width, 3), optional
        Directional albedo of the diffuse lobe, in [0, 1].
    specular_albedo : array_like, shape (height, width, 3), optional
        Directional albedo of the specular lobe, tinted by its reflectance at normal incidence, in [0, 1].
    hit_distance : array_like, shape (height, width), optional
        Distance from the first surface to what its specular lobe sees, world units; 0 where unknown,
        inf where it sees no surface.
    hit_position : array_like, shape (height, width, 3), optional
        World position of that hit.
    hit_normal : array_like, shape (height, width, 3), optional
        Mean over the specular reflections of the shading normal, facing the ray, of the surface that each sees (0 for
        none): the shorter, the more mixed.
    hit_albedo : array_like, shape (height, width, 3), optional
        Mean likewise of the albedo, diffuse + specular, of that surface, in [0, 1]: 1 for a light source, 0 for none.
    mean_normal : array_like, shape (height, width, 3), optional
        Mean of the shading normal over the pixel's area (0 for no surface), where ``normal`` is that of its centre.
    mean_diffuse_albedo, mean_specular_albedo : array_like, shape (height, width, 3), optional
        Means of the albedos over the pixel's area, in [0, 1], without the noise of samples.
    denoiser_albedo : array_like, shape (height, width, 3), optional
        Albedo that a renderer made for denoisers, as its file has it. Open Image Denoise is handed it in place of the
        sum of the others; nothing else reads it.
    denoiser_normal : array_like, shape (height, width, 3), optional
        Normal of another renderer's file, as the file has it, in any space and of any length: the one that was made
        for denoisers where there is one. Open Image Denoise is handed it in place of the others; nothing else reads it.
    mean_emission : array_like, shape (height, width, 3), optional
        Mean over the pixel's area of the light that reaches the camera unscattered, from lamps and the background,
        >= 0, without the noise of samples.
    coverage : array_like, shape (height, width, 9), optional
        Which shares of the pixel's area the surfaces at the centres of its 3x3 neighbours stand for best, row by row:
        in [0, 1], sum 1, that of the pixel itself at index 4, 0 for neighbours outside the image.
    object_share : array_like, shape (height, width), optional
        Largest share of the pixel's area that one object, or the background, has, in (0, 1]: below 1 at silhouettes,
        and over wide areas where depth of field or motion blurs them.
    motion : array_like, shape (height, width, 2), optional
        Pixels from here to where the surface point was in the previous frame, x right and y down.
    material : array_like, shape (height, width), optional
        Which of the frame's lobe tables holds the pixel's lobes, counted from 1; 0 where the alphas tell all.

    Raises
    ------
    InputError
        If an array is not real, has the wrong shape, no pixels, or not the size of the others.
    """

    depth: MaybeImage = ABSENT
    position: MaybeImage = ABSENT
    normal: MaybeImage = ABSENT
    tangent: MaybeImage = ABSENT
    alpha_u: MaybeImage = ABSENT
    alpha_v: MaybeImage = ABSENT
    lobe_kind: MaybeImage = ABSENT
    diffuse_albedo: MaybeImage = ABSENT
    specular_albedo: MaybeImage = ABSENT
    hit_distance: MaybeImage = ABSENT
    hit_position: MaybeImage = ABSENT
    hit_normal: MaybeImage = ABSENT
    hit_albedo: MaybeImage = ABSENT
    mean_normal: MaybeImage = ABSENT
    mean_diffuse_albedo: MaybeImage = ABSENT
    mean_specular_albedo: MaybeImage = ABSENT
    denoiser_albedo: MaybeImage = ABSENT
    denoiser_normal: MaybeImage = ABSENT
    mean_emission: MaybeImage = ABSENT
    coverage: MaybeImage = ABSENT
    object_share: MaybeImage = ABSENT
    motion: MaybeImage = ABSENT
    material: MaybeImage = ABSENT

    def __post_init__(self) -> None:
        vectors = ("position", "normal", "tangent", "albedo", "emission")
        channels = {item.name: 3 if item.name.endswith(vectors) else None for item in fields(self)}
        self.check_images({**channels, "motion": 2, "coverage": 9})

    @property
    def is_placed(self) -> bool:
        """Whether a camera tells the surface point of every pixel: there is its position or its depth."""
        return self.position is not None or self.depth is not None

    def require(self, name: str, whose: str) -> FloatArray:
        """Return the image of that name, which ``whose`` needs.

        Raises
        ------
        MissingChannelError
            If it is not there.
        """
        image: FloatArray | None = getattr(self, name)
        if image is None:
            raise MissingChannelError(
                f"channel {name}",
                expected=f"one for {whose}",
                got="none",
                action="render it with the frame, or choose another similarity",
            )
        return image


class Guided(ABC):
    """What frames share that have guides of some size and perhaps a camera, whatever pixels were shaded."""

    gbuffer: GBuffer
    camera: Camera | None

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """(height, width) of the guides."""

    @property
    def height(self) -> int:
        """Rows."""
        return self.shape[0]

    @property
    def width(self) -> int:
        """Columns."""
        return self.shape[1]

    @property
    def is_placed(self) -> bool:
        """Whether every pixel's surface point is known: there is a camera, and position or depth."""
        return self.camera is not None and self.gbuffer.is_placed

    def require_camera(self, whose: str) -> Camera:
        """Return the camera, which ``whose`` needs.

        Raises
        ------
        MissingChannelError
            If there is none.
        """
        if self.camera is None:
            raise MissingChannelError(
                "camera",
                expected=f"one for {whose}",
                got="none in the frame",
                action="give the frame a camera, or use similarity 'normal'",
            )
        return self.camera


@dataclass(frozen=True, repr=False)
class Frame(Guided):
    """A noisy frame and what is known of it.

    Parameters
    ----------
    radiance : Radiance
        The noisy radiance, in total and where known by part.
    gbuffer : GBuffer
        The first surface of every pixel.
    camera : Camera, optional
        Needed by every similarity that looks at reflection lobes.
    half_a, half_b : Radiance, optional
        The same image from one half of the samples each.
    variance : Radiance, optional
        Per-pixel variance of the mean (of ``radiance``, not of one sample).
    spp : int, optional
        Samples per pixel, >= 1.
    lobe_tables : tuple of LobeTable
        Fitted lobes of the materials that ``gbuffer.material`` names.
    layers : tuple of RadianceLayer
        The light by the lobe that scattered it first, where it is known finer than by ``radiance.diffuse`` and
        ``radiance.specular``, which then are the sums of the layers. What they leave of the total (emission,
        background) passes as it is.
    unscattered : mapping of str to array_like, shape (height, width, 3)
        Light of the total that no surface scattered, by name, beside the layers: emission, background. It passes as it
        is; but where ``gbuffer.object_share`` tells that objects are blurred, single bright pixels are shared out among
        their neighbours.
    also : mapping of str to array_like, shape (height, width, 3)
        Noisy images that belong to the total, such as the light of every lamp; what sums to it before does so after.
    noise_is_shared : bool
        Whether neighbouring pixels share samples, as with a pixel filter that spreads them: then their noise is no
        longer independent, and that of a frame without halves is judged two pixels apart.

    Raises
    ------
    InputError
        If the parts do not have one size, two layers have one name, ``spp`` is below 1, or a pixel names a table that
        is not there.
    """

    radiance: Radiance
    gbuffer: GBuffer = field(default_factory=GBuffer)
    camera: Camera | None = None
    half_a: Radiance | None = None
    half_b: Radiance | None = None
    variance: Radiance | None = None
    spp: int | None = None
    lobe_tables: tuple[LobeTable, ...] = ()
    layers: tuple[RadianceLayer, ...] = ()
    unscattered: Mapping[str, FloatArray] = field(default_factory=dict)
    also: Mapping[str, FloatArray] = field(default_factory=dict)
    noise_is_shared: bool = False

    def __post_init__(self) -> None:
        require_kind("radiance", self.radiance, Radiance)
        require_kind("gbuffer", self.gbuffer, GBuffer)
        require_kind("camera", self.camera, Camera, type(None))
        for name in ("half_a", "half_b", "variance"):
            require_kind(name, getattr(self, name), Radiance, type(None))
        for name in ("gbuffer", "half_a", "half_b", "variance"):
            part: Images | None = getattr(self, name)
            shape = part.shape if part is not None else None
            if shape is not None and shape != self.shape:
                raise refuse_size(name, "the radiance", self.shape, shape)
        require_spp(self.spp)
        object.__setattr__(self, "lobe_tables", tuple(self.lobe_tables))
        self._check_layers()
        material = self.gbuffer.material
        if material is not None and not (material.min() >= 0.0 and material.max() <= len(self.lobe_tables)):
            raise InputError(
                "material",
                expected=f"numbers from 0 to {len(self.lobe_tables)}, the count of lobe tables",
                got=f"{material.min():g} to {material.max():g}",
                action="give the frame the tables of its materials, or leave the channel out",
            )

    def _check_layers(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        for name in ("unscattered", "also"):
            object.__setattr__(self, name, as_images(name, getattr(self, name), self.shape))
        names = [layer.name for layer in self.layers]
        for layer in self.layers:
            if layer.shape != self.shape:
                assert layer.shape is not None
                raise refuse_size(f"layer {layer.name!r}", "the radiance", self.shape, layer.shape)
            if names.count(layer.name) > 1:
                raise InputError(
                    "layers", expected="names of their own", got=f"two {layer.name!r}", action="rename one"
                )
        if self.layers and self.radiance.parts is None:
            raise InputError(
                "layers",
                expected="radiance.diffuse and radiance.specular, their sums, beside them",
                got="neither",
                action="use lobewise.radiance.sum_layers",
            )

    def __repr__(self) -> str:
        return f"Frame({say_size(self.shape)}{describe_content(self)})"

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return int(self.radiance.color.shape[0]), int(self.radiance.color.shape[1])

    def with_changes(self, **changes: Any) -> Frame:
        """Return a copy with some fields replaced, checked again."""
        return replace(self, **changes)


def describe_content(frame: Any) -> str:
    """Return in one line what a whole or sparse frame holds."""
    told = [f"{name} ({', '.join(getattr(frame, name).names)})" for name in ("radiance", "gbuffer")]
    told += [name for name in ("half_a", "half_b", "variance", "camera") if getattr(frame, name, None) is not None]
    told += [f"{frame.spp} spp"] if frame.spp else []
    layers = [layer.name for layer in getattr(frame, "layers", ())]
    told += [f"layers ({', '.join(layers)})"] if layers else []
    tables = len(frame.lobe_tables)
    told += [f"{tables} lobe table{'s' if tables > 1 else ''}"] if tables else []
    return ", ".join(told)


@dataclass(frozen=True, repr=False)
class Result:
    """A denoised frame.

    Parameters
    ----------
    image : (height, width, 3)
        Denoised total radiance, linear, finite.
    diffuse, specular : (height, width, 3) or None
        The two filtered parts, with their albedo, where the frame gave them apart.
    weight_sum : (height, width)
        Sum of the filter weights, of diffuse and specular the smaller where the pixel reflects both; a tap that
        matches fully counts 1.
    effective_samples : (height, width)
        ``(sum w)^2 / sum w^2``: how many equal neighbours the estimate is worth, >= 1 where anything was gathered.
    bad_pixels : (height, width), bool
        Pixels that were NaN, infinite or negative, had weight 0 and were refilled.
    variance : (height, width) or None
        Estimated variance of the image's luminance, where a history tells it.
    energy_lost : float
        Share of the light of the filtered layers that the result lacks, in [0, 1]. What a filter takes from fireflies
        is shared out over their layer, but for pixels that hold so much of its light that they tell nothing of its
        mean. 0 with the quality "fast", which is not measured.
    layers : mapping of str to (height, width, 3)
        The filtered layers of a frame that has any, by name.
    also : mapping of str to (height, width, 3)
        The filtered images of ``Frame.also``; those of ``Frame.unscattered`` where they changed; and under
        ``layer/part`` the parts of its layers.
    settings : dict
        Every parameter that was used, defaults resolved.
    seconds : float
        Wall time of the call.
    method : str
        In one sentence, without its stop, which filters and networks the image is of, and by which guides.
    notes : tuple of str
        One sentence each: what is wrong with the guides (values that no surface can have, and what became of them), and
        that much light was taken from fireflies and shared out, where the noise does not explain how much.
    unused : tuple of str
        Images of the frame that change nothing with these settings.
    """

    image: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray
    bad_pixels: NDArray[np.bool_]
    settings: dict[str, Any]
    seconds: float
    diffuse: FloatArray | None = None
    specular: FloatArray | None = None
    variance: FloatArray | None = None
    energy_lost: float = 0.0
    method: str = ""
    layers: Mapping[str, FloatArray] = field(default_factory=dict)
    also: Mapping[str, FloatArray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()

    @property
    def bad_pixel_count(self) -> int:
        """How many pixels were refilled."""
        return int(np.count_nonzero(self.bad_pixels))

    def __repr__(self) -> str:
        images = [name for name in ("image", "diffuse", "specular", "variance") if getattr(self, name) is not None]
        named = [f"{name} {self.settings[name]}" for name in ("quality", "similarity") if name in self.settings]
        size = say_size((self.image.shape[0], self.image.shape[1]))
        told = [*images, *named, f"{self.bad_pixel_count} bad pixels", f"{self.seconds:.3g} s"]
        return f"Result({size}{', '.join(told)})"
