"""What a frame promises: its bits, its halves, its variance, its errors, its progress."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.records.frame import Frame
from tests.mistakes import refuses

pytestmark = pytest.mark.mitsuba

SIZE = 16


def list_images(part: Any, prefix: str = "") -> dict[str, np.ndarray]:
    """Return every array of a frame by its path."""
    images = {}
    for item in fields(part):
        value = getattr(part, item.name)
        if is_dataclass(value):
            images.update(list_images(value, f"{prefix}{item.name}."))
        elif isinstance(value, np.ndarray):
            images[prefix + item.name] = value
    return images


@pytest.fixture(scope="module")
def scene(mi: Any, make_box_scene: Callable[..., Any]) -> Any:
    plastic = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.2}
    ball = {"type": "sphere", "center": [0, 0.7, 0], "radius": 0.7, "bsdf": plastic}
    return make_box_scene({"ball": ball}, size=SIZE)


def assert_same_bits(first: Frame, second: Frame) -> None:
    one, other = list_images(first), list_images(second)
    assert one.keys() == other.keys()
    for name, image in one.items():
        assert np.array_equal(image, other[name]), name


def test_same_seed_gives_the_same_bits(scene: Any) -> None:
    from lobewise.render import render_frame

    first = render_frame(scene, spp=6, seed=4)
    assert_same_bits(first, render_frame(scene, spp=6, seed=4))
    assert not np.array_equal(first.radiance.color, render_frame(scene, spp=6, seed=5).radiance.color)


def test_bits_do_not_depend_on_threads_tiles_or_chunks(scene: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    import drjit as dr

    from lobewise.render import render_frame, renderer

    first = render_frame(scene, spp=6, seed=4)
    threads = dr.thread_count()
    try:
        dr.set_thread_count(1)
        assert_same_bits(first, render_frame(scene, spp=6, seed=4))
    finally:
        dr.set_thread_count(threads)
    monkeypatch.setattr(renderer, "TILE_PIXELS", 100)
    monkeypatch.setattr(renderer, "CHUNK_SAMPLES", 200)
    assert_same_bits(first, render_frame(scene, spp=6, seed=4))


@pytest.mark.parametrize("spp", [2, 5])
def test_halves_are_the_even_and_the_odd_samples(scene: Any, spp: int) -> None:
    from lobewise.render import render_frame

    frame = render_frame(scene, spp=spp, seed=4)
    even, odd = (spp + 1) // 2, spp // 2
    for name in ("color", "diffuse", "specular"):
        a, b = getattr(frame.half_a, name), getattr(frame.half_b, name)
        assert not np.array_equal(a, b)
        assert np.allclose((even * a + odd * b) / spp, getattr(frame.radiance, name), rtol=1e-5, atol=1e-6), name
    one = render_frame(scene, spp=1, seed=4)
    if spp == 2:
        assert np.allclose(frame.half_a.color, one.radiance.color, rtol=1e-6)


def test_one_sample_has_neither_halves_nor_variance(scene: Any) -> None:
    from lobewise.render import render_frame

    frame = render_frame(scene, spp=1)
    assert frame.half_a is None
    assert frame.half_b is None
    assert frame.variance is None


@pytest.mark.nightly
def test_variance_is_that_of_the_mean_over_many_renders(scene: Any) -> None:
    from lobewise.render import render_frame

    runs = [render_frame(scene, spp=8, seed=seed) for seed in range(100, 160)]
    for name in ("color", "diffuse", "specular"):
        seen = np.var([getattr(run.radiance, name) for run in runs], axis=0, ddof=1)
        told = np.mean([getattr(run.variance, name) for run in runs], axis=0)
        assert told.mean() == pytest.approx(seen.mean(), rel=0.25), name
        assert np.corrcoef(np.log(seen.ravel() + 1e-6), np.log(told.ravel() + 1e-6))[0, 1] > 0.95, name


def test_variance_of_two_samples_is_a_quarter_of_their_squared_difference(scene: Any) -> None:
    from lobewise.render import render_frame

    frame = render_frame(scene, spp=2)
    for name in ("color", "diffuse", "specular"):
        difference = getattr(frame.half_a, name) - getattr(frame.half_b, name)
        assert np.allclose(getattr(frame.variance, name), 0.25 * difference**2, rtol=1e-4, atol=1e-7), name


def test_reference_is_the_same_picture_without_guides(scene: Any) -> None:
    from lobewise.render import render_frame, render_reference

    frame, reference = render_frame(scene, spp=16, seed=9), render_reference(scene, spp=16, seed=9)
    # Splitting draws no random numbers of its own.
    assert np.allclose(frame.radiance.color, reference.radiance.color, rtol=1e-4, atol=1e-5)
    assert reference.radiance.diffuse is None
    assert reference.gbuffer.depth is None
    assert reference.camera is not None
    assert reference.spp == 16


def test_aov_only_gives_the_same_geometry_and_no_light(scene: Any) -> None:
    from lobewise.render import render_frame

    frame, guides = render_frame(scene, spp=32, seed=9), render_frame(scene, spp=32, seed=9, aov_only=True)
    assert guides.radiance.color.max() == 0
    assert guides.variance is None
    for name in ("depth", "position", "normal", "tangent", "alpha_u", "alpha_v", "lobe_kind"):
        assert np.array_equal(getattr(frame.gbuffer, name), getattr(guides.gbuffer, name)), name
    for name in ("diffuse_albedo", "specular_albedo"):
        assert np.abs(getattr(frame.gbuffer, name) - getattr(guides.gbuffer, name)).mean() < 0.01, name
    shiny = frame.gbuffer.lobe_kind > 0
    both = np.isfinite(frame.gbuffer.hit_distance) & np.isfinite(guides.gbuffer.hit_distance) & shiny
    ratio = frame.gbuffer.hit_distance[both] / guides.gbuffer.hit_distance[both]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)


def test_progress_counts_every_sample_once(scene: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from lobewise.render import render_frame, renderer

    calls: list[tuple[int, int]] = []
    monkeypatch.setattr(renderer, "CHUNK_SAMPLES", 2 * SIZE * SIZE)
    render_frame(scene, spp=5, progress=lambda done, total: calls.append((done, total)))
    total = 5 * SIZE * SIZE
    assert calls == [(done * SIZE * SIZE, total) for done in (0, 2, 4, 5)]


@pytest.mark.parametrize(
    ("arguments", "refused"),
    [
        ({"spp": 0}, ("spp", "0")),
        ({"spp": 2.5}, ("spp", "2.5")),
        ({"spp": 1, "seed": -1}, ("seed",)),
        ({"spp": 1, "max_depth": 0}, ("max_depth",)),
    ],
)
def test_bad_numbers_are_errors(scene: Any, arguments: dict[str, Any], refused: tuple[str, ...]) -> None:
    from lobewise.render import render_frame, render_reference

    for function in (render_frame, render_reference):
        with refuses(InputError, *refused):
            function(scene, **arguments)


def test_all_images_are_finite_and_within_their_ranges(scene: Any) -> None:
    from lobewise.render import render_frame

    frame = render_frame(scene, spp=8)
    for name, image in list_images(frame).items():
        if name != "gbuffer.hit_distance":
            assert np.isfinite(image).all(), name
        if name.startswith(("radiance", "half", "variance")) or name.endswith(("albedo", "depth", "distance")):
            assert image.min() >= 0, name
        if name.endswith("albedo"):
            assert image.max() <= 1, name
