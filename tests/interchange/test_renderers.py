"""Each renderer's file is understood: by its own names, spaces and units, in whatever parts they lie."""

from pathlib import Path

import numpy as np
import pytest
from renderers import CAMERA, WRITERS, Scene, make_scene, write

import lobewise
from lobewise.interchange import describe_file, import_file
from lobewise.interchange.preset import load_presets

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene()


@pytest.mark.parametrize("layout", ["one part", "a part each"])
@pytest.mark.parametrize("renderer", WRITERS)
def test_what_it_holds_is_found(renderer: str, layout: str, scene: Scene, tmp_path: Path) -> None:
    written = WRITERS[renderer](scene)
    path = tmp_path / "frame.exr"
    write(path, written, part_each=layout == "a part each")
    found = import_file(path, light_passes=True)
    frame, guides = found.frame, found.frame.gbuffer
    assert found.preset == renderer
    np.testing.assert_array_equal(frame.radiance.color, scene.color)

    there = scene.surface
    if "camera" in written.found:
        np.testing.assert_allclose(frame.camera.position, CAMERA.position, atol=2e-3)
        np.testing.assert_allclose(frame.camera.forward, CAMERA.forward, atol=2e-3)
        assert frame.camera.fov_y == pytest.approx(CAMERA.fov_y, abs=1e-3)
        np.testing.assert_allclose(guides.normal[there], scene.normal[there], atol=2e-3)
    if "position" in written.found:
        np.testing.assert_allclose(guides.position[there], scene.position[there], atol=1e-5)
    if "depth" in written.found:
        np.testing.assert_allclose(guides.depth, scene.depth, rtol=1e-3)
    if "alpha" in written.found:
        np.testing.assert_allclose(guides.alpha_u[there], scene.roughness[there] ** 2, atol=1e-4)
    else:
        assert guides.alpha_u is None
        assert any("No roughness" in note for note in found.notes)
    if "layers" in written.found:
        kinds = [layer.is_diffuse for layer in frame.layers if layer.name != "rest"]
        assert kinds == [True, False]
        np.testing.assert_allclose(frame.layers[0].radiance, scene.diffuse, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(frame.layers[1].radiance, scene.specular, rtol=1e-4, atol=1e-6)
    else:
        assert frame.radiance.parts is None
        assert any("No layers" in note for note in found.notes)
    assert (frame.spp is not None) == ("spp" in written.found)


@pytest.mark.sampled("cycles", "arnold", "vray", "renderman", "karma", "corona", "pbrt", "luxcore", "mitsuba")
@pytest.mark.filterwarnings("ignore::lobewise.errors.UnusedGuideWarning")
@pytest.mark.parametrize("renderer", WRITERS)
def test_it_is_denoised_and_what_is_missing_is_told(renderer: str, scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "frame.exr"
    write(path, WRITERS[renderer](scene))
    told = describe_file(path)
    assert told.preset == load_presets()[renderer].title
    assert told.reason
    result = lobewise.denoise(lobewise.read_frame(path), quality="fast", radius=3)
    clean = scene.color.mean()
    assert result.image.mean() == pytest.approx(clean, rel=0.03)
    rough = [np.abs(np.diff(image[scene.surface.all(1)], axis=1)).mean() for image in (scene.color, result.image)]
    assert rough[1] < 0.75 * rough[0]


def test_every_renderer_stands_in_the_documentation() -> None:
    page = (DOCS / "renderers.md").read_text(encoding="utf-8")
    for preset in load_presets().values():
        if preset.name != "generic":
            assert f"| {preset.title} |" in page
    assert set(WRITERS) == set(load_presets()) - {"generic"}
