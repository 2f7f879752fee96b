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
        ("text", "words"),
        [
            ("", "empty file"),
            (b"\xff\x00\x80" * 100, "not UTF-8: byte 1 is 0xff"),
            ("not JSON", "no JSON"),
            ("[1, 2]", "got a list"),
            ("[" * 200_000, "more than 64 deep"),
            ('{"format": "gltf", "version": 1}', "another format"),
            ('{"format": "lobewise lobes", "version": 2}', "expected version 1, got version 2"),
            ('{"format": "lobewise lobes", "version": 1, "name": "x"}', "got no kind"),
        ],
    )
    def test_other_files_are_refused(self, text, words, tmp_path):
        path = tmp_path / "x.lobes"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(FileError, match=words) as problem:
            read_lobe_table(path)
        assert str(path) in str(problem.value)

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("twist", [1.0]),
            ("twist", [[[True]]]),
            ("kind", "round"),
            ("kind", 5),
            ("kind", ["sg"]),
            ("kind", None),
            ("version", True),
            ("version", 1.0),
            ("comment", "mine"),
            ("cosine", [10**300, 1]),
            ("cosine", ["x" * 1000, ""]),
            ("name", 3),
            ("albedo", None),
            ("axis", "east"),
            ("amplitude", [[["a"]]]),
        ],
    )
    def test_damaged_values_are_refused(self, table, name, value, tmp_path):
        values = json.loads(lobe_table_to_json(table))
        (tmp_path / "x.lobes").write_text(json.dumps({**values, name: value}))
        with pytest.raises(FileError, match=r"x\.lobes"):
            read_lobe_table(tmp_path / "x.lobes")

    def test_numbers_that_are_none_are_refused(self, table):
        text = lobe_table_to_json(table)
        for word, told in (("NaN", "got NaN"), ("1e999", "cosine"), ("1" + 400 * "0", "401 digits")):
            with pytest.raises(FileError, match=told):
                lobe_table_from_json(text.replace("0.33333334", word, 1))

    def test_missing_file(self, tmp_path):
        with pytest.raises(FileError, match="no such file"):
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
        with pytest.raises(FileError, match="something follows the table"):
            read_merl(path)
        path.write_bytes(path.read_bytes()[:1000])
        with pytest.raises(FileError, match="the end is missing") as problem:
            read_merl(path)
        assert str(path) in str(problem.value)

    def test_empty_and_missing_files(self, tmp_path):
        (tmp_path / "a.binary").touch()
        with pytest.raises(FileError, match="expected a MERL table, got an empty file"):
            read_merl(tmp_path / "a.binary")
        with pytest.raises(FileError, match="no such file"):
            read_merl(tmp_path / "b.binary")
