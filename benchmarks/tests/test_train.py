"""benchmarks/training/train.py: its derivatives, its steps, its weights of examples, and that it learns."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.special import softmax

from lobewise.filters.mixing import Network, find_features, mix_candidates
from lobewise.filters.mixing_pass import count_features
from lobewise.frame import Frame
from lobewise.metrics import EPSILON
from tests.filters.test_mixing import CANDIDATES, EXTRAS, make_inputs

SLOPE = 2e-5
"""Relative, of the largest: steps of 1e-5 in float64 leave 1e-10 of a value's rounding over 1e-5."""

pytestmark = pytest.mark.slow


@pytest.fixture
def train(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the program, with small networks."""
    module = importlib.import_module("benchmarks.training.train")
    monkeypatch.setattr(module, "UNITS", (6, 5))
    monkeypatch.setattr(module, "BATCH", 256)
    return module


def make_exact(train: ModuleType, features: Any, candidates: int, rng: np.random.Generator) -> Network:
    """Return an untrained network in float64, none of whose parameters is 0."""
    network = train.make_network(features, candidates, rng)
    weights = tuple(each.astype(np.float64) + 0.3 * rng.normal(size=each.shape) for each in network.weights)
    biases = tuple(0.3 * rng.normal(size=each.shape) for each in network.biases)
    return Network(network.mean, network.scale, weights, biases)  # type: ignore[arg-type]


def test_derivatives_are_those_of_finite_differences(train: ModuleType, rng: np.random.Generator) -> None:
    features = rng.normal(2.0, 3.0, (40, 7))
    network = make_exact(train, features, 3, rng)
    pull = rng.normal(size=(40, 3))

    def find_loss() -> float:
        return float((train.run_forward(network, features)[0] * pull).sum())

    shares, values = train.run_forward(network, features)
    np.testing.assert_allclose(shares, softmax(values[-1], axis=1), rtol=1e-12)
    slopes = train.run_backward(network, values, shares, pull)
    parameters = train.list_parameters(network)
    assert [each.shape for each in slopes] == [each.shape for each in parameters]
    step = 1e-5
    for parameter, slope in zip(parameters, slopes, strict=True):
        expected = np.zeros_like(slope)
        for at in np.ndindex(parameter.shape):
            usual = parameter[at]
            ends = []
            for parameter[at] in (usual + step, usual - step):
                ends.append(find_loss())
            parameter[at] = usual
            expected[at] = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(slope, expected, rtol=SLOPE, atol=SLOPE * np.abs(expected).max())
        assert np.abs(slope).max() > 1e-3


def test_shares_are_those_of_the_kernel(train: ModuleType, rng: np.random.Generator) -> None:
    pairs, middle, extras, level = make_inputs((9, 20))
    features = find_features(pairs, middle, extras, level).reshape(-1, count_features(CANDIDATES, EXTRAS))
    # The first layers' gains, without the small one of the last.
    network = train.make_network(features, CANDIDATES, rng)
    network = network._replace(weights=(*network.weights[:2], 10.0 * network.weights[2]))
    shares, _ = train.run_forward(network, features)
    assert np.ptp(shares, axis=0).min() > 0.2
    means = np.stack([0.5 * (a + b) for a, b in pairs], axis=2).reshape(-1, CANDIDATES, 3)
    expected = (shares[..., None] * means).sum(axis=1)
    mixed = mix_candidates(pairs, middle, extras, level, network)
    # The kernels' exp2 is good to 1e-5, twice; scores are sums in float32.
    np.testing.assert_allclose(mixed.reshape(-1, 3), expected, rtol=5e-5, atol=1e-9)


def test_an_untrained_network_gives_near_equal_shares(train: ModuleType, rng: np.random.Generator) -> None:
    features = rng.normal([-4.0, 2.0, 0.0], [3.0, 0.5, 1e-9], (500, 3)).astype(np.float32)
    network = train.make_network(features, 4, rng)
    shares, (scaled, *_) = train.run_forward(network, features)
    np.testing.assert_allclose(scaled[:, :2].std(axis=0), 1.0, rtol=1e-3)
    # What never changes is not blown up.
    assert np.abs(scaled[:, 2]).max() < 1e-3
    assert np.abs(shares - 0.25).mean() < 0.05


def test_steps_are_those_of_the_paper(train: ModuleType, rng: np.random.Generator) -> None:
    """Source: Kingma and Ba 2015, "Adam: A Method for Stochastic Optimization", algorithm 1."""
    value = rng.normal(size=(3, 4))
    expected, mean, square = value.copy(), np.zeros((3, 4)), np.zeros((3, 4))
    optimiser = train.Adam([value])
    for t in range(1, 8):
        slope, rate = rng.normal(size=(3, 4)) * 10.0 ** rng.integers(-3, 3), 0.1 / t
        optimiser.move([slope], rate)
        mean = 0.9 * mean + 0.1 * slope
        square = 0.999 * square + 0.001 * slope**2
        expected -= rate * (mean / (1.0 - 0.9**t)) / (np.sqrt(square / (1.0 - 0.999**t)) + 1e-8)
        # The rate is a float32.
        np.testing.assert_allclose(value, expected, rtol=1e-6, atol=1e-7)


def make_examples(train: ModuleType, rng: np.random.Generator, count: int = 4000) -> Any:
    """Return pixels of two layers, each of which has two candidates: one is right, the sign of a feature says which."""
    features, candidates, parts = {}, {}, []
    for kind in train.KINDS:
        seen = rng.normal(size=(count, 5)).astype(np.float32)
        part = rng.uniform(0.5, 1.5, (count, 1, 3)).astype(np.float32)
        right = np.stack([seen[:, 2] > 0.0, seen[:, 2] <= 0.0], axis=1)[..., None]
        features[kind], candidates[kind] = seen, np.where(right, part, part + np.float32(0.5))
        parts.append(part[:, 0])
    target = np.sum(parts, axis=0)
    weight = np.full((count, 3), 4.0, np.float32)
    return train.Examples(features, candidates, target, weight, 0.0)


def test_a_choice_is_learned(train: ModuleType, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]) -> None:
    examples, others = make_examples(train, rng), make_examples(train, rng)
    before = {kind: train.make_network(examples.features[kind], 2, rng) for kind in train.KINDS}
    # Half of each error of 1/2, twice: 1/4 of a unit, squared and weighted.
    assert train.measure(before, others) == pytest.approx(1.0, rel=0.1)
    networks = train.train(examples, 1000, 1)
    assert sorted(networks) == sorted(train.KINDS)
    assert train.measure(networks, others) < 0.1
    again = train.train(examples, 1000, 1)
    for kind, network in networks.items():
        for a, b in zip(train.list_parameters(network), train.list_parameters(again[kind]), strict=True):
            np.testing.assert_array_equal(a, b)
    assert "step 0" in capsys.readouterr().out


def test_fireflies_pull_no_harder_than_the_cap(train: ModuleType, rng: np.random.Generator) -> None:
    # Were their squares to count, the network would follow the fireflies, which want the wrong candidate.
    examples = make_examples(train, rng)
    wrong = rng.random(len(examples.target)) < 0.02
    for kind in train.KINDS:
        examples.candidates[kind][wrong] = 1e3 * examples.candidates[kind][wrong][:, ::-1]
    examples.target[wrong] = sum(1e3 * np.ones(3, np.float32) for _ in train.KINDS)
    assert train.measure(train.train(examples, 1000, 1), make_examples(train, rng)) < 0.4


def test_the_noise_of_the_reference_is_taken_off(train: ModuleType, rng: np.random.Generator) -> None:
    shape = (60, 50, 3)
    truth = rng.uniform(0.5, 1.5, shape)
    before, rest = (truth * rng.gamma(20.0, 0.05, shape)).astype(np.float32), np.full(shape, 0.2, np.float32)
    a, b = ((truth * rng.gamma(50.0, 0.02, shape)).astype(np.float32) for _ in range(2))
    scene = train.Scene((a, b), np.ones(shape[:2], bool))
    features = {"specular": rng.normal(size=(*shape[:2], 4)).astype(np.float32)}
    found = train.make_examples(scene, rest, features, {"specular": [before - rest]}, before)
    alone = {"specular": train.make_network(found.features["specular"], 1, rng)}
    # What the error is relative to has an error of 1, whatever the noise of the reference.
    assert train.measure(alone, found) == pytest.approx(1.0, rel=1e-4)
    relative = 1.0 / (scene.reference.astype(np.float64) ** 2 + EPSILON)
    np.testing.assert_allclose(
        found.weight / found.weight[0, 0], relative.reshape(-1, 3) / relative[0, 0, 0], rtol=1e-5
    )
    # Without noise of the reference's own: the spread of a gamma of 20 is 1/20, and that of the reference 1/100.
    assert found.noise == pytest.approx((1 / 100) / (1 / 20), rel=0.15)
    perfect = train.make_examples(scene, rest, features, {"specular": [(truth - rest).astype(np.float32)]}, before)
    assert train.measure(alone, perfect) == pytest.approx(0.0, abs=0.02)


def test_examples_are_those_that_were_chosen(train: ModuleType, rng: np.random.Generator, full_frame: Frame) -> None:
    shape = (9, 13)
    chosen = rng.random(shape) < 0.3
    images = [rng.random((*shape, 3)).astype(np.float32) for _ in range(6)]
    scene = train.Scene((images[0], images[1]), chosen)
    features = {"peer": rng.normal(size=(*shape, 4)).astype(np.float32)}
    found = train.make_examples(scene, images[2], features, {"peer": images[3:5]}, images[5])
    np.testing.assert_array_equal(found.features["peer"], features["peer"][chosen])
    for k in range(2):
        np.testing.assert_array_equal(found.candidates["peer"][:, k], images[3 + k][chosen])
    np.testing.assert_allclose(found.target, (0.5 * (images[0] + images[1]) - images[2])[chosen], atol=1e-6)
    both = train.join([found, found])
    assert len(both.target) == len(both.weight) == 2 * np.count_nonzero(chosen)
    np.testing.assert_array_equal(both.candidates["peer"][len(found.target) :], found.candidates["peer"])
    assert both.noise == pytest.approx(found.noise)
    rest = train.find_rest(full_frame)
    radiance = full_frame.radiance
    np.testing.assert_array_equal(rest, np.maximum(radiance.color - radiance.diffuse - radiance.specular, 0.0))
