"""How files are made: seeds of the corpus with something changed in them, and documents made up from a grammar."""

import copy
import io
import json
import re
import struct
import warnings
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from tests.fuzz.corpus import CORPUS
from tests.fuzz.exr_files import make_from_grammar, make_sound, make_structured


def read_seeds(kind: str) -> list[bytes]:
    """Return the corpus of a kind."""
    return [path.read_bytes() for path in sorted((CORPUS / kind).iterdir())]


@st.composite
def damage_bytes(draw: DrawFn, seeds: list[bytes]) -> bytes:
    """Return a seed with bytes changed, cut out, repeated, put in, or taken from another seed."""
    data = draw(st.sampled_from(seeds))
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 3)))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        size = draw(st.sampled_from((1, 2, 4, 8, 100)))
        part, rest = data[at : at + size], data[at + size :]
        how = draw(st.sampled_from(("flip", "set", "cut", "drop", "repeat", "insert", "splice", "number")))
        if how == "flip":
            part = bytes(byte ^ (1 << draw(st.integers(0, 7))) for byte in part[:1]) + part[1:]
        elif how == "set":
            part = bytes([draw(st.sampled_from((0, 9, 34, 91, 123, 127, 128, 255)))]) * len(part)
        elif how == "cut":
            part, rest = b"", b""
        elif how == "drop":
            part = b""
        elif how == "repeat":
            part *= draw(st.sampled_from((2, 3, 100)))
        elif how == "insert":
            part = draw(st.binary(max_size=16)) + part
        elif how == "splice":
            other = draw(st.sampled_from(seeds))
            start = draw(st.integers(0, max(len(other) - 1, 0)))
            rest = other[start:]
        else:
            number = draw(st.sampled_from((0, 1, 255, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)))
            part = struct.pack("<Q", number)[: len(part)]
        data = data[:at] + part + rest
    return data


USUAL_WORDS = (
    *("0.5", "1", "2", "30", "90.0", "-2", "0.1", "1e-3", "1e30"),
    *("[0, 1, 0]", "[1, 0, 0]", "[0, 0, -1]", "[0.5, 2, 0]"),
)
"""Numbers and vectors that honest files hold."""
WORDS = (
    *USUAL_WORDS,
    *("5", "-1", "0", "1e999", "-1e999", "1e-999", "3.5e38", "1e308", "-0.0"),
    *("2147483648", "1" + "0" * 400, "9" * 5000),
    *("NaN", "Infinity", "-Infinity", "true", "false", "null", '""', '"x"', '"\\ud800"', '"\\u0000\\u001b[31m"', '"é"'),
    *("[]", "{}", "[[]]", "[null]", '[""]', "[1, 2]", "[1, 2, 3]", "[1, 2, 3, 4]", '["1", "2", "3"]', "[NaN, 0, 0]"),
    *("[" * 200_000, "[" * 70 + "]" * 70, "[" * 40 + "]" * 40),
    *('{"a":' * 70 + "1" + "}" * 70, "[0" + ", 0" * 9999 + "]"),
    *("{1: 2}", '{"a": 1, "a": 2}', "[1e300, 1e300, 1e300]", "[1e-300, 0, 0]", '"' + "x" * 9999 + '"', "'", '"', "#"),
)
"""Values of JSON, some of which are none."""


def _list_places(value: Any) -> list[tuple[Any, Any]]:
    """Return (container, key) of everything in a document."""
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [place for key in keys for place in ((value, key), *_list_places(value[key]))]


@st.composite
def change_json(draw: DrawFn, seeds: list[bytes]) -> bytes:
    """Return a document of the corpus with values replaced, left out, put in, renamed, or there twice."""
    value = json.loads(draw(st.sampled_from(seeds)))
    words: list[str] = []

    def draw_value() -> str:
        words.append(draw(st.sampled_from(WORDS)))
        return f"@@{len(words) - 1}@@"

    for _ in range(draw(st.sampled_from((1, 1, 2, 3)))):
        places = _list_places(value)
        if not places:
            break
        inside, key = draw(st.sampled_from(places))
        how = draw(st.sampled_from(("replace",) * 4 + ("drop", "wrap", "rename", "swap", "more")))
        if how == "replace":
            inside[key] = draw_value()
        elif how == "drop":
            del inside[key]
        elif how == "wrap":
            inside[key] = [inside[key]]
        elif how == "rename" and isinstance(inside, dict):
            inside[draw(st.sampled_from(("", "x", "position", "é", "a" * 1000, "@@k@@")))] = inside.pop(key)
        elif how == "swap":
            other, where = draw(st.sampled_from(places))
            if where in other if isinstance(other, dict) else where < len(other):
                inside[key] = json.loads(json.dumps(other[where]))
        elif how == "more" and isinstance(inside, list):
            inside.append(inside[key])
    text = json.dumps(value).replace("@@k@@", "\\udc00")
    for number, word in enumerate(words):
        text = text.replace(f'"@@{number}@@"', word)
    if draw(st.integers(0, 9)) == 0:
        text = draw(st.sampled_from(("\ufeff{}", " {}\n", "[{}]", "{}{}", "{},"))).replace("{}", text)
    return text.encode("utf-8", "surrogatepass")


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=4), inner, max_size=5),
    max_leaves=20,
).map(lambda value: json.dumps(value).encode("utf-8", "surrogatepass"))
"""Any document."""


