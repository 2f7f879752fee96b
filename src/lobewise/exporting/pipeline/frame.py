"""The frame of a pipeline: it stands where recipes read a `lobewise.Frame`, and its images and numbers are recorded.

Images become inputs of the pipeline when a recipe reads them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

from lobewise import engine
from lobewise.engine.graph import Graph, GraphImage
from lobewise.engine.numbers import Number
from lobewise.engine.recorder import Recorder
from lobewise.exporting.pipeline.constants import Constants
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.features import Feature
from lobewise.filters.glue import define_bad, define_composed, define_mean
from lobewise.guides.surfaces import compute_points
from lobewise.settings import ResolvedSettings

SIZE = "height", "width"
SAMPLES = "rows", "columns"
HALVES = "half_a", "half_b"


class Guide(NamedTuple):
    """An image of a frame's guides: its channels, 0 for an image without an axis for them, its meaning and its unit."""

    channels: int
    text: str
    unit: str = ""


ROUGHNESS = "microfacet roughness alpha, the square of perceptual roughness"
ALBEDO = "directional albedo of the {} lobe: its radiance is divided by it, and multiplied afterwards"
GUIDES = {
    "normal": Guide(3, "unit shading normal in world space; 0 without a surface"),
    "depth": Guide(0, "distance of the surface from the camera, along the ray; 0 without a surface", "world units"),
    "position": Guide(3, "world position of the surface", "world units"),
    "alpha": Guide(0, f"{ROUGHNESS}; 0 is a mirror", "0 to 1"),
    "alpha_u": Guide(0, f"{ROUGHNESS}, along the tangent", "0 to 1"),
    "alpha_v": Guide(0, f"{ROUGHNESS}, across the tangent", "0 to 1"),
    "tangent": Guide(3, "tangent in world space; 0 where there is none"),
    "lobe_kind": Guide(0, "0 no specular lobe, 1 GGX, 2 Beckmann, 3 mirror"),
    "hit_distance": Guide(
        0,
        "distance from the surface to what its reflection shows; 0 where unknown, infinite for the sky",
        "world units",
    ),
    "motion": Guide(2, "from a pixel to the place of its surface in the frame before: columns, rows", "pixels"),
    "emission": Guide(
        3, "light that no surface scattered, emission and background, at every pixel; it is not filtered", "any"
    ),
    "diffuse_albedo": Guide(3, ALBEDO.format("diffuse"), "0 to 1"),
    "coverage": Guide(9, "shares of the pixel that the surfaces at the 3x3 pixel centres around it cover", "0 to 1"),
    **{
        f"mean_{name}_albedo": Guide(3, f"albedo of the {name} lobe, averaged over the pixel's area", "0 to 1")
        for name in ("diffuse", "specular")
    },
    **{f"{name}_albedo": Guide(3, ALBEDO.format(name), "0 to 1") for name in ("specular", "glossy", "transmission")},
}
"""The guides that a pipeline may be given, by their names."""


def describe_light(name: str) -> str:
    """Return the meaning of an image of radiance by its name."""
    part = name.rpartition("_")[2]
    every = "all noisy light: diffuse, specular, emission and background"
    text = every if part == "color" else f"noisy {part} light, albedo included"
    return f"{text}, of one half of the samples" if name.startswith(HALVES) else text


@dataclass(frozen=True)
class GivenGuides:
    """The guides of a pipeline's frame; stands where recipes read a `lobewise.GBuffer`."""

    settings: PipelineSettings
    graph: Graph
    shape = SIZE
    is_placed = True

    def __getattr__(self, name: str) -> Any:
        """Return a guide; None if the settings of the pipeline leave it out."""
        if name.startswith("_"):
            raise AttributeError(name)
        if name == "alpha_u" and not self.settings.anisotropic:
            name = "alpha"
        if name in self.settings.left_out or (name := name.replace("mean_emission", "emission")) not in GUIDES:
            return None
        guide = GUIDES[name]
        shape = (*SIZE, guide.channels) if guide.channels else SIZE
        return self.graph.give(name, *shape, text=guide.text, unit=guide.unit)

    def require(self, name: str, whose: str) -> Any:
        """Return a guide that a recipe needs."""
        image = getattr(self, name)
        assert image is not None, f"{whose} needs {name}"
        return image


