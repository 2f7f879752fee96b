"""What is remembered, taken apart into arrays and put together again."""

import io
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.filters.history.sums import HISTORY_CHANNELS
from lobewise.recipes.temporal.past import Past, pack_past, unpack_past
from lobewise.recipes.temporal.validation import Guides
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer
from tests.mistakes import refuses

SHAPE = (9, 13)
# Made orthonormal once more it stays what it is.
CAMERA = Camera(position=(0.1, 2.0, 0.3), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7, fov_x=0.9)


def make_past(frame: Frame, **changes: Any) -> Past:
    """Return a past with the guides of ``frame`` and random sums."""
    rng = np.random.default_rng(1)
    sums = {name: rng.random((*SHAPE, HISTORY_CHANNELS)).astype(np.float32) for name in ("diffuse", "specular", "rest")}
    return replace(Past(Guides(frame.gbuffer, CAMERA, frame.lobe_tables), "sg_mixture", sums), **changes)


def save_and_load(packed: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return arrays as they come back from a file that holds nothing but plain arrays."""
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **packed)
    file.seek(0)
    with np.load(file, allow_pickle=False) as loaded:
        return dict(loaded)


def list_values(past: Past) -> dict[str, Any]:
    """Return everything in a past by name, without `pack_past`."""
    values: dict[str, Any] = {"similarity": past.similarity}
    values |= {f"sums {name}": value for name, value in past.sums.items()}
    guides = past.guides
    parts = {"gbuffer": guides.gbuffer, "camera": guides.camera, **dict(enumerate(guides.lobe_tables))}
    for name, part in parts.items():
        values[f"{name}"] = type(part).__name__
        for item in fields(part) if part is not None else ():
            values[f"{name} {item.name}"] = getattr(part, item.name)
    return values


def assert_same_bits(one: Past, other: Past) -> None:
    """Fail unless both hold the same, to the last bit."""
    values, others = list_values(one), list_values(other)
    assert values.keys() == others.keys()
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            assert (value.dtype, value.shape) == (others[name].dtype, others[name].shape), name
            assert value.tobytes() == others[name].tobytes(), name
        else:
            assert type(value) is type(others[name]), name
            assert value == others[name], name


def test_a_past_comes_back_to_the_last_bit_with_its_tables_in_their_order(full_frame: Frame) -> None:
    tables = tuple(replace(full_frame.lobe_tables[k % 2], name=f"number {k}") for k in range(12))
    past = make_past(full_frame, guides=Guides(full_frame.gbuffer, CAMERA, tables))
    assert_same_bits(unpack_past(save_and_load(pack_past(past))), past)


def test_every_camera_comes_back_to_the_last_bit(full_frame: Frame) -> None:
    rng = np.random.default_rng(2)
    for k in range(200):
        camera = Camera(*rng.normal(size=(3, 3)), fov_y=rng.uniform(0.1, 2.0), fov_x=None if k % 2 else 0.9)
        guides = Guides(full_frame.gbuffer, camera, ())
        past = make_past(full_frame, guides=guides)
        assert_same_bits(unpack_past(pack_past(past)), past)


def test_what_is_missing_stays_missing(full_frame: Frame) -> None:
    normal = full_frame.gbuffer.normal
    past = make_past(full_frame, guides=Guides(GBuffer(normal=normal), None, ()), sums={})
    assert_same_bits(unpack_past(save_and_load(pack_past(past))), past)


@pytest.mark.parametrize("name", ["depth", "position", "alpha_v", "hit_distance", "motion", "material"])
def test_a_missing_channel_stays_missing(full_frame: Frame, name: str) -> None:
    channels = {item.name: getattr(full_frame.gbuffer, item.name) for item in fields(GBuffer) if item.name != name}
    past = make_past(full_frame, guides=Guides(GBuffer(**channels), CAMERA, full_frame.lobe_tables))
    back = unpack_past(save_and_load(pack_past(past)))
    assert getattr(back.guides.gbuffer, name) is None
    assert_same_bits(back, past)


def test_values_that_are_no_numbers_come_back(make_frame: Callable[..., Frame]) -> None:
    frame = make_frame(height=SHAPE[0], width=SHAPE[1])
    distance = np.array(frame.gbuffer.hit_distance)
    distance[0, :3] = np.inf, np.nan, -0.0
    past = make_past(frame, guides=Guides(replace(frame.gbuffer, hit_distance=distance), None, ()))
    assert_same_bits(unpack_past(save_and_load(pack_past(past))), past)


def leave_out(*names: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return a change that removes whatever begins so."""
    return lambda state: {key: value for key, value in state.items() if not key.startswith(names)}


DAMAGES: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "similarity": leave_out("similarity"),
    "gbuffer": leave_out("gbuffer/"),
    "camera without position": leave_out("camera/position"),
    "camera without angle": leave_out("camera/fov_y"),
    "camera of another shape": lambda state: {**state, "camera/up": np.zeros(2)},
    "camera that looks up": lambda state: {**state, "camera/up": state["camera/forward"]},
    "channel of another size": lambda state: {**state, "gbuffer/depth": np.ones((4, 4), np.float32)},
    "channel of words": lambda state: {**state, "gbuffer/depth": np.full(SHAPE, "far")},
    "unknown channel": lambda state: {**state, "gbuffer/colour": np.ones(SHAPE, np.float32)},
    "table without axis": leave_out("table0001/axis"),
    "table of another shape": lambda state: {**state, "table0000/twist": np.zeros(3, np.float32)},
    "sums of another size": lambda state: {**state, "sums/diffuse": np.ones((4, 4, 7), np.float32)},
    "sums of fewer channels": lambda state: {**state, "sums/diffuse": np.ones((*SHAPE, 6), np.float32)},
    "sums of words": lambda state: {**state, "sums/diffuse": np.full((*SHAPE, 7), "heavy")},
    "no arrays": lambda state: dict.fromkeys(state, 1.0),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_state_is_refused(full_frame: Frame, damage: str) -> None:
    state = DAMAGES[damage](pack_past(make_past(full_frame)))
    with refuses(InputError, "state") as caught:
        unpack_past(state)
    assert "\n" not in str(caught.value)
