"""The exported chains on a device, in three languages, against Python: pass by pass, and over whole sequences."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lobewise
from lobewise.cli.program import run
from lobewise.denoising.automatic import resolve_settings
from lobewise.denoising.layers import make_layers
from lobewise.exporting.names import CHAINS, SHADER_LANGUAGES
from lobewise.exporting.shaders.chains import make_chain
from lobewise.exporting.shaders.constants import compute_constants
from lobewise.exporting.shaders.language import Field, lay_out
from lobewise.exporting.shaders.passes import write_pass
from lobewise.exporting.shaders.writing import count_bytes, export_chain
from lobewise.filters.cross_filter import run_filter
from lobewise.records.frame import Frame
from lobewise.settings import FORM_NAMES, DenoiseSettings
from tests.exporting.chain_device import Player, give_images
from tests.exporting.chain_scene import make_frame

RTOL = 1e-3
"""Largest relative difference from Python. It is that of weights: Python's exponentials are polynomials."""
WEIGHT_RTOL = 2e-3
"""The same for weight sums of five passes, whose weights multiply."""


def compare(found: NDArray[Any], expected: NDArray[Any], rtol: float = RTOL) -> None:
    """Assert that images agree. The smallest size that counts is a thousandth of the image's mean."""
    assert np.isfinite(found).all()
    size = np.maximum(np.abs(expected), 1e-3 * np.mean(np.abs(expected)))
    assert np.max(np.abs(found - expected) / size) < rtol


def choose(frame: Frame, form: str, similarity: Any = "ggx") -> Any:
    return resolve_settings(frame, DenoiseSettings(quality="fast", form=form, radius=6, similarity=similarity))


@pytest.mark.sampled("wgsl-full-ggx", "wgsl-separable-ggx", "wgsl-separable-sg")
@pytest.mark.parametrize(("form", "similarity"), [*((form, "ggx") for form in FORM_NAMES), ("separable", "sg")])
def test_filter_chain(graphics: Any, language: str, folder: Path, form: Any, similarity: Any) -> None:
    frame = make_frame(0)
    settings = choose(frame, form, similarity)
    chain = make_chain("filter", form=form, similarity=similarity)
    player = Player(graphics, chain, language, folder)
    image = player.run(give_images(frame), compute_constants(frame.require_camera("lobes"), frame.shape, settings))
    result = lobewise.denoise(frame, quality="fast", form=form, radius=6, similarity=similarity)
    compare(image[..., :3], result.image)
    assert np.abs(image[..., :3] - frame.radiance.color).max(where=np.isfinite(frame.radiance.color), initial=0) > 0.1
    for layer in make_layers(frame, settings):
        last = [each for each in chain.passes if layer.name in each.libraries][-1]
        light, more = (player.images[last.writes[name]] for name in ("added_light", "added_more"))
        options: dict[str, Any] = {"form": form, "radius": settings.radius, "albedo": layer.albedo}
        expected = run_filter(layer.radiance, layer.mask, layer.features, **options)
        there = expected.weight_sum > 0.0
        compare(light[..., 3], expected.weight_sum, WEIGHT_RTOL)
        compare(light[there][:, 3] ** 2 / more[there][:, 0], expected.effective_samples[there], WEIGHT_RTOL)
        compare(light[there][:, :3] / light[there][:, 3:] * layer.albedo[there], expected.image[there])


@pytest.mark.parametrize("chain", CHAINS)
def test_folder(tmp_path: Path, chain: str) -> None:
    """The files are those that chain.json lists, and each declares the bindings and constants that it lists."""
    names = export_chain(tmp_path / "out", "wgsl", chain)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(names)
    told = json.loads((tmp_path / "out" / "chain.json").read_text())
    images = {image["name"]: image for image in told["images"]}
    written = {name for name, image in images.items() if image["lifetime"] in ("given", "before")}
    readme = (tmp_path / "out" / "README.md").read_text()
    for each in told["passes"]:
        text = (tmp_path / "out" / each["file"]).read_text()
        declared = re.findall(r"@binding\((\d+)\) var (\w+): texture(_storage)?_2d", text)
        assert declared == [
            (str(one["binding"]), one["name"], "_storage" if one["access"] == "write" else "")
            for one in each["bindings"]
        ]
        for one in each["bindings"]:
            assert re.search(rf"textureLoad\({one['name']}, |textureStore\({one['name']}, ", text), one
            # No pass reads an image before it was written.
            assert one["access"] == "write" or one["image"] in written, (each["name"], one)
        assert sum(one["access"] == "write" for one in each["bindings"]) <= 4
        written |= {one["image"] for one in each["bindings"] if one["access"] == "write"}
        assert f"`{each['file']}`" in readme
    assert set(images) == written
    assert all(image["before"] in images for image in images.values() if image["lifetime"] == "before")
    for one in told["constants"]["fields"]:
        assert f"| {one['offset']} | `{one['name']}` | {one['type']} |" in readme


def test_every_image_is_used() -> None:
    for name in CHAINS:
        chain = make_chain(name)
        used = {image for each in chain.passes for image in (*each.reads.values(), *each.writes.values())}
        assert used == {image.name for image in chain.images}


def test_no_loop_variable_is_declared_twice() -> None:
    """Older compilers of HLSL know the variable of a loop after the loop, too."""
    texts = [write_pass(chain, each, "hlsl") for chain in map(make_chain, CHAINS) for each in chain.passes]
    functions = [function for text in texts for function in re.split(r"^}$", text, flags=re.M)]
    variables = [re.findall(r"for \(int (\w+) =", function) for function in functions]
    assert any(len(names) > 2 for names in variables)
    assert all(len(set(names)) == len(names) for names in variables)


@pytest.mark.parametrize("language", SHADER_LANGUAGES)
def test_no_language_pads_constants_otherwise(language: str) -> None:
    with pytest.raises(ValueError, match="b begins at byte 4"):
        lay_out([Field("a", "float", ""), Field("b", "vec3", "")])
    for name in CHAINS:
        assert lay_out(make_chain(name).constants)[""] % 16 == 0


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", "passes", "filter", "hlsl", "--form", "atrous", "-o", str(tmp_path / "out")]) == 0
    assert "12 passes" in capsys.readouterr().out
    assert (tmp_path / "out" / "05_diffuse_step_8.hlsl").is_file()


def test_listing(capsys: pytest.CaptureFixture[str]) -> None:
    """``--list`` prints what a chain contains, and writes nothing."""
    assert run(["export", "passes", "history", "glsl", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    chain = make_chain("history")
    passes = [line for line in lines if re.match(r"\d+\. ", line)]
    assert len(passes) == len(chain.passes)
    assert passes[0].startswith("1. guides: surface, place, motion -> points, normals, axes, spreads")
    assert any(line.startswith("  hits: width x height, distance") for line in lines)
    # Nine images of 16 bytes are kept, and their earlier versions.
    assert f" {2 * 9 * 16} from frame to frame" in next(line for line in lines if line.startswith("Memory"))


def test_memory_is_shared_by_images_of_a_frame() -> None:
    """The filter of a layer keeps the sums of two passes at once; guides and the sums of the other layer stay."""
    within, kept = count_bytes(make_chain("filter"))
    assert (within, kept) == ((4 + 1 + 2 + 2) * 16, 0)
