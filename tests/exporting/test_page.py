"""The pages on exports are true: their commands run, their programs compile, their lists are those of the code."""

import re
import subprocess
from pathlib import Path

import pytest

from lobewise.cli.exporting import KNOBS
from lobewise.cli.program import run
from lobewise.exporting.names import TARGETS
from lobewise.exporting.pipeline.writing import MAX_DEVICE_DIFFERENCE, MAX_DIFFERENCE, MAX_PLAIN_DIFFERENCE
from lobewise.exporting.shaders.writing import make_shader
from tests.exporting.conftest import locate_program

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "export.md").read_text()
DETAILS = (DOCS / "developers" / "export.md").read_text()


def get_block(page: str, language: str) -> str:
    """Return the first block of code of a page in a language."""
    return re.findall(rf"```{re.escape(language)}\n(.*?)```", page, flags=re.S)[0]


def test_targets_are_listed() -> None:
    table = DETAILS.split("### Targets")[1].split("Exporting needs no compiler")[0]
    listed = re.findall(r"`((?:x86|arm|wasm)-[\w-]+)`", table)
    assert sorted(["host", *listed]) == sorted(TARGETS)


def test_bounds_are_those_of_the_example() -> None:
    found = [float(word) for word in re.findall(r"\| (0\.0+\d) \|", DETAILS)]
    bounds = [MAX_DIFFERENCE, MAX_PLAIN_DIFFERENCE, MAX_DEVICE_DIFFERENCE]
    assert found == bounds


def test_shader_pass_compiles(glslang: str, tmp_path: Path) -> None:
    program = get_block(DETAILS, "glsl").replace('#include "lobewise.glsl"\n', make_shader("glsl"))
    (tmp_path / "pass.comp").write_text(program)
    done = subprocess.run([glslang, "-V", "pass.comp"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("page", "shell", "language", "standard"),
    [(DETAILS, "sh", "c", "c99"), (PAGE, "bash", "c++", "c++11")],
    ids=["c", "c++"],
)
def test_commands_run_and_program_compiles(
    page: str,
    shell: str,
    language: str,
    standard: str,
    compiler: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    program = compiler if language == "c" else locate_program("g++", "g++")
    monkeypatch.chdir(tmp_path)
    export, enter, *commands = get_block(page, shell).splitlines()
    assert run(export.split()[1:]) == 0
    # What the program suggests is what the page says.
    assert " && ".join(commands) in capsys.readouterr().out
    folder = tmp_path / enter.removeprefix("cd ")
    for command in commands:
        subprocess.run(command, shell=True, cwd=folder, check=True)
    source = folder / f"own.{language.replace('c++', 'cpp')}"
    source.write_text(get_block(page, language))
    words = [f"-std={standard}", "-Wall", "-Wextra", "-pedantic", "-Werror", "-c", source.name]
    done = subprocess.run([program, *words], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_options_of_pipelines_are_those_of_the_page() -> None:
    """Every option of a pipeline is in the page's table, and the table names no other."""
    table = DETAILS.split("| option | what it adds |")[1].split("\n\n")[0]
    named = set(re.findall(r"`--([a-z-]+)", table))
    own = {name.replace("_", "-") for name in KNOBS}
    own = (own - {"motion", "halves", "albedo"}) | {"no-motion", "no-halves", "no-albedo"}
    assert named == own | {"name", "target", "list"}
