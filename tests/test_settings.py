"""Settings are declared once: what derives from the declarations has exactly their fields, types and words."""

import re
import subprocess
import sys
from collections import defaultdict
from dataclasses import fields
from pathlib import Path
from typing import Any, get_type_hints

import pytest

from lobewise.errors import InputError
from lobewise.settings import (
    DenoiseChanges,
    DenoiseSettings,
    ResolvedSettings,
    TemporalChanges,
    TemporalSettings,
    list_knobs,
)
from tests.mistakes import refuses

ROOT = Path(__file__).parents[1]
SETTINGS = pytest.mark.parametrize("kind", [DenoiseSettings, TemporalSettings])
MISTAKES = """
lobewise.denoise(frame, raduis=3)
lobewise.denoise(frame, similarity="ggxx")
lobewise.denoise(frame, radius="3")
lobewise.denoise(frame, with_oidn="maybe")
lobewise.DenoiseSettings(quality="balancd")
lobewise.upsample(sparse, bilinaer=True)
lobewise.upsample(sparse, beta="high")
lobewise.TemporalFilter(memroy=0.9)
lobewise.TemporalFilter(form="round")
lobewise.denoise_file("a.exr", "b.exr", qualty="high")
frame.radience
"""
CORRECT = """
settings = lobewise.DenoiseSettings(quality="high", beta="auto")
lobewise.denoise(frame, settings, radius=3, similarity="ggx", beta=2.0, band_limit=None)
lobewise.upsample(sparse, radius=3, tau=0.01, bilinear=True)
lobewise.TemporalFilter(settings, memory=0.9, plane_sigma=1.0, similarity="sg").add(frame, cut=True).image.shape
lobewise.denoise_file("a.exr", "b.exr", quality="fast", rows=64).bands
lobewise.Camera((0, 0, 0), forward=[0.0, 0.0, -1.0], up=np.array([0, 1, 0]), fov_y=1.0).right
lobewise.GBuffer(normal=np.zeros((4, 4, 3)), depth=[[1.0]])
"""
PROLOGUE = """
import lobewise
import numpy as np

frame = lobewise.read_frame("frame.exr")
sparse = lobewise.read_sparse_frame("sparse.exr")
"""


def strip(kind: type) -> dict[str, Any]:
    """Return the types of a class's fields without what is noted beside them."""
    return get_type_hints(kind)


class TestDeclarations:
    @SETTINGS
    def test_every_field_is_declared_with_words(self, kind):
        knobs = list_knobs(kind)
        assert list(knobs) == [item.name for item in fields(kind)]
        for name, knob in knobs.items():
            assert knob.name == name
            assert knob.default == getattr(kind(), name)
            assert knob.text.endswith((".", "]."))
            assert len(knob.hint) <= len(knob.text)

    @SETTINGS
    def test_the_docstring_tells_every_field(self, kind):
        for name, knob in list_knobs(kind).items():
            assert re.search(rf"^    {name} : ", kind.__doc__, flags=re.M), name
            assert " ".join(knob.text.split()) in " ".join(kind.__doc__.split())

    def test_changes_are_the_fields(self):
        assert strip(DenoiseChanges) == strip(DenoiseSettings)
        own = strip(TemporalSettings)
        del own["beta"]
        assert strip(TemporalChanges) == strip(DenoiseSettings) | own

    def test_types_are_read(self):
        knobs = list_knobs(DenoiseSettings)
        assert knobs["similarity"].choices == ("auto", "normal", "sg", "sg_mixture", "ggx")
        assert (knobs["radius"].kind, knobs["radius"].high) == (int, 64)
        assert (knobs["beta"].kind, knobs["beta"].choices) == (float, ("auto",))
        assert (knobs["band_limit"].kind, knobs["band_limit"].optional) == (float, True)
        assert knobs["with_oidn"].kind is bool

    def test_settings_that_are_resolved_have_no_auto(self):
        whole = {
            "quality": "fast",
            "similarity": "ggx",
            "beta": 1.0,
            "diffuse_beta": 1.0,
            "device": "cpu",
            "screen_sigma": 1.0,
            "tau": 0.01,
            "with_oidn": False,
        }
        assert ResolvedSettings(**whole).radius == 8
        for name in whole:
            with pytest.raises(ValueError, match=name):
                ResolvedSettings(**{**whole, name: "auto"})
        with refuses(InputError, "beta"):
            ResolvedSettings(**{**whole, "beta": -1.0})
        assert list_knobs(ResolvedSettings) == list_knobs(DenoiseSettings)


@pytest.fixture(scope="module")
def complaints(tmp_path_factory) -> dict[str, list[tuple[int, str]]]:
    """Return line and text of what mypy complains about, by file; one run over what a user would write."""
    pytest.importorskip("mypy")
    folder = tmp_path_factory.mktemp("user")
    (folder / "mistakes.py").write_text(PROLOGUE + MISTAKES)
    (folder / "correct.py").write_text(PROLOGUE + CORRECT)
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "developers").glob("*.md")]:
        blocks = re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.S)
        if blocks:
            # Some pages go on where a reader is: this one, and those for developers after those for users.
            before = PROLOGUE + "ids = np.zeros(frame.shape)\n" if page.stem == "features" else ""
            with (folder / f"page_{page.stem}.py").open("a") as file:
                file.write(before + "\n".join(blocks))
    written = [*folder.glob("*.py"), *(ROOT / "examples").glob("*.py")]
    command = [sys.executable, "-m", "mypy", "--config-file=", "--ignore-missing-imports", "--no-error-summary"]
    done = subprocess.run(
        [*command, f"--cache-dir={folder / 'cache'}", *map(str, written)],
        capture_output=True,
        text=True,
        env={"MYPYPATH": str(ROOT / "src"), "PATH": ""},
        cwd=folder,
        check=False,
    )
    found: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for line in (done.stdout + done.stderr).splitlines():
        match = re.fullmatch(r"(.+?):(\d+): error: (.*)", line)
        assert match or ": note: " in line, line
        if match:
            found[Path(match[1]).name].append((int(match[2]), match[3]))
    return found


@pytest.mark.nightly
class TestTypeChecker:
    def test_misspelt_settings_are_found(self, complaints):
        lines = {number for number, _ in complaints["mistakes.py"]}
        text = (PROLOGUE + MISTAKES).splitlines()
        first = len(PROLOGUE.splitlines()) + 2
        assert lines == set(range(first, len(text) + 1)), complaints["mistakes.py"]

    def test_what_is_documented_passes(self, complaints):
        assert {name: found for name, found in complaints.items() if name != "mistakes.py"} == {}
