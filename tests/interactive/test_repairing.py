"""How often unsupported pixels of an interactive frame are shaded again, and what becomes of the samples."""

from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.interactive import InteractiveSettings
from lobewise.interactive.filter_choice import MIN_PATHS_FOR_INTERPOLATION
from lobewise.interactive.repairing import NOISY_PARTS, repair
from lobewise.recipes.temporal import TemporalFilter
from lobewise.records.frame import Radiance
from lobewise.records.sparse_frame import make_sparse
from tests.denoising.test_upsampling import make_clean_frame
from tests.mistakes import refuses

NOISY, CALM = 1.0, float(MIN_PATHS_FOR_INTERPOLATION)


def run(worth: float, **settings: Any) -> tuple[Any, Any, list[tuple[int, int]], Any, Any]:
    """Return result before, result after, pixels and parts of every call, the new samples, and the history."""
    frame, truth = make_clean_frame()
    sparse, temporal, calls = make_sparse(frame, 4), TemporalFilter(), []
    before = temporal.add(sparse)

    def shade(rows: Any, columns: Any, parts: int) -> Radiance:
        calls.append((len(rows), parts))
        color = np.arange(1.0, 1.0 + parts)[:, None] * truth[rows, columns][:, None]
        return Radiance(color, np.zeros_like(color), color)

    asked = InteractiveSettings(adaptive=0.05, **settings)
    after, again = repair(before, sparse, asked, worth, temporal, shade)
    return before, after, calls, again, temporal


@pytest.mark.parametrize(
    ("worth", "settings", "parts"),
    [(NOISY, {}, NOISY_PARTS), (CALM, {}, 1), (NOISY, {"adaptive_parts": 1}, 1), (CALM, {"adaptive_parts": 3}, 3)],
)
def test_parts_share_the_budget(worth: float, settings: dict[str, Any], parts: int) -> None:
    before, after, calls, again, _ = run(worth, **settings)
    count = int(0.05 / parts * before.weight_sum.size)
    assert calls == [(count, parts)]
    assert after.settings["recomputed"] == count
    rows, columns, light = again
    assert light.shape == (count, parts, 3)
    np.testing.assert_allclose(light[:, -1], parts * light[:, 0], rtol=1e-6)
    changed = (after.image != before.image).any(axis=-1)
    marked = np.zeros_like(changed)
    marked[rows, columns] = True
    assert not (changed & ~marked).any()


@pytest.mark.parametrize("worth", [NOISY, CALM])
def test_new_samples_enter_the_history(worth: float) -> None:
    before, _, _, again, temporal = run(worth)
    rows, columns, _ = again
    sums = temporal.get_state()["sums/specular"]
    fresh = TemporalFilter()
    fresh.add(make_sparse(make_clean_frame()[0], 4))
    added = sums[..., 3] - fresh.get_state()["sums/specular"][..., 3]
    marked = np.zeros(before.weight_sum.shape, bool)
    marked[rows, columns] = True
    assert (added[marked] > 0.5).all()
    assert not added[~marked].any()


def test_bad_numbers_of_parts_are_told() -> None:
    for parts in (0, 65, "many"):
        with refuses(InputError, "adaptive_parts"):
            InteractiveSettings(adaptive_parts=parts)  # type: ignore[arg-type]
