"""The site builds without a warning and stands alone, its reference is whole, its notebooks run."""

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.notebooks import list_notebooks, run_notebook

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PUBLIC_MODULES = ("lobewise", "lobewise.render", "lobewise.interactive", "lobewise.mitsuba")
MITSUBA_NOTEBOOKS = ("mitsuba", "sequence")
PICTURES = {"quality": 0, "engine": 0, "blender": 2, "mitsuba": 3, "feature": 2}
"""Cards of frames and results that a notebook shows; one where it is not named."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the built site."""
    pytest.importorskip("mitsuba", reason="the reference imports lobewise.render")
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(DOCS, folder / "docs")
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "docs", "html"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return folder / "html"


@pytest.mark.nightly
def test_front_page_has_its_pictures_and_doors(site: Path) -> None:
    page = (site / "index.html").read_text()
    for name in re.findall(r'(?:src|href)="([^"#:]+?)(?:\?[^"]*)?(?:#[^"]*)?"', page):
        assert (site / name).exists(), name
    assert page.count("sd-card-title") == 3


@pytest.mark.nightly
def test_pages_need_no_other_server(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert not re.findall(r'(?:src|<link[^>]*href)="https?://[^"]+"', page.read_text()), page.name


@pytest.mark.nightly
def test_site_says_where_links_out_of_docs_lead(site: Path) -> None:
    assert "https://github.com/lobewise/lobewise/blob/main/README.md" in (site / "command_line.html").read_text()


@pytest.mark.parametrize("module", PUBLIC_MODULES)
def test_reference_names_everything_public(module: str) -> None:
    pages = "\n".join(path.read_text() for path in (DOCS / "api").glob("*.md"))
    told = set()
    for block in re.split(r"^\.\. currentmodule:: ", pages, flags=re.M)[1:]:
        home, _, rest = block.partition("\n")
        told |= {f"{home.strip()}.{name}" for name in re.findall(r"^\.\. auto\w+:: (\w+)", rest, flags=re.M)}
    public = {f"{module}.{name}" for name in importlib.import_module(module).__all__} - {"lobewise.__version__"}
    assert public - told == set()


@pytest.mark.nightly
@pytest.mark.parametrize("path", list_notebooks(), ids=lambda path: path.stem)
def test_notebook_runs(path: Path, request: pytest.FixtureRequest) -> None:
    if path.stem in MITSUBA_NOTEBOOKS:
        request.getfixturevalue("mi")
    if path.stem == "engine" and shutil.which("c++") is None:
        reason = "the example needs a C++ compiler: apt install g++"
        pytest.fail(reason) if os.environ.get("CI") else pytest.skip(reason)
    book = run_notebook(path)
    outputs = [output for cell in book.cells if cell.cell_type == "code" for output in cell.outputs]
    printed = "".join(output.get("text", "") for output in outputs)
    pictures = sum("text/html" in output.get("data", {}) for output in outputs)
    assert pictures >= PICTURES.get(path.stem, 1)
    if path.stem == "mitsuba":
        assert any("reference 100 %" in str(output.get("data", {}).get("text/html")) for output in outputs)
    if path.stem == "engine":
        differences = re.findall(r"largest relative difference (\S+)", printed)
        assert len(differences) == 5, printed
        assert max(map(float, differences)) < 1e-5
