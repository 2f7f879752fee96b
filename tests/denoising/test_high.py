"""The quality "high": the refining network, and the share of Open Image Denoise."""

import json
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from lobewise import peers
from lobewise.denoising import chain, combining, denoise, evidence
from lobewise.denoising.automatic import choose_quality
from lobewise.denoising.combining import (
    NORMAL_DEVIATION,
    LayerImage,
    choose_between,
    denoise_with_peer,
    mix_albedos,
    share_out,
)
from lobewise.denoising.evidence import load_networks
from lobewise.engine.here import HERE
from lobewise.errors import InputError, MissingDependencyError
from lobewise.filters.glue import define_smooth
from lobewise.filters.mixing import PERCEPTRON_LEAK, Perceptron, compute_shares
from lobewise.filters.noise import agreement, detail
from lobewise.interchange import write_result
from lobewise.io import read_frame, write_frame
from lobewise.io.exr.parsing import read_container
from lobewise.peers import has_oidn
from lobewise.recipes.temporal import TemporalFilter
from lobewise.recipes.upsampling import upsample
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.records.radiance import RadianceLayer
from lobewise.records.sparse_frame import make_sparse
from lobewise.settings import DenoiseSettings
from tests.denoising.test_denoising import SHAPE, make_frame
from tests.denoising.test_quality_modes import FAR, make_shadowed, measure
from tests.mistakes import refuses

CHEAP: dict[str, Any] = {"quality": "high", "similarity": "normal"}
"""Lobes take the most time to compile."""

ROUNDING = 1e-6
"""Relative: a weighted mean in float32."""


def make_network(inputs: int, outputs: int, seed: int) -> Perceptron:
    """Return a small network of random numbers for features, logarithms about -5."""
    rng = np.random.default_rng(seed)
    pairs = list(pairwise((inputs, 4, 4, outputs)))
    weights = tuple((rng.normal(size=pair) / np.sqrt(pair[0])).astype(np.float32) for pair in pairs)
    biases = tuple(rng.normal(size=after).astype(np.float32) for _, after in pairs)
    mean, scale = np.full(inputs, -5.0, np.float32), np.full(inputs, 0.3, np.float32)
    return Perceptron(mean, scale, weights, biases)  # type: ignore[arg-type]


def force(network: Perceptron, chosen: int) -> Perceptron:
    """Return a network that gives one candidate everything."""
    scores = np.full(network.biases[-1].size, -1e3, np.float32)
    scores[chosen] = 1e3
    weights = (*network.weights[:-1], np.zeros_like(network.weights[-1]))
    return network._replace(weights=weights, biases=(*network.biases[:-1], scores))


def make_networks() -> dict[str, Perceptron]:
    """Return one of each kind."""
    return {"peer": make_network(agreement.AGREEMENT_FEATURES + detail.DETAIL_FEATURES, 3, 5)}


def take_networks(monkeypatch: pytest.MonkeyPatch) -> dict[str, Perceptron]:
    """Return the networks that are used from now on, to be changed in place."""
    networks = make_networks()
    monkeypatch.setattr(combining, "load_networks", lambda: networks)
    return networks


@pytest.fixture
def networks(monkeypatch: pytest.MonkeyPatch) -> dict[str, Perceptron]:
    """Return networks of random numbers in place of those that mix in the image of Open Image Denoise."""
    return take_networks(monkeypatch)


@pytest.mark.parametrize("apart", [True, False], ids=["apart", "combined"])
def test_the_whole_plan(apart):
    frame, truth = make_shadowed(apart=apart)
    first, second = (denoise(frame, **CHEAP) for _ in range(2))
    assert np.isfinite(first.image).all()
    assert first.image.tobytes() == second.image.tobytes()
    assert measure(first.image[FAR], truth[FAR]) < 0.1 * measure(frame.radiance.color[FAR], truth[FAR])


