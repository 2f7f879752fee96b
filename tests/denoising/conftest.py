"""Fixtures of the recipe's tests."""

from __future__ import annotations

import numpy as np
import pytest

from lobewise.denoising import stages
from lobewise.denoising.planning import frame_plans


@pytest.fixture
def unshared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the last step, which shares out over the whole image what its filter lost: these tests are of filters.

    With it each pixel tells a little on all others.
    """
    monkeypatch.setitem(stages.RUNNERS, frame_plans.KEEP_LIGHT, lambda state: state)  # type: ignore[arg-type]


@pytest.fixture
def trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave results as the filters made them: no detail is taken back."""
    monkeypatch.setattr(stages, "find_share_lost", lambda samples, *_, **__: np.zeros(samples.shape[:2], np.float32))
