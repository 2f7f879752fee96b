"""Scenes that are too large are refused with a sentence: the film, the nesting of the file, the memory of the image."""

from pathlib import Path
from typing import Any

import pytest

from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.interactive import Session
from lobewise.render import load_scene, render_frame, render_reference
from lobewise.scenes.limits import MAX_DEPTH, require_memory, require_shallow
from lobewise.work.limits import measure_machine_memory
from tests.cli.lines import fail
from tests.mistakes import refuses

pytestmark = pytest.mark.mitsuba

SCENE = """<scene version="3.0.0"><integrator type="{integrator}"/>
<sensor type="{sensor}"><float name="aperture_radius" value="0.1"/><float name="focus_distance" value="4"/>
<film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/></film></sensor>
<shape type="sphere"/><emitter type="constant"/></scene>"""
SMALL = {"integrator": "path", "sensor": "thinlens", "width": 16, "height": 8}


def write_scene(folder: Path, **changes: Any) -> Path:
    path = folder / "scene.xml"
    text = SCENE.format_map(SMALL | changes)
    path.write_text(text if "thinlens" in text else text.replace("<float", "<!-- <float").replace('4"/>', '4"/> -->'))
    return path


def nest(depth: int) -> str:
    """Return a scene with elements that are so deep."""
    return f'<scene version="3.0.0">{"<shape>" * (depth - 1)}{"</shape>" * (depth - 1)}</scene>'


@pytest.mark.parametrize("verb", ["render", "view"])
@pytest.mark.parametrize(("width", "height"), [(65536, 32768), (1, 1 << 31)])
def test_a_huge_film_is_refused(
    verb: str, width: int, height: int, mi: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_scene(tmp_path, sensor="perspective", width=width, height=height)
    assert run([verb, str(path), *(["-o", str(tmp_path / "a.exr")] if verb == "render" else [])]) == 2
    told = capsys.readouterr().err
    assert told.endswith(
        f"scene.xml: expected a film of 1 to 32768 pixels on each side, got {width}x{height}; change its width and "
        "height, or give others (--width, --height).\n"
    )
    assert list(load_scene(path, width=8, height=4).sensors()[0].film().size()) == [8, 4]


@pytest.mark.parametrize("where", ["", "more/"])
def test_deep_elements_are_refused(where: str, mi: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scene.xml"
    (tmp_path / "more").mkdir()
    path.write_text('<scene version="3.0.0"><include filename="more/a.xml"/></scene>')
    # Files that include each other end the search as well.
    (tmp_path / "more" / "a.xml").write_text(f'<scene version="3.0.0"><include filename="{path}"/></scene>')
    require_shallow(path)
    deep = path if not where else tmp_path / "more" / "a.xml"
    deep.write_text(nest(MAX_DEPTH))
    require_shallow(path)
    deep.write_text(nest(100_000))
    got = f"deeper ones in {str(deep)!r}"
    fail(capsys, "render", path, "-o", tmp_path / "a.exr", got=got, expected=f"elements at most {MAX_DEPTH} deep")


@pytest.mark.parametrize("changes", [{"sensor": "perspective"}, {}, {"integrator": "volpath", "sensor": "perspective"}])
def test_an_image_that_does_not_fit_the_memory_is_refused(
    changes: dict[str, str], mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene(write_scene(tmp_path, **changes))
    monkeypatch.setattr("lobewise.scenes.limits.measure_machine_memory", lambda: 16 * 8 * 29)
    for make in (lambda: render_frame(scene, spp=1), lambda: render_reference(scene, spp=1), lambda: Session(scene)):
        with refuses(InputError, "image size"):
            make()
    monkeypatch.setattr("lobewise.scenes.limits.measure_machine_memory", lambda: 16 * 8 * 31)
    render_reference(scene, spp=1)


def test_the_memory_of_this_machine_is_known() -> None:
    there = measure_machine_memory()
    assert there is None or there > 1 << 28
    require_memory(1024, 1024, 30)