@pytest.mark.usefixtures("networks")
class TestContract:
    @pytest.mark.usefixtures("trusted")
    def test_the_edge_of_a_lamp_is_smoothed_and_its_inside_stays(self, rng):
        truth = np.full((48, 48, 3), 0.3, np.float32)
        truth[10:34, 12:40] = 20.0
        truth[10:34, 12] = 6.2
        hits = rng.binomial(16, 0.3, (24, 1)).astype(np.float32) / 16.0
        color = truth.copy()
        color[10:34, 12] = 0.3 + 19.7 * hits
        normal = np.where(truth > 1.0, 0.0, [0.0, 0.0, 1.0]).astype(np.float32)
        normal[10:34, 12, 2] = 1.0 - hits[:, 0]
        wall = np.minimum(color, np.float32(0.3))
        black = np.zeros_like(wall)
        albedos = {"diffuse_albedo": np.ones_like(wall), "specular_albedo": black}
        guides, light = GBuffer(normal=normal, depth=np.ones((48, 48)), **albedos), Radiance(color, wall, black)
        result = denoise(Frame(radiance=light, gbuffer=guides), **CHEAP)
        before, after = (np.abs(image - truth)[10:34, 12].mean() for image in (color, result.image))
        assert after < 0.8 * before
        # The wall's light in the lamp gives its share to the light that bounding took.
        np.testing.assert_allclose(result.image[13:31, 16:37], truth[13:31, 16:37], rtol=1e-4)
        assert (result.diffuse + result.specular <= result.image * (1.0 + 1e-5)).all()

    @pytest.mark.parametrize("quality", ["auto", "fast", "balanced", "high"])
    def test_radius_zero(self, quality):
        # No pass has a tap but the pixel's own: reflections stay as they are.
        frame, _ = make_shadowed()
        result = denoise(frame, radius=0, quality=quality, similarity="normal", with_oidn=False)
        assert result.settings["radius"] == 0
        assert result.energy_lost == 0.0
        np.testing.assert_allclose(result.specular, frame.radiance.specular, rtol=ROUNDING)
        # Of an exponential that is approximated.
        np.testing.assert_allclose(result.weight_sum, 1.0, rtol=1e-5)
        assert np.isfinite(result.image).all()


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return what stands for Open Image Denoise: its "image", and once it is called the first "frame".

    The images of layers, which tests of their own look at, do not count.
    """
    told: dict[str, Any] = {"image": np.full((*SHAPE, 3), 3.0, np.float32)}

    def run(frame: Frame, **options: Any) -> tuple[FloatArray, float]:
        told.setdefault("frame", frame)
        return told["image"], 0.1

    monkeypatch.setattr(combining, "denoise_oidn", run)
    monkeypatch.setattr(peers, "_run_library", lambda quality, is_clean=True, **images: next(iter(images.values())))
    monkeypatch.setattr(peers, "look_up_oidn_fault", lambda: None)
    monkeypatch.setattr(combining, "LAYERS_SHARE", 0.0)
    return told


@pytest.mark.parametrize(
    ("unguided", "spp", "share"),
    [(1.0, 16, 0.25), (1.525, 16, 0.125), (1.525, None, 0.125), (3.1, 1, 0.125), (50.0, 16, 0.0)],
)
def test_the_image_without_guides_counts_where_it_agrees(unguided: float, spp: float | None, share: float) -> None:
    """Half as much where it differs by twice the light, and by half of it at 16 samples, which are usual."""
    images = [np.full((*SHAPE, 3), value, np.float32) for value in (1.0, unguided)]
    mixed = combining.average_alike(*images, combining.UNGUIDED_SHARE, spp)
    np.testing.assert_allclose(mixed, 1.0 + share * (unguided - 1.0), atol=3e-3)


def test_guides_without_noise_are_not_filtered(peer: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[str, ...]] = []

    def prefilter(quality: str, is_clean: bool = True, **images: FloatArray) -> FloatArray:
        calls.append((quality, *images))
        return next(iter(images.values()))

    def run(frame: Frame, *, quality: str, guides: str) -> tuple[FloatArray, float]:
        calls.append((quality, guides, *frame.gbuffer.names))
        return peer["image"], 0.1

    monkeypatch.setattr(combining, "denoise_oidn", run)
    monkeypatch.setattr(peers, "_run_library", prefilter)
    frame = make_frame()
    guides = frame.gbuffer
    means = replace(
        guides,
        mean_normal=guides.normal,
        mean_diffuse_albedo=guides.diffuse_albedo,
        mean_specular_albedo=guides.specular_albedo,
    )
    # The normal is the same everywhere, and left out.
    prefiltered, guided = [("fast", "albedo")], ("high", "mean", "denoiser_albedo")
    for each, first, unguided in ((guides, prefiltered, "balanced"), (means, [], "fast")):
        calls.clear()
        image = frame.radiance.color
        denoise_with_peer(frame.with_changes(gbuffer=each), image, image)
        assert calls == [*first, guided, (unguided, "mean")]


def test_layers_are_filtered_by_themselves(peer: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each with its own albedo; one without much light stays ours, and one without an albedo goes by its light."""
    calls: list[Frame] = []

    def run(frame: Frame, *, guides: str, **_: Any) -> tuple[FloatArray, float]:
        if guides == "noisy":
            calls.append(frame)
        return np.full((*SHAPE, 3), 2.0, np.float32), 0.1

    monkeypatch.setattr(combining, "denoise_oidn", run)
    monkeypatch.setattr(combining, "LAYERS_SHARE", 0.5)
    light = [np.full((*SHAPE, 3), value, np.float32) for value in (2.0, 1.0, 1e-3)]
    albedo = np.full((*SHAPE, 3), 0.25, np.float32)
    layers = [LayerImage(light[0], light[0], albedo), LayerImage(light[1], light[1], None)]
    layers.append(LayerImage(light[2], light[2], albedo))
    total = light[0] + light[1] + light[2]
    found = denoise_with_peer(make_frame(), total, total, layers)
    first, second = calls
    np.testing.assert_array_equal(first.gbuffer.denoiser_albedo, albedo)
    assert second.gbuffer.denoiser_albedo is None
    assert [float(each.mean()) for each in found.layers] == pytest.approx([2.0, 2.0, 1e-3])
    # The library's image is 2 and the sum of its layers 4: they are too far apart to be mixed evenly.
    assert 2.0 < found.image.mean() < 2.0 + combining.LAYERS_SHARE * 2.0