@dataclass(frozen=True)
class GivenCamera:
    """The camera of a pipeline's frame, or of the frame before; stands where recipes read a `lobewise.Camera`."""

    constants: Constants
    is_before: bool = False

    @property
    def position(self) -> list[Number]:
        """Its position."""
        return self.constants.get_vector("eye", before=self.is_before)

    def get_pixel_angle(self, height: object) -> Number:
        """Return the angle of a pixel, radians."""
        return self.constants.pixel_angle

    def get_ray_numbers(self, size: object) -> dict[str, list[Number]]:
        """See `lobewise.Camera.get_ray_numbers`."""
        rays = {name: self.constants.get_vector(name) for name in ("first_ray", "ray_right", "ray_down")}
        return {**rays, "first_row": [Number(0.0, "0.0")]}

    def get_projection_numbers(self, size: object) -> dict[str, list[Number]]:
        """See `lobewise.Camera.get_projection_numbers`."""
        names = {"before": "eye", "before_forward": "forward", "before_right": "before_right", "before_up": "before_up"}
        return {name: self.constants.get_vector(own, before=self.is_before) for name, own in names.items()}


@dataclass(frozen=True)
class GivenHalf:
    """One half of the samples of a pipeline's frame; stands where recipes read a `lobewise.Radiance`."""

    guides: PipelineGuides
    name: str

    def __getattr__(self, part: str) -> Any:
        """Return an image of radiance; None if the pipeline has no light of this name."""
        if part != "color" and part not in self.guides.settings.layer_names:
            return None
        return self.guides.give_light(f"{self.name}_{part}")


Features = Callable[[Any], Sequence[Feature]]
"""Returns more features of every layer from a frame, whose images may be recorded."""


def no_features(frame: object) -> Sequence[Feature]:
    """Return no more features than the recipe's own."""
    return ()


