"""The package and the program's help appear at once: nothing heavy is imported before it is needed."""

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import lobewise
from lobewise.io import write_frame

HEAVY = {
    "numpy",
    "halide",
    "scipy",
    "OpenEXR",
    "mitsuba",
    "drjit",
    "matplotlib",
    "viser",
    "PIL",
    "pyoidn",
    "flip_evaluator",
    "lobewise.io",
}

UNUSED_BY_ONE_FILE = {
    *("pydantic", "rich.console", "lobewise.farm", "lobewise.interchange.cameras.files"),
    *("lobewise.recipes.windows", "lobewise.recipes.temporal", "lobewise.viewer.server"),
    *("lobewise.recipes.upsampling", "lobewise.recipes.streaming.recipe", "lobewise.denoising.refining.network"),
    *("lobewise.fitting.table", "lobewise.display.cards", "lobewise.cli.commands", "importlib.metadata"),
    *(HEAVY - {"numpy", "halide", "OpenEXR", "lobewise.io"}),
}
"""What `lobewise denoise` of a single file does without."""

# Every help, one after the other in one process: the first that loads something is the one to blame.
ASK_FOR_HELP = f"""
import json, sys
import typer
from lobewise.cli.commands import app
from lobewise.cli.program import run

def list_verbs(command, before):
    yield before
    for name, child in getattr(command, "commands", {{}}).items():
        yield from list_verbs(child, [*before, name])

found = []
for verb in list_verbs(typer.main.get_command(app), []):
    for word in ("--help", *(["--version"] if not verb else [])):
        code = run([*verb, word])
        found.append([[*verb, word], code, sorted(set(sys.modules) & {HEAVY})])
sys.stderr.write(json.dumps(found))
"""


def ask_python(code: str) -> subprocess.CompletedProcess[str]:
    """Return what a process of its own printed."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)


def test_no_help_loads_anything_heavy() -> None:
    done = ask_python(ASK_FOR_HELP)
    found = json.loads(done.stderr)
    asked = [words for words, _, _ in found]
    for expected in (["--help"], ["--version"], ["denoise", "--help"], ["bench", "interactive", "--help"]):
        assert expected in asked
    for words, code, loaded in found:
        assert code == 0, words
        assert loaded == [], words
    assert done.stdout.count("Usage: lobewise") == len(asked) - 1
    assert f"lobewise {lobewise.__version__}" in done.stdout


def test_denoising_one_file_loads_no_more_than_it_uses(make_frame: Any, tmp_path: Path) -> None:
    source, target = tmp_path / "noisy.exr", tmp_path / "clean.exr"
    write_frame(source, make_frame(height=8, width=8))
    command = ["denoise", str(source), "-o", str(target), "--quality", "fast"]
    code = f"import sys; from lobewise.cli import main; sys.argv[1:] = {command}\ntry: main()\n"
    code += f"finally: print(sorted(set(sys.modules) & {UNUSED_BY_ONE_FILE}))"
    assert ask_python(code).stdout.splitlines()[-1] == "[]"
    assert target.is_file()


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = f"import sys, lobewise; dir(lobewise); print(sorted(set(sys.modules) & {HEAVY | {'typer', 'rich'}}))"
    assert ask_python(code).stdout.strip() == "[]"


IMPORT_ALL = """
import importlib, pkgutil, sys
sys.modules.update(dict.fromkeys(["halide", "llvmlite"]))
import lobewise
for module in pkgutil.walk_packages(lobewise.__path__, "lobewise."):
    if module.name != "lobewise.__main__":
        importlib.import_module(module.name)
from lobewise.backend.jit import get_kernel
from lobewise.filters.refinement.pyramid import make_filter
try:
    get_kernel("cpu", ("filter",), make_filter)
except lobewise.LobewiseError as problem:
    print(problem)
"""


def test_the_package_needs_no_compiler_until_a_kernel_is_compiled() -> None:
    """Every module can be imported without Halide and LLVM; a kernel that must be compiled is refused in a sentence."""
    told = ask_python(IMPORT_ALL).stdout
    assert told.count("\n") == 1
    assert "Halide" in told
    assert "pip install 'lobewise[jit]'" in told


def test_every_public_name_is_listed_and_loads_alone() -> None:
    assert set(lobewise.__all__) <= set(dir(lobewise))
    code = "import lobewise; print(sorted(set(lobewise.__all__) - set(dir(lobewise))), lobewise.Frame.__module__)"
    assert ask_python(code).stdout.strip() == "[] lobewise.records.frame"
    assert ask_python("from lobewise import *; print(denoise.__module__)").stdout.startswith("lobewise.denoising")
    for name in lobewise.__all__:
        assert getattr(lobewise, name) is not None
    with pytest.raises(AttributeError, match="nothing"):
        _ = lobewise.nothing  # type: ignore[attr-defined]


def test_a_type_checker_sees_the_names_where_they_come_from() -> None:
    tree = ast.parse(Path(lobewise.__file__).with_suffix(".pyi").read_text())
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    seen = {alias.name: node.module for node in imports for alias in node.names if alias.asname == alias.name}
    assert seen.keys() == set(lobewise.__all__) - {"__version__"}
    for name, module in seen.items():
        assert getattr(importlib.import_module(f"lobewise.{module}"), name) is getattr(lobewise, name), name
