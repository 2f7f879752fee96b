"""Files denoised in bands: the bytes of those denoised as a whole, and the same account of it."""

import errno
import os
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.denoising import denoise
from lobewise.denoising.automatic import ask
from lobewise.denoising.inputs import list_images
from lobewise.errors import CancelledError, FileError, InputError, LobewiseError
from lobewise.io import read_frame, write_frame
from lobewise.io.exr.bands import BandReader, BandWriter
from lobewise.recipes.streaming import plan
from lobewise.recipes.streaming import recipe as streaming
from lobewise.recipes.streaming.plan import CHECKED_REACH, choose_rows, estimate_bytes, needs_bands
from lobewise.recipes.streaming.recipe import denoise_file
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.settings import DenoiseSettings
from lobewise.settings.choices import QUALITIES
from lobewise.work.progress import Progress
from tests.mistakes import refuses
from tests.streaming.frames import add_bad_pixels, change_radiance, compare_bands, make_scene

pytestmark = pytest.mark.nightly  # every quality and form, whole and in bands

SHAPE = (83, 19)
HEIGHTS = (1, 10, 33, 83)
"""Rows of a band; fewer of them where filters are slow."""


def compare(frame: Frame, folder: Path, heights: tuple[int, ...] = HEIGHTS, **settings: Any) -> lobewise.Result:
    """Raise AssertionError unless bands give the file that the whole frame does; return that frame's result."""
    write_frame(folder / "in.exr", frame, half=False)
    result, notes = compare_bands(folder / "in.exr", heights, **settings)
    assert notes == {result.notes}
    return result


def make_bad(**options: Any) -> Frame:
    """Return a frame with bad pixels next to where bands begin and end."""
    return add_bad_pixels(make_scene(SHAPE, **options), [0, 9, 10, 19, 32, 33, 34, 49, 50, 66, 82])


@pytest.mark.parametrize("apart", [False, True])
def test_light_of_fireflies_is_shared_out_over_the_whole_image(apart: bool, tmp_path: Path) -> None:
    frame = make_scene(SHAPE, halves=False, apart=apart)
    color, parts = np.array(frame.radiance.color), frame.radiance.parts
    spots = np.zeros_like(color)
    spots[3::13, 3::13] = 20.0
    light = Radiance(color + spots) if parts is None else Radiance(color + spots, parts[0] + spots, parts[1])
    found = compare(frame.with_changes(radiance=light), tmp_path, (10, 33), quality="balanced")
    # Nine fireflies prove so much light, and no more.
    kept = (1.0 - found.energy_lost) * light.color.sum(dtype=np.float64)
    assert found.image.sum(dtype=np.float64) == pytest.approx(kept, rel=0.005)
    assert found.energy_lost < 0.03
    assert [note for note in found.notes if "of the light was shared out" in note]


@pytest.mark.parametrize("similarity", ["normal", "sg", "ggx", "sg_mixture"])
def test_fast_in_bands_is_fast(similarity: str, tmp_path: Path) -> None:
    compare(make_bad(), tmp_path, quality="fast", similarity=similarity)


@pytest.mark.parametrize(
    "settings",
    [
        {"form": "separable"},
        {"form": "atrous"},
        {"radius": 0},
        {"radius": 20, "similarity": "normal"},
        {"similarity": "normal", "band_limit": 1.0},
        {"similarity": "sg", "beta": 3.0, "diffuse_beta": 3.0, "tau": 0.05, "screen_sigma": 4.0},
    ],
    ids=str,
)
def test_every_form_and_option_of_fast(settings: dict[str, Any], tmp_path: Path) -> None:
    compare(make_bad(), tmp_path, **{"quality": "fast", "similarity": "sg", **settings})


@pytest.mark.parametrize("apart", [True, False], ids=["apart", "combined"])
@pytest.mark.parametrize("halves", [True, False], ids=["halves", "checkerboard"])
def test_balanced_in_bands_is_balanced(halves: bool, apart: bool, tmp_path: Path) -> None:
    compare(make_bad(halves=halves, apart=apart), tmp_path, (7, 33, 83), quality="balanced", similarity="sg")


