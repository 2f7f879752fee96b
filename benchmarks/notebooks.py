"""Run the tutorials and keep their outputs in the files.

    python -m benchmarks.notebooks [NAME ...]

Without names, all notebooks of docs are run, each from top to bottom in a fresh Python process and a copy of
the folder, so that the files that they write vanish.
"""

import argparse
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

from benchmarks.common import ROOT

DOCS = ROOT / "docs"
MAX_CELL_SECONDS = 600
VERSION = 4


def list_notebooks() -> list[Path]:
    """Return all tutorials."""
    return sorted(DOCS.rglob("*.ipynb"))


def run_notebook(path: Path) -> Any:
    """Return a notebook with the outputs of a fresh run; raise CellExecutionError if a cell fails."""
    book = nbformat.read(path, as_version=VERSION)
    with tempfile.TemporaryDirectory() as folder:
        for each in path.parent.iterdir():
            if each.is_file() and each.suffix not in (".ipynb", ".md"):
                shutil.copy(each, folder)
        client = NotebookClient(
            book, timeout=MAX_CELL_SECONDS, kernel_name="python3", resources={"metadata": {"path": folder}}
        )
        client.execute()
    for cell in book.cells:  # times of the run: they would change the file with every run
        cell.metadata.pop("execution", None)
    return book


def main() -> None:
    """Run the notebooks that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="names without ending")
    asked = parser.parse_args()
    for path in list_notebooks():
        if not asked.names or path.stem in asked.names:
            start = time.perf_counter()
            nbformat.write(run_notebook(path), path)
            print(f"{path.name}: {time.perf_counter() - start:.0f} s, {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
