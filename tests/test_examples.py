"""Every example runs, and does what it says."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.errors import InputError
from lobewise.filters.cross_filter import run_filter
from tests.mistakes import refuses

FOLDER = Path(__file__).parents[1] / "examples"
FEATURES = [FOLDER / "object_id.py", FOLDER / "spectral_lobe.py"]


def load(path: Path) -> dict[str, Any]:
    """Return the names of an example, without running its main part."""
    return runpy.run_path(str(path), run_name="example")


@pytest.mark.nightly  # kernels of every form are compiled
@pytest.mark.parametrize("path", FEATURES, ids=lambda path: path.stem)
def test_own_feature_lowers_the_error_in_every_form(path: Path) -> None:
    errors = load(path)["main"]()
    assert set(errors) == {"full", "separable", "atrous"}
    for plain, guided in errors.values():
        assert guided < 0.2 * plain


def test_every_example_is_tested() -> None:
    assert set(FOLDER.glob("*.py")) == {*FEATURES, FOLDER / "sequence.py"}


@pytest.mark.nightly
def test_a_history_lowers_the_error_of_an_own_engine() -> None:
    errors = load(FOLDER / "sequence.py")["main"]()
    assert errors["with its history"] < 0.7 * errors["alone"]


def test_object_id_shares_all_or_nothing() -> None:
    names = load(FEATURES[0])
    ids = np.array([[0, 0, 1, 1, 3]])  # any real dtype will do
    image = np.arange(15.0, dtype=np.float32).reshape(1, 5, 3)
    out = run_filter(image, np.ones((1, 5), bool), [names["ObjectId"](ids)], form="full", radius=4)
    np.testing.assert_allclose(out.weight_sum, [[2, 2, 2, 2, 1]], rtol=1e-5)
    expected = np.stack([image[0, [0, 1]].mean(0)] * 2 + [image[0, [2, 3]].mean(0)] * 2 + [image[0, 4]])
    np.testing.assert_allclose(out.image[0], expected, rtol=1e-5)


def test_spectral_lobe_is_the_overlap_of_two_bands() -> None:
    names = load(FEATURES[1])
    mean = np.array([[500.0, 520.0, 600.0]], np.float32)
    deviation = np.array([[20.0, 35.0, 50.0]], np.float32)
    wavelength = np.linspace(200.0, 1000.0, 20001)[:, None]
    bands = np.exp(-0.5 * ((wavelength - mean) / deviation) ** 2)
    overlap = bands.T @ bands
    overlap /= np.sqrt(np.outer(np.diag(overlap), np.diag(overlap)))
    impulse = np.zeros((1, 3, 3), np.float32)
    impulse[0, 0] = 1.0
    feature = names["SpectralLobe"](mean, deviation, beta=2.0)
    out = run_filter(impulse, np.ones((1, 3), bool), [feature], form="full", radius=2)
    np.testing.assert_allclose((out.image[..., 0] * out.weight_sum)[0], overlap[:, 0] ** 2, rtol=1e-3)


def test_feature_of_another_size_is_named() -> None:
    names = load(FEATURES[0])
    frame, ids, _ = names["make_frame"](32)
    with refuses(
        InputError,
        "an array of feature 'object id'",
        "float32 of shape (16, 16)",
        "real numbers of shape (32, 32) or (32, 32, 'channels')",
    ):
        lobewise.denoise(frame, features=[names["ObjectId"](ids[:16, :16])])
