"""LobeTable: what it accepts, what it keeps, what it refuses."""

import math

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.records.lobe_table import LobeTable
from tests.mistakes import refuses


@pytest.fixture
def arrays(rng):
    """Return the fields of a good anisotropic table of 3 views, 2 azimuths and 2 lobes."""
    axis = rng.normal(size=(3, 2, 2, 3))
    return {
        "name": "brushed",
        "kind": "asg",
        "cosine": [0.2, 0.6, 1.0],
        "azimuth": [0.0, math.pi],
        "axis": axis / np.linalg.norm(axis, axis=-1, keepdims=True),
        "sharpness": rng.uniform(1.0, 9.0, (3, 2, 2, 2)),
        "twist": rng.uniform(-1.0, 1.0, (3, 2, 2)),
        "amplitude": rng.uniform(0.1, 2.0, (3, 2, 2)),
        "alpha": rng.uniform(0.1, 1.0, (3, 2, 2)),
        "albedo": rng.random((3, 2, 3)),
        "cosine_l2": rng.random((3, 2)),
    }


def replace(arrays, name, index, value):
    """Return ``arrays`` with one number of one array changed."""
    changed = np.array(arrays[name], dtype=np.float64)
    changed[index] = value
    return {**arrays, name: changed}


def test_it_keeps_read_only_float32_of_its_own(arrays):
    table = LobeTable(**arrays)
    assert (table.lobe_count, table.is_isotropic) == (2, False)
    for name, given in arrays.items():
        if name in ("name", "kind"):
            continue
        kept = getattr(table, name)
        assert kept.dtype == np.float32
        assert not kept.flags.writeable
        np.testing.assert_array_equal(kept, np.asarray(given, dtype=np.float32))
    mine = np.array(arrays["amplitude"], dtype=np.float32)
    table = LobeTable(**{**arrays, "amplitude": mine})
    mine[:] = 7.0
    assert table.amplitude.max() < 7.0


def test_a_few_words_stand_for_it(arrays):
    assert repr(LobeTable(**arrays)) == "LobeTable('brushed': 2 asg lobes, 3 views, 2 azimuths)"


def test_one_azimuth_is_isotropic(arrays):
    one = {
        name: value[:, :1] if isinstance(value, np.ndarray) else [0.0] if name == "azimuth" else value
        for name, value in arrays.items()
    }
    assert LobeTable(**one).is_isotropic


@pytest.mark.parametrize(
    ("name", "index", "value"),
    [
        ("cosine", 0, 0.0),
        ("cosine", 2, 1.5),
        ("cosine", 1, 0.1),
        ("cosine", 1, np.nan),
        ("azimuth", 0, -0.1),
        ("azimuth", 1, 2.0 * math.pi),
        ("axis", (0, 0, 0, 0), 2.0),
        ("axis", (0, 0, 0, 0), np.nan),
        ("sharpness", (1, 1, 1, 1), 0.0),
        ("sharpness", (1, 1, 1, 1), np.inf),
        ("twist", (0, 0, 0), np.nan),
        ("amplitude", (0, 0, 0), -0.1),
        ("amplitude", (0, 0), 0.0),
        ("alpha", (0, 0, 0), 0.0),
        ("alpha", (0, 0, 0), 1.1),
        ("albedo", (0, 0, 0), -0.1),
        ("albedo", (0, 0, 0), np.inf),
        ("cosine_l2", (0, 0), 1.1),
        ("cosine_l2", (0, 0), np.nan),
    ],
)
def test_values_out_of_range_are_refused(arrays, name, index, value):
    with refuses(InputError, f"lobe table: {name}"):
        LobeTable(**replace(arrays, name, index, value))


@pytest.mark.parametrize("name", ["axis", "sharpness", "twist", "amplitude", "alpha", "albedo", "cosine_l2"])
def test_other_shapes_are_refused(arrays, name):
    with refuses(InputError, f"lobe table: {name}"):
        LobeTable(**{**arrays, name: np.asarray(arrays[name])[:2]})
    with refuses(InputError, f"lobe table: {name}"):
        LobeTable(**{**arrays, name: np.asarray(arrays[name])[..., None]})


def test_grids_need_one_axis(arrays):
    for name in ("cosine", "azimuth"):
        for value in ([], 0.5, [[0.5]]):
            with refuses(InputError, f"lobe table: {name}"):
                LobeTable(**{**arrays, name: value})


def test_more_than_four_lobes_are_refused(arrays):
    five = {name: np.repeat(arrays[name], 3, axis=2)[:, :, :5] for name in ("axis", "sharpness", "twist", "amplitude")}
    with refuses(InputError, "lobe table: axis", expected="shape (views, azimuths, lobes, 3) with 1 to 4 lobes"):
        LobeTable(**{**arrays, **five})


def test_kinds(arrays):
    with refuses(InputError, "kind of lobes"):
        LobeTable(**{**arrays, "kind": "ags"})
    with refuses(InputError, "lobe table: sharpness"):
        LobeTable(**{**arrays, "kind": "sg"})
    equal = np.repeat(arrays["sharpness"][..., :1], 2, axis=-1)
    assert LobeTable(**{**arrays, "kind": "sg", "sharpness": equal}).kind == "sg"


def test_what_is_no_number_is_refused(arrays):
    with refuses(InputError, "lobe table: twist"):
        LobeTable(**{**arrays, "twist": "flat"})
    with refuses(InputError, "lobe table: axis"):
        LobeTable(**{**arrays, "axis": [[1.0], [1.0, 2.0]]})
    with refuses(InputError, "lobe table: name"):
        LobeTable(**{**arrays, "name": 3})