def test_balanced_with_lobes_of_two_axes(tmp_path: Path) -> None:
    # What hangs on the similarity is the lobes of a band, which "fast" has for each of them.
    compare(make_bad(), tmp_path, (10, 33), quality="balanced", similarity="ggx")


@pytest.mark.parametrize(("similarity", "halves"), [("ggx", True), ("normal", False)])
def test_high_in_bands_is_high(similarity: str, halves: bool, tmp_path: Path) -> None:
    # Bands leave out what lamps out of focus take.
    frame = leave_out(make_bad(halves=halves), "blur_radius")
    compare(frame, tmp_path, (10, 33), quality="high", similarity=similarity)


def leave_out(frame: Frame, *names: str) -> Frame:
    """Return the frame without some of its guides."""
    return frame.with_changes(gbuffer=replace(frame.gbuffer, **dict.fromkeys(names)))


@pytest.mark.parametrize("missing", ["position", "depth"])
@pytest.mark.parametrize("similarity", ["sg", "ggx", "sg_mixture"])
def test_rays_of_a_band_are_those_of_the_frame(similarity: str, missing: str, tmp_path: Path) -> None:
    frame = leave_out(make_scene(SHAPE), missing, "coverage")
    compare(frame, tmp_path, (33,), quality="fast", similarity=similarity)


def test_materials_see_the_rays_of_the_frame(full_frame: Frame, tmp_path: Path) -> None:
    tables = full_frame.lobe_tables
    material = np.random.default_rng(3).integers(0, 3, SHAPE)
    scene = make_scene(SHAPE)
    frame = leave_out(scene, "position").with_changes(lobe_tables=tables)
    frame = frame.with_changes(gbuffer=replace(frame.gbuffer, material=material))
    compare(frame, tmp_path, (33,), quality="fast", similarity="sg_mixture")
    compare(frame, tmp_path, (33,), quality="fast", similarity="sg_mixture", lobe_tables=tables[::-1])


@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_a_flat_image_without_camera(quality: str, tmp_path: Path) -> None:
    scene = make_scene(SHAPE)
    frame = Frame(Radiance(scene.radiance.color), GBuffer(normal=scene.gbuffer.normal))
    compare(frame, tmp_path, quality=quality)


def test_the_noise_is_that_of_the_whole_frame(tmp_path: Path) -> None:
    frame = make_scene(SHAPE)
    noisy = np.array(frame.variance.color)
    noisy[:40] *= 100.0
    frame = frame.with_changes(variance=Radiance(noisy))
    result = compare(frame, tmp_path, quality="fast", similarity="normal")
    others = denoise(
        frame.with_changes(variance=Radiance(noisy[::-1] * 0.0 + 1e-6)), quality="fast", similarity="normal"
    )
    assert result.settings["screen_sigma"] != others.settings["screen_sigma"]


def test_holes_are_filled_across_bands(tmp_path: Path) -> None:
    # Too far from anything for the first round, then the second, then all of them.
    frame = leave_out(make_scene((560, 5)), "coverage")
    for rows in (slice(20, 50), slice(100, 230)):
        frame = change_radiance(frame, rows, slice(None), np.nan)
    result = compare(frame, tmp_path, (7, 64, 560), quality="fast", similarity="normal", form="separable")
    assert np.isfinite(result.image).all()
    frame = change_radiance(frame, slice(20, 540), slice(None), np.nan)
    result = compare(frame, tmp_path, (7, 64, 200, 560), quality="fast", similarity="normal", form="separable")
    good = np.concatenate([frame.radiance.color[:20], frame.radiance.color[540:]]).astype(np.float64)
    np.testing.assert_allclose(result.image[280], np.broadcast_to(good.mean(axis=(0, 1)), (5, 3)), rtol=1e-6)


def test_the_file_may_be_replaced_by_its_own_result(tmp_path: Path) -> None:
    path = tmp_path / "frame.exr"
    write_frame(path, make_scene(SHAPE))
    expected = denoise(read_frame(path), quality="fast", similarity="sg").image
    denoise_file(path, path, quality="fast", similarity="sg", rows=20)
    np.testing.assert_allclose(read_frame(path).radiance.color, expected, rtol=1e-3)


