"""Small frames of four renderers: errors, energy and the light of every pass stay as they were committed."""

from pathlib import Path

import numpy as np
import pytest

from tests.images.frames import CASES, QUALITIES
from tests.images.measuring import MAX_MEAN_CHANGE, compare_figures, measure_case, read_figures, widen_bound
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
