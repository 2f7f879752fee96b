"""The source distribution is small and makes a wheel, and an index of packages accepts both."""

import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from email import message_from_bytes
from pathlib import Path

import pytest

import lobewise
from releasing import trial
from releasing.sbom import read_project
from releasing.trial import try_wheel

ROOT = Path(__file__).parents[2]
MAX_SOURCE_MEGABYTES = 5.0
PLACES = {"github.com/lobewise/lobewise/blob": False, "raw.githubusercontent.com/lobewise/lobewise": True}
"""Where the files of the repository are, and whether pictures are shown from there."""


def read_citation(name: str) -> str:
    """Return a field of the citation file."""
    (value,) = re.findall(rf"^{name}: (.*)$", (ROOT / "CITATION.cff").read_text(), flags=re.M)
    return str(value)


def test_all_files_name_the_same_release() -> None:
    heads = re.findall(r"^## \[(.*)\] - (.*)$", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)
    assert heads[0] == (read_project()["version"], read_citation("date-released"))
    assert read_citation("version") == read_project()["version"] == lobewise.__version__
    assert read_citation("repository-code") == read_project()["urls"]["Repository"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the source distribution, and a wheel that was built of it."""
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "sdist", "--directory", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True)
    (source,) = folder.glob("*.tar.gz")
    wheel = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    subprocess.run([*wheel, str(source)], check=True)
    (built,) = folder.glob("*.whl")
    return source, built


def list_targets(text: str) -> Iterator[tuple[bool, str]]:
    """Yield the targets of links and pictures of a page, and whether each is a picture's."""
    for mark, target in re.findall(r"(!?)\[[^\]]*\]\(([^)]+)\)", text):
        yield bool(mark), target


@pytest.mark.nightly
class TestDistributions:
    def test_an_index_accepts_them(self, made: tuple[Path, Path]) -> None:
        subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *map(str, made)], check=True)
        assert made[0].stat().st_size < MAX_SOURCE_MEGABYTES * 1e6

    def test_the_description_leads_to_files_of_this_version(self, made: tuple[Path, Path]) -> None:
        with zipfile.ZipFile(made[1]) as file:
            (name,) = (name for name in file.namelist() if name.endswith(".dist-info/METADATA"))
            metadata = message_from_bytes(file.read(name))
        found = list(list_targets(str(metadata.get_payload())))
        assert len(found) == len(list(list_targets((ROOT / "README.md").read_text())))
        own = 0
        for is_picture, target in found:
            assert target.startswith("https://"), target
            for place, shows_pictures in PLACES.items():
                start = f"https://{place}/v{read_project()['version']}/"
                if target.startswith(start):
                    assert is_picture == shows_pictures, target
                    assert (ROOT / target.removeprefix(start)).exists(), target
                    own += 1
        assert own == sum(
            not target.startswith("https://") for _, target in list_targets((ROOT / "README.md").read_text())
        )

    def test_the_wheel_works(self, made: tuple[Path, Path], tmp_path: Path) -> None:
        try_wheel(made[1], tmp_path)

    def test_the_wheel_holds_licence_and_data(self, made: tuple[Path, Path]) -> None:
        with zipfile.ZipFile(made[1]) as file:
            names = set(file.namelist())
        folder = f"lobewise-{read_project()['version']}.dist-info"
        source = ROOT / "src" / "lobewise"
        kept = {
            path.relative_to(source.parent).as_posix() for path in source.rglob("*") if path.suffix in (".npz", ".exr")
        }
        assert kept
        assert names >= {f"{folder}/licenses/LICENSE", "lobewise/py.typed", *kept}


def test_a_wheel_that_writes_no_picture_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[list[str]] = []
    monkeypatch.setattr(trial.subprocess, "run", lambda command, **_: ran.append(command))
    with pytest.raises(SystemExit, match=r"wrote no clean\.exr"):
        try_wheel(tmp_path / "lobewise.whl", tmp_path)
    assert "lobewise.denoise(frame)" in ran[-1][-1]
    (tmp_path / "clean.exr").touch()
    try_wheel(tmp_path / "lobewise.whl", tmp_path)
    assert ran[-1][-1] == "doctor"
