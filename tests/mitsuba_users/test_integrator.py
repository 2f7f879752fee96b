"""The integrator ``lobewise`` of Mitsuba: `mitsuba.render` gives the denoised image."""

from typing import Any

import numpy as np
import pytest

import lobewise.mitsuba
from lobewise.errors import InputError
from tests.mistakes import refuses

pytestmark = pytest.mark.mitsuba


def make_scene(mi: Any, **integrator: Any) -> Any:
    """Return a small box with light that bounces."""
    lobewise.mitsuba.register_integrator()
    items = mi.cornell_box()
    items["integrator"] = {"type": "lobewise", **integrator}
    items["sensor"]["film"] |= {"width": 24, "height": 24}
    return mi.load_dict(items)


def test_the_image_is_that_of_denoise(mi: Any) -> None:
    scene = make_scene(mi, max_depth=4, quality="balanced", with_oidn=False)
    image = mi.render(scene, spp=4, seed=3)
    expected = lobewise.mitsuba.denoise(
        scene, 4, seed=3, integrator="paths", max_depth=4, quality="balanced", with_oidn=False
    )
    assert type(image) is mi.TensorXf
    np.testing.assert_array_equal(np.array(image), np.array(expected))
    other = lobewise.mitsuba.denoise(scene, 4, seed=3, integrator="paths", max_depth=2, quality="balanced")
    assert not np.array_equal(np.array(image), np.array(other))


def test_the_samples_are_those_of_the_sampler_where_none_are_given(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    monkeypatch.setattr("lobewise.mitsuba.integrator.denoise", lambda scene, spp, *_, **__: seen.append(spp))
    scene = make_scene(mi)
    scene.integrator().render(scene)
    assert seen == [scene.sensors()[0].sampler().sample_count()]


def test_unknown_parameters_are_refused(mi: Any) -> None:
    with pytest.raises(Exception, match="colour"):
        make_scene(mi, colour=3)


def test_a_film_that_is_not_developed_is_refused(mi: Any) -> None:
    scene = make_scene(mi)
    with refuses(InputError, "develop"):
        scene.integrator().render(scene, develop=False)
