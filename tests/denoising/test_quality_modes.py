"""Qualities of `denoise`: what knowing the noise buys, what it must not change, and where it is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lobewise.denoising import denoise
from lobewise.denoising.automatic import choose_quality, resolve_guided
from lobewise.denoising.noisy import make_noisy_layers
from lobewise.errors import InputError
from lobewise.features import ScreenFeature
from lobewise.filters.compositing import composite_light
from lobewise.guides.lobe_fields import default_tau
from lobewise.metrics import rel_mse
from lobewise.recipes.temporal import TemporalFilter
from lobewise.recipes.upsampling import upsample
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance, RadianceLayer
from lobewise.records.sparse_frame import make_sparse
from lobewise.settings import QUALITY_NAMES, DenoiseSettings
from tests.denoising.test_denoising import CAMERA, SHAPE, make_frame
from tests.mistakes import refuses

SHADOW = np.broadcast_to(np.where(np.arange(SHAPE[0]) < 20, 0.1, 1.0)[:, None, None], (*SHAPE, 3))
"""Light with an edge that no guide knows."""
FAR = np.r_[0:10, 30:40]
"""Rows that the edge is far from."""
SCALED = {1e-6: 5e-3, 3.0: 2e-3, 1e6: 5e-3}
"""How far a frame may come out unlike k times another, relative, by k: the rounding of a logarithm of 10, times
differences of 1, over the least variance that guides assume; less where the logarithm is."""
MIXED = 0.1
"""Relative error of a pixel of two surfaces: its samples, which show both, count as such of the one at its centre."""


def make_shadowed(*, halves: bool = True, apart: bool = True, seed: int = 3) -> tuple[Frame, Any]:
    """Return a plane of one gloss under that light, with noise of a quarter of it, and what it looks like."""
    rng = np.random.default_rng(seed)
    alpha = np.full(SHAPE, 0.4)
    albedo = np.full((*SHAPE, 3), 0.5)
    base = make_frame(alpha_u=alpha, alpha_v=alpha, diffuse_albedo=albedo, specular_albedo=albedo)

    def draw() -> Radiance:
        parts = [SHADOW * 0.5 * rng.gamma(8.0, 1.0 / 8.0, (*SHAPE, 1)) for _ in range(2)]
        return Radiance(parts[0] + parts[1], *(parts if apart else (None, None)))

    a, b = draw(), draw()
    names = ("color", "diffuse", "specular") if apart else ("color",)
    mean = Radiance(**{name: 0.5 * (getattr(a, name) + getattr(b, name)) for name in names})
    known = {"half_a": a, "half_b": b} if halves else {}
    return base.with_changes(radiance=mean, **known), SHADOW


def measure(image: Any, truth: Any) -> float:
    """Return the mean squared error over the squared truth."""
    return float(np.mean(((image - truth) / truth) ** 2))


def make_flat(value: float = 1.0) -> Frame:
    """Return a plane whose every sample is the same, all of it specular."""
    flat, dark = np.full((*SHAPE, 3), value), np.zeros((*SHAPE, 3))
    alpha = np.full(SHAPE, 0.4)
    radiance = Radiance(flat, dark, flat)
    return make_frame(alpha_u=alpha, alpha_v=alpha).with_changes(radiance=radiance, half_a=radiance, half_b=radiance)


@pytest.mark.nightly
class TestNoise:
    @pytest.mark.parametrize(("quality", "halves"), [("balanced", True), ("balanced", False), ("high", True)])
    def test_an_edge_of_light_that_no_guide_knows_stays(self, quality, halves):
        frame, truth = make_shadowed(halves=halves)
        fast, clean = (measure(denoise(frame, quality=name).image, truth) for name in ("fast", quality))
        assert clean < {"balanced": 0.12, "high": 0.2}[quality] * fast

    def test_a_lamp_in_a_mirror_does_not_leak(self):
        # No guide tells of it; both halves do, at every pixel. What is dark beside it is noisy.
        frame, _ = make_shadowed()
        lamp = np.zeros(SHAPE, bool)
        lamp[10:14, 8:20] = True

        def light(radiance: Radiance) -> Radiance:
            images = (getattr(radiance, name) for name in ("color", "diffuse", "specular"))
            return Radiance(*(np.where(lamp[..., None], np.float32(500.0), image) for image in images))

        lit = frame.with_changes(**{name: light(getattr(frame, name)) for name in ("radiance", "half_a", "half_b")})
        image = denoise(lit, quality="balanced").image
        assert image[lamp].min() > 400.0
        assert image[~lamp].max() < 5.0

    def test_single_lobes_are_compared_where_nothing_else_is_asked_for(self):
        frame, own = make_shadowed()[0], ScreenFeature(1.0)
        for asked, expected in (("auto", "sg"), ("sg", "sg"), ("ggx", "ggx"), ("normal", "normal")):
            settings = resolve_guided(frame, DenoiseSettings(quality="balanced", similarity=asked))
            _, specular = make_noisy_layers(frame, settings, [own])
            assert [feature.name for feature in specular.layer.features] == [expected, own.name]

    @pytest.mark.usefixtures("trusted")
    def test_rough_reflections_are_averaged_further_than_sharp_ones(self):
        # A single bright pixel is spread over what has weight: how much its last neighbour takes, over what it keeps.
        shares = []
        for alpha in (0.5, 0.01):
            flat = make_flat()
            guides = replace(flat.gbuffer, alpha_u=np.full(SHAPE, alpha), alpha_v=np.full(SHAPE, alpha))
            lit = np.array(flat.radiance.specular)
            lit[SHAPE[0] // 2, SHAPE[1] // 2] = 1.2
            radiance = Radiance(lit, np.zeros_like(lit), lit)
            frame = flat.with_changes(gbuffer=guides, radiance=radiance, half_a=radiance, half_b=radiance)
            row, middle = denoise(frame, quality="balanced").image[SHAPE[0] // 2, :, 0], SHAPE[1] // 2
            shares.append((row[middle + 5] - 1.0) / (row[middle] - 1.0))
        assert shares[0] > 0.9
        assert shares[1] < 0.3

    @pytest.mark.usefixtures("trusted")
    def test_neighbours_serve_as_halves_as_well(self):
        # Either way all samples count once: what is left of the noise is alike.
        errors = {"file": 0.0, "neighbours": 0.0}
        noise = 0.0
        for seed in range(3):
            for name in errors:
                frame, truth = make_shadowed(halves=name == "file", seed=seed)
                errors[name] += measure(denoise(frame, quality="balanced").image[FAR], truth[FAR])
            noise += measure(frame.radiance.color[FAR], truth[FAR])
        assert 0.7 < errors["file"] / errors["neighbours"] < 1.4
        assert max(errors.values()) < 0.02 * noise

    def test_neither_origin_of_the_halves_shifts_the_mean(self):
        for halves in (True, False):
            frame, truth = make_shadowed(halves=halves)
            image = denoise(frame, quality="balanced").image
            # Noise of a quarter, shared by some 500 pixels of either side: 1 % at one standard deviation.
            for side in (np.s_[:14], np.s_[26:]):
                assert image[side].mean() == pytest.approx(truth[side].mean(), rel=0.04)

    def test_a_frame_with_colour_alone(self):
        frame, truth = make_shadowed(apart=False)
        fast, balanced = (denoise(frame, quality=quality) for quality in ("fast", "balanced"))
        assert measure(balanced.image, truth) < 0.5 * measure(fast.image, truth)
        assert balanced.diffuse is None
        assert balanced.specular is None

    @pytest.mark.parametrize("quality", ["balanced", "high"])
    @pytest.mark.parametrize("factor", SCALED)
    def test_a_brighter_frame_is_the_same_frame(self, factor, quality):
        frame, _ = make_shadowed()

        def scale(radiance: Radiance) -> Radiance:
            return Radiance(*(factor * getattr(radiance, name) for name in ("color", "diffuse", "specular")))

        scaled = {name: scale(getattr(frame, name)) for name in ("radiance", "half_a", "half_b")}
        plain, bright = (denoise(each, quality=quality) for each in (frame, frame.with_changes(**scaled)))
        np.testing.assert_allclose(bright.image, factor * plain.image, rtol=SCALED[factor])


class TestEmission:
    """Light that no surface scattered, at the edge of a lamp that samples hit or miss."""

    LAMP, SHARE, SPP = 50.0, 0.25, 4

    def make_edge(self) -> Frame:
        """Return a frame whose column 30 shows a lamp on a quarter of its area, which samples see as 0 or all of it."""
        frame = make_flat()
        seen = np.zeros((*SHAPE, 1))
        seen[::4, 30] = self.LAMP
        mean = np.zeros((*SHAPE, 3))
        mean[:, 30] = self.SHARE * self.LAMP
        changes = {}
        for name in ("radiance", "half_a", "half_b"):
            light = getattr(frame, name)
            changes[name] = Radiance(light.color + seen, light.diffuse, light.specular)
        guides = replace(frame.gbuffer, mean_emission=mean)
        return frame.with_changes(gbuffer=guides, spp=self.SPP, **changes)

    @pytest.mark.parametrize("quality", ["balanced", "high"])
    def test_edges_of_lamps_are_averaged_with_the_mean_over_the_area(self, quality):
        frame = self.make_edge()
        scattered = denoise(make_flat(), quality=quality).image[:, 30]
        emitted = denoise(frame, quality=quality).image[:, 30] - scattered
        truth, worth = self.SHARE * self.LAMP, 16.0
        seen = np.where(np.arange(SHAPE[0]) % 4 == 0, self.LAMP, 0.0)
        expected = (self.SPP * seen + worth * truth) / (self.SPP + worth)
        np.testing.assert_allclose(emitted, np.repeat(expected[:, None], 3, axis=1), rtol=1e-4)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0], ids=str)
    def test_what_is_no_light_does_not_count(self, bad):
        frame = self.make_edge()
        mean = np.array(frame.gbuffer.mean_emission)
        # Where samples met the lamp.
        mean[4, 30] = bad
        whole, spoilt = (
            denoise(frame.with_changes(gbuffer=replace(frame.gbuffer, mean_emission=each)), quality="balanced").image
            for each in (frame.gbuffer.mean_emission, mean)
        )
        # What is left are the samples.
        assert spoilt[4, 30, 0] == pytest.approx(self.LAMP + whole[4, 31, 0], rel=1e-3)
        spoilt[4, 30] = whole[4, 30]
        np.testing.assert_array_equal(spoilt, whole)


class TestFireflies:
    def test_no_light_is_lost_without_them(self):
        assert denoise(make_flat(), quality="balanced").energy_lost == 0.0
        assert denoise(make_flat(), quality="fast").energy_lost == 0.0

    def test_one_spike_loses_what_is_above_its_bound(self):
        frame = make_flat()
        spiked = np.array(frame.radiance.color)
        spiked[20, 25] = 1000.0
        dark = np.zeros_like(spiked)
        lit = Radiance(spiked, dark, spiked)
        mean = Radiance(0.5 * (spiked + 1.0), dark, 0.5 * (spiked + 1.0))
        result = denoise(frame.with_changes(radiance=mean, half_a=lit), quality="balanced")
        pixels = SHAPE[0] * SHAPE[1]
        # One pixel tells nothing of the mean: all that it has above the others is lost.
        assert result.energy_lost == pytest.approx(499.5 / (pixels + 499.5), abs=1e-3)
        assert result.image.max() < 1.1
        alone = denoise(frame.with_changes(radiance=lit, half_a=None, half_b=None), quality="balanced")
        assert alone.energy_lost == pytest.approx(999.0 / (pixels + 999.0), abs=1e-3)
        assert alone.image.max() < 1.1


@pytest.mark.nightly
class TestCoverage:
    EDGE = SHAPE[1] // 2 - 1
    """The last column of the left side, of which half shows the right side."""

    def make_edge(self, albedos: tuple[float, float], lights: tuple[float, float]) -> tuple[Frame, Any]:
        """Return two sides of unlike normals, a column of both between them, and what that column is without noise."""
        left = np.arange(SHAPE[1]) <= self.EDGE
        albedo, light = (
            np.broadcast_to(np.where(left, *values)[None, :, None], (*SHAPE, 3)).copy() for values in (albedos, lights)
        )
        color, mean, coverage = albedo * light, albedo.copy(), np.zeros((*SHAPE, 9))
        coverage[..., 4] = 1.0
        coverage[:, self.EDGE, 4:6] = 0.5
        mean[:, self.EDGE] = np.mean(albedos)
        truth = 0.5 * (albedos[0] * lights[0] + albedos[1] * lights[1])
        color[:, self.EDGE] = truth
        dark = np.zeros_like(color)
        normal = np.where(left[None, :, None], [0.0, 0.6, 0.8], [0.6, 0.0, 0.8]) * np.ones((*SHAPE, 1))
        frame = make_frame(
            normal=normal,
            specular_albedo=albedo,
            coverage=coverage,
            mean_specular_albedo=mean,
            mean_diffuse_albedo=dark,
        )
        noise = np.random.default_rng(5).gamma(10.0, 0.1, (2, *SHAPE, 1))
        a, b, both = (Radiance(color * each, dark, color * each) for each in (*noise, noise.mean(axis=0)))
        return frame.with_changes(radiance=both, half_a=a, half_b=b), truth

    @pytest.mark.nightly
    @pytest.mark.parametrize(
        ("albedos", "lights"), [((0.5, 0.5), (2.0, 0.4)), ((0.8, 0.2), (1.5, 1.5))], ids=["light", "albedo"]
    )
    def test_a_pixel_of_two_surfaces_is_their_mean(self, albedos, lights):
        frame, truth = self.make_edge(albedos, lights)
        columns = denoise(frame, quality="balanced", similarity="normal").image.mean(axis=(0, 2))
        assert columns[self.EDGE] == pytest.approx(truth, rel=MIXED)
        assert columns[self.EDGE - 8] == pytest.approx(albedos[0] * lights[0], rel=0.03)
        assert columns[self.EDGE + 8] == pytest.approx(albedos[1] * lights[1], rel=0.02)

    @pytest.mark.usefixtures("unshared", "trusted")
    def test_without_coverage_it_is_the_surface_at_its_centre(self):
        # The noisy image tells that the edge is wrong, and would be taken back.
        frame, truth = self.make_edge((0.5, 0.5), (2.0, 0.4))
        bare = frame.with_changes(gbuffer=replace(frame.gbuffer, coverage=None))
        image, resolved = (denoise(each, quality="balanced", similarity="normal").image for each in (bare, frame))
        assert image[:, self.EDGE].mean() > 1.4 * truth
        away = np.abs(np.arange(SHAPE[1]) - self.EDGE) > 1
        np.testing.assert_allclose(image[:, away], resolved[:, away], rtol=1e-5)

    def test_the_kernel_is_its_definition(self, rng):
        height, width = 7, 9
        light, albedo = rng.random((2, height, width, 3)).astype(np.float32)
        coverage = rng.random((height, width, 9)).astype(np.float32) * (rng.random((height, width, 9)) < 0.6)
        lit = rng.random((height, width)) < 0.7
        coverage[2, 3] = 0.0
        albedo[4, 4, 1] = 0.0
        expected, known = light.astype(np.float64), np.zeros((height, width), bool)
        for y in range(height):
            for x in range(width):
                total, weight = np.zeros(3), np.zeros(3)
                for k in range(9):
                    there = min(max(y + k // 3 - 1, 0), height - 1), min(max(x + k % 3 - 1, 0), width - 1)
                    if lit[there]:
                        known[y, x] |= coverage[y, x, k] > 0.0
                        total += coverage[y, x, k] * albedo[there].astype(np.float64) * light[there]
                        weight += coverage[y, x, k] * albedo[there].astype(np.float64)
                found = weight > 1e-6
                expected[y, x, found] = total[found] / weight[found]
        radiance = rng.random((height, width, 3)).astype(np.float32)
        radiance[0, 0, 0] = np.inf
        expected = np.where(known[..., None], expected * albedo, radiance)
        expected[~known & (radiance[..., 0] == np.inf)] = np.nan
        apart = rng.random(light.shape).astype(np.float32) * light
        for images in ((light,), (light - apart, light + apart)):
            resolved = composite_light(images, lit, radiance, albedo, coverage.astype(np.float32))
            np.testing.assert_allclose(resolved, expected, rtol=1e-5)

    def test_without_coverage_it_is_light_times_albedo(self, rng):
        light, albedo, radiance = rng.random((3, 5, 6, 3)).astype(np.float32)
        lit = rng.random((5, 6)) < 0.7
        albedo[2, 2, 1], albedo[3, 3, 0] = np.nan, -1.0
        lit[2, 2] = lit[3, 3] = True
        tint = np.where(np.isfinite(albedo) & (albedo >= 0.0), albedo, 0.0)
        expected = np.where(lit[..., None], light * tint, radiance)
        np.testing.assert_array_equal(composite_light((light,), lit, radiance, albedo), expected)
        expected = np.where(lit[..., None], light, radiance)
        np.testing.assert_array_equal(composite_light((light,), lit, radiance), expected)


class TestSettings:
    @pytest.mark.parametrize(
        ("settings", "expected"),
        [
            ({}, "high"),
            ({"quality": "balanced"}, "balanced"),
            ({"quality": "fast"}, "fast"),
            ({"quality": "high"}, "high"),
        ],
        ids=str,
    )
    def test_what_auto_takes(self, settings, expected):
        assert choose_quality(DenoiseSettings(**settings)) == expected

    @pytest.mark.parametrize("quality", ["balanced", "high"])
    def test_what_has_no_other_quality_than_fast_says_so(self, quality):
        sparse = make_sparse(make_frame((8, 8)), 2)
        with refuses(InputError, "quality", repr(quality), "'fast' for upsampling"):
            upsample(sparse, quality=quality)
        for asked in ({"quality": quality}, {"settings": DenoiseSettings(quality=quality)}):
            with refuses(InputError, "quality", repr(quality), "'fast' for a filter with history"):
                TemporalFilter(**asked)

    def test_results_tell_what_was_used(self):
        settings = denoise(make_frame(), quality="balanced").settings
        assert (settings["quality"], settings["beta"], settings["diffuse_beta"]) == ("balanced", 1.0, 2.0)
        assert settings["tau"] == max(0.01, default_tau(CAMERA, SHAPE[0]))
        assert settings["screen_sigma"] == 30.0
        assert settings["quality"] in QUALITY_NAMES

    def test_own_parameters_are_respected(self):
        own: dict[str, Any] = {"screen_sigma": 4.0, "beta": 8.0, "diffuse_beta": 3.0, "tau": 0.3}
        frame = make_frame()
        plain = denoise(frame, quality="balanced")
        assert {name: denoise(frame, quality="balanced", **own).settings[name] for name in own} == own
        # Where the specular lobe supports less than the diffuse one: the glossy side.
        glossy = np.s_[5:-5, 5:20]
        support = {
            name: denoise(frame, quality="balanced", **{name: value}).weight_sum[glossy].mean()
            for name, value in own.items()
        }
        before = plain.weight_sum[glossy].mean()
        assert support["screen_sigma"] < 0.8 * before
        assert support["beta"] < 0.9 * before
        assert support["tau"] > 1.05 * before

    @pytest.mark.nightly
    def test_own_features_count(self):
        frame, _ = make_shadowed(apart=False)
        free = denoise(frame, quality="balanced")
        bound = denoise(frame, quality="balanced", features=[ScreenFeature(1.0)])
        # A Gaussian of one pixel sums to less than 2 pi.
        assert bound.weight_sum.max() < 2.0 * np.pi * 1.01
        assert free.weight_sum.max() > 20.0


@pytest.mark.parametrize("quality", ["fast", "balanced", "high"])
def test_light_through_glass_is_compared_by_normals(quality: str) -> None:
    """A smooth pane: no two pixels of its reflection lobe are alike, but what is behind it is seen all the same."""
    height, width = 48, 64
    camera = Camera((0.0, 0.0, 3.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 0.8)
    depth = (3.0 / -camera.make_ray_directions(width, height)[..., 2]).astype(np.float32)
    normal = np.zeros((height, width, 3), np.float32)
    normal[..., 2] = 1.0
    guides = GBuffer(
        depth=depth,
        normal=normal,
        alpha_u=np.full((height, width), 1e-3, np.float32),
        specular_albedo=np.full((height, width, 3), 0.9, np.float32),
        diffuse_albedo=np.zeros((height, width, 3), np.float32),
    )
    noisy = np.random.default_rng(3).gamma(4.0, 0.25, (height, width, 1)).astype(np.float32) * np.ones(3, np.float32)
    errors = {}
    for lobe in ("glossy", "transmission"):
        layer = RadianceLayer(lobe, lobe, noisy, np.full_like(noisy, 0.9))
        radiance = Radiance(noisy, diffuse=np.zeros_like(noisy), specular=noisy)
        frame = Frame(radiance, guides, camera, spp=16, layers=(layer,))
        errors[lobe] = rel_mse(denoise(frame, quality=quality).image, np.ones_like(noisy))
    # The network of "high" removes most of the noise of the reflection as well.
    assert errors["transmission"] < (0.75 if quality == "high" else 0.5) * errors["glossy"]
    assert errors["transmission"] < 0.1 * rel_mse(noisy, np.ones_like(noisy))
