"""The guides of a pipeline's frame: images that the caller gives, and those that are made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from lobewise.denoising.layers import MIN_WHOLE_ALBEDO
from lobewise.engine.graph import Graph, Image
from lobewise.engine.kernels import Kernels, make_feature
from lobewise.engine.numbers import Number
from lobewise.exporting.pipeline.recipes.constants import Constants
from lobewise.exporting.pipeline.recipes.glue import define_both, define_composed, define_mean, define_whole_albedo
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.features import (
    AsgFeature,
    DiffuseFeature,
    Feature,
    GgxFeature,
    NormalFeature,
    PositionFeature,
    ScreenFeature,
    SgFeature,
    SplitGgxFeature,
    SplitLobe,
)
from lobewise.guides.lobe_fields import (
    SHAPES,
    CovarianceField,
    SgField,
    define_lobes,
    define_split_lobes,
    define_spread,
)
from lobewise.guides.surfaces import define_positions, define_surface
from lobewise.settings.choices import get_similarity

SIZE = "height", "width"
SAMPLES = "rows", "columns"
HALVES = "half_a", "half_b"


def describe_light(name: str) -> str:
    """Return the meaning of an image of radiance by its name."""
    part = name.rpartition("_")[2]
    text = "all noisy light" if part == "color" else f"noisy {part} light, albedo included"
    return f"{text}, of one half of the samples" if name.startswith(HALVES) else text


@dataclass(frozen=True)
class PlannedLayer:
    """One radiance of a pipeline; see `lobewise.denoising.layers.Layer`."""

    name: str
    radiance: Image
    albedo: Image | None
    mask: Image
    features: tuple[Feature, ...]
    is_diffuse: bool = False


@dataclass
class PipelineGuides:
    """The guides of a frame. Images are made when they are asked for, once.

    Parameters
    ----------
    settings : PipelineSettings
    graph : Graph
    kernels : Kernels
    constants : Constants
    """

    settings: PipelineSettings
    graph: Graph
    kernels: Kernels
    constants: Constants
    picked: dict[str, Image] = field(default_factory=dict)
    """Images at the shaded pixels, by the names of the images of all pixels."""
    _made: dict[str, Image] = field(default_factory=dict)

    def give_light(self, name: str, text: str) -> Image:
        """Return an image of radiance: of the samples. All light is summed up where emission comes by itself."""
        if name.endswith("color") and self.settings.emission:
            return self._add_light(name)
        size = SIZE if self.settings.upsample == 1 else SAMPLES
        return self.graph.give(name, *size, 3, text=f"{text}, linear radiance", unit="any")

    @property
    def emission(self) -> Image:
        """Light that no surface scattered."""
        text = "light that no surface scattered, emission and background, at every pixel; it is not filtered"
        return self.graph.give("emission", *SIZE, 3, text=text, unit="any")

    def _add_light(self, name: str) -> Image:
        if name not in self._made:
            prefix = name.removesuffix("color")
            parts = [self.give_light(f"{prefix}{each}", describe_light(f"{prefix}{each}")) for each in self.parts]
            images = {f"part{k}": part for k, part in enumerate(parts)} | {"rest": self.emission}
            (self._made[name],) = self.kernels.map_pixels(
                define_composed, images, {}, names=[name], text="all light of the samples"
            )
        return self._made[name]

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the light that lobes scattered."""
        return "diffuse", "specular"

    def give_halves(self, name: str) -> list[Image]:
        """Return the images of both halves of the samples of some light."""
        return [self.give_light(f"{half}_{name}", describe_light(f"{half}_{name}")) for half in HALVES]

    def take_light(self, name: str, text: str) -> Image:
        """Return some light of all samples: an image of the caller, or the mean of two."""
        if not self.constants.guided:
            return self.give_light(name, text)
        if name not in self._made:
            halves = dict(zip("ab", self.give_halves(name), strict=True))
            text = f"{name} light of all samples"
            (self._made[name],) = self.kernels.map_pixels(define_mean, halves, {}, names=[name], text=text)
        return self._made[name]

    @property
    def color(self) -> Image:
        """All noisy light."""
        return self.take_light("color", "all noisy light: diffuse, specular, emission and background")

    @property
    def normal(self) -> Image:
        """Shading normals."""
        return self.graph.give("normal", *SIZE, 3, text="unit shading normal in world space; 0 without a surface")

    @property
    def depth(self) -> Image:
        """Distances of surfaces."""
        text = "distance of the surface from the camera, along the ray; 0 without a surface"
        return self.graph.give("depth", *SIZE, text=text, unit="world units")

    @property
    def position(self) -> Image:
        """Surface points."""
        if self.settings.position:
            return self.graph.give("position", *SIZE, 3, text="world position of the surface", unit="world units")
        if "position" not in self._made:
            numbers = {"eye": self.constants.get_vector("eye"), **self.constants.get_rays()}
            images = {"depth": self.depth}
            (found,) = self.kernels.map_pixels(
                define_positions, images, numbers, names=["position"], text="positions from depths"
            )
            self._made["position"] = found
        return self._made["position"]

    @property
    def alphas(self) -> dict[str, Image]:
        """Roughness, and the tangent of brushed surfaces, by the names of `define_lobes`."""
        text = "microfacet roughness alpha, the square of perceptual roughness"
        if not self.settings.anisotropic:
            return {"alpha_u": self.graph.give("alpha", *SIZE, text=f"{text}; 0 is a mirror", unit="0 to 1")}
        along = self.graph.give("alpha_u", *SIZE, text=f"{text}, along the tangent", unit="0 to 1")
        across = self.graph.give("alpha_v", *SIZE, text=f"{text}, across the tangent", unit="0 to 1")
        tangent = self.graph.give("tangent", *SIZE, 3, text="tangent in world space; 0 where there is none")
        return {"alpha_u": along, "alpha_v": across, "tangent": tangent}

    @property
    def kind(self) -> Image | None:
        """Kind of the lobe of every pixel, where it is told."""
        if not self.settings.lobe_kind:
            return None
        return self.graph.give("lobe_kind", *SIZE, text="0 no specular lobe, 1 GGX, 2 Beckmann, 3 mirror")

    @property
    def surface(self) -> Image:
        """Pixels with a surface."""
        if "surface" not in self._made:
            given = {"depth": self.depth, "position": self.position, "normal": self.normal}
            if not self.settings.position:
                # The recipe judges the images that it is given.
                del given["position"]
            (self._made["surface"],) = self.kernels.map_pixels(
                define_surface, given, {}, names=["surface"], text="pixels with a surface"
            )
        return self._made["surface"]

    def collect_lobe_images(self) -> dict[str, Image | None]:
        """Return the images that lobes are made from; see `lobewise.guides.lobe_fields.collect_guides`."""
        position = self.position if self.settings.position else None
        alphas = self.alphas
        record = self.settings.record
        if not record.has_covariance:
            alphas.pop("tangent", None)
        images = {"normal": self.normal, "position": position, "depth": self.depth, "kind": self.kind}
        return {**images, **alphas}

    def make_lobes(self, similarity: str, noise: Number, *, spread: bool) -> tuple[Image, list[Image]]:
        """Return where pixels have a lobe, and the lobes' axes and shapes; see `make_sg_field`."""
        eye = self.constants.get_vector("eye", single=True)
        fallback = Number(1.0, "1.0", is_single=True)
        numbers = {"eye": eye, "noise": noise, **self.constants.get_rays(), "diffuse_fallback": fallback}
        valid, *lobe = self.kernels.map_pixels(
            define_lobes,
            self.collect_lobe_images(),
            numbers,
            similarity,
            names=[
                "has_lobe",
                "axis",
                "covariance" if get_similarity(similarity).has_covariance else "sharpness",
                "area",
            ],
            text=f"lobes of the similarity {similarity}",
        )
        if not spread:
            return valid, lobe
        kind = CovarianceField if get_similarity(similarity).has_covariance else SgField
        images = {"valid": valid, "axis": lobe[0], **dict(zip(SHAPES[kind], lobe[1:], strict=True))}
        wide = self.kernels.map_pixels(
            define_spread, images, {}, names=[f"wide_{name}" for name in SHAPES[kind]], text="lobes of pixel areas"
        )
        return valid, [lobe[0], *wide]

    def split_lobes(self, noises: Sequence[Number]) -> tuple[Image, list[tuple[Image, ...]]]:
        """Return where pixels have a lobe, and the split lobes for several squared band-limits."""
        eye = self.constants.get_vector("eye", single=True)
        numbers = {"eye": eye, "noise": Number(0.0, "0.0", is_single=True), **self.constants.get_rays()}
        numbers |= {f"noise{k}": noise for k, noise in enumerate(noises)}
        names = ["has_lobe", *(f"axis_{each}" for each in "xyz"), *(f"turn_{each}" for each in "xyz")]
        names += [f"{size}{k}" for k in range(len(noises)) for size in ("large", "small")]
        valid, *planes = self.kernels.map_pixels(
            define_split_lobes,
            self.collect_lobe_images(),
            numbers,
            len(noises),
            names=names,
            text="lobes, split, for comparisons within a frame and between frames",
        )
        return valid, [(*planes[:6], *planes[6 + 2 * k : 8 + 2 * k]) for k in range(len(noises))]

    def make_place_features(self, screen: float, position: float) -> list[Feature]:
        """Return the features that compare places; see `make_position_features`."""
        features = [] if self.settings.form == "atrous" else [make_feature(ScreenFeature, screen)]
        angle = self.constants.pixel_angle
        return [*features, make_feature(PositionFeature, self.position, self.depth, pixel_angle=angle, sigma=position)]

    def make_diffuse_feature(self, beta: float) -> Feature:
        """Return the feature that compares diffuse light."""
        if self.settings.record.has_lobes:
            return make_feature(DiffuseFeature, self.normal, beta)
        return make_feature(NormalFeature, self.normal, self.constants.get("normal_exponent"))

    def make_specular_feature(
        self, similarity: str, beta: float, noise: Number, *, spread: bool = False, hits: object = None
    ) -> tuple[Feature, Image]:
        """Return the feature that compares specular light, and its pixels; see `make_specular_features`."""
        record = get_similarity(similarity)
        if not record.has_lobes:
            return make_feature(NormalFeature, self.normal, self.constants.get("normal_exponent")), self.surface
        valid, lobe = self.make_lobes(similarity, noise, spread=spread)
        kind = SgFeature if not record.has_covariance else AsgFeature if record.fits_gaussian else GgxFeature
        return make_feature(kind, *lobe, beta, hits), self.join_masks(valid)

    def make_split_feature(self, lobe: Sequence[Any], beta: float, hits: object = None) -> Feature:
        """Return the feature that compares split lobes."""
        return make_feature(SplitGgxFeature, SplitLobe(*lobe), beta, hits)

    def join_masks(self, valid: Image) -> Image:
        """Return the pixels with a surface and a lobe."""
        images = {"surface": self.surface, "valid": valid}
        (mask,) = self.kernels.map_pixels(define_both, images, {}, names=["specular_mask"], text="pixels with a lobe")
        return mask

    def give_albedo(self, name: str) -> Image:
        """Return the albedo of a layer."""
        text = f"directional albedo of the {name} lobe: its radiance is divided by it, and multiplied afterwards"
        return self.graph.give(f"{name}_albedo", *SIZE, 3, text=text, unit="0 to 1")

    def make_layers(
        self, place: Sequence[Feature], specular: tuple[Feature, Image], diffuse: float
    ) -> list[PlannedLayer]:
        """Return the layers of the frame; see `lobewise.denoising.layers.make_lobe_layers`.

        Parameters
        ----------
        place : sequence of Feature
            Features that count in all layers.
        specular : (Feature, Image)
            What compares specular light, or all light in one image, and the pixels that have it.
        diffuse : float
            Exponent of the similarity of diffuse lobes.
        """
        feature, mask = specular
        if self.settings.layers == "color":
            both = {name: self.give_albedo(name) for name in ("diffuse", "specular")}
            (albedo,) = self.kernels.map_pixels(
                define_whole_albedo, both, {}, MIN_WHOLE_ALBEDO, names=["albedo"], text="albedo of all light"
            )
            return [PlannedLayer("color", self.color, albedo, mask, (*place, feature))]
        light = {name: self.take_light(name, describe_light(name)) for name in ("diffuse", "specular")}
        scattered = (*place, self.make_diffuse_feature(diffuse))
        return [
            PlannedLayer("diffuse", light["diffuse"], self.give_albedo("diffuse"), self.surface, scattered, True),
            PlannedLayer("specular", light["specular"], self.give_albedo("specular"), mask, (*place, feature)),
        ]
