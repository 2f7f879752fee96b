"""What a file has and denoising cannot use is named with its reason, and never passed over in silence."""

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from renderers import HEIGHT, WIDTH, WRITERS, make_scene, name, write

from lobewise.errors import FileError, InputError, MissingChannelError
from lobewise.interchange.importing.draft import Draft, Outcome, Step
from lobewise.interchange.preset import CONVERSIONS, CONVERSIONS_OF, ROLES, look_up_preset
from lobewise.interchange.reading import import_file
from tests.mistakes import refuses

SCENE = make_scene()
WHOLE = (np.zeros(2, np.int32), np.array([WIDTH - 1, HEIGHT - 1], np.int32))
COLOR = name("", SCENE.color)


def save(path: Path, *parts: tuple[str, dict[str, Any]], **header: Any) -> Path:
    """Write a file of one part or several, each a name and its channels, all within one display window."""
    fields = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, "displayWindow": WHOLE, **header}
    # The library changes the dictionaries that it is given.
    made = [OpenEXR.Part(dict(fields), dict(channels), title) for title, channels in parts]
    (OpenEXR.File(made) if len(made) > 1 else OpenEXR.File(fields, dict(parts[0][1]))).write(str(path))
    return path


def halve(image: np.ndarray) -> dict[str, np.ndarray]:
    return {key: np.ascontiguousarray(plane[::2, ::2]) for key, plane in name("", image, "XYZ").items()}


def write_chroma(path: Path, luminance: str = "Y") -> Path:
    gray = SCENE.color.mean(axis=-1)
    small = {key: OpenEXR.Channel(key, gray, 2, 2) for key in ("RY", "BY")}
    return save(path, ("", {luminance: OpenEXR.Channel(luminance, gray, 1, 1), **small}))


class TestNoImage:
    def test_luminance_and_chroma(self, tmp_path: Path) -> None:
        """No option is advised, because none helps."""
        path = write_chroma(tmp_path / "a.exr")
        with refuses(MissingChannelError, "input 'a.exr'", "luminance and chroma (Y, RY, BY), which are not read"):
            import_file(path)
        with refuses(InputError, "--map color, channel 'RY'", "one that is subsampled, with one value for 2x2 pixels"):
            import_file(path, mapping={"color": "Y,RY,BY"})

    def test_subsampled_color(self, tmp_path: Path) -> None:
        planes = {key: OpenEXR.Channel(key, plane, 2, 2) if key == "B" else plane for key, plane in COLOR.items()}
        path = save(tmp_path / "a.exr", ("", planes))
        with refuses(MissingChannelError, "input 'a.exr'", "B with less than one value for each pixel"):
            import_file(path)

    def test_a_part_for_each_color(self, tmp_path: Path) -> None:
        """No option is advised, because none joins parts."""
        parts = [(f"rgba.{key}", {key: plane}) for key, plane in COLOR.items()]
        with pytest.raises(MissingChannelError, match=r"each of them in a part of its own \(R, G, B\); save the file"):
            import_file(save(tmp_path / "a.exr", *parts))

    def test_gray(self, tmp_path: Path) -> None:
        """The option that is advised is taken."""
        path = save(tmp_path / "a.exr", ("", {"Y": COLOR["R"]}))
        with refuses(MissingChannelError, "input 'a.exr'", "only Y"):
            import_file(path)
        assert np.array_equal(import_file(path, mapping={"color": "Y,Y,Y"}).frame.radiance.color[..., 2], COLOR["R"])


def list_told(path: Path, **options: Any) -> list[str]:
    return [note for note in import_file(path, **options).notes if "normal" in note]


class TestNormals:
    def test_half_size_in_another_part(self, tmp_path: Path) -> None:
        position = "position", name("", SCENE.position, "XYZ")
        path = save(tmp_path / "a.exr", ("rgb", COLOR), ("normal", halve(SCENE.normal)), position)
        told = list_told(path)
        assert "normal.X/Y/Z is not used as normal: it has 24x18 pixels, the image 48x36." in told
        assert any(note.startswith("No normal that can be used: ") for note in told)
        assert not any("there is no normal" in note for note in told)
        with refuses(InputError, "--map normal", "one that has 24x18 pixels, the image 48x36"):
            import_file(path, mapping={"normal": "normal"})

    def test_other_pixels(self, tmp_path: Path) -> None:
        window = (np.array([0, 1], np.int32), np.array([WIDTH - 1, HEIGHT], np.int32))
        fields = {"type": OpenEXR.scanlineimage, "displayWindow": WHOLE}
        moved = OpenEXR.Part({**fields, "dataWindow": window}, name("", SCENE.normal, "XYZ"), "normal")
        OpenEXR.File([OpenEXR.Part(fields, dict(COLOR), "rgb"), moved]).write(str(tmp_path / "a.exr"))
        assert any("it covers other pixels than the image" in note for note in list_told(tmp_path / "a.exr"))

    def test_passes_that_are_there_are_not_to_be_switched_on(self, tmp_path: Path) -> None:
        parts = ("normal", halve(SCENE.normal)), ("albedo", halve(SCENE.diffuse_albedo))
        path = save(tmp_path / "a.exr", ("rgb", COLOR), *parts, generatedBy="Mitsuba version 3.6.0")
        (told,) = (note for note in import_file(path).notes if note.startswith("Of a color image alone"))
        assert (
            ": give normal and albedo the channels and the pixels of the image, and switch on in Mitsuba 3: aovs"
            in told
        )
        assert "sh_normal" not in told
        assert "albedo:albedo" not in told

    def test_two_components(self, tmp_path: Path) -> None:
        path = save(tmp_path / "a.exr", ("", COLOR | name("N", SCENE.normal[..., :2], "XY")))
        assert "N.X/Y is not used as normal: X, Y and Z are needed." in list_told(path)

    def test_subsampled(self, tmp_path: Path) -> None:
        small = {
            key: OpenEXR.Channel(key, np.ascontiguousarray(plane), 2, 2)
            for key, plane in name("N", SCENE.normal, "XYZ").items()
        }
        path = save(tmp_path / "a.exr", ("", COLOR | small))
        assert any("not used as normal: it is subsampled" in note for note in list_told(path))

    def test_channels_of_two_parts_are_refused(self, tmp_path: Path) -> None:
        path = save(tmp_path / "a.exr", ("rgb", COLOR), ("normal", name("", SCENE.normal, "XYZ")))
        with refuses(InputError, "--map normal"):
            import_file(path, mapping={"normal": "X,Y,R"})

    def test_whole_ones_are_used_in_silence(self, tmp_path: Path) -> None:
        path = save(tmp_path / "a.exr", ("rgb", COLOR), ("normal", name("", SCENE.normal, "XYZ")))
        assert not any("not used as" in note or "No normal" in note for note in list_told(path)), list_told(path)


