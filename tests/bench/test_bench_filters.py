"""`lobewise bench` without a verb: its jobs, times and tables."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.cli.bench import filters
from lobewise.cli.bench.filters import FULL_SIZE, OIDN, PARTS, QUICK_SIZE, add_halves, make_tables
from lobewise.cli.bench.machine import describe_machine
from lobewise.cli.bench.plane import SIMILARITIES, make_features, make_frame, make_mixture
from lobewise.cli.bench.timing import time_best
from lobewise.cli.program import run
from lobewise.errors import DeviceError, InputError
from lobewise.features import Feature
from lobewise.filters.cross_filter import run_filter
from lobewise.peers import has_oidn
from tests.mistakes import refuses


def make_row(part: str, name: str, milliseconds: float, device: str = "cpu") -> dict[str, Any]:
    """Return a row as a measurement has it."""
    return {
        "part": part, "device": device, "width": 512, "height": 256, "name": name, "milliseconds": milliseconds
    }  # fmt: skip


MEASURED = {
    "machine": {"processor": "Abacus <1>", "threads": 2, "version": "0.1.0"},
    "devices": {"cpu": "beads", "cuda": "more beads"},
    "what": PARTS,
    "skipped": ["Nothing & no one."],
    "rows": [
        make_row("whole frames", "fast, ggx, separable", 1000.0),
        make_row("whole frames", OIDN["fast"], 1500.0),
        make_row("whole frames", OIDN["high"], 6000.0),
        make_row("one kernel, full", "normal", 10.0),
        make_row("one kernel, full", "sg", 12.5),
        make_row("one kernel, full", "normal", 2.0, "cuda"),
        make_row("one kernel, full", "sg", 8.0, "cuda"),
    ],
}


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

    monkeypatch.setattr("lobewise.cli.bench.timing.time.perf_counter", lambda: now)
    candidates = {name: make_call(name) for name in "ab"}
    # Two rounds take 16 seconds; at least three are required.
    assert time_best(candidates, 10.0, rounds=3) == {"a": 2.0, "b": 5.0}
    assert "".join(calls) == "abababab"


def test_more_rounds_follow_until_the_time_is_up(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0

    def call() -> None:
        nonlocal now
        now += 1.0

    monkeypatch.setattr("lobewise.cli.bench.timing.time.perf_counter", lambda: now)
    assert time_best({"a": call}, 10.0, rounds=2) == {"a": 1.0}
    assert now == 11.0


@pytest.mark.nightly
def test_everything_is_measured() -> None:
    seen: list[tuple[int, int]] = []
    found = filters.measure_filters(["cpu"], size=(40, 24), progress=lambda done, total: seen.append((done, total)))
    assert found["machine"] == describe_machine()
    assert list(found["devices"]) == ["cpu"]
    assert bool(found["skipped"]) != has_oidn()
    rows = found["rows"]
    assert list(dict.fromkeys(row["part"] for row in rows)) == list(PARTS)
    assert all(row["milliseconds"] > 0.0 for row in rows)
    assert {(row["width"], row["height"], row["device"]) for row in rows} == {(40, 24, "cpu")}
    names = [row["name"] for row in rows if row["part"] == "one kernel, full"]
    assert names == list(SIMILARITIES)
    assert [row["name"] for row in rows if row["name"] in OIDN.values()] == (list(OIDN.values()) if has_oidn() else [])
    assert seen == [(number, seen[-1][1]) for number in range(len(seen))]


def test_what_cannot_run_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise DeviceError("no beads left")

    jobs = [("whole frames", {"high": refuse}, 1), ("upsampling", {"bilinear": lambda: None}, 1)]
    monkeypatch.setattr(filters, "list_jobs", lambda *_, **__: jobs)
    found = filters.measure_filters(["cpu"], size=(9, 7))
    assert [row["part"] for row in found["rows"]] == ["upsampling"]
    assert "whole frames on cpu: no beads left" in found["skipped"]


def test_what_is_timed_is_what_its_name_says() -> None:
    frame = make_frame(40, 24)
    assert frame.shape == (24, 40)
    features = make_features(frame)
    assert tuple(features) == SIMILARITIES
    names = {name: [feature.name for feature in listed][2:] for name, listed in features.items()}
    assert names["normal"] == ["normal"]
    assert all(len(listed) == 1 for listed in names.values())


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
    for name in ("color", "diffuse", "specular"):
        whole, one, other = (getattr(part, name) for part in (frame.radiance, frame.half_a, frame.half_b))
        np.testing.assert_allclose(0.5 * (one + other), whole, rtol=1e-6)
        assert not np.allclose(one, other)


def test_tables_compare_with_normals_on_the_same_device_or_with_the_peer() -> None:
    assert make_tables(MEASURED) == {
        "Whole frames, 512x256": (
            ["what", "device", "ms", "OIDN, fast, over it", "OIDN, default, over it"],
            [
                ["fast, ggx, separable", "cpu", "1000.0", "1.50", "6.00"],
                [OIDN["fast"], "", "1500.0", "1.00", "4.00"],
                [OIDN["high"], "", "6000.0", "0.25", "1.00"],
            ],
        ),
        "One kernel, full, 512x256": (
            ["what", "device", "ms", "over normal"],
            [
                ["normal", "cpu", "10.0", "1.00"],
                ["sg", "cpu", "12.5", "1.25"],
                ["normal", "cuda", "2.0", "1.00"],
                ["sg", "cuda", "8.0", "4.00"],
            ],
        ),
    }


def test_the_verb_prints_tables_and_writes_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Any] = []

    def measure(devices: Any, *, size: tuple[int, int], progress: Any) -> dict[str, Any]:
        progress(1, 2)
        asked.append((devices, size))
        return MEASURED

    monkeypatch.setattr(filters, "measure_filters", measure)
    path = tmp_path / "bench.json"
    assert run(["bench", "--quick", "--device", "cpu", "-o", str(path)]) == 0
    printed = capsys.readouterr()
    assert json.loads(path.read_text()) == MEASURED
    assert "\u2026" not in printed.out
    assert max(len(line) for line in printed.out.splitlines()[:-2]) <= 80
    for word in ("Whole frames, 512x256", "fast, ggx, separable", "12.5", "Abacus <1>, 2 threads; cuda: more beads"):
        assert word in printed.out
    assert "Nothing & no one." in printed.err
    monkeypatch.chdir(tmp_path)
    assert run(["bench"]) == 0
    assert asked == [(["cpu"], QUICK_SIZE), (None, FULL_SIZE)]
    assert list(tmp_path.iterdir()) == [path]


def test_an_unknown_device_is_refused_before_anything_is_measured() -> None:
    with refuses(InputError, "device"):
        filters.measure_filters(["abacus"])
