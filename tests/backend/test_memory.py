"""The memory of images: where it begins, and when it is used again."""

import gc

import numpy as np
import pytest

from lobewise.backend.buffers import MIN_SPREAD_BYTES, PAGE_BYTES, MemoryPool, make_array, make_plane_stack

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
        pass
    with pool.use():
        pass
    assert not pool._free


def test_outside_of_a_pool_memory_is_not_kept() -> None:
    pool = MemoryPool()
    with pool.use():
        kept = make_array(SHAPE)
    make_array(SHAPE)
    assert not pool._free
    del kept
    assert sum(map(len, pool._free.values())) == 1
    pool.clear()
    assert not pool._free