def test_best_turns_the_frame_and_filters_layers_at_high_quality(
    peer: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The turned image of a slope is turned back: its mean with the other is the slope."""
    calls: list[tuple[str, ...]] = []
    slope = np.ones((*SHAPE, 3), np.float32) * np.linspace(1.0, 2.0, SHAPE[1], dtype=np.float32)[:, None]

    def prefilter(quality: str, is_clean: bool = True, **images: FloatArray) -> FloatArray:
        calls.append((quality, *images))
        return next(iter(images.values()))

    def run(frame: Frame, *, quality: str, guides: str) -> tuple[FloatArray, float]:
        calls.append((quality, guides))
        return frame.radiance.color, 0.1

    monkeypatch.setattr(combining, "denoise_oidn", run)
    monkeypatch.setattr(peers, "_run_library", prefilter)
    layers = [LayerImage(slope, slope, np.full_like(slope, 0.5))]
    found = denoise_with_peer(make_frame(), slope, slope, layers, is_best=True)
    guided = ("high", "mean")
    assert calls == [("fast", "albedo"), guided, guided, ("high", "noisy"), ("balanced", "mean")]
    np.testing.assert_allclose(found.image, slope, rtol=ROUNDING)


def test_best_needs_open_image_denoise() -> None:
    assert DenoiseSettings(quality="best").asks_for_oidn
    with refuses(InputError, "quality", got="'best'"):
        DenoiseSettings(quality="best", with_oidn=False)


def test_two_albedos_of_a_renderer_are_mixed() -> None:
    one = np.ones((*SHAPE, 3), np.float32)
    guides = GBuffer(denoiser_albedo=0.2 * one, mean_diffuse_albedo=0.3 * one, mean_specular_albedo=0.9 * one)
    np.testing.assert_allclose(mix_albedos(guides).denoiser_albedo, 0.4, rtol=1e-6)
    alone = replace(guides, mean_specular_albedo=None)
    assert mix_albedos(alone) is alone


@pytest.mark.parametrize("units", [4, 6, 16])
def test_a_network_of_any_size_reads_no_further(units: int) -> None:
    """Vectors that reach beyond the last unit read what lies in memory behind the weights."""
    rng = np.random.default_rng(2)
    shapes = [(5, units), (units, units), (units, 3), (units,), (units,), (3,)]
    values = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
    seen = rng.normal(size=(5, 7, 5)).astype(np.float32)

    def place(array: FloatArray, behind: float) -> FloatArray:
        memory = np.full(array.size + 32, behind, np.float32)
        memory[: array.size] = array.ravel()
        return memory[: array.size].reshape(array.shape)

    shares = []
    for behind in (0.0, np.nan, 1e30):
        arrays = [place(each, behind) for each in values]
        network = Perceptron(np.zeros(5, np.float32), np.ones(5, np.float32), tuple(arrays[:3]), tuple(arrays[3:]))  # type: ignore[arg-type]
        shares.append(compute_shares(seen, network, 3))
    layer = seen
    for number, (weights, bias) in enumerate(zip(values[:3], values[3:], strict=True)):
        layer = layer @ weights + bias
        layer = layer if number == 2 else np.maximum(layer, np.float32(PERCEPTRON_LEAK) * layer)
    expected = np.exp(layer) / np.exp(layer).sum(axis=-1, keepdims=True)
    for each in shares:
        np.testing.assert_allclose(each, expected, atol=1e-4)


def test_normals_are_smoothed_within_surfaces() -> None:
    """Noise of normals falls to a third and an edge stays: neighbours across it hardly count."""
    rng = np.random.default_rng(3)
    left = np.arange(32)[None, :, None] < 16
    clean = np.where(left, np.float32([0.0, 0.0, 1.0]), np.float32([1.0, 0.0, 0.0])) + np.zeros((24, 1, 1), np.float32)
    noisy = (clean + 0.05 * rng.standard_normal(clean.shape)).astype(np.float32)
    (smooth,) = HERE.pixels(define_smooth, {"image": noisy}, {"deviation": np.float32(NORMAL_DEVIATION / 4.0)})
    assert np.std(smooth - clean) < 0.4 * np.std(noisy - clean)
    assert np.abs(smooth - clean)[:, 15:17].max() < 0.12


OURS, NOISY, PEERS = 0, 1, 2


class TestPeer:
    def combine(self, frame: Frame, ours: FloatArray) -> FloatArray:
        noisy = frame.radiance.color
        return choose_between(frame, noisy, ours, denoise_with_peer(frame, noisy, ours).image, noisy).image

    def make_ours(self) -> FloatArray:
        return np.random.default_rng(8).uniform(0.5, 1.5, (*SHAPE, 3)).astype(np.float32)

    def test_either_alone_and_what_is_between(self, networks, peer):
        ours, usual = self.make_ours(), networks["peer"]
        networks["peer"] = force(usual, OURS)
        np.testing.assert_allclose(self.combine(make_frame(), ours), ours, rtol=ROUNDING)
        networks["peer"] = force(usual, PEERS)
        np.testing.assert_allclose(self.combine(make_frame(), ours), peer["image"], rtol=ROUNDING)
        networks["peer"] = usual
        noisy, mixed = make_frame().radiance.color, self.combine(make_frame(), ours)
        images = np.stack([ours, noisy, peer["image"]])
        bound = ROUNDING * images.max(axis=0)
        assert (mixed >= images.min(axis=0) - bound).all()
        assert (mixed <= images.max(axis=0) + bound).all()
        # In proportions that change from pixel to pixel.
        assert np.ptp((mixed - ours) / (peer["image"] - ours)) > 1e-3
        networks["peer"] = force(usual, NOISY)
        np.testing.assert_allclose(self.combine(make_frame(), ours), noisy, rtol=1e-5, atol=1e-6)

    def test_without_guides_it_is_the_peers(self, networks, peer):
        networks["peer"] = force(networks["peer"], OURS)
        frame, ours = make_frame(apart=False), self.make_ours()
        np.testing.assert_allclose(self.combine(frame, ours), ours, rtol=ROUNDING)
        flat = np.zeros((*SHAPE, 3), np.float32)
        flat[..., 2] = 1.0
        bare = frame.with_changes(gbuffer=GBuffer(normal=flat))
        np.testing.assert_array_equal(self.combine(bare, ours), peer["image"])

    def test_the_peer_is_given_the_frame(self, networks, peer):
        frame = make_frame()
        self.combine(frame, self.make_ours())
        given, albedo = peer["frame"], frame.gbuffer.diffuse_albedo + frame.gbuffer.specular_albedo
        np.testing.assert_array_equal(given.radiance.color, frame.radiance.color)
        np.testing.assert_array_equal(given.gbuffer.denoiser_albedo, albedo)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0], ids=str)
    def test_what_the_peer_spoils_is_ours(self, bad, networks, peer):
        networks["peer"] = force(networks["peer"], PEERS)
        ours = self.make_ours()
        peer["image"][3, 4, 1] = bad
        mixed = self.combine(make_frame(), ours)
        np.testing.assert_allclose(mixed[3, 4], ours[3, 4], rtol=ROUNDING)
        mixed[3, 4] = 3.0
        np.testing.assert_allclose(mixed, 3.0, rtol=ROUNDING)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0], ids=str)
    def test_bad_pixels_do_not_reach_the_peer(self, bad, networks, peer):
        frame, ours = make_frame(), self.make_ours()
        color = np.array(frame.radiance.color)
        color[3, 4, 1] = bad
        mixed = self.combine(frame.with_changes(radiance=replace(frame.radiance, color=color)), ours)
        given = peer["frame"]
        np.testing.assert_array_equal(given.radiance.color[3, 4], ours[3, 4])
        color[3, 4] = ours[3, 4]
        np.testing.assert_array_equal(given.radiance.color, color)
        assert np.isfinite(mixed).all()

    def test_parts_are_shared_out_by_what_they_had(self):
        # Both kinds; exact light alone; both, and darker than the exact light alone; neither, between such pixels.
        diffuse, specular = np.full((1, 4, 3), 0.6, np.float32), np.full((1, 4, 3), 0.2, np.float32)
        diffuse[0, [1, 3]], specular[0, [1, 3]] = 0.0, 0.0
        specular[0, 0] = np.nan
        before = np.float32([[[0.7] * 3, [0.5] * 3, [1.8] * 3, [0.0] * 3]])
        mixed = np.float32([[[1.3] * 3, [0.9] * 3, [0.4] * 3, [0.2] * 3]])
        image, (scattered, reflected), gain = share_out(mixed, before, [diffuse, specular])
        np.testing.assert_allclose(image[0, :, 0], [1.3, 0.9, 0.4, 0.2], rtol=1e-5)
        np.testing.assert_allclose(scattered[0, :, 0], [1.2, 0.0, 0.6 / 9.0, 0.2 * 1.2 / 1.4], rtol=1e-5)
        np.testing.assert_allclose(reflected[0, :, 0], [0.0, 0.0, 0.2 / 9.0, 0.2 * 0.2 / 1.4], atol=1e-6)
        np.testing.assert_allclose(gain[0, :, 0], [1.0, 1.8, 0.4 - 0.8 / 9.0, 1.0], rtol=1e-5)
        rest = before - np.nan_to_num(diffuse) - np.nan_to_num(specular)
        np.testing.assert_allclose(scattered + reflected + rest * gain, image, rtol=1e-5, atol=1e-6)

    @pytest.mark.usefixtures("trusted")
    def test_the_passes_of_a_result_make_up_its_image(self, networks, peer):
        networks["peer"] = force(networks["peer"], PEERS)
        frame = make_frame()
        shone = np.zeros((*SHAPE, 3), np.float32)
        # A sky, a lamp that is brighter than what the peer makes of it, and surfaces.
        shone[:4], shone[6, 7] = 0.7, 50.0
        light, guides = frame.radiance, frame.gbuffer
        dark = {name: np.where(shone > 0.0, np.float32(0.0), getattr(light, name)) for name in ("diffuse", "specular")}
        radiance = Radiance(dark["diffuse"] + dark["specular"] + shone, **dark)
        normal, depth = np.array(guides.normal), np.array(guides.depth)
        normal[:4], depth[:4] = 0.0, 0.0
        bare = {"half_a": None, "half_b": None, "variance": None, "unscattered": {"emission": shone}}
        frame = frame.with_changes(radiance=radiance, gbuffer=replace(guides, normal=normal, depth=depth), **bare)
        result = denoise(frame, similarity="normal", with_oidn=True)
        assert (result.image == peer["image"]).all(axis=-1).mean() > 0.9
        total = result.diffuse + result.specular + result.also["emission"]
        np.testing.assert_allclose(total, result.image, rtol=1e-4, atol=1e-5)

    @pytest.mark.usefixtures("trusted")
    @pytest.mark.parametrize("apart", [True, False], ids=["apart", "combined"])
    def test_denoise_mixes_when_asked(self, apart, networks, peer):
        frame, usual = make_frame(apart=apart), networks["peer"]
        for quality, used in (("auto", "balanced"), ("high", "high")):
            peer.pop("frame", None)
            plain = denoise(frame, similarity="normal", quality=used)
            assert "frame" not in peer
            assert (plain.diffuse is not None) is (plain.specular is not None) is apart
            for chosen, expected in ((OURS, plain.image), (PEERS, peer["image"])):
                networks["peer"] = force(usual, chosen)
                result = denoise(frame, similarity="normal", quality=quality, with_oidn=True)
                np.testing.assert_allclose(result.image, expected, rtol=ROUNDING)
                assert result.settings["quality"] == used
                assert result.settings["with_oidn"] is True
                assert (result.diffuse is not None) is (result.specular is not None) is apart

    @pytest.mark.usefixtures("networks", "peer", "trusted")
    def test_a_written_file_has_the_mixture_and_its_parts(self, tmp_path):
        source, out = tmp_path / "in.exr", tmp_path / "out.exr"
        write_frame(source, make_frame(), half=False)
        before = read_frame(source)
        result = denoise(before, similarity="normal", with_oidn=True)
        write_result(out, result, source=source)
        after = read_frame(out)
        np.testing.assert_array_equal(after.radiance.color, result.image)
        # Where the network takes more than nothing of either, both parts and the rest are the whole.
        radiance = before.radiance
        rest = np.maximum(radiance.color - radiance.diffuse - radiance.specular, 0.0)
        parts = after.radiance.diffuse + after.radiance.specular
        whole = (parts > 0.0) & (result.image > rest)
        assert whole.mean() > 0.5
        np.testing.assert_allclose((parts + rest)[whole], result.image[whole], rtol=1e-2, atol=1e-3)
        for item in fields(before.gbuffer):
            np.testing.assert_array_equal(getattr(after.gbuffer, item.name), getattr(before.gbuffer, item.name))
        attributes = {item.name: item.value for item in read_container(out).parts[0].attributes}
        assert json.loads(attributes["lobewise/denoised"])["with_oidn"] is True

    def test_one_that_is_not_installed_is_told_before_anything_is_filtered(self, monkeypatch):
        fault = peers.OidnFault("It is not installed", "pip install 'lobewise[best]'", is_installed=False)
        monkeypatch.setattr(peers, "look_up_oidn_fault", lambda: fault)
        monkeypatch.setattr(chain, "filter_halves", lambda *_: pytest.fail("filtered first"))
        for quality in ("auto", "high"):
            with refuses(MissingDependencyError, action="pip install 'lobewise[best]'"):
                denoise(make_frame(), similarity="normal", quality=quality, with_oidn=True)

    @pytest.mark.skipif(not peers.has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[best]'")
    @pytest.mark.usefixtures("trusted")
    def test_the_real_one(self, networks):
        networks["peer"] = force(networks["peer"], PEERS)
        frame, noise = make_frame(), np.random.default_rng(2).gamma(60.0, 1.0 / 60.0, (2, *SHAPE, 1))
        # Without a firefly the peer is given the frame as it is.
        frame = frame.with_changes(radiance=Radiance(0.3 * noise.sum(axis=0) * np.ones(3)))
        result = denoise(frame, similarity="normal", with_oidn=True)
        color = frame.radiance.color
        np.testing.assert_allclose(result.image, denoise_with_peer(frame, color, color).image, rtol=1e-4, atol=1e-5)


class TestSettings:
    def test_open_image_denoise_is_mixed_with_balanced_unless_high_is_named(self):
        for quality, used in (("auto", "balanced"), ("balanced", "balanced"), ("high", "high")):
            assert choose_quality(DenoiseSettings(quality=quality, with_oidn=True)) == used

    def test_what_has_fast_alone_does_not_mix(self):
        sparse = make_sparse(make_frame((8, 8)), 2)
        with refuses(InputError, "quality", expected="'fast' for upsampling"):
            upsample(sparse, with_oidn=True)
        with refuses(InputError, "quality", expected="'fast' for a filter with history"):
            TemporalFilter(with_oidn=True)


class TestWeights:
    def test_the_shipped_networks_fit(self):
        found = load_networks()
        assert sorted(found) == ["noisy", "peer", "refined"]
        shares = {
            "noisy": (detail.DETAIL_FEATURES, 2),
            "refined": (detail.DETAIL_FEATURES, 2),
            "peer": (agreement.AGREEMENT_FEATURES + detail.DETAIL_FEATURES, 3),
        }
        for kind, network in found.items():
            inputs, candidates = shares[kind]
            assert network.mean.shape == network.scale.shape == (inputs,)
            assert network.weights[0].shape[0] == inputs
            assert network.weights[-1].shape[1] == candidates
            for weights, bias in zip(network.weights, network.biases, strict=True):
                assert weights.shape[1:] == bias.shape
            for before, after in pairwise(network.weights):
                assert before.shape[1] == after.shape[0]
            for array in (network.mean, network.scale, *network.weights, *network.biases):
                assert array.dtype == np.float32
                assert np.isfinite(array).all()
            assert (network.scale > 0.0).all()


@pytest.mark.parametrize(("quality", "name"), [("balanced", "noisy"), ("high", "refined")])
def test_each_quality_takes_back_by_its_own_network(quality: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    class Recorded(dict[str, Perceptron]):
        def __getitem__(self, key: str) -> Perceptron:
            asked.append(key)
            return super().__getitem__(key)

    monkeypatch.setattr(evidence, "load_networks", lambda: Recorded(load_networks()))
    denoise(make_frame((24, 24)), quality=quality)
    assert asked == [name]


def test_an_error_of_the_mixture_at_a_lamp_stays_small_in_the_light_that_the_lamp_scatters() -> None:
    scattered, lamp = np.full((1, 1, 3), 0.02, np.float32), np.float32(60.0)
    before = scattered + lamp
    image, (part,), gain = share_out(before * np.float32(1.05), before, [scattered])
    assert part.max() < 0.05
    np.testing.assert_allclose(part + lamp * gain, image, rtol=1e-6)


@pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[best]'")
@pytest.mark.parametrize("apart", [True, False], ids=["apart", "combined"])
@pytest.mark.parametrize("quality", ["balanced", "high", "auto"])
def test_a_huge_pixel_changes_no_more_than_one_at_the_bound(quality: str, apart: bool) -> None:
    frame = make_frame((64, 80))
    images = []
    for value in (3e3, 1e4, 1e8, 1e38):
        diffuse, specular = frame.radiance.parts or ()
        specular = np.array(specular)
        specular[30, 40] = value
        parts = (diffuse, specular) if apart else ()
        images.append(denoise(frame.with_changes(radiance=Radiance(diffuse + specular, *parts)), quality=quality).image)
    for image in images[1:]:
        # What bounding took is told apart from noise: up to a fortieth of a layer's light is shared out.
        np.testing.assert_allclose(image, images[0], rtol=0.06)


@pytest.mark.skipif(not has_oidn(), reason="needs Open Image Denoise: pip install 'lobewise[best]'")
def test_a_layered_frame_with_bad_pixels_is_mixed() -> None:
    frame = make_frame(SHAPE)
    diffuse, specular = (np.array(part) for part in frame.radiance.parts or ())
    diffuse[3, 4] = np.nan
    layers = (
        RadianceLayer("one", "diffuse", diffuse, frame.gbuffer.diffuse_albedo),
        RadianceLayer("two", "glossy", specular, frame.gbuffer.specular_albedo),
    )
    frame = frame.with_changes(radiance=Radiance(diffuse + specular, diffuse, specular), layers=layers)
    assert np.isfinite(denoise(frame, with_oidn=True).image).all()
