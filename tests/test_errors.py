"""What messages say: a suggestion only where one is near, numbers as people write them."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest

from lobewise.errors import (
    FileError,
    InputError,
    LobewiseError,
    choose_nearest,
    name_value,
    require_choice,
    require_integer,
)
from lobewise.interchange.preset import look_up_preset
from lobewise.records.camera import Camera
from lobewise.settings import DenoiseSettings
from tests.mistakes import cut_folders, find_line, refuses

QUALITIES = ("auto", "fast", "balanced", "high")


@pytest.mark.parametrize(
    ("problem", "sentence"),
    [
        (
            InputError("radius", expected="an integer", got="-3", action="pass 8", holder="input 'a.exr'"),
            "input 'a.exr': radius: expected an integer, got -3; pass 8.",
        ),
        (
            FileError("device", expected="cpu", got="'cup'", action="mean 'cpu'?"),
            "device: expected cpu, got 'cup'; mean 'cpu'?",
        ),
        (LobewiseError("Dask is absent", action="pip install dask"), "Dask is absent; pip install dask."),
        (LobewiseError("Nothing goes on."), "Nothing goes on."),
    ],
)
def test_an_error_keeps_its_fields_through_pickles_and_copies(problem: LobewiseError, sentence: str) -> None:
    for same in (problem, copy.copy(problem), copy.deepcopy(problem), pickle.loads(pickle.dumps(problem))):
        assert (type(same), str(same), same.fields) == (type(problem), sentence, problem.fields)
    assert [problem.change().fields, type(problem.change())] == [problem.fields, type(problem)]


def test_an_error_in_a_file_names_the_outermost_first() -> None:
    found = InputError("up", expected="a direction", got="0", action="pass another").place_in("camera", FileError)
    assert isinstance(found, FileError)
    assert str(found.place_in("input 'a'")) == "input 'a': camera: up: expected a direction, got 0; pass another."
    assert found.fault == "camera: up: expected a direction, got 0"


def test_programs_are_names_of_presets() -> None:
    assert look_up_preset("Blender") is look_up_preset("cycles")
    assert look_up_preset("prman") is look_up_preset("renderman")
    with pytest.raises(InputError) as caught:
        look_up_preset("houdini")
    assert "cycles" in str(caught.value)
    assert "did you mean" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "near"), [("hihg", "high"), ("FAST", "fast"), ("balancd", "balanced"), ("best", None), ("zzz", None)]
)
def test_only_a_near_name_is_suggested(given: str, near: str | None) -> None:
    assert choose_nearest(given, QUALITIES) == near
    with pytest.raises(InputError) as caught:
        require_choice("quality", given, QUALITIES)
    assert str(caught.value).endswith("; choose one of them." if near is None else f"; did you mean {near!r}?")


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (np.float64(0.0), "0.0"),
        (np.int32(-3), "-3"),
        ((np.float64(0.5), np.nan), "(0.5, nan)"),
        (np.array([0.0, np.inf]), "[0.0, inf]"),
        (np.zeros(1000), "a ndarray"),
        ("a", "'a'"),
    ],
)
def test_numbers_of_numpy_are_shown_as_numbers(value: Any, shown: str) -> None:
    assert name_value(value) == shown


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({"position": (np.float64(0.0), np.nan, 1.0)}, ("camera position", "(0.0, nan, 1.0)")),
        ({"shift": (np.float64(0.0), np.float64(np.nan))}, ("camera shift", "(0.0, nan)")),
        ({"fov_y": np.float64(40.0)}, ("camera fov_y", "40.0")),
        ({"fov_y": np.float64(0.0)}, ("camera fov_y", "0.0")),
        ({"forward": (0, 0, 0)}, ("camera forward",)),
        ({"up": (0, 0, 0)}, ("camera up", "a vector of length 0")),
        ({"up": (0, 0, 2)}, ("camera up", "(0.0, 0.0, 2.0)")),
    ],
)
def test_a_camera_names_what_is_wrong(changes: dict[str, Any], refused: tuple[str, ...]) -> None:
    good = {"position": (0, 0, 0), "forward": (0, 0, 1), "up": (0, 1, 0), "fov_y": 0.7}
    Camera(**good)
    with refuses(InputError, *refused):
        Camera(**(good | changes))


def test_no_message_of_a_setting_has_a_type_of_numpy() -> None:
    for call in (
        lambda: DenoiseSettings(beta=np.float64(-1.0)),
        lambda: require_integer("radius", np.float64(0.0), 1, 8),
    ):
        with pytest.raises(InputError) as caught:
            call()
        assert "np." not in str(caught.value)


@pytest.mark.parametrize(
    "fields", [{"what": "beta"}, {"got": "5"}, {"expected": "an int"}, {"holder": "input 'a.exr'"}]
)
def test_a_test_that_asks_for_other_fields_fails(fields: dict[str, str]) -> None:
    with pytest.raises(AssertionError), refuses(InputError, **fields):
        raise InputError("radius", expected="an integer", got="4", action="pass 8")


@pytest.mark.parametrize(
    ("text", "short"),
    [
        ("input '/tmp/x/a.exr': no 'b/c.exr'", "input 'a.exr': no 'b/c.exr'"),
        ("output '/tmp/x/a.exr/'", "output 'a.exr/'"),
        ("tls://host:1 ./a/b ~/a/b", "tls://host:1 ./a/b ~/a/b"),
    ],
)
def test_folders_of_this_machine_are_cut(text: str, short: str) -> None:
    assert cut_folders(text) == short


def test_dots_in_the_table_stand_for_any_words() -> None:
    lines = {"a: expected b, got …; c.", "a: expected b, got 1; d."}
    assert find_line("a: expected b, got (2); c.", lines) == "a: expected b, got …; c."
    assert find_line("a: expected b, got 2; d.", lines) is None
