"""The program as users call it: its output, its files and its exit codes."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lobewise.cli.program import run
from lobewise.interchange import describe_file, read_image
from lobewise.io import read_frame, write_frame, write_image
from lobewise.io.materials import read_lobe_table, write_lobe_table
from lobewise.metrics import evaluate
from lobewise.records.camera import Camera
from lobewise.records.frame import Radiance
from lobewise.settings import DenoiseSettings
from tests.cli.lines import fail
from tests.streaming.frames import make_scene


@pytest.fixture
def frame_file(tmp_path):
    """Return a small noisy frame on disk."""
    path = tmp_path / "frame.exr"
    camera = Camera(position=(0.0, 1.0, 4.0), forward=(0.0, -0.4, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.4)
    write_frame(path, make_scene((12, 16)).with_changes(camera=camera), half=False)
    return path


class TestProgram:
    def test_the_installed_program(self):
        program = Path(sys.executable).with_name("lobewise")
        done = subprocess.run([program, "inspect", "/nowhere.exr"], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.startswith("lobewise: input '/nowhere.exr': expected an existing file")

    def test_our_own_failures_are_told_apart(self, frame_file, monkeypatch, capsys):
        def explode(_path, **_options):
            raise ZeroDivisionError("a\nb")

        monkeypatch.setattr("lobewise.interchange.describing.inspect_file", explode)
        assert run(["inspect", str(frame_file)]) == 1
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert "ZeroDivisionError: a b" in err
        assert "--debug" in err
        assert run(["inspect", str(frame_file), "--debug"]) == 1
        assert "Traceback" in capsys.readouterr().err

    def test_debug_shows_where_a_users_mistake_was_found(self, capsys):
        assert run(["--debug", "inspect", "/nowhere.exr"]) == 2
        assert "Traceback" in capsys.readouterr().err

    def test_interrupts(self, frame_file, monkeypatch, capsys):
        def interrupt(_path, **_options):
            raise KeyboardInterrupt

        monkeypatch.setattr("lobewise.interchange.describing.inspect_file", interrupt)
        assert run(["inspect", str(frame_file)]) == 130
        assert capsys.readouterr().err == "lobewise: interrupted; every output is whole, or as it was.\n"

    def test_a_closed_pipe_is_no_failure(self, frame_file):
        code = f"from lobewise.cli import main; main(['inspect', '-a', {str(frame_file)!r}])"
        line = f'"{sys.executable}" -c "{code}" | head -c 1 > /dev/null; exit ${{PIPESTATUS[0]}}'
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


class TestDenoise:
    @pytest.mark.parametrize("quality", ["fast", pytest.param("balanced", marks=pytest.mark.nightly)])
    def test_it_does_what_the_function_does(self, quality, frame_file, tmp_path, capsys):
        from lobewise import denoise

        out = tmp_path / "out.exr"
        line = ["--similarity", "normal", "--radius", "3", "--beta", "2.5", "--quality", quality, "--verbose"]
        assert run(["denoise", str(frame_file), "-o", str(out), *line]) == 0
        expected = denoise(read_frame(frame_file), similarity="normal", radius=3, beta=2.5, quality=quality)
        np.testing.assert_array_equal(read_image(out), expected.image)
        np.testing.assert_array_equal(read_frame(out).radiance.specular, expected.specular)
        np.testing.assert_array_equal(read_frame(out).gbuffer.normal, read_frame(frame_file).gbuffer.normal)
        text, err = capsys.readouterr()
        assert text.startswith(f"Wrote {out}: 16x12 pixels, quality {quality}, ")
        assert "bad pixel" not in text
        told = f"Settings: similarity normal, form full, quality {quality}, radius 3, beta 2.5, device cpu."
        assert told in err.splitlines()

    @pytest.mark.parametrize(
        ("similarity", "form"),
        [
            pytest.param("normal", "full", marks=pytest.mark.nightly),
            pytest.param("sg", "separable", marks=pytest.mark.nightly),
            pytest.param("ggx", "atrous", marks=pytest.mark.nightly),
        ],
    )
    def test_choices_arrive(self, similarity, form, frame_file, tmp_path):
        out = tmp_path / "out.exr"
        line = ["denoise", str(frame_file), "-o", str(out), "--similarity", similarity, "--form", form]
        assert run(line) == 0
        attributes = {name: value for name, _, value in describe_file(out).parts[0].attributes}
        assert f'"form": "{form}"' in attributes["lobewise/denoised"]
        assert np.isfinite(read_image(out)).all()

    @pytest.mark.parametrize(("option", "with_oidn"), [("--with-oidn", True), ("--offline", False), ("", "auto")])
    def test_open_image_denoise_is_asked_for(self, option, with_oidn, frame_file, tmp_path, monkeypatch, capsys):
        from lobewise.recipes.files import denoiser

        asked = []
        real = denoiser.denoise_checked

        def record(checked, named):
            asked.append(named)
            return real(checked, DenoiseSettings(quality="fast", radius=1))

        monkeypatch.setattr(denoiser, "denoise_checked", record)
        line = ["denoise", str(frame_file), "-o", str(tmp_path / "out.exr")]
        assert run([*line, option] if option else line) == 0
        assert [(one.with_oidn, one.quality) for one in asked] == [(with_oidn, "auto")]
        # Brackets are markup where help is printed.
        capsys.readouterr()
        monkeypatch.setenv("COLUMNS", "300")
        assert run(["denoise", "--help"]) == 0
        assert "(lobewise[best])" in capsys.readouterr().out

    def test_open_image_denoise_that_is_not_installed_is_a_sentence(self, frame_file, tmp_path, monkeypatch, capsys):
        from lobewise import peers
        from lobewise.denoising import recipe

        fault = peers.OidnFault("Open Image Denoise is not here", "install it")
        monkeypatch.setattr(peers, "look_up_oidn_fault", lambda: fault)
        monkeypatch.setattr(recipe, "clean_frame", lambda *_: pytest.fail("filtered first"))
        fail(capsys, "denoise", frame_file, "-o", tmp_path / "out.exr", "--with-oidn", what=fault.reason)
        assert not (tmp_path / "out.exr").exists()

    def test_refilled_pixels_are_told_and_no_share_of_fireflies(self):
        """The share holds noise as well as light. Only clearly lost light gives a note."""
        from lobewise.cli.output import describe_result
        from lobewise.recipes.files import FileResult
        from lobewise.records.frame import Result

        ones = np.ones((2, 3), np.float32)
        result = Result(np.ones((2, 3, 3), np.float32), ones, ones, ones > 2.0, {"quality": "balanced"}, 0.5)
        assert describe_result(FileResult((result,))) == "3x2 pixels, quality balanced, 0.50 s"
        told = describe_result(FileResult((replace(result, energy_lost=0.01234, bad_pixels=ones > 0.0),)))
        assert told.endswith("0.50 s; 6 bad pixels refilled")

    @pytest.mark.nightly
    def test_materials_replace_those_of_the_file(self, frame_file, full_frame, tmp_path):
        from lobewise import denoise

        frame = read_frame(frame_file)
        material = np.resize([1, 2, 2, 0], frame.shape)
        gbuffer = replace(frame.gbuffer, material=material)
        frame = frame.with_changes(gbuffer=gbuffer, lobe_tables=full_frame.lobe_tables)
        write_frame(frame_file, frame, half=False)
        sharp = [replace(table, sharpness=9.0 * table.sharpness) for table in frame.lobe_tables]
        line = ["denoise", str(frame_file), "-o", str(tmp_path / "out.exr"), "--similarity", "sg_mixture", "--offline"]
        for k, table in enumerate(sharp):
            write_lobe_table(tmp_path / f"{k}.lobes", table)
            line += ["--material", str(tmp_path / f"{k}.lobes")]
        assert run(line) == 0
        expected = denoise(frame.with_changes(lobe_tables=sharp), similarity="sg_mixture", with_oidn=False).image
        np.testing.assert_allclose(read_image(tmp_path / "out.exr"), expected, rtol=1e-5)
        assert not np.allclose(expected, denoise(frame, similarity="sg_mixture", with_oidn=False).image, rtol=1e-3)

    def test_bad_pixels_are_counted(self, frame_file, tmp_path, capsys):
        frame = read_frame(frame_file)
        color = frame.radiance.color.copy()
        color[2, 3], color[5, 6] = np.nan, np.inf
        write_frame(frame_file, frame.with_changes(radiance=Radiance(color)), half=False)
        line = ["denoise", str(frame_file), "-o", str(tmp_path / "out.exr"), "--similarity", "normal"]
        assert run(line) == 0
        assert "; 2 bad pixels refilled." in capsys.readouterr().out
        assert np.isfinite(read_image(tmp_path / "out.exr")).all()


class TestUpsample:
    def test_it_does_what_the_function_does(self, frame_file, tmp_path, capsys):
        from lobewise import make_sparse, upsample

        out = tmp_path / "out.exr"
        line = ["upsample", str(frame_file), "-o", str(out), "--scale", "2", "--place", "1,0", "--radius", "2"]
        assert run(line) == 0
        expected = upsample(make_sparse(read_frame(frame_file), 2, (1, 0)), radius=2)
        np.testing.assert_allclose(read_image(out), expected.image, rtol=2e-3)
        assert read_frame(out).gbuffer.normal is not None
        text, err = capsys.readouterr()
        assert text.startswith(f"Wrote {out}: 16x12 pixels, quality fast, ")
        assert "Settings" not in err
        assert run([*line[:-2], "--bilinear", "--verbose"]) == 0
        text, err = capsys.readouterr()
        assert text.startswith(f"Wrote {out}: 16x12 pixels, interpolated between pixels, ")
        assert "Settings: similarity " in err


@pytest.mark.mitsuba
@pytest.mark.nightly
def test_sparse_render_upsampled_and_shaded_again(tmp_path, capsys):
    sparse, out = tmp_path / "sparse.exr", tmp_path / "out.exr"
    size = ["--width", "24", "--height", "20"]
    assert run(["render", "showroom", "--spp", "1", "--scale", "4", "--place", "1,2", *size, "-o", str(sparse)]) == 0
    assert "24x20 pixels, one of 4x4 pixels shaded, 1 spp" in capsys.readouterr().out
    line = ["upsample", str(sparse), "-o", str(out), "--radius", "2"]
    assert run([*line, "--adaptive", "10%", "--scene", "showroom", "--adaptive-spp", "2"]) == 0
    assert re.search(r"\d+ pixels were shaded again, with 2 samples each\.", capsys.readouterr().err)
    assert run([*line, "--adaptive", "10%", "--scene", "showroom"]) == 0
    assert re.search(r"\d+ pixels were shaded again, with 32 samples each\.", capsys.readouterr().err)
    assert read_image(out).shape == (20, 24, 3)
    assert np.isfinite(read_image(out)).all()


class TestMistakes:
    """Every mistake gives one sentence and exit code 2, and writes no file."""

    @pytest.fixture(autouse=True)
    def _nothing_is_written(self, tmp_path):
        yield
        assert not (tmp_path / "out.exr").exists()
        assert not list(tmp_path.glob(".*.part"))

    def test_missing_channel(self, rng, tmp_path, capsys):
        write_image(tmp_path / "a.exr", rng.random((4, 4, 3)))
        line = ["denoise", tmp_path / "a.exr", "-o", tmp_path / "out.exr", "--similarity", "sg"]
        fail(capsys, *line, holder="input 'a.exr'")

    def test_image_of_zero_size(self, frame_file, tmp_path, capsys):
        data = frame_file.read_bytes()
        at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
        frame_file.write_bytes(data[:at] + np.array([0, 0, -1, -1], "<i4").tobytes() + data[at + 16 :])
        got = "an empty data window of 0x0 pixels, an image of zero size"
        fail(capsys, "denoise", frame_file, "-o", tmp_path / "out.exr", got=got)

    def test_unwritable_paths(self, frame_file, tmp_path, capsys):
        os.mkfifo(tmp_path / "pipe")
        for path, words in (("/proc/out.exr", ""), (tmp_path / "pipe", "a device or pipe")):
            problem = fail(capsys, "denoise", frame_file, "--quality", "fast", "-o", path, what=f"--output '{path}'")
            assert words in problem.got

    def test_comparing_bad_pixels(self, rng, tmp_path, capsys):
        image = rng.random((4, 4, 3))
        write_image(tmp_path / "good.exr", image)
        image[1, 2] = np.nan
        write_image(tmp_path / "bad.exr", image)
        line = ["compare", tmp_path / "good.exr", tmp_path / "bad.exr", "-r", tmp_path / "good.exr"]
        fail(capsys, *line, what="image", holder="input 'bad.exr'")
        line = ["compare", tmp_path / "good.exr", "-r", tmp_path / "bad.exr"]
        fail(capsys, *line, what="reference", holder="--reference 'bad.exr'")


class TestCompare:
    @pytest.fixture
    def files(self, rng, tmp_path):
        reference = rng.random((6, 5, 3)).astype(np.float32)
        images = {"r": reference, "a": reference + 0.1, "b": reference * 0.5}
        for name, image in images.items():
            write_image(tmp_path / f"{name}.exr", image)
        return images

    def test_table_and_json_agree_with_the_library(self, files, tmp_path, capsys, monkeypatch):
        monkeypatch.setenv("COLUMNS", "300")
        line = ["compare", "a.exr", "b.exr", "r.exr", "--reference", "r.exr", "--json", "out.json"]
        monkeypatch.chdir(tmp_path)
        assert run(line) == 0
        out, err = capsys.readouterr()
        assert err == ""
        found = json.loads((tmp_path / "out.json").read_text())
        assert found["reference"] == "r.exr"
        assert [row.pop("path") for row in found["images"]] == ["a.exr", "b.exr", "r.exr"]
        for row, name in zip(found["images"], "abr", strict=True):
            expected = evaluate(files[name], files["r"])
            assert row.keys() == expected.keys()
            for metric, value in expected.items():
                assert row[metric] == (None if np.isinf(value) else pytest.approx(value, rel=1e-6))
                assert ("inf" if np.isinf(value) else f"{value:.4g}") in out

    def test_json_on_standard_output_is_alone(self, files, tmp_path, capsys, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert run(["compare", "a.exr", "-r", "r.exr", "--json", "-"]) == 0
        assert json.loads(capsys.readouterr().out)["images"][0]["path"] == "a.exr"
        assert not (tmp_path / "-").exists()

    def test_without_flip_the_rest_is_told(self, files, tmp_path, capsys, monkeypatch):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setitem(sys.modules, "flip_evaluator", None)
        assert run(["compare", "a.exr", "-r", "r.exr", "--json", "-"]) == 0
        out, err = capsys.readouterr()
        assert "flip" not in json.loads(out)["images"][0]
        assert "flip-evaluator" in err


class TestInspect:
    def test_text(self, frame_file, capsys):
        assert run(["inspect", str(frame_file), "--attributes"]) == 0
        out, err = capsys.readouterr()
        assert err == ""
        expected = (
            "16x12",
            "normal.X",
            "gbuffer.normal",
            "Camera: known. Samples per pixel: 4.",
            "normal, sg, sg_mixture, ggx",
            "lobewise/camera/fov_y",
            "missing: not needed for one frame",
        )
        for words in expected:
            assert words in out

    def test_json(self, frame_file, capsys):
        assert run(["inspect", str(frame_file), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["spp"] == 4
        assert found["camera"]["position"] == [0.0, 1.0, 4.0]
        assert found["parts"][0]["data_window"] == {"x_min": 0, "y_min": 0, "x_max": 15, "y_max": 11}

    def test_names_cannot_style_or_command_the_terminal(self, tmp_path, capsys):
        import OpenEXR

        channels = {name: np.ones((2, 2), "f") for name in ("R", "G", "B", "[red]x[/red]", "\x1b[31mred")}
        OpenEXR.File({"[bold]": "[/nonsense]"}, channels).write(str(tmp_path / "a.exr"))
        assert run(["inspect", str(tmp_path / "a.exr"), "-a"]) == 0
        out = capsys.readouterr().out
        assert "[red]x[/red]" in out
        assert "[bold]" in out
        assert "\x1b[31m" not in out


def test_devices(capsys):
    assert run(["devices"]) == 0
    out = capsys.readouterr().out
    assert "cpu" in out
    assert "yes" in out


@pytest.mark.mitsuba
class TestRender:
    """Files of rendered frames; other tests check the rendering itself."""

    @pytest.mark.nightly
    def test_frame_reference_and_guides(self, tmp_path, capsys):
        for name, extra in (
            ("frame", ["--png"]),
            ("reference", ["--reference"]),
            ("guides", ["--aov-only", "--float"]),
        ):
            line = ["render", "showroom", "--spp", "2", "--width", "24", "--height", "16", "-o"]
            assert run([*line, str(tmp_path / f"{name}.exr"), *extra]) == 0
            assert f"Wrote {tmp_path / name}.exr: 24x16 pixels, 2 spp." in capsys.readouterr().out
        frame = read_frame(tmp_path / "frame.exr")
        assert frame.shape == (16, 24)
        assert frame.camera is not None
        assert frame.spp == 2
        assert frame.half_a is not None
        reference = read_frame(tmp_path / "reference.exr")
        assert reference.gbuffer.normal is None
        assert reference.radiance.color.max() > 0.0
        guides = read_frame(tmp_path / "guides.exr")
        assert guides.radiance.color.max() == 0.0
        for name, kind in (("frame", "half"), ("guides", "float")):
            assert {
                one.pixel_type for one in describe_file(tmp_path / f"{name}.exr").parts[0].channels if one.name == "R"
            } == {kind}
        np.testing.assert_array_equal(guides.gbuffer.normal, frame.gbuffer.normal)
        assert run(["denoise", str(tmp_path / "frame.exr"), "-o", str(tmp_path / "out.exr")]) == 0
        assert (tmp_path / "frame.png").read_bytes().startswith(b"\x89PNG")

    def test_output_is_checked_before_rendering(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr("lobewise.render.load_scene", lambda *_a, **_k: pytest.fail("rendered first"))
        assert run(["render", "showroom", "-o", str(tmp_path / "missing" / "a.exr")]) == 2
        assert "no folder" in capsys.readouterr().err


def test_no_color_in_pipes(frame_file, capsys):
    assert run(["inspect", str(frame_file)]) == 0
    assert "\x1b[" not in capsys.readouterr().out


SCENE = """<scene version="3.0.0">
    <bsdf type="twosided" id="brass"><bsdf type="roughconductor" id="inner">
        <string name="distribution" value="ggx"/><float name="alpha" value="0.2"/>
    </bsdf></bsdf>
    <shape type="rectangle" id="plate"><ref id="brass"/></shape>
    <shape type="sphere" id="ball"><bsdf type="conductor"/></shape>
    <shape type="sphere" id="rod"><bsdf type="roughconductor" id="brushed">
        <string name="distribution" value="ggx"/>
        <float name="alpha_u" value="0.4"/><float name="alpha_v" value="0.15"/>
    </bsdf></shape>
