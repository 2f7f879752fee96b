"""Small frames of four renderers: errors, energy and the light of every pass stay as they were committed."""

from pathlib import Path

import numpy as np
import pytest

from lobewise.peers import denoise_oidn
from lobewise.records.frame import Frame
from tests.images.frames import CASES, QUALITIES, denoise_view, read_views
from tests.images.measuring import (
    MAX_MEAN_CHANGE,
    compare_figures,
    measure_case,
    measure_image,
    read_figures,
    widen_bound,
)
from tests.images.pictures import locate_baseline, write_comparison

ADVICE = "if it was meant, commit what `python -m tests.images.write` writes"


def skip_without_oidn(quality: str) -> None:
    """Skip "auto" where Open Image Denoise is not installed."""
    from lobewise.peers import has_oidn

    if quality == "auto" and not has_oidn():
        pytest.skip("needs Open Image Denoise: pip install 'lobewise[best]'")


@pytest.mark.parametrize(("name", "quality"), CASES, ids=["-".join(each) for each in CASES])
def test_image_is_as_good_as_the_committed_one(name: str, quality: str, tmp_path: Path) -> None:
    """No figure of a frame leaves its bound, upwards or downwards."""
    skip_without_oidn(quality)
    measured = measure_case(name, quality)
    told = compare_figures(measured.figures, read_figures()[name][quality], quality)
    if told:
        picture = tmp_path / f"{name}-{quality}.png"
        write_comparison(picture, measured, locate_baseline(name, quality))
        pytest.fail(f"{'; '.join(told)}. See {picture} (noisy, result, committed, reference); {ADVICE}")


@pytest.mark.parametrize("quality", QUALITIES)
def test_mean_error_of_all_frames_is_the_committed_one(quality: str) -> None:
    """A change too small for the bound of one frame shows in all of them together."""
    skip_without_oidn(quality)
    committed = read_figures()
    logs = [
        np.log(measure_case(name, quality).figures["trimmed"] / committed[name][quality]["trimmed"])
        for name, each in CASES
        if each == quality
    ]
    change, bound = float(np.exp(np.mean(logs))), widen_bound(MAX_MEAN_CHANGE, quality)
    assert abs(change - 1.0) < bound, f"errors are {change:.4f} times the committed ones; {ADVICE}"


def test_no_pixel_of_a_volume_is_black_where_the_peer_has_light() -> None:
    """Fog at one sample: between the samples our own filters have no light, but the mixture has."""
    skip_without_oidn("auto")
    (view,) = read_views("haze")
    noisy, result, (peer, _) = view.noisy, denoise_view(view.noisy, "auto"), denoise_oidn(view.noisy)
    assert isinstance(noisy, Frame)
    assert (noisy.radiance.color <= 0.0).all(axis=-1).mean() > 0.05
    assert not ((result.image <= 0.0).all(axis=-1) & (peer > 0.0).any(axis=-1)).any()
    parts = [*result.layers.values(), *(result.also.get(name, noisy.unscattered[name]) for name in noisy.unscattered)]
    np.testing.assert_allclose(sum(parts), result.image, atol=0.1)


@pytest.mark.parametrize("name", ["halves", "brushed", "broken"])
def test_halves_of_the_samples_make_no_mixture_worse(name: str) -> None:
    skip_without_oidn("auto")
    (view,) = read_views(name)
    frame = view.noisy
    assert isinstance(frame, Frame)
    assert frame.half_a is not None
    errors = [
        measure_image(denoise_view(each, "auto").image, view.reference.radiance.color)["trimmed"]
        for each in (frame, frame.with_changes(half_a=None, half_b=None))
    ]
    assert errors[0] < errors[1]