def test_a_layer_that_lacks_a_pass_names_it(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", WRITERS["cycles"](SCENE).leave_out(".GlossInd."))
    assert "The layer glossy is left out: the file has no pass GlossInd." in import_file(tmp_path / "a.exr").notes


class TestPresets:
    def test_passes_that_match_nothing_are_named(self, tmp_path: Path) -> None:
        path, preset = tmp_path / "a.exr", tmp_path / "mine.toml"
        save(path, ("", COLOR | name("N", SCENE.normal, "XYZ")))
        layer = '[[layer]]\nname = "diffuse"\nlobe = "diffuse"\nlight = ["Lambert"]\n'
        preset.write_text('normal = ["N"]\nroughness = ["rough", "gloss"]\n' + layer)
        notes = import_file(path, preset=preset).notes
        assert "The preset names 'rough' or 'gloss' for roughness, and the file has no such pass." in notes
        assert "The layer diffuse is left out: the file has no pass Lambert." in notes
        assert not any("names 'N'" in note for note in notes)

    @pytest.mark.parametrize(
        ("text", "refused"),
        [
            ("\n", ("preset 'mine.toml'", "none")),
            ("# nothing\n", ("preset 'mine.toml'", "none")),
            ('title = "Mine"\n', ("preset 'mine.toml'", "none")),
            ('normal = [{ pass = "N", convert = ["square"] }]', ("preset 'mine.toml', normal, conversion", "'square'")),
            (
                'color = ["C"]\nnormal = [{ pass = "n", convert = ["upside"] }]',
                ("preset 'mine.toml', normal, conversion", "'upside'"),
            ),
            ("title = ", ("preset 'mine.toml'", "text that is no TOML: it ends too soon")),
            ('title = "x"\ncolour = ["beauty"]', ("preset 'mine.toml', key",)),
            ('layer = [{ name = "d", lobe = "matte", light = ["lambert"] }]', ("preset 'mine.toml', layer, lobe",)),
        ],
    )
    def test_one_that_makes_no_sense_is_refused(self, text: str, refused: tuple[str, ...], tmp_path: Path) -> None:
        (tmp_path / "mine.toml").write_text(text)
        with refuses((InputError, FileError), *refused):
            look_up_preset(tmp_path / "mine.toml")

    def test_an_unknown_renderer_gives_nothing_by_any_menu(self, tmp_path: Path) -> None:
        position = "position", name("", SCENE.position, "XYZ")
        notes = import_file(save(tmp_path / "a.exr", ("rgb", COLOR), position)).notes
        wanted = "No normal: edges and bumps are guessed from the image; give a pass named normal, in world space."
        assert wanted in notes
        assert not any("gives it by" in note for note in notes)


class TestConversions:
    @pytest.mark.parametrize(
        ("role", "text", "got"),
        [
            ("normal", "N.X,N.Y,N.Z:square", "'square'"),
            ("normal", "N:y_up", "'y_up'"),
            ("color", "N:encoded", "'encoded'"),
            ("position", "N:camera_space", "'camera_space'"),
        ],
    )
    def test_only_those_of_the_role_are_taken(self, role: str, text: str, got: str, tmp_path: Path) -> None:
        path = save(tmp_path / "a.exr", ("", COLOR | name("N", SCENE.normal, "XYZ")))
        with refuses(InputError, f"--map {role}, conversion", got):
            import_file(path, mapping={role: text})

    def test_every_conversion_is_one_of_a_role(self) -> None:
        assert {word for words in CONVERSIONS_OF.values() for word in words} == set(CONVERSIONS)
        assert set(CONVERSIONS_OF) <= set(ROLES)


@pytest.mark.parametrize("need", ["nromal", "run", ""])
def test_a_step_that_could_never_run_is_refused(need: str) -> None:
    def take_normals(draft: Draft) -> Outcome:
        return Outcome(draft)

    assert Step(take_normals, needs=("normal", "albedos")).needs == ("normal", "albedos")
    with pytest.raises(ValueError, match=rf"take_normals.*{need}"):
        Step(take_normals, needs=("normal", need))