@st.composite
def change_words(draw: DrawFn, seeds: list[bytes]) -> bytes:
    """Return a text of the corpus with numbers and words in it replaced, lines left out, repeated or moved."""
    text = draw(st.sampled_from(seeds)).decode("utf-8", "surrogateescape")
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(("word", "word", "word", "line", "twice", "move")))
        if how == "word":
            found = list(re.finditer(r"-?[\d.]+|\"[^\"]{0,99}\"|\[[^\]]{0,99}\]|[\w*]+|=", text[:5000]))
            if found:
                at = draw(st.sampled_from(found))
                new = draw(st.sampled_from(WORDS + ODD_WORDS)) if how == "word" else ""
                new = f'"{new[:5000]}"' if at[0].startswith('"') and draw(st.booleans()) else new
                text = text[: at.start()] + new + text[at.end() :]
            continue
        lines = text.split("\n")
        at_line = draw(st.integers(0, len(lines) - 1))
        line = lines.pop(at_line)
        if how == "twice":
            lines[at_line:at_line] = [line] * draw(st.sampled_from((2, 3, 1000)))
        elif how == "move":
            lines.insert(draw(st.integers(0, len(lines))), line)
        text = "\n".join(lines)
    return text.encode("utf-8", "surrogatepass")


ODD_WORDS = (
    *USUAL_WORDS,
    *("", "*", "[!]", "[z-a]", "?" * 2000, "*a" * 500, "color", "normal", ":square", ":x", ",", ",,,", "$w", "$r", "w"),
    *("a." * 300 + "a", "a." * 60_000 + "a", "{a={a={a=1}}}", "1979-13-27"),
    *("'''", '"""', "\ud800", "\0", "&lt;", "&a;"),
    *("<!DOCTYPE a [<!ENTITY b 'c'>]>", "<a>" * 1000, "-->", "]]>", "inf", "nan", "0mm", "mm", "path", "optimize=1"),
)


@st.composite
def make_glb(draw: DrawFn, seeds: list[bytes], texts: list[bytes]) -> bytes:
    """Return a binary glTF around a changed text, its header perhaps wrong."""
    text = draw(change_json(texts))
    numbers = [0x46546C67, 2, 20 + len(text), len(text), 0x4E4F534A]
    if draw(st.booleans()):
        at = draw(st.integers(1, 4))
        numbers[at] = draw(st.sampled_from((0, 1, 3, len(text) - 1, len(text) + 1, 2**31, 2**32 - 1)))
    return struct.pack("<5I", *numbers) + text


@st.composite
def make_merl(draw: DrawFn) -> bytes:
    """Return what a MERL file is made of; see `tests.fuzz.readers.read_merl`."""
    whole = 34_992_012
    # Most of them are short: a whole one takes a second.
    sizes = st.sampled_from((0, 1, 11, 12, 13, 20, 1000, 10**6)) | st.sampled_from((whole - 8, whole, whole + 1, whole))
    bins = [90, 90, 180]
    if draw(st.integers(0, 3)) == 0:
        bins[draw(st.integers(0, 2))] = draw(st.sampled_from((0, 1, -90, 89, 91, 2**31 - 1, -(2**31), 360)))
    values = st.sampled_from((0.0, 0.5, -1.0, 1e308, -1e308, 5e-324, float("inf"), float("-inf"), float("nan"), 1e42))
    bits = struct.unpack("<Q", struct.pack("<d", draw(values)))[0]
    patch = st.tuples(
        st.integers(0, whole), st.binary(max_size=16).map(bytes.hex) | values.map(lambda x: struct.pack("<d", x).hex())
    )
    told = {"bins": bins, "bits": bits, "size": draw(sizes), "patches": draw(st.lists(patch, max_size=4))}
    return json.dumps(told).encode()


