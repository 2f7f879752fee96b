"""`lobewise render` of scene files: their parameters, and the integrator that computes the light."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.cli.program import run

pytestmark = pytest.mark.mitsuba

SCENE = """<scene version="3.0.0">
<default name="depth" value="16"/><default name="columns" value="24"/>
<integrator type="volpath"><integer name="max_depth" value="$depth"/></integrator>
<sensor type="perspective"><film type="hdrfilm">
<integer name="width" value="$columns"/><integer name="height" value="16"/></film></sensor>
<shape type="sphere"><point name="center" value="0 0 4"/><bsdf type="null"/>
<medium name="interior" type="homogeneous"><float name="sigma_t" value="$density"/></medium></shape>
<emitter type="constant"/></scene>"""


@pytest.fixture
def fog(mi: Any, tmp_path: Path) -> Path:
    path = tmp_path / "fog.xml"
    path.write_text(SCENE)
    return path


def render(fog: Path, *words: str) -> int:
    return run(["render", str(fog), "--spp", "4", "-o", str(fog.with_suffix(".exr")), *words])


@pytest.mark.nightly
def test_parameters_stand_in_the_file(fog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert render(fog, "-D", "density=0.0001", "-D", "columns=20") == 0
    frame = lobewise.read_frame(fog.with_suffix(".exr"))
    assert frame.shape == (16, 20)
    # The fog is too thin to be seen against the white sky.
    np.testing.assert_allclose(frame.radiance.color, 1.0, rtol=2e-3)
    assert render(fog, "-D", "density=8") == 0
    assert lobewise.read_frame(fog.with_suffix(".exr")).radiance.color[8, 12].max() < 0.9
    told = capsys.readouterr().err
    assert "Light by the scene's own integrator, 'volpath'" in told


def test_a_frame_of_an_own_integrator_is_denoised(fog: Path) -> None:
    assert render(fog, "-D", "density=2") == 0
    frame = lobewise.read_frame(fog.with_suffix(".exr"))
    assert frame.half_a is not None
    assert run(["denoise", str(fog.with_suffix(".exr")), "-o", str(fog.with_name("clean.exr"))]) == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["-D", "density=2", "-D", "colums=20"], "parameter 'colums': expected one of columns, density, depth"),
        (["-D", "density=2", "-D", "colums=20"], "did you mean 'columns'?"),
        (["-D", "density"], "-D: expected NAME=VALUE"),
        (["-D", "density=2", "-D", "density=3"], "-D: expected every name once"),
        ([], "undefined parameter: $density"),
        (
            ["-D", "density=2", "--max-depth", "3"],
            "--max-depth: expected none, as the scene's own integrator, 'volpath'",
        ),
        (["-D", "density=2", "--scale", "2", "--light", "indirect"], "light: expected 'all'"),
        (["-D", "density=2", "--light", "indirect"], "light: expected 'all'"),
        (["-D", "density=2", "--integrator", "path"], "did you mean 'paths'?"),
    ],
)
def test_mistakes_are_told(fog: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str) -> None:
    assert render(fog, *words) == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not fog.with_suffix(".exr").exists()


def test_paths_are_taken_where_they_are_asked_for(fog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert render(fog, "-D", "density=8", "--integrator", "paths", "--max-depth", "3") == 0
    assert "the scene's own 'volpath' would give other light" in " ".join(capsys.readouterr().err.split())
    assert lobewise.read_frame(fog.with_suffix(".exr")).radiance.parts is not None


def test_a_sparse_frame_of_an_own_integrator_is_upsampled(fog: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert render(fog, "-D", "density=8", "--scale", "2") == 0
    assert "Light by the scene's own integrator, 'volpath'" in capsys.readouterr().err
    assert run(["upsample", str(fog.with_suffix(".exr")), "-o", str(fog.with_name("whole.exr"))]) == 0
    color = lobewise.read_frame(fog.with_name("whole.exr")).radiance.color
    assert color.shape == (16, 24, 3)
    assert color[8, 12].max() < 0.8 * color[0, 0].max()


def test_sequences_of_an_own_integrator(fog: Path) -> None:
    pattern = fog.with_name("out.####.exr")
    words = ["--frames", "2", "--camera-path", "still", "-D", "density=2", "-o", str(pattern)]
    assert run(["render", str(fog), "--spp", "2", *words]) == 0
    assert lobewise.read_frame(fog.with_name("out.0002.exr")).gbuffer.motion is not None
