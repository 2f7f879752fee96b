"""What travels between the rooms: G-buffer, radiance, frame and result. Checked once, then frozen."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any, ClassVar

from lobewise.errors import InputError, MissingChannelError, require_kind, require_number
from lobewise.records.camera import Camera
from lobewise.records.images import ABSENT, Images, MaybeImage, as_image, as_images, refuse_size, say_size, wrap_columns
from lobewise.records.images import FloatArray as FloatArray  # every room has it from here
from lobewise.records.lobe_table import LobeTable
from lobewise.records.radiance import Radiance as Radiance
from lobewise.records.radiance import RadianceLayer as RadianceLayer
from lobewise.records.result import Result as Result


def require_spp(spp: Any) -> None:
    """Raise InputError unless a count of samples per pixel is None or a number of at least 1."""
    if spp is not None and not require_number("spp", spp) >= 1:
        raise InputError("spp", expected="at least 1", got=str(spp), action="leave it out if unknown")


class LobeKind(IntEnum):
    """Kind of the specular lobe of a pixel; the channel ``lobe_kind.I`` holds its value.

    A pixel of any kind may have a diffuse lobe as well, which its diffuse albedo tells.
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
    """The first surface of every pixel, in world space, row 0 on top. Depth 0 means no surface.

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
        Distance from the first surface to the surface that its specular lobe hits, world units; 0 where unknown, inf
        where the lobe hits no surface.
    hit_position : array_like, shape (height, width, 3), optional
        World position of the hit.
    mean_normal : array_like, shape (height, width, 3), optional
        Mean of the shading normal over the pixel's area without the noise of samples, 0 where there is no surface.
        ``normal`` is the normal at the centre of the pixel.
    mean_diffuse_albedo, mean_specular_albedo : array_like, shape (height, width, 3), optional
        Means of the albedos over the pixel's area, in [0, 1], without the noise of samples.
    denoiser_albedo : array_like, shape (height, width, 3), optional
        Albedo that a renderer made for denoisers, unchanged. Only Open Image Denoise reads it.
    denoiser_normal : array_like, shape (height, width, 3), optional
        Normal of another renderer's file, unchanged, in any space and of any length; the normal for denoisers where the
        file has one. Open Image Denoise gets it instead of the other normals; nothing else reads it.
    mean_emission : array_like, shape (height, width, 3), optional
        Mean over the pixel's area of the light that reaches the camera unscattered, from lamps and the background,
        >= 0, without the noise of samples.
    coverage : array_like, shape (height, width, 9), optional
        Shares of the pixel's area, row by row, that belong to the surfaces at the centres of its 3x3 neighbours: in
        [0, 1], sum 1; the pixel itself has index 4; 0 for neighbours outside the image, if it does not wrap around.
    blur_radius : array_like, shape (height, width), optional
        Radius of the area that the lens blurs the pixel over, its circle of confusion: pixels, >= 0, 0 in focus;
        NaN where it is not known.
    motion : array_like, shape (height, width, 2), optional
        Place of the surface point in the previous frame minus its place in this frame, pixels, x right and y down.
    reflected_motion : array_like, shape (height, width, 3), optional
        World position of the hit in the previous frame minus its position in this frame; 0 where it stood still.
    material : array_like, shape (height, width), optional
        Number of the frame's lobe table with the pixel's lobes, counted from 1; 0 where the alphas describe the lobe.

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
    mean_normal: MaybeImage = ABSENT
    mean_diffuse_albedo: MaybeImage = ABSENT
    mean_specular_albedo: MaybeImage = ABSENT
    denoiser_albedo: MaybeImage = ABSENT
    denoiser_normal: MaybeImage = ABSENT
    mean_emission: MaybeImage = ABSENT
    coverage: MaybeImage = ABSENT
    blur_radius: MaybeImage = ABSENT
    motion: MaybeImage = ABSENT
    reflected_motion: MaybeImage = ABSENT
    material: MaybeImage = ABSENT

    def __post_init__(self) -> None:
        vectors = ("position", "normal", "tangent", "albedo", "emission", "reflected_motion")
        channels = {item.name: 3 if item.name.endswith(vectors) else None for item in fields(self)}
        self.check_images({**channels, "motion": 2, "coverage": 9})

    @property
    def is_placed(self) -> bool:
        """Whether the surface points are known, given a camera: there is a position or a depth."""
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
    """The base of full and sparse frames: guides of some size, and perhaps a camera."""

    gbuffer: GBuffer
    camera: Camera | None
    is_sparse: ClassVar[bool] = False
    """Whether radiance is given at one pixel of each block alone."""

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
        """Whether the surface points are known: there is a camera, and a position or a depth."""
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
    """A noisy frame with its guides.

    It owns what it checked: writeable arrays are copied, and read-only arrays are kept without a copy.

    Parameters
    ----------
    radiance : Radiance
        The noisy radiance: the total, and its parts where they are known.
    gbuffer : GBuffer
        The first surface of every pixel.
    camera : Camera, optional
        Every similarity of lobes needs it. Of an image that wraps around it tells only where the camera stands and the
        angle of a pixel; positions tell where the pixels look.
    half_a, half_b : Radiance, optional
        The images of the two halves of the samples.
    variance : Radiance, optional
        Per-pixel variance of the mean (of ``radiance``, not of one sample).
    spp : int, optional
        Samples per pixel, >= 1.
    lobe_tables : tuple of LobeTable
        Fitted lobes of the materials that ``gbuffer.material`` names.
    layers : tuple of RadianceLayer
        The light by the lobe that scattered it first, in more layers than ``radiance.diffuse`` and
        ``radiance.specular``, which are then the sums of the layers. The rest of the total (emission, background) is
        not filtered.
    unscattered : mapping of str to array_like, shape (height, width, 3)
        Light of the total that no surface scattered, by name: emission, background. It is not filtered, but where
        ``gbuffer.blur_radius`` tells that the lens blurs it, it is shared out among neighbours.
    also : mapping of str to array_like, shape (height, width, 3) or (height, width)
        Further noisy images with the same guides, such as the light of every lamp. Each is denoised by itself, which
        takes as long as the total does. Images that sum to the total before denoising do so after it. A plane (height,
        width) whose name ends in a wavelength, such as ``S0.550nm``, is light too. Any other plane, such as ambient
        occlusion, is averaged by the weights of the total and no more.
    alpha : array_like, shape (height, width), optional
        Noisy opacity, in [0, 1], by which the radiance is multiplied already: of shadow catchers, or out of focus.
    noise_is_shared : bool
        Whether neighbouring pixels share samples, as with a pixel filter that spreads samples. The noise of neighbours
        is then not independent, and without halves it is estimated from pixels that are two apart.
    notes : tuple of str
        Sentences on the frame's file that results repeat, such as which of its noisy images are not in the frame.
    wraps : bool
        Whether the left and the right border are neighbours: an image of 360 degrees, such as a panorama by latitude
        and longitude.
    origin : object, optional
        The file that the frame was read from, as `lobewise.read_frame` keeps it for `lobewise.write_result`.

    Raises
    ------
    InputError
        If the parts do not have one size, two layers have one name, ``spp`` is below 1, a pixel names a table that is
        not there, or an image that wraps around has a camera and no positions.
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
    alpha: FloatArray | None = None
    noise_is_shared: bool = False
    notes: tuple[str, ...] = ()
    wraps: bool = False
    origin: object = field(default=None, compare=False)

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

        if self.wraps and self.camera is not None and self.gbuffer.position is None:
            raise InputError(
                "camera",
                expected="positions beside it for an image that wraps around, whose rays are not those of a pinhole",
                got="none",
                action="leave the camera out, or say that the image does not wrap around (--no-wrap)",
            )

    def _check_layers(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        object.__setattr__(self, "unscattered", as_images("unscattered", self.unscattered, self.shape))
        object.__setattr__(self, "also", as_images("also", self.also, self.shape, with_planes=True))
        object.__setattr__(self, "alpha", as_image("alpha", self.alpha, None))
        if self.alpha is not None and self.alpha.shape != self.shape:
            raise refuse_size("alpha", "the radiance", self.shape, self.alpha.shape)
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
                action="use lobewise.records.radiance.sum_layers",
            )

    def __repr__(self) -> str:
        return f"Frame({say_size(self.shape)}{describe_content(self)})"

    def _repr_html_(self) -> str:
        """Return the card that notebooks show."""
        from lobewise.display.cards import make_card

        facts = [("guides", ", ".join(self.gbuffer.names))]
        facts += [("light", ", ".join(layer.name for layer in self.layers) or ", ".join(self.radiance.names))]
        facts += [("samples", f"{self.spp:g} per pixel")] if self.spp else []
        facts += [("camera", "known" if self.camera else "unknown")]
        title = f"Frame, {say_size(self.shape)[:-2]}"
        return make_card(title, {"radiance": self.radiance.color}, facts)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return int(self.radiance.color.shape[0]), int(self.radiance.color.shape[1])

    def surround(self) -> Frame:
        """Return an image that wraps around with half of itself on each side, and any other frame as it is.

        Every pixel then has its neighbours, and every column counts twice in sums over the image.
        """
        if not self.wraps:
            return self
        return replace(
            self, **{item.name: wrap_columns(getattr(self, item.name), self.width // 2) for item in fields(self)}
        )

    def with_changes(self, **changes: Any) -> Frame:
        """Return a copy with some fields replaced, checked again."""
        return replace(self, **changes)


def describe_content(frame: Any) -> str:
    """Return the contents of a full or sparse frame in one line."""
    parts = [f"{name} ({', '.join(getattr(frame, name).names)})" for name in ("radiance", "gbuffer")]
    parts += [name for name in ("half_a", "half_b", "variance", "camera") if getattr(frame, name, None) is not None]
    parts += [f"{frame.spp} spp"] if frame.spp else []
    layers = [layer.name for layer in getattr(frame, "layers", ())]
    parts += [f"layers ({', '.join(layers)})"] if layers else []
    tables = len(frame.lobe_tables)
    parts += [f"{tables} lobe table{'s' if tables > 1 else ''}"] if tables else []
    return ", ".join(parts)
