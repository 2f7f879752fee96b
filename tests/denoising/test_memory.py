"""The memory of the images of a call: later images lie in that of earlier ones, and nothing is held afterwards."""

import gc
from typing import Any
from weakref import ref

import numpy as np
import pytest

import lobewise
from lobewise.backend import buffers
from lobewise.backend.buffers import MIN_SPREAD_BYTES, MemoryPool
from tests.denoising.test_denoising import make_frame

SHAPE = 128, 160
"""Images of one channel are already large enough for a pool."""
assert 4 * SHAPE[0] * SHAPE[1] > MIN_SPREAD_BYTES


class WatchedPool(MemoryPool):
    """A pool that counts the bytes that it hands out, and is known to `pools` as long as it lives."""

    pools: list[ref["WatchedPool"]]

    def __init__(self) -> None:
        super().__init__()
        self.taken_bytes = 0
        self.pools.append(ref(self))

    def take(self, size: int) -> Any:
        self.taken_bytes += size
        return super().take(size)


def test_images_of_a_call_lie_in_the_memory_of_earlier_ones() -> None:
    WatchedPool.pools = []
    with (pool := WatchedPool()).use():
        lobewise.denoise(make_frame(SHAPE), quality="high", device="cpu")
    assert 0 < pool.fresh_bytes < 2 / 3 * pool.taken_bytes


@pytest.mark.parametrize("quality", ["fast", "high"])
def test_nothing_is_held_after_a_call(quality: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    WatchedPool.pools = []
    monkeypatch.setattr(buffers, "MemoryPool", WatchedPool)
    result = lobewise.denoise(make_frame(SHAPE), quality=quality, device="cpu")
    gc.collect()
    assert [pool() for pool in WatchedPool.pools] == [None]
    assert np.isfinite(result.image).all()


def test_a_filter_with_history_takes_no_fresh_memory_for_a_further_frame() -> None:
    temporal = lobewise.TemporalFilter(device="cpu")
    for _ in range(3):
        result = temporal.add(make_frame(SHAPE))
    fresh = temporal._memory.fresh_bytes
    result = temporal.add(make_frame(SHAPE))
    assert temporal._memory.fresh_bytes == fresh > 0
    assert np.isfinite(result.image).all()
