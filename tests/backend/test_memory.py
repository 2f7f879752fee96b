"""The memory of images: where it begins, and when it is used again."""

import gc
from threading import Thread
from weakref import ref

import numpy as np
import pytest

from lobewise.backend.buffers import (
    MIN_SPREAD_BYTES,
    PAGE_BYTES,
    MemoryPool,
    get_pool,
    make_array,
    make_plane_stack,
    share_memory,
)

SHAPE = (256, 512)


def get_place(array: np.ndarray) -> int:
    return array.ctypes.data % PAGE_BYTES


def test_planes_of_whole_pages_begin_at_different_places_of_a_page() -> None:
    planes = make_plane_stack((12, *SHAPE))
    assert planes.shape == (12, *SHAPE)
    assert planes[0].nbytes % PAGE_BYTES == 0
    assert len({get_place(plane) for plane in planes}) == 12
    assert all(plane.flags.c_contiguous for plane in planes)
    for number, plane in enumerate(planes):
        plane[...] = number
    assert [plane.min() for plane in planes] == [plane.max() for plane in planes] == list(range(12))


def test_arrays_begin_at_different_places_of_a_page() -> None:
    arrays = [make_array(SHAPE) for _ in range(8)]
    assert len({get_place(array) for array in arrays}) == 8
    assert all(array.flags.c_contiguous and array.flags.writeable for array in arrays)


@pytest.mark.parametrize("type", ["float32", "uint8"])
@pytest.mark.parametrize("shape", [(0, 4), (3, 5), (2, 3, 3), (MIN_SPREAD_BYTES, 3)])
def test_every_size_and_type(shape: tuple[int, ...], type: str) -> None:
    array = make_array(shape, type)
    assert array.shape == shape
    assert array.dtype == type
    assert array.flags.aligned
    array[...] = 7
    assert (array == 7).all()


def test_memory_of_arrays_that_are_gone_is_used_again() -> None:
    pool = MemoryPool()
    with pool.use():
        address = make_plane_stack((3, *SHAPE)).ctypes.data // PAGE_BYTES
        gc.collect()
        again = make_plane_stack((3, *SHAPE))
        assert again.ctypes.data // PAGE_BYTES == address
        other = make_plane_stack((3, *SHAPE))
    assert abs(other.ctypes.data - again.ctypes.data) >= again.nbytes


def test_memory_of_arrays_that_live_is_not_used_again() -> None:
    pool = MemoryPool()
    with pool.use():
        first = make_array(SHAPE)
    first[...] = 1.0
    view = first[3:5]
    del first
    with pool.use():
        make_array(SHAPE)[...] = 2.0
    assert (view == 1.0).all()


def test_memory_that_two_uses_did_not_need_is_freed() -> None:
    pool = MemoryPool()
    with pool.use():
        make_array(SHAPE)
    with pool.use():
        assert pool.held_bytes > 0
    with pool.use():
        pass
    assert pool.held_bytes == 0


def test_outside_of_a_pool_memory_is_not_kept() -> None:
    pool = MemoryPool()
    with pool.use():
        kept = make_array(SHAPE)
    held = pool.held_bytes
    make_array(SHAPE)
    assert pool.held_bytes == held
    del kept
    with pool.use():
        assert pool.held_bytes == held
    pool.clear()
    assert pool.held_bytes == 0


def test_a_block_serves_arrays_of_about_its_size() -> None:
    """A result that took a much larger block would keep it."""
    pool = MemoryPool()
    with pool.use():
        make_array((256, 512))
        fresh = pool.fresh_bytes
        make_array((240, 512))
        assert pool.fresh_bytes == fresh
        make_array((128, 512))
    assert pool.fresh_bytes > fresh


def test_a_pool_holds_no_more_than_was_in_use_at_once() -> None:
    """Free blocks that no array fits are given back before new memory is taken."""
    pool, most = MemoryPool(), 0
    with pool.use():
        for rows in (128, 512, 64, 256, 1024, 100, 900):
            image, other = make_array((rows, 512)), make_array((rows // 2, 512))
            most = max(most, image.nbytes + other.nbytes)
            del image, other
            assert pool.held_bytes <= most + 4 * 2 * PAGE_BYTES
    assert pool.held_bytes > 0


def test_memory_shared_by_a_call_ends_with_it_though_results_live() -> None:
    with share_memory():
        pool = ref(get_pool())
        with share_memory():
            assert get_pool() is pool()
            kept = make_array(SHAPE)
            make_array(SHAPE)
    gc.collect()
    assert pool() is None
    kept[...] = 1.0


def test_a_pool_of_another_thread_takes_memory_back() -> None:
    pool = MemoryPool()
    with pool.use():
        arrays = [make_array(SHAPE) for _ in range(8)]
        held = pool.held_bytes
        thread = Thread(target=arrays.clear)
        thread.start()
        thread.join()
        arrays = [make_array(SHAPE) for _ in range(8)]
        assert pool.held_bytes == held == pool.fresh_bytes
