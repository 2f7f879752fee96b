"""Workers that die of a frame, have a full disk or another version: real processes, and a sentence for each."""

import re
from pathlib import Path

import pytest

import lobewise
from tests.farm.conftest import NUMBERS, read_outputs, require_frame_3_failed, require_only_frame_3_is_filtered
from tests.farm.hurting import DEATH, make_hurt
from tests.farm.processes import Farm, run_program

pytestmark = [pytest.mark.processor, pytest.mark.usefixtures("dask")]
ADDRESS = r"tcp://127\.0\.0\.1:\d+"


@pytest.mark.sampled("local")
@pytest.mark.parametrize("kind", ["farm", "nannies", "local"])
def test_a_frame_that_kills_its_workers_is_named_and_the_others_are_done(
    kind: str, sources: Path, expected: dict[str, bytes], folder: Path, tmp_path: Path
) -> None:
    if kind != "local":
        with Farm(tmp_path, more=make_hurt("die 3"), has_nannies=kind == "nannies") as farm:
            done = run_program(sources, folder, "--farm", farm.address)
        assert (tmp_path / "dask.log").read_text().count(DEATH) == 3
    else:
        before = "from tests.farm import hurting; hurting.hurt_local_processes()"
        done = run_program(sources, folder, "--workers", "2", before=before, more=make_hurt("die 3"))
    worker = "process " if kind == "local" else "tcp://"
    named = [line for line in done.stderr.splitlines() if line.startswith(f"Frame 3, worker {worker}")]
    assert len(named) == 1, done.stderr
    assert ": its process ended while it filtered this: memory was short, " in named[0]
    require_frame_3_failed(done, folder, expected)
    require_only_frame_3_is_filtered(sources, folder, expected)


@pytest.mark.nightly
def test_a_full_disk_of_one_worker_is_told_and_another_worker_does_its_frames(
    sources: Path, expected: dict[str, bytes], folder: Path, tmp_path: Path
) -> None:
    with Farm(tmp_path, workers=1) as farm:
        farm.add_worker(**make_hurt("full 4096"))
        done = run_program(sources, folder, "--farm", farm.address)
    assert done.returncode == 0, done.stderr
    told = rf"Frame (\d+), tried again after worker {ADDRESS} failed: output '{folder}/out\.00(\d\d)\.exr': "
    told += r"expected a path that can be written, got file too large; choose another path or make room\.\n"
    found = re.findall(told, done.stderr)
    assert len(found) == 1, done.stderr
    assert int(found[0][0]) == int(found[0][1])
    assert read_outputs(folder) == expected
    assert [path for path in folder.iterdir() if path.is_dir()] == []


@pytest.mark.nightly
def test_full_disks_of_all_workers_name_every_frame_and_leave_nothing(
    sources: Path, folder: Path, tmp_path: Path
) -> None:
    with Farm(tmp_path, more=make_hurt("full 4096")) as farm:
        done = run_program(sources, folder, "--farm", farm.address)
    assert done.returncode == 2
    assert len(re.findall(rf"Frame \d+, worker {ADDRESS}: output '", done.stderr)) == 20
    assert f"lobewise: {len(NUMBERS)} of {len(NUMBERS)} frames could not be filtered (" in done.stderr
    assert read_outputs(folder) == {}
    assert list(folder.rglob("*.part")) == []


def put_old_version(folder: Path) -> dict[str, str]:
    """Put an old lobewise below a folder; return the environment of a worker that has it."""
    package = folder / "old" / "lobewise"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("__version__ = '0.0.1'\n")
    return {"PYTHONPATH": str(package.parent)}


OLD = f"it has lobewise 0.0.1 instead of {lobewise.__version__}, which must be installed there"


def test_a_worker_of_another_version_gets_no_frame(
    sources: Path, expected: dict[str, bytes], folder: Path, tmp_path: Path
) -> None:
    with Farm(tmp_path, workers=1) as farm:
        farm.add_worker(**put_old_version(tmp_path))
        done = run_program(sources, folder, "--farm", farm.address, "--frames", "1-6")
    assert done.returncode == 0, done.stderr
    assert len(re.findall(rf"The worker {ADDRESS} is not used: {OLD}\.\n", done.stderr)) == 1
    assert read_outputs(folder) == {name: expected[name] for name in sorted(expected)[:6]}


@pytest.mark.nightly
def test_a_farm_of_another_version_is_refused(sources: Path, folder: Path, tmp_path: Path) -> None:
    with Farm(tmp_path, workers=1, more=put_old_version(tmp_path)) as farm:
        done = run_program(sources, folder, "--farm", farm.address)
    assert done.returncode == 2
    refused = (
        rf"lobewise: --farm: expected a worker that can be used, got none \({ADDRESS}: {OLD}\); see docs/farm\.md\.\n"
    )
    assert re.search(refused, done.stderr), done.stderr
    assert list(folder.iterdir()) == []
