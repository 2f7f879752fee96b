"""`lobewise fit` as users call it: its output, its files and its errors."""

import struct
import sys

import numpy as np
import pytest

from lobewise.cli.fitting import choose_plot
from lobewise.cli.program import run
from lobewise.fitting.fit import fit_lobes
from lobewise.fitting.ggx import ggx_brdf
from lobewise.fitting.merl import FILE_BYTES
from lobewise.io.materials import read_lobe_table
from lobewise.reporting.fit_plot import draw_fit
from tests.cli import lines
from tests.fitting.merl_tables import make_merl, to_bytes
from tests.lobes.oracles.brdf import lambert_brdf
from tests.pythons import run_python


@pytest.fixture(scope="module")
def material(tmp_path_factory):
    """Return the path of a MERL file of a reddish GGX of roughness 0.2."""
    path = tmp_path_factory.mktemp("merl") / "copper.binary"
    color = np.asarray([0.9, 0.5, 0.2])
    path.write_bytes(to_bytes(make_merl(lambda view, light: ggx_brdf(view, light, 0.2)[:, None] * color)))
    return path


def read_png_size(data):
    """Return (width, height) of a PNG."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">2I", data[16:24])


class TestFit:
    @pytest.mark.nightly
    def test_a_file_becomes_lobes_residuals_and_a_plot(self, material, tmp_path, capsys):
        out = tmp_path / "copper.lobes"
        assert run(["fit", str(material), "-o", str(out), "--lobes", "2"]) == 0
        table = read_lobe_table(out)
        assert (table.name, table.kind, table.lobe_count) == ("copper", "asg", 2)
        assert table.cosine_l2[-1, 0] > 0.99
        np.testing.assert_allclose(table.alpha[-1], 0.2, rtol=0.01)
        assert table.albedo[-1, 0, 0] > table.albedo[-1, 0, 2]
        width, height = read_png_size((tmp_path / "copper.png").read_bytes())
        assert min(width, height) > 500
        printed = capsys.readouterr().out
        assert "copper: 2 asg lobes a view" in printed
        assert f"{table.cosine_l2[-1, 0]:.4f}" in printed
        assert printed.count("│") == (table.cosine.size) * 6
        assert printed.endswith(f"Wrote {out} and {tmp_path / 'copper.png'}.\n")

    def test_choices_arrive(self, material, tmp_path):
        out = tmp_path / "a.lobes"
        assert run(["fit", str(material), "-o", str(out), "--lobes", "1", "--kind", "sg", "--no-plot"]) == 0
        table = read_lobe_table(out)
        assert (table.kind, table.lobe_count) == ("sg", 1)
        assert list(tmp_path.iterdir()) == [out]

    def test_where_the_plot_goes(self, tmp_path):
        out, other = tmp_path / "a.lobes", tmp_path / "b.png"
        assert choose_plot(out, other, wanted=True) == other
        assert choose_plot(out, None, wanted=True) == tmp_path / "a.png"
        assert choose_plot(out, None, wanted=False) is None


class TestMistakes:
    """Every mistake gives one sentence and exit code 2, and writes no file."""

    @pytest.fixture
    def fail(self, tmp_path, capsys):
        """Return a function that runs a line which must fail, and returns its error."""

        def call(material, *arguments):
            before = sorted(tmp_path.iterdir())
            told = lines.fail(capsys, "fit", material, "-o", tmp_path / "out.lobes", *arguments)
            assert sorted(tmp_path.iterdir()) == before
            return told

        return call

    def test_broken_files(self, material, tmp_path, fail):
        path = tmp_path / "bad.binary"
        good = material.read_bytes()
        cases = {
            "34992011, so the end is missing": good[:-1],
            "20000630, 90, 180": b"\x76\x2f\x31\x01" + good[4:4000],
            "none: all are marked as not measured": good[:12] + np.full((FILE_BYTES - 12) // 8, -1.0).tobytes(),
            "an empty file of 0 bytes": b"",
        }
        for got, data in cases.items():
            path.write_bytes(data)
            assert fail(path).got == got

    def test_without_matplotlib(self, material, fail, monkeypatch):
        monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
        assert fail(material).what == "the plot of a fit"

    def test_nothing_is_written_when_the_plot_fails(self, material, tmp_path, monkeypatch):
        def explode(*_arguments):
            raise ZeroDivisionError

        table = fit_lobes(lambert_brdf, cosines=[1.0], lobes=1)
        monkeypatch.setattr("lobewise.fitting.fit.fit_lobes", lambda *_arguments, **_settings: table)
        monkeypatch.setattr("lobewise.reporting.fit_plot.draw_fit", explode)
        assert run(["fit", str(material), "-o", str(tmp_path / "out.lobes"), "--lobes", "1"]) == 1
        assert not list(tmp_path.iterdir())


@pytest.mark.sampled("cosines0")
@pytest.mark.parametrize("cosines", [[1.0], np.linspace(0.1, 1.0, 5)])
def test_plots_of_few_views(cosines):
    def hole(view, light):
        return np.where(light[:, 0] > 0.5, np.nan, ggx_brdf(view, light, 0.3))

    table = fit_lobes(hole, cosines=cosines, lobes=1, name="50 $ a $ piece")
    assert min(read_png_size(draw_fit(table, hole))) > 100


def test_nothing_heavy_is_imported_before_it_is_needed():
    code = (
        "import lobewise.fitting.fit, lobewise.reporting.fit_plot, lobewise.io.materials, lobewise.cli.fitting, sys;"
        "print(sorted(set(sys.modules) & {'scipy', 'matplotlib', 'rich.table'}))"
    )
    assert run_python("-c", code) == "[]\n"