</scene>
"""


@pytest.mark.mitsuba
@pytest.mark.nightly
class TestFitMitsuba:
    """Fits of materials of scenes; other tests check the fitting itself."""

    @pytest.fixture
    def scene(self, tmp_path):
        """Return the path of a scene file."""
        path = tmp_path / "scene.xml"
        path.write_text(SCENE)
        return path

    def test_a_bsdf_becomes_lobes(self, scene, tmp_path, capsys):
        out = tmp_path / "brass.lobes"
        assert run(["fit", "--mitsuba", f"{scene}#brass", "-o", str(out), "--lobes", "1"]) == 0
        table = read_lobe_table(out)
        assert (table.name, table.kind, table.lobe_count, table.is_isotropic) == ("brass", "asg", 1, True)
        assert table.alpha[-1, 0] == pytest.approx([0.2, 0.2], rel=0.05)
        assert table.cosine_l2[-1, 0] > 0.98
        assert (tmp_path / "brass.png").read_bytes()[:4] == b"\x89PNG"
        assert f"Wrote {out} and" in capsys.readouterr().out

    def test_an_anisotropic_one_by_its_shape(self, scene, tmp_path):
        out = tmp_path / "rod.lobes"
        line = ["fit", "--mitsuba", f"{scene}#rod", "-o", str(out), "--lobes", "1", "--kind", "sg", "--no-plot"]
        assert run(line) == 0
        table = read_lobe_table(out)
        assert table.azimuth.size == 8
        # The first azimuth is along the tangent of the BSDF, the third across it.
        assert table.alpha[-2, 0] == pytest.approx([0.4, 0.15], rel=0.1)
        assert table.alpha[-2, 2] == pytest.approx([0.15, 0.4], rel=0.1)

    @pytest.mark.parametrize(
        ("reference", "words"),
        [
            ("{}#bras", "such as brass,"),
            ("{}#ball", "expected a glossy lobe"),
            ("{}", "expected SCENE#ID"),
            ("{}#", "expected SCENE#ID"),
            ("#brass", "expected SCENE#ID"),
            ("{}.xml#brass", "expected a Mitsuba XML file"),
            ("showrom#plate", "did you mean 'showroom'?"),
            ("brushed#inner", "name the shape that carries it"),
        ],
    )
    def test_mistakes(self, scene, tmp_path, reference, words, capsys):
        before = sorted(tmp_path.iterdir())
        assert words in str(fail(capsys, "fit", "--mitsuba", reference.format(scene), "-o", tmp_path / "a.lobes"))
        assert sorted(tmp_path.iterdir()) == before


def test_the_program_can_be_called_again_and_again() -> None:
    code = "from lobewise.cli import main\nfor _ in 'ab':\n    try: main(['devices'])\n    except SystemExit: pass\n"
    code += "import lobewise.cli\nassert lobewise.cli.main is main"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0
