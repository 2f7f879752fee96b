"""Files of materials: what comes back, and what is refused."""

import json
from dataclasses import fields

import numpy as np
import pytest

from lobewise.errors import FileError
from lobewise.io.materials import lobe_table_from_json, lobe_table_to_json, read_lobe_table, read_merl, write_lobe_table
from lobewise.records.lobe_table import LobeTable
from tests.fitting.merl_tables import make_merl, to_bytes
from tests.lobes.oracles.brdf import lambert_brdf
from tests.mistakes import refuses


@pytest.fixture
def table(rng):
    """Return an anisotropic table with numbers of every size."""
    axis = rng.normal(size=(3, 2, 4, 3))
    return LobeTable(
        name='brushed "é" steel',
        kind="asg",
        cosine=[0.1, 1.0 / 3.0, 1.0],
        azimuth=[0.0, 1.0],
        axis=axis / np.linalg.norm(axis, axis=-1, keepdims=True),
        sharpness=10.0 ** rng.uniform(-30.0, 30.0, (3, 2, 4, 2)),
        twist=rng.normal(size=(3, 2, 4)),
        amplitude=10.0 ** rng.uniform(-40.0, 38.0, (3, 2, 4)),
        alpha=rng.uniform(0.01, 1.0, (3, 2, 2)),
        albedo=rng.random((3, 2, 3)),
        cosine_l2=rng.random((3, 2)),
    )


def assert_same(one, other):
    """Compare two tables bit by bit."""
    for item in fields(LobeTable):
        np.testing.assert_array_equal(getattr(one, item.name), getattr(other, item.name), err_msg=item.name)


class TestLobeFiles:
    def test_the_same_bits_come_back(self, table, tmp_path):
        write_lobe_table(tmp_path / "steel.lobes", table)
        assert_same(read_lobe_table(tmp_path / "steel.lobes"), table)
        assert_same(lobe_table_from_json(lobe_table_to_json(table)), table)

    def test_it_is_plain_json(self, table):
        values = json.loads(lobe_table_to_json(table))
        assert (values["format"], values["version"], values["kind"]) == ("lobewise lobes", 1, "asg")
        # No more digits than float32 has.
        assert values["cosine"] == [0.1, 0.33333334, 1.0]

    @pytest.mark.parametrize(
        ("text", "got"),
        [
            ("", "an empty file of 0 bytes"),
            (b"\xff\x00\x80" * 100, "text that is not UTF-8: byte 1 is 0xff"),
            ("not JSON", "text that is no JSON from line 1, column 1 on"),
            ("[1, 2]", "a list"),
            ("[" * 200_000, "lists or objects more than 64 deep"),
            ('{"format": "gltf", "version": 1}', "another format"),
            ('{"format": "lobewise lobes", "version": 2}', "version 2"),
            ('{"format": "lobewise lobes", "version": 1, "name": "x"}', "no kind"),
        ],
    )
    def test_other_files_are_refused(self, text, got, tmp_path):
        path = tmp_path / "x.lobes"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        with refuses(FileError, "lobe file 'x.lobes'", got) as problem:
            read_lobe_table(path)
        assert str(path) in str(problem.value)

    @pytest.mark.parametrize(
        ("name", "value", "what"),
        [
            ("twist", [1.0], "lobe table: twist"),
            ("twist", [[[True]]], "lobe table, twist"),
            ("kind", "round", "kind of lobes"),
            ("kind", 5, "lobe file 'x.lobes', kind"),
            ("kind", ["sg"], "lobe file 'x.lobes', kind"),
            ("kind", None, "lobe file 'x.lobes', kind"),
            ("version", True, "lobe file 'x.lobes'"),
            ("version", 1.0, "lobe file 'x.lobes'"),
            ("comment", "mine", "lobe file 'x.lobes'"),
            ("cosine", [10**300, 1], "lobe table: cosine"),
            ("cosine", ["x" * 1000, ""], "lobe table, cosine"),
            ("name", 3, "lobe file 'x.lobes', name"),
            ("albedo", None, "lobe table, albedo"),
            ("axis", "east", "lobe table, axis"),
            ("amplitude", [[["a"]]], "lobe table, amplitude"),
        ],
    )
    def test_damaged_values_are_refused(self, table, name, value, what, tmp_path):
        values = json.loads(lobe_table_to_json(table))
        (tmp_path / "x.lobes").write_text(json.dumps({**values, name: value}))
        with refuses(FileError, what):
            read_lobe_table(tmp_path / "x.lobes")

    def test_numbers_that_are_none_are_refused(self, table):
        text = lobe_table_to_json(table)
        for word, what in (("NaN", "lobe table"), ("1e999", "lobe table, cosine"), ("1" + 400 * "0", "lobe table")):
            with refuses(FileError, what):
                lobe_table_from_json(text.replace("0.33333334", word, 1))

    def test_missing_file(self, tmp_path):
        with refuses(FileError, "lobe file 'x.lobes'", "no such file"):
            read_lobe_table(tmp_path / "x.lobes")


class TestMerlFiles:
    def test_round_trip(self, tmp_path):
        path = tmp_path / "chalk.binary"
        chalk = make_merl(lambert_brdf)
        path.write_bytes(to_bytes(chalk))
        again = read_merl(path)
        assert again.name == "chalk"
        np.testing.assert_allclose(again.samples, chalk.samples, rtol=1e-6)
        with path.open("ab") as stream:
            stream.write(b"\0")
        with refuses(FileError, "MERL file 'chalk'", "34992013, so something follows the table", holder="chalk.binary"):
            read_merl(path)
        path.write_bytes(path.read_bytes()[:1000])
        with refuses(FileError, "MERL file 'chalk'", "1000, so the end is missing", holder="chalk.binary") as problem:
            read_merl(path)
        assert str(path) in str(problem.value)

    def test_empty_and_missing_files(self, tmp_path):
        (tmp_path / "a.binary").touch()
        with refuses(FileError, "input 'a.binary'"):
            read_merl(tmp_path / "a.binary")
        with refuses(FileError, "input 'b.binary'"):
            read_merl(tmp_path / "b.binary")
