"""One line names the noisy images of a file that denoising leaves as they are."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from renderers import WRITERS, Written, make_scene, name, read_channels, write

import lobewise
from lobewise.cli.program import run
from lobewise.denoising.plan import foretell
from lobewise.interchange import siblings
from lobewise.interchange.reading import import_file
from lobewise.io import write_frame
from lobewise.recipes.temporal.recipe import ALSO_STAYS
from lobewise.records.frame import Frame, GBuffer, Radiance

LAYER = "View Layer.001"


def list_left(path: Path, **options: object) -> list[str]:
    """Return the lines that the frame of a file carries."""
    return [note for note in lobewise.read_frame(path, **options).notes if note.startswith("Left noisy")]  # type: ignore[arg-type]


def write_frame_of(path: Path, *changes: Callable[[Written], object], renderer: str = "cycles") -> Written:
    """Write the scene with more passes, or with fewer."""
    written = WRITERS[renderer](make_scene())
    for change in changes:
        change(written)
    write(path, written)
    return written


def copy_layer(written: Written, other: str) -> None:
    """Add the passes of the view layer again under another name, with other noise."""
    for key, plane in list(written.channels.items()):
        written.channels[key.replace(LAYER, other)] = plane[::-1]


def add_eyes(written: Written) -> None:
    """Name every channel twice, once for each eye, as Blender does."""
    for key, plane in list(written.channels.items()):
        head, _, component = key.rpartition(".")
        del written.channels[key]
        written.channels |= {f"{head}.{eye}.{component}": plane for eye in ("left", "right")}


def add_groups(written: Written) -> None:
    color = make_scene().color
    lamp = np.linspace(0.1, 0.9, color.shape[1], dtype=np.float32)[None, :, None] * color
    for group, light in (("lamp", lamp), ("sky", color - lamp)):
        written.channels |= name(f"{LAYER}.Combined_{group}", light)


def add_bands(written: Written) -> None:
    for wavelength in ("450,00", "550,00", "650,00"):
        written.channels[f"S0.{wavelength}nm"] = make_scene().color[..., 0]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda written: copy_layer(written, "Wood"), "view layer 'Wood'"),
        (lambda written: [copy_layer(written, f"W{k}") for k in range(6)], "view layers 'W0', 'W1', 'W2', 'W3' and 2"),
        (add_eyes, "view 'right'"),
        (add_bands, "3 spectral bands"),
        (lambda written: written.leave_out("GlossCol"), "passes of light 'GlossDir', 'GlossInd'"),
    ],
)
def test_each_kind_is_named(change: Callable[[Written], object], told: str, tmp_path: Path) -> None:
    write_frame_of(tmp_path / "plain.exr")
    assert list_left(tmp_path / "plain.exr") == []
    write_frame_of(tmp_path / "more.exr", change)
    (line,) = list_left(tmp_path / "more.exr")
    assert line.startswith(f"Left noisy: {told}")
    assert line.endswith(".")


def test_kinds_share_one_line(tmp_path: Path) -> None:
    write_frame_of(tmp_path / "a.exr", add_bands, lambda written: copy_layer(written, "Wood"))
    assert list_left(tmp_path / "a.exr") == [
        "Left noisy: view layer 'Wood', 3 spectral bands (--also '*nm' takes all)."
    ]


def test_a_copy_of_the_picture_is_named(tmp_path: Path) -> None:
    written = write_frame_of(tmp_path / "a.exr", renderer="mitsuba")
    assert list_left(tmp_path / "a.exr") == ["Left noisy: copy of the picture 'image'."]
    for key in [key for key in written.channels if key.startswith("image")]:
        # Another image than the picture is no copy.
        written.channels[key] = np.ones_like(written.channels[key])
    write(tmp_path / "b.exr", written)
    assert list_left(tmp_path / "b.exr") == []


def test_all_three_places_say_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, told = tmp_path / "a.exr", "Left noisy: 3 spectral bands (--also '*nm' takes all)."
    write_frame_of(path, add_bands)
    assert lobewise.denoise(lobewise.read_frame(path), quality="fast").notes[0] == told
    assert run(["denoise", str(path), "-o", str(tmp_path / "b.exr"), "--quality", "fast"]) == 0
    assert told in " ".join(capsys.readouterr().err.split())
    assert run(["inspect", str(path)]) == 0
    assert told in " ".join(capsys.readouterr().out.split())
    temporal = lobewise.TemporalFilter()
    assert temporal.add(lobewise.read_frame(path)).notes[0] == told
    frames = [lobewise.read_frame(path)] * 2
    assert told in lobewise.WindowFilter(1, quality="fast").denoise(frames, 0).notes


def test_what_is_filtered_is_not_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    written = write_frame_of(path, add_groups)
    command = ["denoise", str(path), "-o", str(tmp_path / "b.exr"), "--quality", "fast"]
    groups = [key for key in written.channels if "Combined_" in key]
    for options, is_filtered in (([], True), (["--also", "Combined_*"], True), (["--no-light-groups"], False)):
        assert run([*command, *options]) == 0
        told = " ".join(capsys.readouterr().err.split())
        assert ("Left noisy: light groups 'lamp', 'sky'." in told) != is_filtered
        assert ("Light groups 'lamp', 'sky': each denoised by itself." in told) == is_filtered
        after = read_channels(tmp_path / "b.exr")
        assert all(np.array_equal(after[key], written.channels[key]) != is_filtered for key in groups)


def test_light_groups_are_read_at_once_and_before_other_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = WRITERS["cycles"](make_scene())
    add_groups(written)
    written.channels |= name(f"{LAYER}.AO", np.full_like(make_scene().color, 1e-3))
    path, calls = tmp_path / "a.exr", []
    write(path, written)
    decode = siblings.decode_part
    monkeypatch.setattr(siblings, "decode_part", lambda *each: calls.append(each[2]) or decode(*each))
    frame = import_file(path, also=["AO"], light_passes=True).frame
    assert sum(any("Combined_" in channel for channel in names) for names in calls) == 1
    assert [each.rpartition(".")[2] for each in frame.also] == ["Combined_lamp", "Combined_sky", "AO"]
    result = lobewise.denoise(frame, quality="fast")
    groups = [result.also[each] for each in list(frame.also)[:2]]
    np.testing.assert_allclose(groups[0] + groups[1], result.image, rtol=1e-5, atol=1e-6)
    assert sum("by itself" in line for line in foretell(frame, lobewise.DenoiseSettings(quality="fast"))) == 3


def test_the_pass_of_a_shadow_catcher_is_denoised(rng: np.random.Generator, tmp_path: Path) -> None:
    written = WRITERS["cycles"](make_scene())
    shape = make_scene().color.shape
    shadow = np.clip(rng.normal(0.6, 0.2, shape), 0.0, 1.0).astype(np.float32)
    for image, is_denoised in ((shadow, True), (np.ones(shape, np.float32), False)):
        written.channels |= name(f"{LAYER}.Shadow Catcher", image)
        write(tmp_path / "a.exr", written)
        frame = lobewise.read_frame(tmp_path / "a.exr")
        assert list(frame.also) == ([f"{LAYER}.Shadow Catcher"] if is_denoised else [])
    written.channels |= name(f"{LAYER}.Shadow Catcher", shadow)
    write(tmp_path / "a.exr", written)
    assert run(["denoise", str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.exr"), "--quality", "fast"]) == 0
    after = read_channels(tmp_path / "b.exr")[f"{LAYER}.Shadow Catcher.R"]
    assert np.std(after) < 0.8 * np.std(shadow[..., 0])


@pytest.mark.parametrize(("renderer", "start"), [("arnold", "RGBA"), ("renderman", "Ci"), ("karma", "C")])
def test_light_groups_of_other_renderers_are_found(renderer: str, start: str, tmp_path: Path) -> None:
    written, color = WRITERS[renderer](make_scene()), make_scene().color
    for group, share in (("key", 0.7), ("fill", 0.3)):
        written.channels |= name(f"{start}_{group}", np.float32(share) * color)
    write(tmp_path / "a.exr", written)
    assert set(lobewise.read_frame(tmp_path / "a.exr").also) == {f"{start}_key", f"{start}_fill"}


def test_light_groups_sum_to_the_image_and_others_are_none_of_it(tmp_path: Path) -> None:
    written = write_frame_of(tmp_path / "a.exr", add_groups)
    frame = lobewise.read_frame(tmp_path / "a.exr")
    assert set(frame.also) == {f"{LAYER}.Combined_lamp", f"{LAYER}.Combined_sky"}
    for quality in ("fast", "balanced"):
        result = lobewise.denoise(frame, quality=quality)
        np.testing.assert_allclose(sum(result.also[each] for each in frame.also), result.image, rtol=1e-5, atol=1e-6)
    assert lobewise.TemporalFilter().add(frame).notes.count(ALSO_STAYS) == 1
    # More light than the image has, as an albedo in the dark, or an image without noise.
    color = make_scene().color
    for light in (3.0 * color, np.full_like(color, 0.01)):
        for group in ("lamp", "sky"):
            written.channels |= name(f"{LAYER}.Combined_{group}", light)
        write(tmp_path / "b.exr", written)
        assert not lobewise.read_frame(tmp_path / "b.exr").also
        assert list_left(tmp_path / "b.exr") == ["Left noisy: light groups 'lamp', 'sky'."]


def test_what_lobewise_wrote_before_is_not_named(tmp_path: Path) -> None:
    write_frame_of(tmp_path / "a.exr")
    assert run(["denoise", str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.exr"), "--suffix", "_clean"]) == 0
    assert list_left(tmp_path / "b.exr") == []


def test_a_picture_that_the_user_did_not_choose_is_named(tmp_path: Path) -> None:
    write_frame_of(tmp_path / "a.exr", add_groups)
    (line,) = list_left(tmp_path / "a.exr", mapping={"color": "Combined_lamp"})
    assert "light group 'sky'" in line
    assert f"picture '{LAYER}.Combined'" in line


def test_light_of_a_file_in_lobewises_names(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    color = rng.gamma(1.0, 1.0, (12, 16, 3)).astype("f4")
    normal = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), color.shape)
    path, told = tmp_path / "a.exr", "Left noisy: passes of light 'direct', 'indirect'."
    write_frame(path, Frame(Radiance(color, direct=0.5 * color, indirect=0.5 * color), GBuffer(normal=normal)))
    assert list_left(path) == [told]
    for bands in ("off", "4"):
        assert run(["denoise", str(path), "-o", str(tmp_path / "b.exr"), "--quality", "fast", "--bands", bands]) == 0
        assert told in capsys.readouterr().err
    assert run(["inspect", str(path)]) == 0
    assert told in " ".join(capsys.readouterr().out.split())