@st.composite
def change_arrays(draw: DrawFn, seeds: list[bytes]) -> bytes:
    """Return a ``.npz`` whose arrays have other shapes, types and sizes than they say, are packed, or there twice."""
    with zipfile.ZipFile(io.BytesIO(draw(st.sampled_from(seeds)))) as file:
        members = [(name, file.read(name)) for name in file.namelist()]
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(members) - 1))
        name, data = members[at]
        how = draw(st.sampled_from(("header",) * 4 + ("bytes", "array", "array", "drop", "twice", "name", "bomb")))
        start = 10 + struct.unpack_from("<H", data, 8)[0] if len(data) > 10 else len(data)
        if how == "header":
            header = data[10:start].decode("latin-1", "replace")
            shape, kind = draw(st.sampled_from(SHAPES)), draw(st.sampled_from(KINDS))
            if draw(st.booleans()):
                header = re.sub(r"'shape': [^}]*}", f"'shape': {shape}}}", header)
            else:
                header = re.sub(r"'descr': '[^']*'", f"'descr': {kind}", header)
            text = header.rstrip().encode() + b"\n"
            members[at] = name, data[:8] + struct.pack("<H", len(text) % 65536) + text + data[start:]
        elif how == "bytes":
            members[at] = name, draw(damage_bytes([data]))
        elif how == "array":
            array = draw(st.sampled_from(ARRAYS))
            out = io.BytesIO()
            np.save(out, np.array(array))
            members[at] = name, out.getvalue()
        elif how == "drop" and len(members) > 1:
            del members[at]
        elif how == "twice":
            members.append((name, data))
        elif how == "name":
            members[at] = draw(st.sampled_from(("", "x", "../x.npy", "state/x.npy", "state/sums/x.npy", "é.npy"))), data
        elif how == "bomb":
            members[at] = name, data[:start] + bytes(draw(st.sampled_from((1000, 10**7))))
    out = io.BytesIO()
    packing = draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", packing) as file:
        warnings.simplefilter("ignore")  # names that are there twice are meant
        for name, data in members:
            file.writestr(zipfile.ZipInfo(name), data, compress_type=packing)
    return out.getvalue()


SHAPES = ("()", "(0,)", "(1,)", "(2, 3)", "(4, 5, 3)", "(4, 5, 7)", "(5, 4)", "(-1,)", "(10**9,)", "(1000000000,)",
          "(2000, 2000, 200)", "(1 << 40,)", "(9999999999999999999,)", "(4, 5, 3",
          "(" * 300, "None", "'a'", "(1.5,)")  # fmt: skip
KINDS = ("'|O'", "'<f8'", "'<f4'", "'>f4'", "'<i8'", "'|b1'", "'<U4'", "'<U999999999'", "'|V8'", "'<c16'", "'<M8[s]'",
         "[('a', '<f4')]", "'|S0'", "'x'", "5", "'|O8'", "'<f2'")  # fmt: skip
ARRAYS = (0, 1, -1, 2**62, 1.5, float("nan"), True, "normal", "x" * 1000, [], [[1.0]], [1, 2, 3], [float("inf")] * 3,
          np.zeros((4, 5)), np.full((4, 5, 3), np.nan, np.float32), np.zeros((4, 5, 7), np.float32),
          b"x", 1j)  # fmt: skip


@st.composite
def change_message(draw: DrawFn, seeds: list[bytes]) -> bytes:
    """Return a message of a browser with values replaced by those that no browser sends."""
    import msgspec

    value = msgspec.msgpack.decode(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.integers(1, 3))):
        places = _list_places(value)
        inside, key = draw(st.sampled_from(places))
        new = draw(st.sampled_from(MESSAGE_VALUES) | st.floats() | st.integers(-(2**63), 2**63 - 1))
        # A list that is put in may be changed by the next step.
        inside[key] = copy.deepcopy(new)
    return msgspec.msgpack.encode(value)


MESSAGE_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1e300, -1e300, 1e-300, float("nan"), float("inf"), 2**62, "", "x", "one", "x" * 70_000,
    [], {}, [0, 0, 0], [1e9, 1e9, 1e9], ["a"] * 3, [[1]], {"a": 1}, b"\0", 3.1415927, 8.0, 16384, 10**9,
)  # fmt: skip


def _make(kind: str) -> SearchStrategy[bytes]:
    seeds = read_seeds(kind) or [b""]
    damaged = damage_bytes(seeds)
    text = change_words(seeds)
    shaped: dict[str, Callable[[], SearchStrategy[bytes]]] = {
        "exr": lambda: st.one_of(make_structured(seeds), make_structured(seeds), make_from_grammar(), make_sound()),
        "merl": make_merl,
        "lobes": lambda: st.one_of(change_json(seeds), change_json(seeds), JSON),
        "camera_path": lambda: st.one_of(change_json(seeds), change_json(seeds), JSON),
        "object_paths": lambda: st.one_of(change_json(seeds), change_json(seeds), JSON),
        "camera_json": lambda: st.one_of(change_json(seeds), change_json(seeds), JSON),
        "camera_gltf": lambda: st.one_of(change_json(seeds), change_json(seeds), JSON),
        "camera_glb": lambda: make_glb(seeds, read_seeds("camera_gltf")),
        "checkpoint": lambda: change_arrays(seeds),
        "camera_usdc": lambda: damaged,
        "viewer": lambda: change_message(seeds),
    }
    chosen = shaped.get(kind, lambda: text)()
    if kind == "merl":
        return chosen
    return st.one_of(chosen, chosen, chosen, damaged)


def make_strategy(kind: str) -> SearchStrategy[bytes]:
    """Return what makes files of a kind: three of four with a sound structure, the fourth damaged byte by byte."""
    return _make(kind)