@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_images_that_are_not_read_do_not_matter(quality: str, make_frame: Any) -> None:
    asked = ask(None, {"quality": quality, "similarity": "sg_mixture"})
    frame = make_frame(height=12, width=14)
    frame = frame.with_changes(gbuffer=replace(frame.gbuffer, position=make_scene((12, 14)).gbuffer.position))
    wanted = list_images(asked)

    def strip(owner: str) -> Any:
        part = getattr(frame, owner)
        kept = {item.name: getattr(part, item.name) for item in fields(part) if (owner, item.name) in wanted}
        return (GBuffer if owner == "gbuffer" else Radiance)(**kept) if kept else None

    bare = frame.with_changes(
        **{owner: strip(owner) for owner in ("radiance", "gbuffer", "half_a", "half_b", "variance")}
    )
    one, other = (denoise(each, asked) for each in (frame, bare))
    np.testing.assert_array_equal(one.image, other.image)
    assert one.settings == other.settings


def test_progress_goes_over_the_frame_twice(tmp_path: Path) -> None:
    write_frame(tmp_path / "in.exr", make_scene(SHAPE))
    told: list[Progress] = []
    options: dict[str, Any] = {"quality": "fast", "similarity": "normal", "rows": 40}
    denoise_file(tmp_path / "in.exr", tmp_path / "out.exr", progress=told.append, **options)
    stages = [each.stage for each in told]
    assert list(dict.fromkeys(stages)) == ["measuring", "filtering", "writing", "done"]
    # Measuring is 1 of 4.5, and both begin at rows 0, 27 and 55 of 83.
    shares = np.array([each.share for each in told])
    for stage, first, cost in (("measuring", 0.0, 1.0), ("filtering", 1.0, 3.0)):
        for rows in (0, 27, 55):
            where = (first + cost * rows / 83) / 4.5
            assert np.isclose(shares[[each == stage for each in stages]], where).any(), (stage, rows)


def test_a_frame_is_measured_where_something_hangs_on_it(tmp_path: Path) -> None:
    # Nothing, the noise, levels; what is beyond the reach of all holes.
    frame = make_scene(SHAPE)
    bare = frame.with_changes(variance=None)
    far = change_radiance(
        leave_out(make_scene((420, 5)), "coverage").with_changes(variance=None), slice(9, 420), slice(None), np.nan
    )
    options: dict[str, Any] = {"similarity": "normal", "rows": 40}
    for case, quality, expected in (
        (bare, "fast", False),
        (frame, "fast", True),
        (bare, "balanced", True),
        (far, "fast", True),
    ):
        write_frame(tmp_path / "in.exr", case)
        told: list[Progress] = []
        denoise_file(tmp_path / "in.exr", tmp_path / "out.exr", quality=quality, progress=told.append, **options)
        assert any(each.stage == "measuring" for each in told) == expected


class Stop(BaseException):
    """As KeyboardInterrupt, which pytest takes for itself."""


@pytest.mark.parametrize("way", ["raises", "returns False"])
@pytest.mark.parametrize(
    "moment", [("measuring", 0.05), ("filtering", 0.3), ("filtering", 0.6), ("writing", 0.8)], ids=str
)
def test_whatever_interrupts_leaves_no_trace(moment: tuple[str, float], way: str, tmp_path: Path) -> None:
    write_frame(tmp_path / "in.exr", make_scene(SHAPE))
    (tmp_path / "out.exr").write_text("before")

    def stop(record: Progress) -> bool | None:
        if record.stage != moment[0] or record.share < moment[1]:
            return None
        if way == "raises":
            raise Stop
        return False

    with pytest.raises(Stop if way == "raises" else CancelledError):
        denoise_file(
            tmp_path / "in.exr", tmp_path / "out.exr", quality="fast", similarity="normal", rows=40, progress=stop
        )
    assert sorted(os.listdir(tmp_path)) == ["in.exr", "out.exr"]
    assert (tmp_path / "out.exr").read_text() == "before"


