"""filters/refinement: the kernels agree with the definition in NumPy, for every size, set of images and cut."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.devices import make_target
from lobewise.backend.jit import compile_kernel
from lobewise.errors import InputError
from lobewise.filters.refinement import planes, shape
from lobewise.filters.refinement.convolutions import make_convolution
from lobewise.filters.refinement.pyramid import make_averages, make_filter, make_sums
from lobewise.filters.refinement.run import pack_weights, refine_image
from lobewise.records.frame import FloatArray
from tests.mistakes import refuses

Exact = NDArray[np.float64]
Images = dict[str, FloatArray]
SIZE = (35, 38)
"""No multiple of the blocks of any level."""
NUMBERS: dict[str, Any] = {"brightness": 0.7, "mean_log_depth": 0.5, "shared": True}
MAX_CODE_BYTES = 100_000
"""Of all object files together."""
TOLERANCE = 2e-4
"""Relative: polynomials stand for logarithms and exponentials."""


def make_images(size: tuple[int, int] = SIZE, seed: int = 1) -> Images:
    """Return every image that the network reads."""
    rng = np.random.default_rng(seed)
    images = {name: rng.gamma(0.5, 2.0, (*size, 3)).astype(np.float32) for name in ("noisy", "filtered", "change")}
    for name, channels in planes.OPTIONAL.items():
        images.setdefault(name, rng.random((*size, channels) if channels else size, dtype=np.float32))
    images["depth"][::3] = 0.0
    images["lobe_sharpness"] *= 6.0
    return images


def make_weights(seed: int = 2) -> dict[str, FloatArray]:
    """Return random weights of every layer, as a file has them."""
    rng = np.random.default_rng(seed)
    found = {}
    for name, layer in shape.LAYERS.items():
        side, inputs = (2, layer.inputs // 4) if name == "stem" else (layer.side, layer.inputs)
        scale = (side * side * inputs) ** -0.5
        found[f"{name}.weight"] = (scale * rng.normal(size=(layer.outputs, inputs, side, side))).astype(np.float32)
        found[f"{name}.bias"] = (0.1 * rng.normal(size=layer.outputs)).astype(np.float32)
    return found


WEIGHTS = make_weights()


def refine(images: Images, **options: Any) -> FloatArray:
    """Return the refined image by the kernels."""
    return np.asarray(refine_image(dict(images), pack_weights(WEIGHTS), **{**NUMBERS, **options}))


class Definition:
    """The network and its pyramid in NumPy: images are (rows, columns, channels)."""

    def __init__(self, weights: dict[str, FloatArray]) -> None:
        self.weights = {name: each.astype(np.float64) for name, each in weights.items()}

    def convolve(self, name: str, image: Exact, *, active: bool = True) -> Exact:
        """Return a convolution with zeros outside the image."""
        weight, bias = self.weights[f"{name}.weight"], self.weights[f"{name}.bias"]
        if name == "stem":
            image = pad_even(image)
            total = bias + sum(image[v::2, u::2] @ weight[:, :, v, u].T for v in range(2) for u in range(2))
        else:
            total = bias + sum(each @ weight[:, :, v, u].T for v, u, each in list_taps(image, weight.shape[-1]))
        return np.where(total > 0.0, total, 0.1 * total) if active else total

    def compute_features(self, image: Exact) -> list[Exact]:
        """Return the features of every level."""
        last, seen = self.convolve("stem", image), {}
        for level in range(1, shape.LEVEL_COUNT):
            if level > 1:
                last = pad_even(last, -np.inf)
                last = np.max([last[v::2, u::2] for v in range(2) for u in range(2)], axis=0)
            last = self.convolve(f"down.{level - 1}.1", self.convolve(f"down.{level - 1}.0", last))
            seen[level] = last
        features = [last]
        for level in reversed(range(1, shape.LEVEL_COUNT - 1)):
            joined = np.concatenate([enlarge(features[0], seen[level]), seen[level]], axis=-1)
            name = f"up.{level - 1}"
            features.insert(0, self.convolve(f"{name}.1", self.convolve(f"{name}.0", joined)))
        squeezed = self.convolve("squeeze", features[0])
        fine = np.concatenate([enlarge(squeezed, image), image], axis=-1)
        return [self.convolve("fine.1", self.convolve("fine.0", fine)), *features]

    def run(self, planes: Exact, light: Exact, vectors: Exact, tint: Exact) -> Exact:
        """Return the filtered light; the light is not divided by the tint before."""
        features = self.compute_features(planes)
        logits = [self.convolve(f"heads.{level}", each, active=False) for level, each in enumerate(features)]
        sources = 1e-3 + 1.0 / (1.0 + np.exp(-2.0 - logits[0][..., -3:-1]))
        tint = 1.0 + (tint - 1.0) / (1.0 + np.exp(-4.0 - logits[0][..., -1:]))
        light = light / np.concatenate([tint, tint], axis=-1)
        sums = np.concatenate(
            [
                np.concatenate([light[..., 3 * k : 3 * k + 3] * sources[..., k : k + 1], sources[..., k : k + 1]], -1)
                for k in range(2)
            ],
            axis=-1,
        )
        pyramid = [(sums, vectors)]
        for _ in range(shape.LEVEL_COUNT - 1):
            halved = (pad_even(each) for each in pyramid[-1])
            pyramid.append(
                tuple(0.25 * sum(each[v::2, u::2] for v in range(2) for u in range(2)) for each in halved)  # type: ignore[arg-type]
            )
        coarse: Exact | None = None
        for level in reversed(range(shape.LEVEL_COUNT)):
            coarse = filter_level(level, logits[level], *pyramid[level], coarse)
        return coarse * tint


def filter_level(level: int, logits: Exact, sums: Exact, vectors: Exact, coarse: Exact | None) -> Exact:
    """Return the filtered light of a level."""
    places = shape.place_logits(level)
    exponents = np.exp(np.minimum(2.0 * logits[..., places.exponents : places.exponents + 2] - 1.0, 3.0))
    bounded = np.clip(logits, -20.0, 20.0)
    total = np.zeros((*sums.shape[:2], 4))
    for side, first, part in ((5, places.noisy, sums[..., :4]), (3, places.filtered, sums[..., 4:])):
        near = zip(list_taps(part, side), list_taps(vectors, side), strict=True)
        for k, ((_, _, light), (_, _, other)) in enumerate(near):
            squares = (vectors - other) ** 2
            distance = sum(exponents[..., g] * squares[..., 4 * g : 4 * g + 4].sum(-1) for g in range(2))
            total += np.exp(bounded[..., first + k] - distance)[..., None] * light
    if coarse is not None:
        above = np.concatenate([coarse, np.ones((*coarse.shape[:2], 1))], axis=-1)
        for k, (_, _, each) in enumerate(list_taps(above, 3)):
            total += np.exp(bounded[..., places.coarse + k])[..., None] * enlarge(each, sums)
    return np.asarray(total[..., :3] / total[..., 3:])


def list_taps(image: Exact, side: int) -> Iterable[tuple[int, int, Exact]]:
    """Yield row, column and shifted image of every tap, 0 outside the image."""
    radius, (rows, columns) = side // 2, image.shape[:2]
    padded = np.pad(image, ((radius, radius), (radius, radius), (0, 0)))
    for v in range(side):
        for u in range(side):
            yield v, u, padded[v : v + rows, u : u + columns]


def pad_even(image: Exact, value: float = 0.0) -> Exact:
    """Return an image of an even number of rows and columns."""
    return np.pad(image, ((0, image.shape[0] % 2), (0, image.shape[1] % 2), (0, 0)), constant_values=value)


def enlarge(image: Exact, like: Exact) -> Exact:
    """Return every pixel four times, cut to the size of another image."""
    return np.asarray(image.repeat(2, axis=0).repeat(2, axis=1)[: like.shape[0], : like.shape[1]])


def make_definition(images: Images) -> Exact:
    """Return the refined image by the definition."""
    exact = {name: each.astype(np.float64) for name, each in images.items()}
    size = exact["noisy"].shape[:2]

    def read(name: str) -> Exact:
        channels = max(planes.OPTIONAL[name], 1)
        return exact[name].reshape(*size, channels) if name in exact else np.zeros((*size, channels))

    tint = np.maximum(exact["albedo"], 0.1) if "albedo" in exact else np.ones((*size, 3))
    light = [exact[name] / NUMBERS["brightness"] for name in ("noisy", "filtered")]
    depth, log_depth = read("depth"), np.zeros((*size, 1))
    if "depth" in exact:
        with np.errstate(divide="ignore"):
            log_depth = np.clip(np.log(depth) - NUMBERS["mean_log_depth"], -4.0, 4.0)
        log_depth[depth <= 0.0] = 4.0
    change = (read("change") / tint / NUMBERS["brightness"]).mean(axis=-1, keepdims=True)
    flags = [np.full((*size, 1), float(name in exact)) for name in ("albedo", "depth", "roughness", "change")]
    compressed = [0.5 * np.log1p(10.0 * each) for each in (*(each / tint for each in light), change)]
    seen = [*compressed[:2], read("albedo"), read("normal"), 0.25 * log_depth, read("roughness")]
    seen += [read("specular_share"), compressed[2], *flags, np.full((*size, 1), float(NUMBERS["shared"]))]
    sharpness = read("lobe_sharpness")
    lobes = [0.37 * 2.0 ** (0.5 * (sharpness - 1.0)) * read("lobe_axis"), 0.37 * sharpness]
    vectors = [0.66 * read("normal"), 1.2 * log_depth, *lobes]
    found = Definition(WEIGHTS).run(*(np.concatenate(each, axis=-1) for each in (seen, light, vectors)), tint)
    return found * NUMBERS["brightness"]


@pytest.mark.parametrize("size", [SIZE, (16, 48), (1, 1), (2, 19)], ids=str)
def test_the_kernels_agree_with_the_definition(size: tuple[int, int]) -> None:
    images = make_images(size)
    np.testing.assert_allclose(refine(images), make_definition(images), rtol=TOLERANCE)


@pytest.mark.parametrize(
    "known", [(), ("albedo", "normal", "depth"), ("change", "lobe_axis", "lobe_sharpness")], ids=str
)
def test_images_that_are_not_known_count_nothing(known: tuple[str, ...]) -> None:
    images = {name: image for name, image in make_images().items() if name in ("noisy", "filtered", *known)}
    np.testing.assert_allclose(refine(images), make_definition(images), rtol=TOLERANCE)


@pytest.mark.sampled("vulkan")
def test_graphics_cards_agree_with_the_processor(device: str) -> None:
    images = make_images()
    found = refine(images)
    with engine.on("cpu"):
        np.testing.assert_allclose(found, refine(images), rtol=1e-4)


@pytest.mark.nightly
@pytest.mark.processor
def test_one_small_kernel_serves_all_layers() -> None:
    """Code for each layer and level takes many times as long to compile."""
    makers = (make_convolution, make_sums, make_averages, make_filter)
    code = [compile_kernel(make, make_target("cpu"), make.__name__)[0] for make in makers]
    assert sum(map(len, code)) < MAX_CODE_BYTES


def test_the_mean_is_convex() -> None:
    images = make_images() | {"albedo": np.ones((*SIZE, 3), np.float32)}
    images["noisy"], images["filtered"] = (np.clip(images[name], 0.5, 2.0) for name in ("noisy", "filtered"))
    found = refine(images)
    assert 0.5 * (1.0 - 1e-5) <= found.min() <= found.max() <= 2.0 * (1.0 + 1e-5)


def test_a_cut_at_a_block_keeps_the_bits() -> None:
    height = 2 * shape.REFINEMENT_REACH + 3 * shape.MULTIPLE
    images = make_images((height, 9))
    whole = refine(images)
    first = 2 * shape.MULTIPLE
    below = refine({name: image[first:] for name, image in images.items()})
    np.testing.assert_array_equal(below[shape.REFINEMENT_REACH :], whole[first + shape.REFINEMENT_REACH :])
    above = refine({name: image[:-first] for name, image in images.items()})
    np.testing.assert_array_equal(above[: -shape.REFINEMENT_REACH], whole[: -first - shape.REFINEMENT_REACH])


@pytest.mark.parametrize("factor", [1e-30, 1e30])
def test_a_brighter_image_is_the_same_image(factor: float) -> None:
    images = make_images()
    scaled = {**images, **{name: images[name] * np.float32(factor) for name in ("noisy", "filtered", "change")}}
    found = refine(scaled, brightness=factor * NUMBERS["brightness"])
    np.testing.assert_allclose(found, refine(images) * np.float32(factor), rtol=1e-4)


def test_the_largest_numbers_do_not_overflow() -> None:
    images = make_images()
    images["noisy"][3, 4] = images["filtered"][5, 6] = np.finfo(np.float32).max
    assert np.isfinite(refine(images)).all()


def test_weights_of_another_shape_are_refused() -> None:
    spoiled = {**WEIGHTS, "squeeze.bias": np.zeros(3, np.float32)}
    with refuses(InputError, "squeeze.bias"):
        pack_weights(spoiled)
    with refuses(InputError, "stem.weight"):
        pack_weights({name: each for name, each in WEIGHTS.items() if name != "stem.weight"})


def test_an_image_of_another_size_is_refused() -> None:
    with refuses(InputError, "albedo"):
        refine(make_images() | {"albedo": np.ones((3, 4, 3), np.float32)})