@dataclass
class PipelineGuides:
    """The frame of a pipeline. Images are made when they are asked for, once.

    Parameters
    ----------
    settings : PipelineSettings
    graph : Graph
    kernels : Recorder
    constants : Constants
    make_features : callable
        More features of every layer.
    """

    settings: PipelineSettings
    graph: Graph
    kernels: Recorder
    constants: Constants
    make_features: Features = no_features
    light: Any = None
    """The light of the samples, where it is not that of the caller."""
    lobe_tables = ()
    noise_is_shared = False
    shape = SIZE
    height, width = SIZE
    is_placed = True
    place = "p->frame->row", "p->frame->column"

    @property
    def is_sparse(self) -> bool:
        """Whether radiance is given at one pixel of each block alone."""
        return self.settings.upsample > 1

    @property
    def spp(self) -> Number:
        """Samples per pixel, which the user sets."""
        return self.constants.get("samples_per_pixel")

    @property
    def scale(self) -> int:
        """Distance of shaded pixels."""
        return self.settings.upsample

    @cached_property
    def gbuffer(self) -> Any:
        """The guides."""
        return GivenGuides(self.settings, self.graph)

    @cached_property
    def camera(self) -> Any:
        """The camera."""
        return GivenCamera(self.constants)

    def require_camera(self, whose: str) -> Any:
        """Return the camera."""
        return self.camera

    @property
    def before(self) -> Any:
        """The frame before, of which only the camera is known."""
        return SimpleNamespace(
            camera=GivenCamera(self.constants, is_before=True), gbuffer=None, is_placed=False, shape=SIZE
        )

    @property
    def frame(self) -> PipelineGuides:
        """The frame itself, as of `lobewise.recipes.temporal.validation.Guides`."""
        return self

    @property
    def places(self) -> Any:
        """The surface points and their depths."""
        return compute_points(self.gbuffer, self.camera)

    @cached_property
    def features(self) -> tuple[Feature, ...]:
        """More features of every layer."""
        return tuple(self.make_features(self))

    @property
    def layers(self) -> list[Any]:
        """The layers that the frame names itself."""
        if self.settings.layers != "named":
            return []
        return [
            SimpleNamespace(
                name=name,
                radiance=self.take_light(name),
                half_a=getattr(self.half_a, name, None),
                half_b=getattr(self.half_b, name, None),
                albedo=getattr(self.gbuffer, f"{name}_albedo"),
                is_diffuse=name == "diffuse",
                is_transmitted=name == "transmission",
                parts={},
            )
            for name in self.settings.layer_names
        ]

    @property
    def radiance(self) -> Any:
        """The radiance, which has the names of `lobewise.Radiance`."""
        return self if self.light is None else self.light

    def with_light(self, color: GraphImage, diffuse: GraphImage, specular: GraphImage) -> PipelineGuides:
        """Return the frame with other light of its samples."""
        light = SimpleNamespace(color=color, diffuse=diffuse, specular=specular, parts=(diffuse, specular))
        return replace(self, light=light)

    @property
    def rays(self) -> Any:
        """The rays along which specular light came."""
        if not self.settings.rays:
            return None
        text = "f cos / (p a) of the specular ray of each sample: BRDF, density of the direction, specular albedo"
        return SimpleNamespace(weight=self.graph.give("ray_weight", *SAMPLES, text=text, unit=">= 0"))

    @property
    def parts(self) -> tuple[GraphImage, GraphImage] | None:
        """The light of two layers; None where all light comes in one image."""
        if self.settings.layers == "color":
            return None
        first, second = (self.take_light(name) for name in self.settings.layer_names[:2])
        return first, second

    @cached_property
    def resolved(self) -> ResolvedSettings:
        """The settings of the recipe, with the numbers that the pipeline computes for every frame."""
        constants = self.constants
        return ResolvedSettings(
            **self.settings.choices,
            beta=constants.beta,
            diffuse_beta=constants.diffuse_beta,
            screen_sigma=constants.screen_sigma,
            position_sigma=constants.get("position_sigma"),
            tau=constants.tau,
            normal_exponent=constants.get("normal_exponent"),
        )

    def give_light(self, name: str) -> GraphImage:
        """Return an image of radiance: of the samples. All light is summed up where emission comes by itself."""
        if name.endswith("color") and self.settings.emission:
            prefix = name.removesuffix("color")
            names = [f"{prefix}{each}" for each in self.settings.layer_names]
            images = {f"part{k}": self.give_light(each) for k, each in enumerate(names)}
            images |= {"rest": self.emission}
            return self._compute(define_composed, images, name, "all light of the samples")
        size = SIZE if self.settings.upsample == 1 else SAMPLES
        return self.graph.give(name, *size, 3, text=f"{describe_light(name)}, linear radiance", unit="any")

    def _compute(self, define: Any, images: dict[str, GraphImage], name: str, text: str) -> GraphImage:
        (image,) = engine.pixels(define, images, {}, names=[name], text=text)
        return image  # type: ignore[return-value]  # recorded images stand for arrays

    @property
    def emission(self) -> GraphImage:
        """Light that no surface scattered."""
        return self.gbuffer.emission  # type: ignore[no-any-return]

    @property
    def half_a(self) -> GivenHalf | None:
        """One half of the samples, where they are given."""
        return GivenHalf(self, HALVES[0]) if self.settings.reads_halves else None

    @property
    def half_b(self) -> GivenHalf | None:
        """The other half."""
        return GivenHalf(self, HALVES[1]) if self.settings.reads_halves else None

    def take_light(self, name: str) -> GraphImage:
        """Return some light of all samples: an image of the caller, or the mean of two."""
        if self.half_a is None:
            return self.give_light(name)
        halves = {"a": getattr(self.half_a, name), "b": getattr(self.half_b, name)}
        return self._compute(define_mean, halves, name, f"{name} light of all samples")

    @property
    def color(self) -> GraphImage:
        """All noisy light."""
        return self.take_light("color")

    @property
    def bad(self) -> GraphImage:
        """Pixels whose radiance is NaN, infinite or negative."""
        light = [layer.radiance for layer in self.layers] or self.parts or ()
        images = {f"light{number}": image for number, image in enumerate((self.color, *light))}
        return self._compute(define_bad, images, "bad", "bad pixels")
