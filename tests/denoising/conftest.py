"""Fixtures of the recipe's tests."""

import numpy as np
import pytest

from lobewise.denoising import chain


@pytest.fixture
def unshared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the last step, which shares out over the whole image what its filter lost: these tests are of filters.

    With it each pixel tells a little on all others.
    """
    monkeypatch.setattr(chain, "keep_light", lambda found: found)


@pytest.fixture
def trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave results as the filters made them: no detail is taken back."""
    monkeypatch.setattr(chain, "estimate_share_lost", lambda samples, *_, **__: np.zeros(samples.shape[:2], np.float32))
