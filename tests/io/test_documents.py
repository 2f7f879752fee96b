"""JSON and TOML of strangers: what is read, and what is refused before it takes time or memory."""

import tracemalloc
from typing import Any

import pytest

from lobewise.errors import FileError, InputError
from lobewise.io import documents
from lobewise.io.documents import parse_json, parse_toml, read_document, require_arrays, require_numbers
from tests.mistakes import refuses


def refuse_json(text: str | bytes, got: str) -> None:
    """Assert that a document is refused."""
    with refuses(FileError, "file 'a'", got, "JSON", action="mend the file"):
        parse_json(text, what="file 'a'")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("[1, 2.5, -3]", [1, 2.5, -3]),
        ('\ufeff{"a": "\\ud83d\\ude00 é"}', {"a": "\U0001f600 é"}),
        ('{"a": {"b": [[], {}, null, true]}}', {"a": {"b": [[], {}, None, True]}}),
        ('"[[[[[[[[[["', "[[[[[[[[[["),
        ('"\\"[" ', '"['),
        ("9" * 308, int("9" * 308)),
        ("[" * 64 + "]" * 64, None),
    ],
    ids=["list", "mark and pair", "nested", "brackets in text", "quote in text", "digits", "depth"],
)
def test_honest_documents_are_read(text: str, value: Any) -> None:
    found = parse_json(text.encode("utf-8", "surrogatepass"), what="a")
    assert value is None or found == value


@pytest.mark.parametrize(
    ("text", "got"),
    [
        ("", "text that is no JSON: it ends too soon, in line 1"),
        ("[" * 200_000, "lists or objects more than 64 deep"),
        ("[" * 65 + "]" * 65, "lists or objects more than 64 deep"),
        ('{"a":' * 200_000, "lists or objects more than 64 deep"),
        ('["' + '\\"[' * 200_000, "text that is no JSON from line 1, column 2 on"),
        ("1" + 308 * "0", "a whole number of 309 digits"),
        ("-" + 5000 * "9", "a whole number of 5000 digits"),
        ("[NaN]", "NaN, which JSON does not have"),
        ("[-Infinity]", "-Infinity, which JSON does not have"),
        ('{"a": 1, "b": 2, "a": 3}', "the key 'a' twice"),
        ('["\\ud800"]', r"a text with half a letter in it: '\ud800'"),
        (b"\xff\xfe[\0]\0", "text that is not UTF-8: byte 1 is 0xff"),
        ("[1] \x00\x1b[31m", "text that is no JSON from line 1, column 5 on"),
    ],
)
def test_everything_else_is_refused_in_a_sentence(text: str | bytes, got: str) -> None:
    refuse_json(text, got)


def test_values_are_counted_before_they_are_made() -> None:
    """8 MB of empty lists would be 2.7 million of them, which take 180 MB."""
    text = b"[" + b"[]," * ((8 << 20) // 3) + b"[]]"
    tracemalloc.start()
    refuse_json(text, "more than 2097152 values")
    assert tracemalloc.get_traced_memory()[1] < 6 * len(text)
    tracemalloc.stop()


def test_a_larger_file_is_refused_and_named(tmp_path: Any) -> None:
    (tmp_path / "a").write_bytes(bytes(11))
    assert read_document(tmp_path / "a", 11, what="x", holds="y") == bytes(11)
    with refuses(FileError, "x 'a'", "11 bytes", "y, in a file of at most 10 bytes"):
        read_document(tmp_path / "a", 10, what="x", holds="y")


@pytest.mark.parametrize(
    ("text", "refused"),
    [
        (b"a = [", ("file 'a'", "text that is no TOML: it ends too soon")),
        (b"a = " + b"[" * 200_000, ("file 'a'", "lists or objects more than 64 deep", "TOML")),
        (b"a = " + b"[" * 70 + b"]" * 70, ("file 'a'", "lists or tables more than 64 deep")),
        (b".".join([b"a"] * 100_000) + b" = 1", ("file 'a'", "a line with more than 256 dots")),
        (b".".join([b"a"] * 200) + b" = 1", ("file 'a'", "lists or tables more than 64 deep")),
        (b"a = 1" + 400 * b"0", ("file 'a'", "a whole number of more than 308 digits")),
        (b"a = 1" + 5000 * b"0", ("file 'a'", "text that is no TOML")),
        (b"a = 1\na = 2", ("file 'a'", "text that is no TOML: it ends too soon")),
        (b"\xff", ("file 'a'", "text that is not UTF-8: byte 1 is 0xff", "TOML")),
    ],
)
def test_toml_has_the_same_limits(text: bytes, refused: tuple[str, ...]) -> None:
    with refuses(FileError, *refused):
        parse_toml(text, what="file 'a'")


def test_texts_are_no_numbers() -> None:
    """NumPy would make 1000 texts of 10,000 letters each of these."""
    with refuses(InputError, "x, a"):
        require_arrays("x", {"a": [["y" * 10_000], *[["z"]] * 1000]}, ["a"], action="mend it")
    require_arrays("x", {"a": [[1, 2.0], []], "b": "text"}, ["a"], action="mend it")
    for wrong in ([1, 2], [1, 2, True], [1, 2, float("inf")], "abc", None, {"a": 1}, [1, 2, [3]]):
        with refuses(InputError, "x"):
            require_numbers("x", wrong, 3)


def test_limits_leave_room_for_honest_files() -> None:
    assert documents.MAX_VALUES > 100 * 1000 * 4
