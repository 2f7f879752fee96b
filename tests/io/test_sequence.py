"""Patterns of numbered files: what they name, what they find, what they say when there is nothing."""

from pathlib import Path

import pytest

from lobewise.errors import FileError, InputError
from lobewise.io.sequence import FramePattern, describe_gaps, is_pattern
from tests.mistakes import refuses


@pytest.mark.parametrize(
    "text", ["a.####.exr", "a.%04d.exr", "a%d.exr", "#", "x/a_##_b.exr", Path("a.#.exr"), "a@@.exr", "a.$F4.exr", "$F"]
)
def test_patterns_are_told_from_files(text):
    assert is_pattern(text)


@pytest.mark.parametrize(
    "text",
    [
        *("a.exr", "a.0001.exr", "####/a.exr", "100%.exr", "%4d.exr", "%00d.exr", "a%04i.exr"),
        *("me@studio.exr", "$FF.exr", "$FEND.exr", "$F0.exr", "$F12.exr", "$Foo", "F4.exr"),
        # Tiles of a texture, which are no frames.
        *("wood.1001.exr", "wood.<UDIM>.exr", "wood.<udim>.exr", "wood_u1_v1.exr"),
    ],
)
def test_files_are_told_from_patterns(text):
    assert not is_pattern(text)


def test_a_file_of_just_that_name_is_a_file(tmp_path):
    (tmp_path / "take#2.exr").write_bytes(b"x")
    assert not is_pattern(tmp_path / "take#2.exr")
    assert is_pattern(tmp_path / "take#3.exr")


@pytest.mark.parametrize(
    ("text", "number", "name"),
    [
        ("d/a.####.exr", 7, "d/a.0007.exr"),
        ("d/a.%04d.exr", 7, "d/a.0007.exr"),
        ("d/a.%04d.exr", 12345, "d/a.12345.exr"),
        ("a%d.exr", 0, "a0.exr"),
        ("a%012d.exr", 5, "a000000000005.exr"),
        ("##", 3, "03"),
        ("v2_#_b(1).exr", 40, "v2_40_b(1).exr"),
        ("###/a.##.exr", 1, "###/a.01.exr"),
        ("cam@left.@@@@.exr", 7, "cam@left.0007.exr"),
        ("cam@left.####.exr", 7, "cam@left.0007.exr"),
        ("shot-####-a.exr", 7, "shot-0007-a.exr"),
        ("a.$F4.exr", 7, "a.0007.exr"),
        ("a.$F.exr", 12, "a.12.exr"),
    ],
)
def test_names(text, number, name):
    assert FramePattern.parse(text).name(number) == Path(name)


def test_both_ways_of_writing_are_one_pattern():
    pattern = FramePattern.parse("d/a.%03d.exr")
    assert pattern == FramePattern.parse("d/a.###.exr")
    assert str(pattern) == str(Path("d/a.###.exr"))


@pytest.mark.parametrize("text", ["a.exr", "####/a.exr", "a.##.##.exr", "a.%04d.#.exr", "a.%4d.exr", "a@@.$F4.exr"])
def test_other_names_are_refused(text):
    with refuses(InputError, expected="a name with one run of #, such as render.####.exr"):
        FramePattern.parse(text)


def test_found_files_are_in_the_order_of_their_numbers(tmp_path):
    names = ["a.0002.exr", "a.0010.exr", "a.0000.exr", "a.9999.exr", "a.10000.exr", "a.100001.exr", "a.-007.exr"]
    others = [
        "a.002.exr",
        "a.00003.exr",
        "a.0004.exr.bak",
        "b.0005.exr",
        "axx.0006.exr",
        "a.-0007.exr",
        "a.-07.exr",
        "a.-000.exr",
        "a.000٣.exr",
    ]
    for name in names + others:
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "a.0008.exr").mkdir()
    found = FramePattern.parse(tmp_path / "a.####.exr").find()
    assert [number for number, _ in found] == [-7, 0, 2, 10, 9999, 10000, 100001]
    assert [path for _, path in found] == [FramePattern.parse(tmp_path / "a.####.exr").name(n) for n, _ in found]
    assert sorted(path.name for _, path in found) == sorted(names)


def test_a_hyphen_before_every_number_is_no_sign(tmp_path):
    for name in ("a-001.exr", "a-002.exr"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(FileError, match=r"did you mean '.*a-###\.exr'"):
        FramePattern.parse(tmp_path / "a####.exr").find()


@pytest.mark.parametrize(
    ("there", "near"),
    [
        (["a.001.exr"], "a.###.exr"),
        (["a_0001.exr", "zzz"], "a_####.exr"),
        (["A.0001.EXR"], "A.####.EXR"),
        (["zzz.txt"], None),
        ([], None),
        # A number and an ending in common make no name alike.
        (["1x08.exr", "nn.0001.exr", "a.0001.png"], None),
    ],
)
def test_nothing_found_is_said_with_what_is_near(there, near, tmp_path):
    for name in there:
        (tmp_path / name).write_bytes(b"x")
    with refuses(FileError, "sequence 'a.####.exr'", expected="files such as 'a.0001.exr'") as problem:
        FramePattern.parse(tmp_path / "a.####.exr").find()
    assert (repr(str(tmp_path / near)) if near else "the path") in problem.value.action


def test_a_folder_that_is_not_there(tmp_path):
    with refuses(FileError, "sequence 'a.#.exr'"):
        FramePattern.parse(tmp_path / "no" / "a.#.exr").find()


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ([1], ""),
        ([3, 4, 5], ""),
        ([1, 2, 4], "Frame 3 of 1 to 4 is missing."),
        ([1, 3, 7], "Frames 2, 4 to 6 of 1 to 7 are missing."),
        (list(range(1, 100, 2)), "Frames 2, 4, 6, 8, 10, 12, 14, 16 and 41 more of 1 to 99 are missing."),
        ([1, 1_700_000_000], "Frames 2 to 1699999999 of 1 to 1700000000 are missing."),
    ],
)
def test_missing_numbers_are_named(numbers: list[int], told: str) -> None:
    assert describe_gaps(numbers) == told


@pytest.mark.parametrize("text", ["a.####.exr", "v2_#_b(1).exr"])
def test_a_file_has_its_number(text: str) -> None:
    pattern = FramePattern.parse(text)
    assert [pattern.read_number(pattern.name(number)) for number in (0, 7, 12345)] == [0, 7, 12345]
