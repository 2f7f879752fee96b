"""Gradients pass through a denoiser with fixed weights, exactly; everything else refuses them."""

from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.mitsuba import Denoiser
from tests.mistakes import refuses

pytestmark = pytest.mark.mitsuba

HEIGHT, WIDTH = 12, 16


@pytest.fixture
def images(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a noisy image with a lamp and a bad pixel, and guides of two walls, one of them textured."""
    noisy = rng.gamma(2.0, 0.5, (HEIGHT, WIDTH, 3))
    noisy[2:6, 2:6] = 60.0
    noisy[8, 3] = np.nan
    left = np.arange(WIDTH)[None, :, None] < 9
    normals = np.where(left, [0.6, 0.0, -0.8], [-0.3, 0.0, -0.95]) * np.ones((HEIGHT, 1, 1))
    albedo = rng.uniform(0.2, 0.9, (HEIGHT, WIDTH, 3))
    return {
        name: image.astype(np.float32) for name, image in (("noisy", noisy), ("normals", normals), ("albedo", albedo))
    }


def make_tensors(mi: Any, images: dict[str, np.ndarray]) -> dict[str, Any]:
    return {name: mi.TensorXf(image) for name, image in images.items()}


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_backward_is_the_transpose_of_forward(
    mi: Any, images: dict[str, np.ndarray], rng: np.random.Generator, channels: int
) -> None:
    import drjit as dr

    extra = rng.random((HEIGHT, WIDTH, 1), dtype=np.float32)
    images["noisy"] = np.concatenate([images["noisy"], extra], axis=-1)[..., :channels]
    tensors = make_tensors(mi, images)
    noisy, guides = tensors.pop("noisy"), tensors
    denoiser = Denoiser((WIDTH, HEIGHT), quality="fast", radius=3, denoise_alpha=True)
    tangent = rng.normal(size=images["noisy"].shape).astype(np.float32)
    gradient = rng.normal(size=images["noisy"].shape).astype(np.float32)

    dr.enable_grad(noisy)
    clean = denoiser(noisy, **guides)
    dr.set_grad(noisy, mi.TensorXf(tangent))
    dr.enqueue(dr.ADMode.Forward, noisy)
    dr.traverse(dr.ADMode.Forward)
    forward = np.array(dr.grad(clean))

    other = mi.TensorXf(images["noisy"])
    dr.enable_grad(other)
    clean = denoiser(other, **guides)
    dr.set_grad(clean, mi.TensorXf(gradient))
    dr.enqueue(dr.ADMode.Backward, clean)
    dr.traverse(dr.ADMode.Backward)
    backward = np.array(dr.grad(other))

    bad = ~np.isfinite(images["noisy"]).all(axis=-1)
    assert not backward[bad, : min(channels, 3)].any()
    tangent[bad, :3] = 0.0
    first = (forward.astype(np.float64) * gradient).sum()
    second = (tangent.astype(np.float64) * backward).sum()
    np.testing.assert_allclose(first, second, rtol=1e-4)
    assert abs(first) > 0.1


def test_gradients_are_differences_of_the_denoised_image(
    mi: Any, images: dict[str, np.ndarray], rng: np.random.Generator
) -> None:
    import drjit as dr

    denoiser = Denoiser((WIDTH, HEIGHT), quality="fast", radius=3)
    guides = make_tensors(mi, images)
    target = rng.random((HEIGHT, WIDTH, 3), dtype=np.float32)
    noisy = guides.pop("noisy")
    dr.enable_grad(noisy)
    clean = denoiser(noisy, **guides)
    dr.backward(dr.sum(clean * mi.TensorXf(target), axis=None))
    found = np.array(dr.grad(noisy))
    plain = {name: images[name] for name in guides}
    np.testing.assert_allclose(np.array(clean), denoiser(images["noisy"], **plain), rtol=1e-5, atol=1e-6)

    def measure(image: np.ndarray) -> float:
        return float((denoiser(image, **plain).astype(np.float64) * target).sum())

    for row, column, channel in ((0, 0, 0), (3, 3, 1), (7, 4, 2), (8, 10, 0), (11, 15, 1)):
        step = np.zeros_like(images["noisy"])
        step[row, column, channel] = 0.25
        difference = (measure(images["noisy"] + step) - measure(images["noisy"])) / 0.25
        np.testing.assert_allclose(found[row, column, channel], difference, rtol=2e-3, atol=2e-3)


def test_a_loss_reaches_what_the_light_came_from(mi: Any, images: dict[str, np.ndarray]) -> None:
    import drjit as dr

    brightness = mi.Float(2.0)
    dr.enable_grad(brightness)
    noisy = mi.TensorXf(np.ones((HEIGHT, WIDTH, 3), np.float32)) * mi.TensorXf(brightness, (1, 1, 1))
    clean = Denoiser((WIDTH, HEIGHT), quality="fast")(noisy, normals=mi.TensorXf(images["normals"]))
    dr.backward(dr.mean(clean, axis=None))
    # A constant in, the same constant out.
    np.testing.assert_allclose(np.array(dr.grad(brightness)).item(), 1.0, rtol=1e-4)


def test_what_cannot_pass_gradients_refuses_them(mi: Any, images: dict[str, np.ndarray]) -> None:
    import drjit as dr

    tensors = make_tensors(mi, images)
    dr.enable_grad(tensors["noisy"])
    for settings in ({}, {"quality": "high"}, {"quality": "fast", "form": "atrous"}):
        with refuses(InputError, "noisy"):
            Denoiser((WIDTH, HEIGHT), **settings)(tensors["noisy"])
    with refuses(InputError, "noisy", expected="a tensor without gradients, which are not passed exactly by a history"):
        Denoiser((WIDTH, HEIGHT), temporal=True)(
            tensors["noisy"],
            flow=mi.TensorXf(np.zeros((HEIGHT, WIDTH, 2))),
            previous_denoised=dr.detach(tensors["noisy"]),
        )
    for name in ("normals", "albedo"):
        dr.enable_grad(tensors[name])
        with refuses(InputError, name):
            Denoiser((WIDTH, HEIGHT), quality="fast")(dr.detach(tensors["noisy"]), **{name: tensors[name]})
    assert Denoiser((WIDTH, HEIGHT))(dr.detach(tensors["noisy"])).shape == (HEIGHT, WIDTH, 3)


def test_a_hole_that_nothing_linear_fills_is_refused(mi: Any, images: dict[str, np.ndarray]) -> None:
    import drjit as dr

    noisy = images["noisy"].copy()
    noisy[:, 9:] = np.nan
    tensor = mi.TensorXf(noisy)
    dr.enable_grad(tensor)
    with refuses(InputError, "radiance"):
        Denoiser((WIDTH, HEIGHT), quality="fast", radius=2)(tensor)