def test_a_full_disk_is_told_and_leaves_no_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_frame(tmp_path / "in.exr", make_scene(SHAPE))

    def fill(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for moment in ("_encode", "_list_chunks"):
        with monkeypatch.context() as patch:
            patch.setattr(BandWriter, moment, fill)
            with refuses(FileError, "output 'out.exr'", "no space left on device"):
                denoise_file(tmp_path / "in.exr", tmp_path / "out.exr", quality="fast", similarity="normal", rows=40)
        assert os.listdir(tmp_path) == ["in.exr"]


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({"rows": 0}, ("rows", "0")),
        ({"rows": 2.5}, ("rows", "2.5")),
        ({"rows": True}, ("rows", "True")),
        ({"memory": 0.0}, ("memory", "0.0")),
        ({"memory": float("nan")}, ("memory", "nan")),
        ({"with_oidn": True}, ("with_oidn",)),
        ({"radius": -1}, ("radius",)),
        ({"raduis": 1}, ("setting",)),
        ({"similarity": "sg_mixture", "lobes": 9}, ("lobes",)),
    ],
    ids=str,
)
def test_bad_arguments_are_refused(changes: dict[str, Any], refused: tuple[str, ...], tmp_path: Path) -> None:
    with refuses(InputError, *refused):
        denoise_file(tmp_path / "none.exr", tmp_path / "out.exr", **changes)


def test_what_a_frame_cannot_do_is_told_alike(tmp_path: Path) -> None:
    scene = make_scene(SHAPE)
    bad = change_radiance(scene, slice(None), slice(None), np.nan)
    for frame, settings in (
        (bad, {}),
        (leave_out(scene, "alpha_u"), {"similarity": "ggx"}),
        (leave_out(scene, "tangent"), {"similarity": "ggx", "quality": "balanced"}),
        (scene.with_changes(camera=None), {"similarity": "sg"}),
    ):
        write_frame(tmp_path / "in.exr", frame)
        with pytest.raises(LobewiseError) as expected:
            denoise(read_frame(tmp_path / "in.exr"), **{"quality": "fast", **settings})
        with pytest.raises(type(expected.value)) as found:
            denoise_file(tmp_path / "in.exr", tmp_path / "out.exr", rows=20, **{"quality": "fast", **settings})
        assert str(found.value) == str(expected.value)
        assert os.listdir(tmp_path) == ["in.exr"]
    with refuses(FileError, "output 'out.exr'", "no folder 'none'"):
        denoise_file(tmp_path / "in.exr", tmp_path / "none" / "out.exr")


def test_rows_fit_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_frame(tmp_path / "in.exr", make_scene(SHAPE))
    asked = ask(DenoiseSettings(), {"quality": "fast", "similarity": "sg", "screen_sigma": 1.0, "tau": 0.1})
    reader = BandReader(tmp_path / "in.exr", wanted=list_images(asked))
    pixel = sum(reader.count_bytes()) + QUALITIES["fast"].work_bytes_per_pixel
    high = ask(None, {"quality": "high"})
    assert estimate_bytes(reader, high) == reader.count_bytes()[1] + QUALITIES["high"].work_bytes_per_pixel
    for rows in (300, 1000):
        memory = (rows + 0.5) * SHAPE[1] * pixel / 2**30
        assert choose_rows(reader, asked, None, memory) == rows - 2 * (8 + CHECKED_REACH)
    assert choose_rows(reader, asked, None, 1e-9) == 32
    assert not needs_bands(reader, asked)
    for rows, large in ((SHAPE[0] + 1, False), (SHAPE[0] - 1, True)):
        monkeypatch.setattr(plan, "MAX_WHOLE_GIB", rows * SHAPE[1] * pixel / 2**30)
        assert needs_bands(reader, asked) == large
    taken: list[float] = []
    monkeypatch.setattr(streaming, "choose_rows", lambda reader, settings, rows, memory: taken.append(memory) or 30)
    done = denoise_file(tmp_path / "in.exr", tmp_path / "out.exr", memory=0.5, quality="fast", similarity="normal")
    assert (done.bands, taken) == (3, [0.5])
