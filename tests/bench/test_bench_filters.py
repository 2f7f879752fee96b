"""`lobewise bench` without a verb: its jobs, times, tables and plots."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.bench import filters, plan
from lobewise.bench.kernels import count_taps
from lobewise.bench.machine import describe_machine
from lobewise.bench.page import make_bench_page
from lobewise.bench.plan import MEANINGS_OF_TIMES, Extent, add_halves, list_threads
from lobewise.bench.plane import SIMILARITIES, make_features, make_frame, make_mixture
from lobewise.bench.plots import draw_plots
from lobewise.bench.summary import Section, format_time, make_sections
from lobewise.bench.timing import limit_threads, time_best
from lobewise.cli.main import run
from lobewise.errors import InputError, MissingDependencyError
from lobewise.features import Feature
from lobewise.filters.cross_filter import run_filter
from lobewise.peers import has_oidn

TINY = Extent(
    size=(40, 24),
    sizes=((24, 24), (40, 24)),
    recipe_size=(40, 24),
    radius_size=(40, 24),
    radii=(8,),
    lobes=(1,),
    scales=(2,),
    forms=("separable",),
    qualities=("fast",),
    similarities=("normal", "sg"),
    core=("normal",),
    seconds=0.0,
    rounds=1,
    recipe_rounds=1,
)


def make_row(part: str, name: str, milliseconds: float, **facts: Any) -> dict[str, Any]:
    """Return a row as a measurement has it."""
    return {"part": part, "name": name, "device": "cpu", **facts, "milliseconds": milliseconds}


def make_data(*rows: dict[str, Any]) -> dict[str, Any]:
    """Return a measurement of these rows."""
    return {
        "machine": {"processor": "Abacus <1>", "threads": 2, "version": "0.1.0"},
        "devices": {"cpu": "beads", "cuda": "more beads"},
        "what": MEANINGS_OF_TIMES,
        "skipped": ["Nothing & no one."],
        "seconds": 90.0,
        "rows": list(rows),
    }


FULL_HD = {"width": 1920, "height": 1080, "radius": 8}
PAPER = {"width": 1024, "height": 1024, "form": "separable"}
SMALL = {"width": 512, "height": 512, "form": "separable", "radius": 8}
ROWS = (
    make_row("forms", "normal", 10.0, **SMALL),
    make_row("forms", "sg", 12.5, **SMALL),
    make_row("radius", "normal", 40.0, radius=8, **PAPER),
    make_row("radius", "sg", 50.0, radius=8, **PAPER),
    make_row("radius", "ggx", 90.0, radius=8, **PAPER),
    make_row("radius", "normal", 60.0, radius=16, **PAPER),
    make_row("lobes", "one axis", 20.0, lobes=1, **SMALL),
    make_row("lobes", "one axis", 30.0, lobes=3, **SMALL),
    make_row("lobes", "own axes", 55.0, lobes=3, **SMALL),
    make_row("pixels", "sg", 11.0, **SMALL),
    make_row("pixels", "sg", 80.5, **FULL_HD, form="separable"),
    make_row("pixels", "OIDN, fast", 200.0, **SMALL),
    make_row("threads", "sg", 19.0, threads=1, **SMALL),
    make_row("threads", "sg", 10.0, threads=2, **SMALL),
    make_row("upsampling", "bilinear", 3.0, scale=2, **FULL_HD),
    make_row("denoising", "balanced", 1000.0, **FULL_HD),
    make_row("denoising", "OIDN, fast", 1500.0, **FULL_HD),
    make_row("denoising", "OIDN, default", 6000.0, **FULL_HD),
)


def get_section(data: dict[str, Any], key: str) -> Section:
    """Return the section of a key."""
    return next(section for section in make_sections(data) if section.key == key)


def test_candidates_run_in_turn_and_their_first_run_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    calls: list[str] = []
    seconds = {"a": iter([9.0, 3.0, 2.0, 4.0]), "b": iter([1.0, 5.0, 6.0, 7.0])}

    def make_call(name: str) -> Any:
        def call() -> None:
            nonlocal now
            calls.append(name)
            now += next(seconds[name])

        return call

    monkeypatch.setattr("lobewise.bench.timing.time.perf_counter", lambda: now)
    candidates = {name: make_call(name) for name in "ab"}
    # Two rounds take 16 seconds; at least three are required.
    assert time_best(candidates, 10.0, rounds=3) == {"a": 2.0, "b": 5.0}
    assert "".join(calls) == "abababab"


def test_more_rounds_follow_until_the_time_is_up(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0

    def call() -> None:
        nonlocal now
        now += 1.0

    monkeypatch.setattr("lobewise.bench.timing.time.perf_counter", lambda: now)
    assert time_best({"a": call}, 10.0, rounds=2) == {"a": 1.0}
    assert now == 11.0


@pytest.mark.nightly
def test_everything_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(filters, "list_threads", lambda: [1, 2])
    seen: list[tuple[int, int]] = []
    found = filters.measure_filters(["cpu"], extent=TINY, progress=lambda done, total: seen.append((done, total)))
    assert found["machine"] == describe_machine()
    assert list(found["devices"]) == ["cpu"]
    assert bool(found["skipped"]) != has_oidn()
    rows = found["rows"]
    assert list(dict.fromkeys(row["part"] for row in rows)) == list(MEANINGS_OF_TIMES)
    assert all(row["milliseconds"] > 0.0 for row in rows)
    ours = [(row["part"], row["name"]) for row in rows if not row["name"].startswith("OIDN")]
    assert ours == [
        ("forms", "normal"),
        ("forms", "sg"),
        ("radius", "normal"),
        ("radius", "sg"),
        ("lobes", "one axis"),
        ("pixels", "normal"),
        ("pixels", "normal"),
        ("threads", "normal"),
        ("threads", "normal"),
        ("upsampling", "bilinear"),
        ("upsampling", "normal"),
    ]
    assert [row["threads"] for row in rows if row["part"] == "threads"] == [1, 2]
    peers = [row["part"] for row in rows if row["name"].startswith("OIDN")]
    assert peers == (["pixels"] * 4 + ["denoising"] * 3 if has_oidn() else [])
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert len({total for _, total in seen}) == 1
    assert seen[0][0] == 0
    assert seen[-1][0] == seen[-1][1]


def test_threads_are_counted_in_powers_of_two_up_to_all(monkeypatch: pytest.MonkeyPatch) -> None:
    for number, expected in (("1", [1]), ("2", [1, 2]), ("6", [1, 2, 4, 6]), ("16", [1, 2, 4, 8, 16])):
        monkeypatch.setenv("HL_NUM_THREADS", number)
        assert list_threads() == expected
    limit_threads(3)
    assert os.environ["HL_NUM_THREADS"] == "3"


def test_what_is_timed_is_what_its_name_says() -> None:
    frame = make_frame(40, 24)
    assert frame.shape == (24, 40)
    features = make_features(frame)
    assert tuple(features) == SIMILARITIES
    names = {name: [feature.name for feature in listed][2:] for name, listed in features.items()}
    assert names["normal"] == ["normal"]
    assert all(len(listed) == 1 for listed in names.values())
    assert [count_taps(form, 8) for form in ("full", "separable", "atrous")] == [289, 34, 125]


@pytest.mark.nightly
def test_lobes_with_own_axes_weigh_as_those_with_one() -> None:
    frame = make_frame(40, 24)
    mask = np.ones(frame.shape, dtype=bool)

    def filter_with(*features: Feature) -> Any:
        return run_filter(frame.radiance.color, mask, features, form="separable", radius=3).image

    apart, together = (filter_with(make_mixture(frame, 2, coaxial=coaxial)) for coaxial in (False, True))
    # The exponents of own axes are computed from their cosine, which near 1 has few digits left in float32.
    np.testing.assert_allclose(apart, together, rtol=2e-3)
    assert np.abs(apart - frame.radiance.color).max() > 0.1


def test_halves_add_up_to_the_frame() -> None:
    frame = add_halves(make_frame(9, 7))
    assert frame.half_a is not None
    assert frame.half_b is not None
    for name in ("color", "diffuse", "specular"):
        whole, one, other = (getattr(part, name) for part in (frame.radiance, frame.half_a, frame.half_b))
        np.testing.assert_allclose(0.5 * (one + other), whole, rtol=1e-6)
        assert not np.allclose(one, other)


def test_tables_say_what_was_measured() -> None:
    data = make_data(*ROWS)
    assert get_section(data, "paper").rows == [
        ["normal", "8", "40.0", "1.00", "1.00"],
        ["sg", "8", "50.0", "1.25", "1.35"],
        ["ggx", "8", "90.0", "2.25", ""],
        ["normal", "16", "60.0", "1.00", "1.00"],
    ]
    assert get_section(data, "forms").header == ["similarity", "separable", "ratio"]
    assert get_section(data, "forms").rows == [["normal", "10.0", "1.00"], ["sg", "12.5", "1.25"]]
    lobes = get_section(data, "lobes")
    assert (lobes.header, lobes.rows) == (
        ["lobes", "1", "3"],
        [["one axis", "20.0", "30.0"], ["own axes", "", "55.0"]],
    )
    assert get_section(data, "pixels").header == ["megapixels", "0.26", "2.1"]
    assert get_section(data, "threads").rows == [["sg", "19.0", "10.0", "1.90"]]
    assert get_section(data, "denoising").rows[0] == ["balanced", "1000", "6.00", "1.50"]
    assert "1920x1080" in get_section(data, "denoising").title
    assert [format_time(value) for value in (0.5, 9.876, 42.42, 1234.5)] == ["0.50", "9.88", "42.4", "1234"]


def test_parts_without_rows_are_left_out() -> None:
    assert [section.key for section in make_sections(make_data(ROWS[0]))] == ["forms"]


def test_several_devices_are_told_apart_and_the_peer_comes_once() -> None:
    doubled = make_data(*ROWS, *({**row, "device": "cuda", "milliseconds": 0.5 * row["milliseconds"]} for row in ROWS))
    pixels = get_section(doubled, "pixels").rows
    assert pixels == [
        ["sg, cpu", "11.0", "80.5"],
        ["OIDN, fast", "200", ""],
        ["sg, cuda", "5.50", "40.2"],
    ]
    # Ratios are to the same device.
    assert get_section(doubled, "forms").rows[-1] == ["sg, cuda", "6.25", "1.25"]


def test_every_plot_is_a_picture() -> None:
    pytest.importorskip("matplotlib")
    plots = draw_plots(make_data(*ROWS))
    assert list(plots) == ["pixels", "radius", "lobes", "threads"]
    assert all(png.startswith(b"\x89PNG") for png in plots.values())
    # A single number of threads gives no curve.
    alone = draw_plots(make_data(make_row("threads", "sg", 19.0, threads=1, **SMALL)))
    assert alone == {}


def test_page_holds_every_figure_and_obeys_no_name() -> None:
    page = make_bench_page(make_data(*ROWS), {"pixels": b"png"}, "lobewise bench --device <b>")
    for section in make_sections(make_data(*ROWS)):
        for cell in (cell for row in section.rows for cell in row):
            assert f">{cell}<" in page
    assert "Abacus &lt;1&gt;" in page
    assert "Nothing &amp; no one." in page
    assert "--device &lt;b&gt;" in page
    assert page.count("<img") == 1


def test_the_verb_writes_page_plots_and_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    asked: list[Any] = []

    def measure(devices: Any, *, extent: Extent, progress: Any) -> dict[str, Any]:
        progress(1, 2)
        asked.append((devices, extent))
        return make_data(*ROWS)

    monkeypatch.setattr(filters, "measure_filters", measure)
    folder = tmp_path / "new" / "bench"
    assert run(["bench", "--quick", "--device", "cpu", "-o", str(folder)]) == 0
    printed = capsys.readouterr()
    assert asked == [(["cpu"], plan.QUICK)]
    assert sorted(path.name for path in folder.iterdir()) == [
        "bench.json",
        "index.html",
        "lobes.png",
        "pixels.png",
        "radius.png",
        "threads.png",
    ]
    assert json.loads((folder / "bench.json").read_text()) == make_data(*ROWS)
    assert "lobewise bench --quick --device cpu" in (folder / "index.html").read_text()
    assert "\u2026" not in printed.out
    assert "Whole frames, 1920x1080" in printed.out
    assert "Nothing & no one." in printed.err
    monkeypatch.chdir(tmp_path)
    assert run(["bench"]) == 0
    assert asked[-1] == (None, plan.FULL)
    assert (tmp_path / "lobewise-bench" / "index.html").exists()


def test_without_matplotlib_only_the_plots_are_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(data: Any) -> Any:
        raise MissingDependencyError("no matplotlib")

    monkeypatch.setattr(filters, "measure_filters", lambda *_, **__: make_data(*ROWS))
    monkeypatch.setattr("lobewise.bench.plots.draw_plots", refuse)
    assert run(["bench", "-o", str(tmp_path)]) == 0
    assert "no matplotlib" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bench.json", "index.html"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--device", "abacus"], "abacus"),
        (["-o", "taken"], "taken"),
        (["--quick", "interactive"], "bench"),
        (["filters"], "filters"),
        (["--radius", "8"], "radius"),
    ],
    ids=str,
)
def test_bad_input_is_told_in_a_sentence(
    arguments: list[str],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("a file")
    assert run(["bench", *arguments]) == 2
    told = capsys.readouterr().err
    assert says in told
    assert told.count("\n") == 1


def test_an_unknown_device_is_refused_before_anything_is_measured() -> None:
    with pytest.raises(InputError, match="device"):
        filters.measure_filters(["abacus"])
