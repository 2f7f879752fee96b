"""`lobewise bench interactive`: its figures, output and files."""

import json
from pathlib import Path
from typing import Any

import pytest

from lobewise.cli.bench.interactive import list_render_devices, measure_devices
from lobewise.cli.bench.machine import describe_machine
from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.interactive.settings import InteractiveSettings
from lobewise.interactive.views import STAGES
from tests.mistakes import refuses

pytestmark = [pytest.mark.mitsuba, pytest.mark.usefixtures("mi")]

QUICK = InteractiveSettings(similarity="none", adaptive=0.0, filter_direct=False)


@pytest.mark.nightly
def test_every_method_and_size_is_measured() -> None:
    seen: list[tuple[int, int]] = []
    found = measure_devices(
        ["cpu"],
        sizes=[(32, 32), (48, 24)],
        methods=["paths"],
        settings=QUICK,
        frames=2,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert found["machine"] == describe_machine()
    assert found["settings"]["similarity"] == "none"
    rows = found["devices"]["cpu"]
    assert [(row["method"], row["width"], row["height"]) for row in rows] == [("paths", 32, 32), ("paths", 48, 24)]
    for row in rows:
        assert set(row["seconds"]) == {*STAGES, "total", "frame"}
        assert 0.0 < row["seconds"]["gbuffer"] < row["seconds"]["frame"]
        assert row["frames_per_second"] == pytest.approx(1.0 / row["seconds"]["frame"])
    assert seen[-1] == (len(seen), len(seen)) == (12, 12)


@pytest.mark.nightly
def test_the_table_fits_a_terminal_and_the_file_says_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bench.json"
    arguments = ["bench", "interactive", "--size", "32x32", "--size", "24x24", "--method", "paths", "--frames", "1"]
    assert run([*arguments, "--similarity", "none", "--device", "cpu", "-o", str(out)]) == 0
    text = capsys.readouterr().out
    assert "\u2026" not in text
    assert max(len(line) for line in text.splitlines()[:-1]) <= 80
    for word in (*STAGES, "frame", "frames a second", "paths", "32x32", "24x24"):
        assert word in text
    found = json.loads(out.read_text())
    assert len(found["devices"]["cpu"]) == 2


def test_rays_are_always_traced_on_the_cpu() -> None:
    assert list_render_devices()[0] == "cpu"


def test_frames_must_be_counted() -> None:
    arguments: dict[str, Any] = {"frames": 0, "methods": ["paths"]}
    with refuses(InputError, "frames"):
        measure_devices(["cpu"], **arguments)
